//! The exact scans of one local day as records, and back: one record for the day, and one for each of its tiles.
//!
//! Flips are written cell by cell as differences of scan numbers (T-RO 2017, section III.B, calls this Δ-encoding): a
//! cell flips rarely, so a difference takes a byte or two. Invariant: `decode(encode(day)) == day`, or `encode`
//! refuses.

use std::sync::Arc;

use tidemap_grid::{
    day::{Bit, DayTile, Flip, GridDay, PresenceRun, ScanTime},
    index::{TILE_CELLS, TileId},
    mask::{Mask, TileMasks},
    sensors::SensorId,
    snapshot::FutureScan,
};
use tidemap_layout::grid as layout;
use tidemap_model::LocalDay;

use super::{
    Invalid,
    cells::{MASK_LENGTH, decode_masks, encode_mask, masks},
    columns, offsets, sensors, sources,
    tile_set::{push_set, take_set},
    varint::{push_varint, take_u32, take_varint},
};

/// Number of bits of a tile: two per cell.
const BITS: usize = 2 * TILE_CELLS;
/// Limit of the number of scans of one day. Runs of equal scans take no space, so the length of the payload does not
/// limit this number.
const SCANS_MAX: usize = 1 << 26;
/// Limit of tiles in all presence runs of one day together.
const SEEN_TILES_MAX: usize = 1 << 30;

/// Encodes the day without its tiles; `tiles` tile records follow it.
pub(crate) fn encode(day: &GridDay, tiles: usize) -> Result<layout::Day, Invalid> {
    const MANY: Invalid = "a day has more scans or tiles than can be numbered";
    let nanos: Vec<i64> = day.scans.iter().map(|scan| scan.utc_nanos).collect();
    let times = columns::encode_times(&nanos)?;
    let (offset_counts, offset_secs) = offsets::encode(day.scans.iter().map(|scan| scan.offset_secs));
    let (sensor_counts, sensor_numbers) = sensors::encode_runs(day.scans.iter().map(|scan| scan.sensor));
    let (source_counts, source_numbers) = sources::encode(day.scans.iter().map(|scan| scan.source));
    let mut presence = Vec::new();
    let mut before: &[TileId] = &[];
    let mut scans = 0_u64;
    for run in &day.presence {
        if u64::from(run.first) != scans || run.count == 0 {
            return Err("the runs of a day do not follow each other");
        }
        push_varint(&mut presence, u64::from(run.count));
        push_set(&mut presence, before, &run.seen)?;
        before = &run.seen;
        scans += u64::from(run.count);
    }
    if scans != day.scans.len() as u64 {
        return Err("the runs of a day are not as long as the day");
    }
    if day.scans.len() > SCANS_MAX {
        return Err(MANY);
    }
    Ok(layout::Day {
        day: day.day.0,
        scans: u32::try_from(scans).map_err(|_| MANY)?,
        first_time_nanos: times.first_nanos,
        time_unit_nanos: times.unit_nanos,
        times: times.differences,
        offset_counts,
        offset_secs,
        presence,
        tiles: u32::try_from(tiles).map_err(|_| MANY)?,
        tiles_end: match day.tiles().next_back() {
            Some((last, _)) => last.0.checked_add(1).ok_or(MANY)?,
            None => 0,
        },
        sensor_counts,
        sensors: sensor_numbers,
        source_counts,
        sources: source_numbers,
    })
}

