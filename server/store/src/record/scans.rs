//! Scans as a payload of the log, and back.
//!
//! This runs for every scan and every flip, so each column is one pass. Invariant: `decode(encode(scans)) == scans`, or
//! `encode` refuses; what a payload makes `decode` allocate follows its length, but for sets of tiles, whose sizes have a
//! bound of their own.

use std::sync::Arc;

use tidemap_map::{
    event::ProducerId,
    grid::{
        index::{TileId, TileIndex},
        scan::{CellRef, LoggedScan, Scans},
    },
};
use tidemap_migrations::v2::event as v2;

use super::{
    Invalid, columns,
    event::{decode_producer_key, decode_refused, encode_producer_key, encode_refused},
    offsets,
    tile_set::{push_set, take_set},
    varint::{CUT, push_varint, take_varint, unzigzag, zigzag},
};

/// Most scans in one event.
pub const SCANS_MAX: usize = 1 << 16;
/// Most tiles in all sets of seen tiles of one event together.
pub const SEEN_TILES_MAX: usize = 1 << 24;

/// The message of an event.
pub(super) fn encode(event: &Scans) -> Result<v2::Scans, Invalid> {
    let scans = &event.scans;
    if scans.len() > SCANS_MAX {
        return Err("there are more scans than one record may hold");
    }
    if event.last_sequence < event.first_sequence {
        return Err("the last sequence number is before the first");
    }
    let (refused_sequences, refused_reasons) = encode_refused(&event.refused)?;
    let nanos: Vec<i64> = scans.iter().map(|scan| scan.utc_nanos).collect();
    let times = columns::encode_times(&nanos)?;
    let (offset_counts, offset_secs) = offsets::encode(scans.iter().map(|scan| scan.offset_secs));
    Ok(v2::Scans {
        producer: event.producer.0,
        new_producer: event.new_producer.as_ref().map(encode_producer_key),
        incarnation: event.incarnation,
        first_sequence: event.first_sequence,
        last_sequence: event.last_sequence,
        content_crc: event.content_crc,
        received_nanos: event.received_nanos,
        new_tiles: encode_tiles(&event.new_tiles),
        // Checked above.
        count: scans.len() as u32,
        first_time_nanos: times.first_nanos,
        time_unit_nanos: times.unit_nanos,
        times: times.differences,
        offset_counts,
        offset_secs,
        seen: encode_seen(scans)?,
        observed_counts: encode_counts(scans, |scan| &scan.observed_flips),
        occupied_counts: encode_counts(scans, |scan| &scan.occupied_flips),
        observed_flips: encode_flips(scans, |scan| &scan.observed_flips)?,
        occupied_flips: encode_flips(scans, |scan| &scan.occupied_flips)?,
        refused_sequences,
        refused_reasons,
    })
}

/// The event of a message.
pub(super) fn decode(message: &v2::Scans) -> Result<Scans, Invalid> {
    let count = message.count as usize;
    if count > SCANS_MAX {
        return Err("there are more scans than one record may hold");
    }
    if message.last_sequence < message.first_sequence {
        return Err("the last sequence number is before the first");
    }
    let times = columns::Times {
        first_nanos: message.first_time_nanos,
        unit_nanos: message.time_unit_nanos,
        differences: &message.times,
    };
    let nanos = columns::decode_times(&times, count)?;
    let offsets = offsets::decode(&message.offset_counts, &message.offset_secs, count)?;
    let seen = decode_seen(&message.seen, count)?;
    let size = |number| usize::try_from(number).map_err(|_| CUT);
    let observed_counts = columns::decode_numbers(&message.observed_counts, count, size)?;
    let occupied_counts = columns::decode_numbers(&message.occupied_counts, count, size)?;
    let mut observed: &[u8] = &message.observed_flips;
    let mut occupied: &[u8] = &message.occupied_flips;
    let mut scans = Vec::with_capacity(count);
    let columns = nanos.into_iter().zip(offsets).zip(seen).zip(observed_counts.into_iter().zip(occupied_counts));
    for (((utc_nanos, offset_secs), seen), (observed_count, occupied_count)) in columns {
        scans.push(LoggedScan {
            utc_nanos,
            offset_secs,
            seen,
            observed_flips: take_flips(&mut observed, observed_count)?,
            occupied_flips: take_flips(&mut occupied, occupied_count)?,
        });
    }
    if !observed.is_empty() || !occupied.is_empty() {
        return Err(columns::LENGTH);
    }
    Ok(Scans {
        producer: ProducerId(message.producer),
        new_producer: message.new_producer.as_ref().map(decode_producer_key).transpose()?,
        incarnation: message.incarnation,
        first_sequence: message.first_sequence,
        last_sequence: message.last_sequence,
        content_crc: message.content_crc,
        received_nanos: message.received_nanos,
        new_tiles: decode_tiles(&message.new_tiles)?,
        scans,
        refused: decode_refused(&message.refused_sequences, &message.refused_reasons)?,
    })
}

