//! Reading a grid out of a checkpoint, record by record.
//!
//! Tiles are loaded into memory up to a limit in bytes; of the others only the offsets are kept. Invariant:
//! every record has been read and checked, loaded or not.

use std::sync::{Arc, Weak};

use tidemap_grid::{
    index::TileId,
    live_tile::LiveTile,
    snapshot::GridSnapshot,
    tile::{ColdTile, ModelSlot, SumsSlot, TileSource},
};
use tidemap_layout::{file::RecordKind, grid as layout};
use tidemap_model::{Periodicities, PhasorSum};

use super::tiles::{CheckpointTiles, TileOffset, TileOffsets};
use crate::{
    failure::ReadFailure,
    record::{
        day, spec, tile,
        tile_model::{self, EncodedSums},
        tile_set,
    },
    record_file::RecordReader,
};

/// The part of a grid that a reader keeps.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) enum Keep {
    /// Only the offsets of its tiles: the file is only checked.
    Offsets,
    /// Everything; models and sums up to about this many bytes.
    UpTo(u64),
}

/// A grid that was read.
pub(super) struct ReadGrid {
    /// Offsets of its tiles.
    pub(super) offsets: TileOffsets,
    /// Shared sums that are in memory, by number.
    pub(super) shared: Vec<Weak<PhasorSum>>,
    /// The grid, with empty slots for the tiles that are not in memory; empty if only the offsets are kept.
    grid: GridSnapshot,
    /// The first tile that is not in memory.
    cold_from: usize,
}

impl ReadGrid {
    /// The grid, whose tiles that are not in memory are read from `source`.
    pub(super) fn into_grid(self, source: &Arc<CheckpointTiles>) -> GridSnapshot {
        let mut grid = self.grid;
        for index in self.cold_from..grid.models.len() {
            let cold = || ColdTile {
                source: Arc::clone(source) as Arc<dyn TileSource>,
                // The number of tiles fits into 32 bits.
                tile: TileId(index as u32),
            };
            grid.models[index] = ModelSlot::Cold(cold());
            grid.sums[index] = SumsSlot::Cold(cold());
        }
        grid
    }

    /// Takes the offsets out; the shared sums with them.
    pub(super) fn take_offsets(&mut self) -> (TileOffsets, Vec<Weak<PhasorSum>>) {
        (std::mem::take(&mut self.offsets), std::mem::take(&mut self.shared))
    }
}

struct TileReader<'reader> {
    reader: &'reader mut RecordReader,
    periodicities: &'reader Periodicities,
    /// Bytes of models and sums that may still be loaded.
    room: u64,
    /// Shared sums in memory: all before the first tile that is not loaded.
    shared: Vec<Arc<PhasorSum>>,
    offsets: TileOffsets,
    buffer: Vec<u8>,
}

/// Reads a grid.
pub(super) fn read(
    reader: &mut RecordReader,
    periodicities: &Periodicities,
    keep: Keep,
) -> Result<ReadGrid, ReadFailure> {
    let mut buffer = Vec::new();
    let head: layout::Grid = reader.long_message(RecordKind::Grid, &mut buffer)?;
    if head.models > head.tiles {
        return Err("there are more models than tiles".into());
    }
    let mut last_seen = &head.last_seen[..];
    let mut room = head.tiles as usize;
    let last_seen_tiles = tile_set::take_set(&mut last_seen, &[], head.tiles, &mut room)?;
    if !last_seen.is_empty() {
        return Err("the tiles of the last scan are too many".into());
    }
    let mut grid = GridSnapshot {
        tiles: Vec::new(),
        models: Vec::new(),
        sums: Vec::new(),
        last_seen: last_seen_tiles.into(),
        days: Vec::new(),
        future: Vec::new(),
        scans: head.scans,
        cell_observations: head.cell_observations,
        shown: spec::decode_shown(head.shown.as_ref())?,
        received_nanos: head.received_nanos,
    };
    let room = match keep {
        Keep::Offsets => 0,
        Keep::UpTo(bytes) => bytes,
    };
    let keeps = keep != Keep::Offsets;
    let mut tiles =
        TileReader { reader, periodicities, room, shared: Vec::new(), offsets: TileOffsets::default(), buffer };
    let mut cold_from = None;
    for index in 0..head.tiles as usize {
        let (live, slots) = tiles.tile(index < head.models as usize)?;
        if keeps {
            grid.tiles.push(Arc::new(live));
        }
        if keeps && index < head.models as usize {
            if slots.is_none() {
                cold_from.get_or_insert(index);
            }
            let (model, sums) = slots.unwrap_or_default();
            grid.models.push(model);
            grid.sums.push(sums);
        }
    }
    let TileReader { reader, shared, offsets, mut buffer, .. } = tiles;
    let mut last_day = None;
    for _ in 0..head.days {
        let day = read_day(reader, head.tiles, &mut buffer)?;
        if last_day.replace(day.day) >= Some(day.day) {
            return Err("the days do not ascend".into());
        }
        if keeps {
            grid.days.push(day);
        }
    }
    for _ in 0..head.ahead {
        let message: layout::AheadScan = reader.long_message(RecordKind::AheadScan, &mut buffer)?;
        let scan = day::decode_ahead(&message, head.tiles)?;
        if keeps {
            grid.future.push(scan);
        }
    }
    let shared = shared.iter().map(Arc::downgrade).collect();
    let cold_from = cold_from.unwrap_or(grid.models.len());
    Ok(ReadGrid { offsets, shared, grid, cold_from })
}