/// Decodes the day without its tiles. All tiles are below `tiles_end`, and so below `limit`. `keep` selects the tiles
/// that the runs of presence keep.
pub(crate) fn decode(message: &layout::Day, limit: u32, keep: impl Fn(TileId) -> bool) -> Result<GridDay, Invalid> {
    let count = message.scans as usize;
    if count > SCANS_MAX {
        return Err("a day has more scans than the limit");
    }
    let times = columns::Times {
        first_nanos: message.first_time_nanos,
        unit_nanos: message.time_unit_nanos,
        differences: &message.times,
    };
    let nanos = columns::decode_times(&times, count)?;
    let offsets = offsets::decode(&message.offset_counts, &message.offset_secs, count)?;
    let mut day = GridDay::new(LocalDay(message.day));
    let sensor = SensorId::OWN;
    let sources = sources::decode(&message.source_counts, &message.sources, count)?;
    let times = nanos.into_iter().zip(offsets).zip(sources);
    day.scans =
        times.map(|((utc_nanos, offset_secs), source)| ScanTime { utc_nanos, offset_secs, sensor, source }).collect();
    for (scan, sensor) in day
        .scans
        .iter_mut()
        .zip(sensors::decode_runs(&message.sensor_counts, &message.sensors, count)?.unwrap_or_default())
    {
        scan.sensor = sensor;
    }
    let mut bytes = &message.presence[..];
    let mut before = Vec::new();
    let mut first = 0_u32;
    let mut room = SEEN_TILES_MAX;
    while !bytes.is_empty() {
        let count = take_u32(&mut bytes)?;
        let end = first.checked_add(count).filter(|&end| count > 0 && end <= message.scans);
        before = take_set(&mut bytes, &before, limit, &mut room)?;
        let seen: Arc<[TileId]> = before.iter().copied().filter(|&tile| keep(tile)).collect();
        day.presence.push(PresenceRun { first, count, seen });
        first = end.ok_or("the runs of a day are longer than the day")?;
    }
    if first != message.scans {
        return Err("the runs of a day are not as long as the day");
    }
    if message.tiles_end > limit {
        return Err("a tile is unknown");
    }
    Ok(day)
}

/// Encodes the observations of a tile on one day.
pub(crate) fn encode_tile(tile: &DayTile) -> Result<layout::DayTileScans, Invalid> {
    let key = |flip: &Flip| (flip.scan, flip.bit(), flip.cell());
    let is_ordered = tile.flips.is_sorted_by(|one, next| key(one) < key(next));
    let (flips, flips_in_order) =
        if is_ordered { (encode_by_bit(&tile.flips), Vec::new()) } else { (Vec::new(), encode_in_order(&tile.flips)?) };
    let is_last_known = flipped(tile.first, &tile.flips) == Some(tile.last);
    Ok(layout::DayTileScans {
        first_observed: encode_mask(tile.first.observed()),
        first_occupied: encode_mask(tile.first.occupied()),
        flips,
        flips_in_order,
        last: (!is_last_known).then(|| layout::Masks {
            observed: encode_mask(tile.last.observed()),
            occupied: encode_mask(tile.last.occupied()),
        }),
    })
}

/// The masks of a tile after all flips.
fn flipped(first: TileMasks, flips: &[Flip]) -> Option<TileMasks> {
    let (mut observed, mut occupied) = (first.observed(), first.occupied());
    for flip in flips {
        match flip.bit() {
            Bit::Observed => observed.flip(flip.cell()),
            Bit::Occupied => occupied.flip(flip.cell()),
        }
    }
    TileMasks::new(observed, occupied)
}

fn bit_of(flip: &Flip) -> usize {
    2 * usize::from(flip.cell()) + usize::from(flip.bit() == Bit::Occupied)
}

fn flip_of(scan: u32, bit: usize) -> Flip {
    // A bit's number is below 1,024.
    Flip::new(scan, (bit / 2) as u16, if bit.is_multiple_of(2) { Bit::Observed } else { Bit::Occupied })
}

fn encode_by_bit(flips: &[Flip]) -> Vec<u8> {
    let mut starts = [0_u32; BITS + 1];
    for flip in flips {
        starts[bit_of(flip) + 1] += 1;
    }
    for bit in 0..BITS {
        starts[bit + 1] += starts[bit];
    }
    let mut ends = starts;
    let mut scans = vec![0; flips.len()];
    for flip in flips {
        let end = &mut ends[bit_of(flip)];
        scans[*end as usize] = flip.scan;
        *end += 1;
    }
    let mut out = Vec::with_capacity(flips.len() * 2 + 16);
    let mut next_bit = 0;
    for bit in 0..BITS {
        let scans = &scans[starts[bit] as usize..starts[bit + 1] as usize];
        if scans.is_empty() {
            continue;
        }
        push_varint(&mut out, (bit - next_bit) as u64);
        push_varint(&mut out, scans.len() as u64 - 1);
        next_bit = bit + 1;
        let mut next = 0;
        for &scan in scans {
            push_varint(&mut out, u64::from(scan) - next);
            next = u64::from(scan) + 1;
        }
    }
    out
}

fn encode_in_order(flips: &[Flip]) -> Result<Vec<u8>, Invalid> {
    let mut out = Vec::new();
    let mut before = 0;
    for flip in flips {
        push_varint(&mut out, u64::from(flip.scan.checked_sub(before).ok_or("the flips of a day do not ascend")?));
        push_varint(&mut out, bit_of(flip) as u64);
        before = flip.scan;
    }
    Ok(out)
}