fn encode_tiles(tiles: &[TileIndex]) -> Vec<u8> {
    let mut out = Vec::new();
    let mut before = TileIndex::default();
    for &tile in tiles {
        for (now, before) in [(tile.x, before.x), (tile.y, before.y), (tile.z, before.z)] {
            push_varint(&mut out, zigzag(i64::from(now) - i64::from(before)));
        }
        before = tile;
    }
    out
}

fn decode_tiles(mut bytes: &[u8]) -> Result<Vec<TileIndex>, Invalid> {
    let mut tiles = Vec::new();
    let mut before = TileIndex::default();
    while !bytes.is_empty() {
        let mut next = |before: i32| {
            let now = i64::from(before).checked_add(unzigzag(take_varint(&mut bytes)?));
            now.and_then(|now| i32::try_from(now).ok()).ok_or("the place of a tile is outside its range")
        };
        before = TileIndex { x: next(before.x)?, y: next(before.y)?, z: next(before.z)? };
        tiles.push(before);
    }
    Ok(tiles)
}

fn encode_seen(scans: &[LoggedScan]) -> Result<Vec<u8>, Invalid> {
    let mut out = Vec::new();
    let mut before: &[TileId] = &[];
    let mut next = 0;
    let mut tiles = 0;
    for (number, scan) in scans.iter().enumerate() {
        let Some(seen) = &scan.seen else { continue };
        push_varint(&mut out, (number - next) as u64);
        push_set(&mut out, before, seen)?;
        tiles += seen.len();
        next = number + 1;
        before = seen;
    }
    if tiles > SEEN_TILES_MAX { Err("its scans see more tiles than one record may hold") } else { Ok(out) }
}

fn decode_seen(mut bytes: &[u8], count: usize) -> Result<Vec<Option<Arc<[TileId]>>>, Invalid> {
    let mut all: Vec<Option<Arc<[TileId]>>> = vec![None; count];
    let mut before: Option<Arc<[TileId]>> = None;
    let mut rest = &mut all[..];
    let mut room = SEEN_TILES_MAX;
    while !bytes.is_empty() {
        let gap = usize::try_from(take_varint(&mut bytes)?).unwrap_or(usize::MAX);
        let Some((scan, behind)) = rest.get_mut(gap..).and_then(<[_]>::split_first_mut) else {
            return Err("more scans see something than there are");
        };
        rest = behind;
        let set = take_set(&mut bytes, before.as_deref().unwrap_or_default(), CellRef::TILES_MAX, &mut room)?;
        before = Some(set.into());
        scan.clone_from(&before);
    }
    Ok(all)
}

fn encode_counts(scans: &[LoggedScan], flips: impl Fn(&LoggedScan) -> &Vec<CellRef>) -> Vec<u8> {
    let counts: Vec<u64> = scans.iter().map(|scan| flips(scan).len() as u64).collect();
    columns::encode_numbers(&counts, |count| count)
}

fn encode_flips(scans: &[LoggedScan], flips: impl Fn(&LoggedScan) -> &Vec<CellRef>) -> Result<Vec<u8>, Invalid> {
    let total: usize = scans.iter().map(|scan| flips(scan).len()).sum();
    let mut out = Vec::with_capacity(total * 2);
    for scan in scans {
        let mut next = 0;
        for cell in flips(scan) {
            let gap = u64::from(cell.0).checked_sub(next).ok_or("the flips of a scan do not ascend")?;
            push_varint(&mut out, gap);
            next = u64::from(cell.0) + 1;
        }
    }
    Ok(out)
}

fn take_flips(bytes: &mut &[u8], count: usize) -> Result<Vec<CellRef>, Invalid> {
    if count > bytes.len() {
        return Err(CUT);
    }
    let mut flips = Vec::with_capacity(count);
    let mut next = 0_u64;
    for _ in 0..count {
        let cell = next.saturating_add(take_varint(bytes)?);
        flips.push(CellRef(u32::try_from(cell).map_err(|_| "a cell is outside its range")?));
        next = cell + 1;
    }
    Ok(flips)
}
