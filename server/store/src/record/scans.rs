//! Scans as a payload of the log, and back.
//!
//! This code runs for every scan and every flip, so each column is one pass. Invariant: `decode(encode(scans)) ==
//! scans`, or `encode` refuses; the memory that `decode` allocates is bounded by the length of the payload, except for
//! sets of tiles, whose sizes have their own bound.

use std::{borrow::Cow, sync::Arc};

use tidemap_grid::{
    index::{TILE_CELLS, TileId, TileIndex},
    scan::{CellRef, LoggedScan, Scans},
};
use tidemap_layout::event as layout;
use tidemap_map::{
    event::{Envelope, SequenceSpan},
    ids::ProducerId,
};

use super::{
    Invalid, columns,
    ids::{decode_new_producer, decode_refused, encode_new_producer, encode_refused},
    offsets, sources, spec,
    tile_set::{push_set, take_set},
    varint::{CUT, push_varint, take_varint, unzigzag, zigzag},
};

/// Limit of scans in one event.
pub const SCANS_MAX: usize = 1 << 16;
/// Limit of tiles in all sets of seen tiles of one event together.
pub const SEEN_TILES_MAX: usize = 1 << 24;

/// Limit of tiles of one event that are first observed as a whole.
pub(crate) const WHOLE_TILES_MAX: usize = 1 << 17;

/// The observed bits that a scan flips.
struct ObservedFlips<'a> {
    /// Tiles all of whose bits flip.
    whole: Vec<TileId>,
    others: Cow<'a, [CellRef]>,
}

impl ObservedFlips<'_> {
    fn new(flips: &[CellRef]) -> ObservedFlips<'_> {
        let mut observed = ObservedFlips { whole: Vec::new(), others: Cow::Borrowed(flips) };
        if flips.len() < TILE_CELLS {
            return observed;
        }
        let mut others = Vec::new();
        for of_tile in flips.chunk_by(|one, other| one.tile() == other.tile()) {
            // An ascending list of 512 cells of one tile is the whole tile; another order is refused later.
            match of_tile.first().filter(|_| of_tile.len() == TILE_CELLS && of_tile.is_sorted()) {
                Some(first) => observed.whole.push(first.tile()),
                None => others.extend_from_slice(of_tile),
            }
        }
        observed.others = Cow::Owned(others);
        observed
    }
}

