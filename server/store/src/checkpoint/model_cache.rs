//! Recently used models of tiles that are not in memory.
//!
//! Invariant: the models take at most about the allowed bytes; the least recently used is dropped first.

use std::{
    collections::{BTreeMap, HashMap},
    sync::Arc,
};

use tidemap_grid::{index::TileId, tile::TileModel};

/// A few models, up to a limit in bytes.
pub(crate) struct ModelCache {
    bytes_max: usize,
    bytes: usize,
    /// Number of uses so far.
    now: u64,
    models: HashMap<TileId, (u64, Arc<TileModel>)>,
    by_use: BTreeMap<u64, TileId>,
}

impl ModelCache {
    pub(crate) fn new(bytes_max: usize) -> ModelCache {
        ModelCache { bytes_max, bytes: 0, now: 0, models: HashMap::new(), by_use: BTreeMap::new() }
    }

    pub(crate) fn get(&mut self, tile: TileId) -> Option<Arc<TileModel>> {
        let (used, model) = self.models.get_mut(&tile)?;
        self.now += 1;
        self.by_use.remove(used);
        self.by_use.insert(self.now, tile);
        *used = self.now;
        Some(Arc::clone(model))
    }

    pub(crate) fn insert(&mut self, tile: TileId, model: &Arc<TileModel>) {
        self.now += 1;
        self.bytes += model.bytes();
        self.by_use.insert(self.now, tile);
        if let Some((used, before)) = self.models.insert(tile, (self.now, Arc::clone(model))) {
            self.by_use.remove(&used);
            self.bytes -= before.bytes();
        }
        while self.bytes > self.bytes_max {
            let Some((_, tile)) = self.by_use.pop_first() else { break };
            if let Some((_, model)) = self.models.remove(&tile) {
                self.bytes -= model.bytes();
            }
        }
    }
}

#[cfg(test)]
mod tests {
    use tidemap_grid::{mask::Mask, tile::Group};

    use super::*;

    #[test]
    fn the_longest_unused_goes_first() {
        let group = Group { cells: Mask::FULL, observations: 1, first_nanos: 0, last_nanos: 0, ..Group::default() };
        let model = Arc::new(TileModel { groups: vec![group; 10], ..TileModel::default() });
        let mut cache = ModelCache::new(model.bytes() * 2);
        cache.insert(TileId(1), &model);
        cache.insert(TileId(2), &model);
        assert!(cache.get(TileId(1)).is_some());
        cache.insert(TileId(3), &model);
        cache.insert(TileId(3), &model);
        let found = [1, 2, 3].map(|tile| cache.get(TileId(tile)).is_some());
        assert_eq!(found, [true, false, true]);
        assert_eq!((cache.bytes, cache.by_use.len()), (model.bytes() * 2, 2));
    }
}