/// Decodes a tile; its flips belong to scans below `scans`.
pub(crate) fn decode_tile(message: &layout::DayTileScans, scans: u32) -> Result<DayTile, Invalid> {
    let first = decode_masks(&message.first_observed, &message.first_occupied)?;
    let mut flips = decode_by_bit(&message.flips, scans)?;
    flips.extend(decode_in_order(&message.flips_in_order, scans)?);
    let last = match &message.last {
        Some(last) => decode_masks(&last.observed, &last.occupied)?,
        None => flipped(first, &flips).ok_or("a cell is occupied but not observed")?,
    };
    Ok(DayTile { first, flips, last })
}

fn decode_by_bit(mut bytes: &[u8], scans: u32) -> Result<Vec<Flip>, Invalid> {
    let mut flips = Vec::with_capacity(bytes.len());
    let mut next_bit = 0_u64;
    while !bytes.is_empty() {
        let bit = next_bit.saturating_add(take_varint(&mut bytes)?);
        if bit >= BITS as u64 {
            return Err("a cell is outside its tile");
        }
        next_bit = bit + 1;
        let more = take_varint(&mut bytes)?;
        let mut next = 0_u64;
        for _ in 0..=more {
            let scan = next.saturating_add(take_varint(&mut bytes)?);
            if scan >= u64::from(scans) {
                return Err("a flip belongs to a scan that does not exist");
            }
            flips.push(flip_of(scan as u32, bit as usize));
            next = scan + 1;
        }
    }
    flips.sort_unstable_by_key(|flip| (flip.scan, flip.bit(), flip.cell()));
    flips.shrink_to_fit();
    Ok(flips)
}

fn decode_in_order(mut bytes: &[u8], scans: u32) -> Result<Vec<Flip>, Invalid> {
    let mut flips = Vec::new();
    let mut scan = 0_u64;
    while !bytes.is_empty() {
        scan = scan.saturating_add(take_varint(&mut bytes)?);
        let bit = take_varint(&mut bytes)?;
        if scan >= u64::from(scans) || bit >= BITS as u64 {
            return Err("a flip belongs to a scan or a cell that does not exist");
        }
        flips.push(flip_of(scan as u32, bit as usize));
    }
    Ok(flips)
}

/// Encodes a scan whose time is in the future.
pub(crate) fn encode_ahead(scan: &FutureScan) -> layout::AheadScan {
    let mut bytes = Vec::with_capacity(scan.tiles.len() * 2 * MASK_LENGTH);
    for (_, masks) in &scan.tiles {
        bytes.extend(masks.observed().to_bytes());
        bytes.extend(masks.occupied().to_bytes());
    }
    layout::AheadScan {
        utc_nanos: scan.time.utc_nanos,
        offset_secs: scan.time.offset_secs,
        tiles: scan.tiles.iter().map(|(tile, _)| tile.0).collect(),
        masks: bytes,
        sensor: u32::from(scan.time.sensor.0),
        source: sources::number(scan.time.source),
    }
}

/// Decodes a scan whose time is in the future; its tiles are below `limit`.
pub(crate) fn decode_ahead(message: &layout::AheadScan, limit: u32) -> Result<FutureScan, Invalid> {
    let (sets, rest) = message.masks.as_chunks::<MASK_LENGTH>();
    let (pairs, odd) = sets.as_chunks::<2>();
    if !rest.is_empty() || !odd.is_empty() || pairs.len() != message.tiles.len() {
        return Err("the tiles of a scan differ in number from their sets");
    }
    if message.tiles.iter().any(|&tile| tile >= limit) {
        return Err("a tile is unknown");
    }
    let tile = |(&tile, [observed, occupied]): (&u32, &[[u8; MASK_LENGTH]; 2])| {
        Ok((TileId(tile), masks(Mask::from_bytes(observed), Mask::from_bytes(occupied))?))
    };
    Ok(FutureScan {
        time: ScanTime {
            utc_nanos: message.utc_nanos,
            offset_secs: message.offset_secs,
            sensor: sensors::number(message.sensor)?,
            source: sources::source(message.source)?,
        },
        tiles: message.tiles.iter().zip(pairs).map(tile).collect::<Result<_, Invalid>>()?,
    })
}
