//! Tiles that are not in memory, read one by one from the checkpoint that holds them.
//!
//! Invariant: the file stays open and never changes, so a tile can be read as long as anything refers to it, even
//! after the checkpoint was deleted. A sum that tiles share is loaded once for all tiles that are in memory at the same
//! time.

use std::{
    any::Any,
    fmt,
    path::PathBuf,
    sync::{Arc, Mutex, MutexGuard, PoisonError, Weak},
};

use tidemap_grid::{
    index::TileId,
    tile::{TileModel, TileSource, TileSums, TileUnavailable},
};
use tidemap_layout::{file::RecordKind, grid as layout};
use tidemap_model::{Periodicities, PhasorSum};

use super::model_cache::ModelCache;
use crate::{
    disk::DiskReader,
    record::tile_model::{self, EncodedSums},
    record_file::anywhere,
};

/// Bytes of models of cold tiles that are kept.
const MODELS_BYTES: usize = 16 << 20;

/// Offsets of a tile's records in the file; 0 if it has none.
#[derive(Clone, Copy, Debug, Default)]
pub(crate) struct TileOffset {
    pub(crate) model: u64,
    pub(crate) sums: u64,
}

/// Offsets of all records in the file.
#[derive(Default)]
pub(crate) struct TileOffsets {
    pub(crate) tiles: Vec<TileOffset>,
    /// The shared sums, by their number.
    pub(crate) shared: Vec<u64>,
}

/// The tiles of one checkpoint.
pub(crate) struct CheckpointTiles {
    file: Box<dyn DiskReader>,
    path: PathBuf,
    periodicities: Periodicities,
    offsets: TileOffsets,
    /// The shared sums that are in memory. The lock is held for a look-up.
    shared: Mutex<Vec<Weak<PhasorSum>>>,
    /// The models that are in memory. The lock is held for a look-up.
    models: Mutex<ModelCache>,
}

impl fmt::Debug for CheckpointTiles {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.debug_struct("CheckpointTiles").field("path", &self.path).finish_non_exhaustive()
    }
}

impl CheckpointTiles {
    /// `shared`: the shared sums that are in memory, by their number; the rest is not.
    pub(crate) fn new(
        file: Box<dyn DiskReader>,
        path: PathBuf,
        periodicities: Periodicities,
        offsets: TileOffsets,
        mut shared: Vec<Weak<PhasorSum>>,
    ) -> CheckpointTiles {
        shared.resize_with(offsets.shared.len(), Weak::new);
        let models = Mutex::new(ModelCache::new(MODELS_BYTES));
        CheckpointTiles { file, path, periodicities, offsets, shared: Mutex::new(shared), models }
    }

    pub(super) fn periodicities(&self) -> &Periodicities {
        &self.periodicities
    }

    fn offset(&self, tile: TileId) -> TileOffset {
        self.offsets.tiles.get(tile.0 as usize).copied().unwrap_or_default()
    }

    /// A tile's model as bytes; `None` if it has none.
    pub(super) fn raw_model(&self, tile: TileId) -> Result<Option<Vec<u8>>, String> {
        match self.offset(tile).model {
            0 => Ok(None),
            offset => Ok(Some(anywhere::long(&*self.file, RecordKind::TileModel, offset)?.0)),
        }
    }

    /// A tile's sums as bytes; `None` if it has none.
    pub(super) fn raw_sums(&self, tile: TileId) -> Result<Option<Vec<u8>>, String> {
        match self.offset(tile).sums {
            0 => Ok(None),
            offset => Ok(Some(anywhere::long(&*self.file, RecordKind::TileSums, offset)?.0)),
        }
    }

    /// A shared sum as bytes.
    pub(super) fn raw_shared(&self, number: u32) -> Result<Vec<u8>, String> {
        let offset = self.offsets.shared.get(number as usize).ok_or("a shared sum is not there")?;
        Ok(anywhere::long(&*self.file, RecordKind::SharedSum, *offset)?.0)
    }

    fn shared(&self) -> MutexGuard<'_, Vec<Weak<PhasorSum>>> {
        self.shared.lock().unwrap_or_else(PoisonError::into_inner)
    }

    fn models(&self) -> MutexGuard<'_, ModelCache> {
        self.models.lock().unwrap_or_else(PoisonError::into_inner)
    }

    /// A shared sum, if it is in memory.
    pub(super) fn shared_in_memory(&self, number: u32) -> Option<Arc<PhasorSum>> {
        self.shared().get(number as usize)?.upgrade()
    }

    fn shared_sum(&self, number: u32) -> Result<Arc<PhasorSum>, String> {
        if let Some(sum) = self.shared_in_memory(number) {
            return Ok(sum);
        }
        let sum = Arc::new(tile_model::decode_shared(&self.raw_shared(number)?, &self.periodicities)?);
        let mut shared = self.shared();
        let Some(known) = shared.get_mut(number as usize) else { return Ok(sum) };
        // Another thread may have loaded it meanwhile.
        if let Some(known) = known.upgrade() {
            return Ok(known);
        }
        *known = Arc::downgrade(&sum);
        Ok(sum)
    }

    pub(crate) fn read_model(&self, tile: TileId) -> Result<TileModel, String> {
        let Some(bytes) = self.raw_model(tile)? else { return Ok(TileModel::default()) };
        let message: layout::TileModel =
            prost::Message::decode(&bytes[..]).map_err(|_| "its model is not a message".to_owned())?;
        tile_model::decode(&message, &self.periodicities)
    }

    pub(crate) fn read_sums(&self, tile: TileId) -> Result<TileSums, String> {
        let Some(bytes) = self.raw_sums(tile)? else { return Ok(TileSums::default()) };
        let sums = EncodedSums::new(&bytes, &self.periodicities)?;
        let groups = sums.shared.iter().map(|&number| self.shared_sum(number)).collect::<Result<_, _>>()?;
        sums.decode(groups, &self.periodicities).map_err(|error| error.to_string())
    }

    fn unavailable(&self, tile: TileId, reason: &str) -> TileUnavailable {
        TileUnavailable { tile, reason: format!("{} is damaged or not readable: {reason}", self.path.display()) }
    }
}

impl TileSource for CheckpointTiles {
    fn model(&self, tile: TileId) -> Result<Arc<TileModel>, TileUnavailable> {
        if let Some(model) = self.models().get(tile) {
            return Ok(model);
        }
        let model = Arc::new(self.read_model(tile).map_err(|reason| self.unavailable(tile, &reason))?);
        self.models().insert(tile, &model);
        Ok(model)
    }

    fn sums(&self, tile: TileId) -> Result<Arc<TileSums>, TileUnavailable> {
        self.read_sums(tile).map(Arc::new).map_err(|reason| self.unavailable(tile, &reason))
    }

    fn as_any(&self) -> &dyn Any {
        self
    }
}
