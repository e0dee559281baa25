//! Writing a grid into a checkpoint, tile by tile.
//!
//! A sum that several tiles share is written once, before the first of them; the tiles refer to it. Tiles that are not
//! in memory are copied from their file, one at a time. Invariant: a record that could not be read back is refused.

use std::{
    collections::HashMap,
    io,
    sync::{Arc, Weak},
};

use prost::Message as _;
use tidemap_grid::{
    snapshot::GridSnapshot,
    tile::{ModelSlot, SumsSlot, TileModel, TileSums, TileUnavailable},
};
use tidemap_layout::{file::RecordKind, grid as layout};
use tidemap_model::{Periodicities, PhasorSum};

use super::tiles::CheckpointTiles;
use crate::{
    record::{
        Invalid, day, doubles, spec, tile,
        tile_model::{self, EncodedSums},
        tile_set,
    },
    record_file::RecordWriter,
};

/// Why a grid cannot be written.
#[derive(Debug)]
pub(crate) enum WriteError {
    /// The disk returned an error.
    Io(io::Error),
    /// The grid could not be read back, or part of it cannot be read now.
    Invalid(String),
}

impl From<io::Error> for WriteError {
    fn from(error: io::Error) -> WriteError {
        WriteError::Io(error)
    }
}

impl From<Invalid> for WriteError {
    fn from(reason: Invalid) -> WriteError {
        WriteError::Invalid(reason.to_owned())
    }
}

impl From<String> for WriteError {
    fn from(reason: String) -> WriteError {
        WriteError::Invalid(reason)
    }
}

impl From<TileUnavailable> for WriteError {
    fn from(error: TileUnavailable) -> WriteError {
        WriteError::Invalid(error.to_string())
    }
}

/// Writes a grid. Returns the shared sums that are in memory, by number.
pub(super) fn write(
    writer: &mut RecordWriter,
    grid: &GridSnapshot,
    periodicities: &Periodicities,
) -> Result<Vec<Weak<PhasorSum>>, WriteError> {
    let number = |count: usize| u32::try_from(count).map_err(|_| "a grid has more than can be numbered");
    if grid.models.len() != grid.sums.len() || grid.models.len() > grid.tiles.len() {
        return Err("the tiles of the grid differ in number from their models or sums".into());
    }
    let mut last_seen = Vec::new();
    tile_set::push_set(&mut last_seen, &[], &grid.last_seen)?;
    let head = layout::Grid {
        tiles: number(grid.tiles.len())?,
        models: number(grid.models.len())?,
        days: number(grid.days.len())?,
        ahead: number(grid.future.len())?,
        scans: grid.scans,
        cell_observations: grid.cell_observations,
        received_nanos: grid.received_nanos,
        last_seen,
        shown: spec::encode_shown(&grid.shown),
    };
    writer.long(RecordKind::Grid, &head.encode_to_vec())?;
    let mut tiles = TileWriter::new(writer, periodicities, Shared::default());
    for (index, live) in grid.tiles.iter().enumerate() {
        let has_model = match (grid.models.get(index), grid.sums.get(index)) {
            (Some(model), Some(sums)) => tiles.prepare(model, sums)?,
            _ => false,
        };
        tiles.writer.long(RecordKind::Tile, &tile::encode(live, has_model)?.encode_to_vec())?;
        if has_model {
            tiles.write_prepared()?;
        }
    }
    let shared = tiles.shared.in_memory;
    for kept in &grid.days {
        writer.long(RecordKind::Day, &day::encode(kept, kept.tiles().len())?.encode_to_vec())?;
        for (tile, of_day) in kept.tiles() {
            let message = layout::DayTile { tile: tile.0, scans: Some(day::encode_tile(of_day)?), models: Vec::new() };
            writer.long(RecordKind::DayTile, &message.encode_to_vec())?;
        }
    }
    for scan in &grid.future {
        writer.long(RecordKind::AheadScan, &day::encode_ahead(scan).encode_to_vec())?;
    }
    Ok(shared)
}

/// The shared sums that have been written.
#[derive(Default)]
pub(crate) struct Shared {
    /// The numbers of the sums by address. The weak references keep the addresses from being given to others.
    by_address: HashMap<usize, u32>,
    /// Sums that are not in memory: by the address of their file and their number in it.
    by_place: HashMap<(usize, u32), u32>,
    /// The sums by number; empty if a sum is not in memory.
    in_memory: Vec<Weak<PhasorSum>>,
}

impl Shared {
    fn next(&self) -> Result<u32, WriteError> {
        u32::try_from(self.in_memory.len()).map_err(|_| "a grid has more shared sums than can be numbered".into())
    }
}

/// Writes models and sums of tiles.
pub(crate) struct TileWriter<'writer> {
    writer: &'writer mut RecordWriter,
    periodicities: &'writer Periodicities,
    shared: Shared,
    /// The records of the next tile.
    model: Vec<u8>,
    sums: Vec<u8>,
}

