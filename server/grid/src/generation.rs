//! The result that one update published for a grid: a model per tile.
//!
//! Invariant: a generation is immutable once published; it shares unchanged tiles with the generation before.

use crate::{index::TileId, tile::ModelSlot};

/// The models of all tiles.
#[derive(Clone, Debug, Default)]
pub struct Generation {
    /// Models by the number of the tile; a tile that no update has seen may be missing.
    pub models: Vec<ModelSlot>,
}

impl Generation {
    /// The model of a tile; `None` where no update has seen it.
    pub fn model(&self, tile: TileId) -> Option<&ModelSlot> {
        self.models.get(tile.0 as usize)
    }
}