fn encode_whole(scans: &[ObservedFlips<'_>]) -> Result<Vec<u8>, Invalid> {
    let mut out = Vec::new();
    let mut next = 0;
    for (number, scan) in scans.iter().enumerate().filter(|(_, scan)| !scan.whole.is_empty()) {
        push_varint(&mut out, (number - next) as u64);
        push_set(&mut out, &[], &scan.whole)?;
        next = number + 1;
    }
    Ok(out)
}

/// The number of each scan that first observes whole tiles, and these tiles.
fn decode_whole(mut bytes: &[u8], count: usize) -> Result<Vec<(usize, Vec<TileId>)>, Invalid> {
    let mut whole = Vec::new();
    let (mut next, mut room) = (0_usize, WHOLE_TILES_MAX);
    while !bytes.is_empty() {
        let gap = usize::try_from(take_varint(&mut bytes)?).unwrap_or(usize::MAX);
        let scan = next.saturating_add(gap);
        if scan >= count {
            return Err("more scans observe whole tiles than the event has");
        }
        whole.push((scan, take_set(&mut bytes, &[], CellRef::TILES_MAX, &mut room)?));
        next = scan + 1;
    }
    Ok(whole)
}

/// Adds all cells of some tiles to ascending flips.
fn add_whole(flips: &mut Vec<CellRef>, tiles: &[TileId]) {
    let cells = 0..TILE_CELLS as u16;
    flips.extend(tiles.iter().flat_map(|&tile| cells.clone().map(move |cell| CellRef::new(tile, cell))));
    flips.sort_unstable();
}

/// The message of an event.
pub(super) fn encode(envelope: &Envelope, event: &Scans) -> Result<layout::Scans, Invalid> {
    let scans = &event.scans;
    if scans.len() > SCANS_MAX {
        return Err("there are more scans than one record may hold");
    }
    if envelope.span.is_empty() {
        return Err("the last sequence number is before the first");
    }
    let (refused_sequences, refused_reasons) = encode_refused(&envelope.refused)?;
    let observed: Vec<ObservedFlips<'_>> = scans.iter().map(|scan| ObservedFlips::new(&scan.observed_flips)).collect();
    if observed.iter().map(|scan| scan.whole.len()).sum::<usize>() > WHOLE_TILES_MAX {
        return Err("its scans observe more whole tiles than one record may hold");
    }
    let nanos: Vec<i64> = scans.iter().map(|scan| scan.utc_nanos).collect();
    let times = columns::encode_times(&nanos)?;
    let (offset_counts, offset_secs) = offsets::encode(scans.iter().map(|scan| scan.offset_secs));
    let (source_counts, source_numbers) = sources::encode(scans.iter().map(|scan| scan.source));
    Ok(layout::Scans {
        producer: envelope.producer.0,
        new_producer: envelope.new_producer.as_ref().map(encode_new_producer),
        incarnation: envelope.incarnation,
        first_sequence: envelope.span.first,
        last_sequence: envelope.span.last,
        content_crc: envelope.span.content_crc,
        received_nanos: envelope.received_nanos,
        new_tiles: encode_tiles(&event.new_tiles),
        // The number is checked above.
        count: scans.len() as u32,
        first_time_nanos: times.first_nanos,
        time_unit_nanos: times.unit_nanos,
        times: times.differences,
        offset_counts,
        offset_secs,
        seen: encode_seen(scans)?,
        observed_counts: encode_counts(observed.iter().map(|scan| &*scan.others)),
        occupied_counts: encode_counts(scans.iter().map(|scan| &*scan.occupied_flips)),
        observed_flips: encode_flips(observed.iter().map(|scan| &*scan.others))?,
        occupied_flips: encode_flips(scans.iter().map(|scan| &*scan.occupied_flips))?,
        observed_tiles: encode_whole(&observed)?,
        refused_sequences,
        refused_reasons,
        shown: spec::encode_shown(&event.shown),
        source_counts,
        sources: source_numbers,
    })
}

/// The event of a message.
pub(super) fn decode(message: &layout::Scans) -> Result<(Envelope, Scans), Invalid> {
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
    let sources = sources::decode(&message.source_counts, &message.sources, count)?;
    let seen = decode_seen(&message.seen, count)?;
    let size = |number| usize::try_from(number).map_err(|_| CUT);
    let observed_counts = columns::decode_numbers(&message.observed_counts, count, size)?;
    let occupied_counts = columns::decode_numbers(&message.occupied_counts, count, size)?;
    let mut observed: &[u8] = &message.observed_flips;
    let mut occupied: &[u8] = &message.occupied_flips;
    let whole = decode_whole(&message.observed_tiles, count)?;
    let mut scans: Vec<LoggedScan> = Vec::with_capacity(count);
    let columns =
        nanos.into_iter().zip(offsets).zip(sources).zip(seen).zip(observed_counts.into_iter().zip(occupied_counts));
    for ((((utc_nanos, offset_secs), source), seen), (observed_count, occupied_count)) in columns {
        scans.push(LoggedScan {
            utc_nanos,
            offset_secs,
            source,
            seen,
            observed_flips: take_flips(&mut observed, observed_count)?,
            occupied_flips: take_flips(&mut occupied, occupied_count)?,
        });
    }
    if !observed.is_empty() || !occupied.is_empty() {
        return Err(columns::LENGTH);
    }
    for (scan, tiles) in whole {
        if let Some(scan) = scans.get_mut(scan) {
            add_whole(&mut scan.observed_flips, &tiles);
        }
    }
    Ok((
        Envelope {
            producer: ProducerId(message.producer),
            new_producer: message.new_producer.as_ref().map(decode_new_producer).transpose()?,
            incarnation: message.incarnation,
            span: SequenceSpan {
                first: message.first_sequence,
                last: message.last_sequence,
                content_crc: message.content_crc,
            },
            received_nanos: message.received_nanos,
            refused: decode_refused(&message.refused_sequences, &message.refused_reasons)?,
        },
        Scans {
            new_tiles: decode_tiles(&message.new_tiles)?,
            scans,
            shown: spec::decode_shown(message.shown.as_ref())?,
        },
    ))
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
            return Err("more scans have tiles than the event has");
        };
        rest = behind;
        let set = take_set(&mut bytes, before.as_deref().unwrap_or_default(), CellRef::TILES_MAX, &mut room)?;
        before = Some(set.into());
        scan.clone_from(&before);
    }
    Ok(all)
}

fn encode_counts<'a>(flips: impl Iterator<Item = &'a [CellRef]>) -> Vec<u8> {
    let counts: Vec<u64> = flips.map(|flips| flips.len() as u64).collect();
    columns::encode_numbers(&counts, |count| count)
}

fn encode_flips<'a>(scans: impl Iterator<Item = &'a [CellRef]> + Clone) -> Result<Vec<u8>, Invalid> {
    let total: usize = scans.clone().map(<[CellRef]>::len).sum();
    let mut out = Vec::with_capacity(total * 2);
    for flips in scans {
        let mut next = 0;
        for cell in flips {
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

#[cfg(test)]
mod tests {
    use tidemap_grid::scan::ScanSource;

    use super::*;

    #[test]
    fn tiles_observed_anew_as_a_whole_come_back_and_cost_next_to_nothing() {
        let scan = |observed_flips: Vec<CellRef>| LoggedScan {
            utc_nanos: 5,
            offset_secs: 0,
            source: ScanSource::Cells,
            seen: None,
            observed_flips,
            occupied_flips: Vec::new(),
        };
        let whole = |tiles: std::ops::Range<u32>| (tiles.start * 512..tiles.end * 512).map(CellRef);
        let scans = vec![
            scan(whole(0..1000).collect()),
            scan(Vec::new()),
            scan([CellRef(7)].into_iter().chain(whole(3..4)).chain(whole(9..10).skip(1)).collect()),
        ];
        let envelope = Envelope {
            producer: ProducerId(0),
            new_producer: None,
            incarnation: 1,
            span: SequenceSpan { first: 1, last: 3, content_crc: 0 },
            received_nanos: 0,
            refused: Vec::new(),
        };
        let event = Scans { new_tiles: Vec::new(), scans, ..Scans::default() };
        let message = encode(&envelope, &event).expect("a good event");
        assert_eq!(message.observed_flips.len(), 1 + 2 + 510);
        assert!(message.observed_tiles.len() < 16);
        assert_eq!(decode(&message).expect("what was encoded"), (envelope, event));
    }
}
