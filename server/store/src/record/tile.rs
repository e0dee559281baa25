//! The current state of tiles after the newest scans, as records, and back.
//!
//! Invariant: a tile that is written is in no run of equal scans; counts that are read can grow without an overflow.

use tidemap_grid::{
    index::{TILE_CELLS, TileIndex},
    live_tile::{Away, LiveTile},
    scan::ScanSource,
    sensors::SensorId,
    tile_odds::{CellOdds, TileOdds},
};
use tidemap_layout::grid as layout;

use super::{
    Invalid,
    cells::{CellsIn, CellsOut, decode_mask, decode_masks, encode_mask},
    sensors, sources,
    varint::{CUT, push_varint, take_varint, unzigzag, zigzag},
};

/// Larger counts are refused, so that the sum of two never overflows.
const COUNT_MAX: u64 = 1 << 61;

pub(crate) fn encode(tile: &LiveTile, has_model: bool) -> Result<layout::Tile, Invalid> {
    let mut away = CellsOut::default();
    for cell in &tile.away {
        away.push(cell.cell)?;
        push_varint(&mut away.bytes, zigzag(tile.newest_nanos.wrapping_sub(cell.last_nanos)));
        push_varint(&mut away.bytes, cell.pairs);
    }
    let is_own = tile.away.iter().all(|away| away.sensor == SensorId::OWN);
    let away_sensors = if is_own { Vec::new() } else { tile.away.iter().map(|away| away.sensor.0).collect() };
    let mut offsets = CellsOut::default();
    for &(cell, offset) in &tile.offsets {
        offsets.push(cell)?;
        push_varint(&mut offsets.bytes, zigzag(offset));
    }
    let mut change_rates = CellsOut::default();
    for &(cell, rate) in &tile.change_rates {
        change_rates.push(cell)?;
        change_rates.bytes.extend(rate.to_le_bytes());
    }
    Ok(layout::Tile {
        x: tile.index.x,
        y: tile.index.y,
        z: tile.index.z,
        arrival_observed: encode_mask(tile.arrival.observed()),
        arrival_occupied: encode_mask(tile.arrival.occupied()),
        known: encode_mask(tile.known),
        occupied: encode_mask(tile.occupied),
        current: encode_mask(tile.current),
        newest_nanos: tile.newest_nanos,
        scans: tile.scans,
        away: away.bytes,
        offsets: offsets.bytes,
        change_rates: change_rates.bytes,
        has_model,
        sensor: u32::from(tile.sensor.0),
        away_sensors,
        odds: tile.odds.sources().map(encode_odds).collect::<Result<_, _>>()?,
    })
}

pub(crate) fn decode(message: &layout::Tile) -> Result<LiveTile, Invalid> {
    let index = TileIndex { x: message.x, y: message.y, z: message.z };
    if !index.is_valid() {
        return Err("a tile lies outside the limits");
    }
    if message.scans > COUNT_MAX {
        return Err("a count is outside its range");
    }
    let mut tile = LiveTile::new(index);
    tile.arrival = decode_masks(&message.arrival_observed, &message.arrival_occupied)?;
    tile.known = decode_mask(&message.known)?;
    tile.occupied = decode_mask(&message.occupied)?;
    tile.current = decode_mask(&message.current)?;
    tile.newest_nanos = message.newest_nanos;
    tile.scans = message.scans;
    tile.sensor = sensors::number(message.sensor)?;
    let mut away_sensors = message.away_sensors.iter();
    let mut away = CellsIn::new(&message.away);
    while let Some(cell) = away.take()? {
        let before = unzigzag(take_varint(&mut away.bytes)?);
        let pairs = count(take_varint(&mut away.bytes)?)?;
        let sensor = SensorId(away_sensors.next().copied().unwrap_or(0));
        tile.away.push(Away { cell, sensor, last_nanos: message.newest_nanos.wrapping_sub(before), pairs });
    }
    if !message.away_sensors.is_empty() && message.away_sensors.len() != tile.away.len() {
        return Err("the sensors of a tile differ in number from its cells");
    }
    tile.odds = TileOdds::from_sources(message.odds.iter().map(decode_odds).collect::<Result<_, _>>()?)
        .map_err(|_| "the newest evidence of a tile is out of range, or its sources do not ascend")?;
    let mut offsets = CellsIn::new(&message.offsets);
    while let Some(cell) = offsets.take()? {
        let offset = unzigzag(take_varint(&mut offsets.bytes)?);
        count(offset.unsigned_abs())?;
        tile.offsets.push((cell, offset));
    }
    let mut rates = CellsIn::new(&message.change_rates);
    while let Some(cell) = rates.take()? {
        let (rate, rest) = rates.bytes.split_first_chunk().ok_or(CUT)?;
        rates.bytes = rest;
        let rate = f64::from_le_bytes(*rate);
        if !(0.0..=f64::MAX).contains(&rate) {
            return Err("a rate of change is outside its range");
        }
        tile.change_rates.push((cell, rate));
    }
    Ok(tile)
}

fn encode_odds((source, odds): (ScanSource, &[i8; TILE_CELLS])) -> Result<layout::SourceOdds, Invalid> {
    let mut cells = CellsOut::default();
    for (cell, odds) in (0..).zip(odds.iter()).filter(|(_, odds)| **odds != 0) {
        cells.push(cell)?;
        cells.bytes.extend(odds.to_le_bytes());
    }
    Ok(layout::SourceOdds { source: sources::number(source), cells: cells.bytes })
}

fn decode_odds(message: &layout::SourceOdds) -> Result<(ScanSource, CellOdds), Invalid> {
    let mut odds = CellOdds::new([0; TILE_CELLS]);
    let mut cells = CellsIn::new(&message.cells);
    while let Some(cell) = cells.take()? {
        let (&byte, rest) = cells.bytes.split_first().ok_or(CUT)?;
        cells.bytes = rest;
        if let Some(odds) = odds.get_mut(usize::from(cell)) {
            *odds = i8::from_le_bytes([byte]);
        }
    }
    Ok((sources::source(message.source)?, odds))
}

fn count(count: u64) -> Result<u64, Invalid> {
    if count > COUNT_MAX { Err("a count is outside its range") } else { Ok(count) }
}
