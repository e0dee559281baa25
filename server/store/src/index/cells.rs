//! The models of a grid's tiles, read from the index one by one.
//!
//! Invariant: a tile is of the generation whose mark was found, or is unavailable: the mark is compared after each
//! read.

use std::{
    any::Any,
    fmt,
    sync::{Arc, Mutex, MutexGuard, PoisonError},
};

use tidemap_grid::{
    index::TileId,
    tile::{TileModel, TileSource, TileSums, TileUnavailable},
};
use tidemap_layout::{
    grid as layout,
    index::{item_key, map_key},
};
use tidemap_model::Periodicities;

use super::{
    Trees, panics,
    rows::{self, Kind},
};
use crate::{checkpoint::ModelCache, failure::ReadFailure, record::tile_model};

/// Bytes of models that are kept.
const MODELS_BYTES: usize = 16 << 20;

/// The models of a grid's tiles in the index.
pub(super) struct IndexedCells {
    cells: sled::Tree,
    generations: sled::Tree,
    map: u32,
    mark: sled::IVec,
    periodicities: Periodicities,
    /// The models that are in memory. The lock is held for a look-up.
    models: Mutex<ModelCache>,
}

impl fmt::Debug for IndexedCells {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.debug_struct("IndexedCells").field("map", &self.map).finish_non_exhaustive()
    }
}

impl IndexedCells {
    /// `mark`: the clean mark of the map, as it is stored.
    pub(super) fn new(trees: &Trees, map: u32, periodicities: Periodicities, mark: sled::IVec) -> IndexedCells {
        let (cells, generations) = (trees.of(Kind::Cells).clone(), trees.generations.clone());
        IndexedCells { cells, generations, map, mark, periodicities, models: Mutex::new(ModelCache::new(MODELS_BYTES)) }
    }

    fn models(&self) -> MutexGuard<'_, ModelCache> {
        self.models.lock().unwrap_or_else(PoisonError::into_inner)
    }

    fn read(&self, tile: TileId) -> Result<TileModel, ReadFailure> {
        panics::catch(|| {
            let mut items = rows::items(Kind::Cells, self.cells.scan_prefix(item_key(self.map, tile.0)));
            let item = items.next().transpose()?;
            let mark = self.generations.get(map_key(self.map))?;
            if mark.as_ref() != Some(&self.mark) {
                return Err("a newer generation has replaced it".into());
            }
            let Some(item) = item else { return Ok(TileModel::default()) };
            let model = tile_model::decode(&item.message::<layout::TileModel>(Kind::Cells)?, &self.periodicities)?;
            Ok::<_, ReadFailure>(model)
        })?
    }
}

impl TileSource for IndexedCells {
    fn model(&self, tile: TileId) -> Result<Arc<TileModel>, TileUnavailable> {
        if let Some(model) = self.models().get(tile) {
            return Ok(model);
        }
        let unavailable = |reason| TileUnavailable { tile, reason: format!("the index cannot be read: {reason}") };
        let model = Arc::new(self.read(tile).map_err(unavailable)?);
        self.models().insert(tile, &model);
        Ok(model)
    }

    fn sums(&self, tile: TileId) -> Result<Arc<TileSums>, TileUnavailable> {
        Err(TileUnavailable { tile, reason: "the index holds no sums".to_owned() })
    }

    fn as_any(&self) -> &dyn Any {
        self
    }
}