impl<'writer> TileWriter<'writer> {
    /// `shared`: the sums that the file already has.
    pub(crate) fn new(
        writer: &'writer mut RecordWriter,
        periodicities: &'writer Periodicities,
        shared: Shared,
    ) -> TileWriter<'writer> {
        TileWriter { writer, periodicities, shared, model: Vec::new(), sums: Vec::new() }
    }

    fn write_prepared(&mut self) -> io::Result<()> {
        self.writer.long(RecordKind::TileModel, &self.model)?;
        self.writer.long(RecordKind::TileSums, &self.sums)
    }

    /// Prepares the records of a tile and writes its new shared sums. `false` if the tile has no model.
    fn prepare(&mut self, model: &ModelSlot, sums: &SumsSlot) -> Result<bool, WriteError> {
        self.model.clear();
        self.sums.clear();
        let has_model = match model {
            ModelSlot::Cold(cold) => match cold.source.as_any().downcast_ref::<CheckpointTiles>() {
                Some(tiles) => tiles.raw_model(cold.tile)?.map(|bytes| self.model = bytes).is_some(),
                None => self.encode_model(&*cold.source.model(cold.tile)?)?,
            },
            ModelSlot::Resident(model) => self.encode_model(model)?,
        };
        let has_sums = match sums {
            SumsSlot::Cold(cold) => match cold.source.as_any().downcast_ref::<CheckpointTiles>() {
                Some(tiles) if tiles.periodicities() == self.periodicities => {
                    let bytes = tiles.raw_sums(cold.tile)?;
                    bytes.map(|bytes| self.copy_sums(tiles, &bytes)).transpose()?.is_some()
                }
                _ => self.encode_sums(&*cold.source.sums(cold.tile)?)?,
            },
            SumsSlot::Resident(sums) => self.encode_sums(sums)?,
        };
        if has_model != has_sums {
            return Err("a tile has a model without sums, or sums without a model".into());
        }
        Ok(has_model)
    }

    fn encode_model(&mut self, model: &TileModel) -> Result<bool, WriteError> {
        let is_empty = model.groups.is_empty() && model.cells.is_empty() && model.always_occupied.is_empty();
        if !is_empty {
            tile_model::encode(model).encode(&mut self.model).map_err(|error| error.to_string())?;
        }
        Ok(!is_empty)
    }

    fn encode_sums(&mut self, sums: &TileSums) -> Result<bool, WriteError> {
        if sums.groups.is_empty() && sums.cells.is_empty() {
            return Ok(false);
        }
        if sums.cells.iter().any(|cell| cell.as_slice().len() != 2 * self.periodicities.len()) {
            return Err("a sum has another number of periodicities than its map".into());
        }
        let shared = sums.shared().map(|sum| self.share(sum)).collect::<Result<Vec<_>, _>>()?;
        tile_model::encode_sums(&shared, sums, &mut self.sums)?;
        Ok(true)
    }

    /// The number of a shared sum in memory, which is written if it is new.
    fn share(&mut self, sum: &Arc<PhasorSum>) -> Result<u32, WriteError> {
        let address = Arc::as_ptr(sum) as usize;
        if let Some(&number) = self.shared.by_address.get(&address) {
            return Ok(number);
        }
        let number = self.shared.next()?;
        let mut bytes = Vec::with_capacity(size_of_val(sum.as_slice()));
        doubles::push(&mut bytes, sum.as_slice());
        self.writer.long(RecordKind::SharedSum, &bytes)?;
        self.shared.by_address.insert(address, number);
        self.shared.in_memory.push(Arc::downgrade(sum));
        Ok(number)
    }

    /// Copies the sums of a tile from another checkpoint, with the numbers that its shared sums have here.
    fn copy_sums(&mut self, tiles: &CheckpointTiles, bytes: &[u8]) -> Result<(), WriteError> {
        let sums = EncodedSums::new(bytes, self.periodicities)?;
        let mut shared = Vec::with_capacity(sums.shared.len());
        for &old in &sums.shared {
            let place = (std::ptr::from_ref(tiles) as usize, old);
            let number = match (self.shared.by_place.get(&place), tiles.shared_in_memory(old)) {
                (Some(&number), _) => number,
                (None, Some(sum)) => self.share(&sum)?,
                (None, None) => {
                    let number = self.shared.next()?;
                    self.writer.long(RecordKind::SharedSum, &tiles.raw_shared(old)?)?;
                    self.shared.in_memory.push(Weak::new());
                    number
                }
            };
            self.shared.by_place.insert(place, number);
            shared.push(number);
        }
        sums.encode_again(&shared, self.periodicities, &mut self.sums);
        Ok(())
    }
}
