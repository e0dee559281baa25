//! Sets of tiles. Each set is stored as the tiles in which it differs from the set before, in ranges of ids.
//!
//! Between two scans a moving robot gains and loses a few tiles; a standing robot observes the same tiles.
//! Invariant: a set ascends and holds no tile twice; a set that is read holds only tiles below the limit given.

use tidemap_grid::index::TileId;

use super::{
    Invalid,
    varint::{push_varint, take_u32, take_varint},
};

/// Appends a set. Both sets must ascend.
pub(crate) fn push_set(out: &mut Vec<u8>, before: &[TileId], set: &[TileId]) -> Result<(), Invalid> {
    if !set.is_sorted_by(|one, next| one < next) {
        return Err("the tiles of a set do not ascend");
    }
    let ranges = ranges(differences(before, set));
    push_varint(out, ranges.len() as u64);
    let mut end = 0;
    for (first, last) in ranges {
        push_varint(out, u64::from(first) - end);
        push_varint(out, u64::from(last - first));
        end = u64::from(last) + 1;
    }
    Ok(())
}

/// The tiles that are in exactly one of the sets, ascending.
fn differences(mut one: &[TileId], mut other: &[TileId]) -> Vec<u32> {
    let mut found = Vec::new();
    loop {
        let same = one.iter().zip(other).take_while(|(one, other)| one == other).count();
        (one, other) = (&one[same..], &other[same..]);
        match (one, other) {
            ([first, rest @ ..], [second, ..]) if first < second => {
                found.push(first.0);
                one = rest;
            }
            (_, [second, rest @ ..]) => {
                found.push(second.0);
                other = rest;
            }
            ([first, rest @ ..], []) => {
                found.push(first.0);
                one = rest;
            }
            ([], []) => return found,
        }
    }
}

/// First and last number of each run of consecutive numbers.
fn ranges(numbers: Vec<u32>) -> Vec<(u32, u32)> {
    let mut ranges: Vec<(u32, u32)> = Vec::new();
    for number in numbers {
        match ranges.last_mut() {
            Some((_, last)) if *last + 1 == number => *last = number,
            _ => ranges.push((number, number)),
        }
    }
    ranges
}

/// Reads a set from the front; its tiles are below `limit`. `room` is the number of tiles that may still be read; it
/// is reduced.
pub(crate) fn take_set(
    bytes: &mut &[u8],
    before: &[TileId],
    limit: u32,
    room: &mut usize,
) -> Result<Vec<TileId>, Invalid> {
    const MANY: Invalid = "the sets of tiles are larger than the limit";
    let ranges = take_varint(bytes)?;
    let mut set = Vec::with_capacity(before.len().min(*room));
    let mut before = before;
    let mut end = 0_u32;
    for _ in 0..ranges {
        let first = end.checked_add(take_u32(bytes)?);
        let last = first.and_then(|first| first.checked_add(take_varint(bytes).ok()?.try_into().ok()?));
        let (Some(first), Some(last)) = (first, last.filter(|&last| last < limit)) else {
            return Err("a tile is unknown");
        };
        let same = before.partition_point(|tile| tile.0 < first);
        if (last - first) as usize >= *room || set.len() + same + (last - first) as usize >= *room {
            return Err(MANY);
        }
        set.extend_from_slice(&before[..same]);
        before = &before[same..];
        for tile in first..=last {
            match before {
                [first, rest @ ..] if first.0 == tile => before = rest,
                _ => set.push(TileId(tile)),
            }
        }
        end = last + 1;
    }
    set.extend_from_slice(before);
    *room = room.checked_sub(set.len()).ok_or(MANY)?;
    Ok(set)
}