impl TileReader<'_> {
    /// The next tile, with its model and sums if they are loaded.
    fn tile(&mut self, may_have_model: bool) -> Result<(LiveTile, Option<(ModelSlot, SumsSlot)>), ReadFailure> {
        while self.reader.next_kind()? == RecordKind::SharedSum {
            self.offsets.shared.push(self.reader.offset());
            self.reader.long(RecordKind::SharedSum, &mut self.buffer)?;
            let sum = tile_model::decode_shared(&self.buffer, self.periodicities)?;
            if self.room > 0 {
                self.room = self.room.saturating_sub(sum.bytes() as u64);
                self.shared.push(Arc::new(sum));
            }
        }
        let message: layout::Tile = self.reader.long_message(RecordKind::Tile, &mut self.buffer)?;
        let live = tile::decode(&message)?;
        if !message.has_model {
            self.offsets.tiles.push(TileOffset::default());
            return Ok((live, (self.room > 0).then(Default::default)));
        }
        if !may_have_model {
            return Err("a tile has a model where there should be none".into());
        }
        let model_offset = self.reader.offset();
        let model: layout::TileModel = self.reader.long_message(RecordKind::TileModel, &mut self.buffer)?;
        let model = tile_model::decode(&model, self.periodicities)?;
        self.offsets.tiles.push(TileOffset { model: model_offset, sums: self.reader.offset() });
        self.reader.long(RecordKind::TileSums, &mut self.buffer)?;
        let sums = EncodedSums::new(&self.buffer, self.periodicities)?;
        if sums.groups != model.groups.len() || sums.cells(self.periodicities) != model.cells.len() {
            return Err("the sums of a tile differ in number from its groups and cells".into());
        }
        if sums.shared.iter().any(|&number| number as usize >= self.offsets.shared.len()) {
            return Err("a shared sum is missing".into());
        }
        // Tiles are loaded in order until the limit, so that every shared sum that they refer to is loaded.
        let shared: Option<Vec<Arc<PhasorSum>>> =
            sums.shared.iter().map(|&number| self.shared.get(number as usize).map(Arc::clone)).collect();
        let Some(shared) = shared.filter(|_| self.room > 0) else { return Ok((live, None)) };
        self.room = self.room.saturating_sub((model.bytes() + self.buffer.len()) as u64);
        let sums = sums.decode(shared, self.periodicities).map_err(|error| error.to_string())?;
        Ok((live, Some((ModelSlot::Resident(Arc::new(model)), SumsSlot::Resident(Arc::new(sums))))))
    }
}

/// The next day with its tiles.
fn read_day(
    reader: &mut RecordReader,
    limit: u32,
    buffer: &mut Vec<u8>,
) -> Result<tidemap_grid::day::GridDay, ReadFailure> {
    let head: layout::Day = reader.long_message(RecordKind::Day, buffer)?;
    let mut kept = day::decode(&head, limit, |_| true)?;
    let mut next = 0;
    for _ in 0..head.tiles {
        let message: layout::DayTile = reader.long_message(RecordKind::DayTile, buffer)?;
        if !(next..head.tiles_end).contains(&message.tile) {
            return Err("the tiles of a day are out of order".into());
        }
        let scans = message.scans.as_ref().ok_or("a tile of a day has no scans")?;
        kept.put(TileId(message.tile), day::decode_tile(scans, head.scans)?);
        next = message.tile + 1;
    }
    Ok(kept)
}
