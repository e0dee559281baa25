//! Paging: tiles that the store has saved are removed from memory, and are read back on demand.
//!
//! Invariant: a tile is removed from memory only if its model and sums are the ones that were saved; data that an
//! update has changed since then stays. No tile is removed while an update has the sums.

use std::{
    collections::HashSet,
    sync::{Arc, Weak},
};

use tidemap_model::PhasorSum;

use crate::{
    generation::Generation,
    index::TileId,
    live::LiveGrid,
    snapshot::GridSnapshot,
    tile::{ColdTile, ModelSlot, SumsSlot, TileModel, TileSource, TileSums},
};

/// Identifies the models and sums of a save without holding them in memory.
#[derive(Clone, Debug, Default)]
pub struct SavedTiles {
    tiles: Vec<Option<(Weak<TileModel>, Weak<TileSums>)>>,
}

impl SavedTiles {
    /// The tiles of a snapshot that was saved.
    pub fn of(snapshot: &GridSnapshot) -> SavedTiles {
        let resident = |(model, sums): (&ModelSlot, &SumsSlot)| match (model, sums) {
            (ModelSlot::Resident(model), SumsSlot::Resident(sums)) => {
                Some((Arc::downgrade(model), Arc::downgrade(sums)))
            }
            _ => None,
        };
        SavedTiles { tiles: snapshot.models.iter().zip(&snapshot.sums).map(resident).collect() }
    }

    fn has(&self, tile: usize, model: &Arc<TileModel>, sums: &Arc<TileSums>) -> bool {
        self.tiles.get(tile).and_then(Option::as_ref).is_some_and(|(saved_model, saved_sums)| {
            std::ptr::eq(saved_model.as_ptr(), Arc::as_ptr(model))
                && std::ptr::eq(saved_sums.as_ptr(), Arc::as_ptr(sums))
        })
    }
}

/// The memory of the tiles of a grid.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct TileMemory {
    /// Models and sums of tiles in memory, in bytes, about; a shared sum counts once.
    pub bytes: u64,
    /// Tiles with neither model nor sums in memory.
    pub cold_tiles: u64,
}

impl LiveGrid {
    /// Memory of models and sums, without the models and sums that a running update has.
    pub fn memory(&self) -> TileMemory {
        let mut shared = HashSet::new();
        let mut memory = TileMemory::default();
        let models = &self.generation.models;
        for (tile, model) in models.iter().enumerate() {
            let sums = self.sums.get(tile);
            memory.bytes += bytes_of(model, sums, &mut shared);
            let is_cold = matches!(model, ModelSlot::Cold(_)) && !matches!(sums, Some(SumsSlot::Resident(_)));
            memory.cold_tiles += u64::from(is_cold);
        }
        memory
    }

    /// From now on, reads tiles outside of memory from this save, which is the newest. Then moves saved tiles out of
    /// memory until the rest take `budget_bytes` or less; tiles that were not observed for longest go first. Returns
    /// the number of tiles moved. Views published from now on do not hold them. No update may have the sums.
    pub fn page_out(&mut self, source: &Arc<dyn TileSource>, saved: &SavedTiles, budget_bytes: u64) -> usize {
        self.follow(source);
        let mut bytes = self.memory().bytes;
        if bytes <= budget_bytes {
            return 0;
        }
        let mut may_go: Vec<(i64, usize)> = Vec::new();
        for (tile, slots) in self.generation.models.iter().zip(&self.sums).enumerate() {
            if let (ModelSlot::Resident(model), SumsSlot::Resident(sums)) = slots
                && saved.has(tile, model, sums)
            {
                may_go.push((model.groups.iter().map(|group| group.last_nanos).max().unwrap_or(i64::MIN), tile));
            }
        }
        may_go.sort_unstable();
        let mut models = self.generation.models.clone();
        // A sum is freed with the last tile that holds it.
        let mut holders: std::collections::HashMap<*const PhasorSum, usize> = std::collections::HashMap::new();
        for sums in self.sums.iter().filter_map(resident) {
            for group in sums.shared() {
                *holders.entry(Arc::as_ptr(group)).or_default() += 1;
            }
        }
        let mut gone = 0;
        for (_, tile) in may_go {
            if bytes <= budget_bytes {
                break;
            }
            let Ok(id) = u32::try_from(tile).map(TileId) else { break };
            let cold = ColdTile { source: Arc::clone(source), tile: id };
            if let ModelSlot::Resident(model) = std::mem::replace(&mut models[tile], ModelSlot::Cold(cold.clone())) {
                bytes = bytes.saturating_sub(model.bytes() as u64);
            }
            if let SumsSlot::Resident(sums) = std::mem::replace(&mut self.sums[tile], SumsSlot::Cold(cold)) {
                bytes = bytes.saturating_sub(sums.own_bytes() as u64);
                for group in sums.shared() {
                    let left = holders.entry(Arc::as_ptr(group)).or_default();
                    *left = left.saturating_sub(1);
                    if *left == 0 {
                        bytes = bytes.saturating_sub(group.bytes() as u64);
                    }
                }
            }
            gone += 1;
        }
        if gone > 0 {
            self.generation = Arc::new(Generation { models });
        }
        gone
    }

    /// Reads tiles outside of memory from the newest save, which contains them unchanged, so that no older save is kept
    /// open.
    fn follow(&mut self, source: &Arc<dyn TileSource>) {
        let is_older = |cold: &ColdTile| !Arc::ptr_eq(&cold.source, source);
        let is_model_older = |slot: &ModelSlot| matches!(slot, ModelSlot::Cold(cold) if is_older(cold));
        if self.generation.models.iter().any(is_model_older) {
            let mut models = self.generation.models.clone();
            for slot in &mut models {
                if let ModelSlot::Cold(cold) = slot {
                    cold.source = Arc::clone(source);
                }
            }
            self.generation = Arc::new(Generation { models });
        }
        for slot in &mut self.sums {
            if let SumsSlot::Cold(cold) = slot {
                cold.source = Arc::clone(source);
            }
        }
    }
}

fn resident(slot: &SumsSlot) -> Option<&TileSums> {
    match slot {
        SumsSlot::Resident(sums) => Some(sums),
        SumsSlot::Cold(_) => None,
    }
}

fn bytes_of(model: &ModelSlot, sums: Option<&SumsSlot>, shared: &mut HashSet<*const PhasorSum>) -> u64 {
    let mut bytes = match model {
        ModelSlot::Resident(model) => model.bytes(),
        ModelSlot::Cold(_) => 0,
    };
    if let Some(sums) = sums.and_then(resident) {
        bytes += sums.own_bytes();
        bytes +=
            sums.shared().filter(|group| shared.insert(Arc::as_ptr(group))).map(|group| group.bytes()).sum::<usize>();
    }
    bytes as u64
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::{
        spec::{GridSpec, Retention},
        tile::TileUnavailable,
    };

    /// A save in which every tile is empty.
    #[derive(Debug)]
    struct Empty;

    impl TileSource for Empty {
        fn model(&self, _: TileId) -> Result<Arc<TileModel>, TileUnavailable> {
            Ok(Arc::default())
        }

        fn sums(&self, _: TileId) -> Result<Arc<TileSums>, TileUnavailable> {
            Ok(Arc::default())
        }

        fn as_any(&self) -> &dyn std::any::Any {
            self
        }
    }

    #[test]
    fn no_save_but_the_newest_is_kept_open() {
        let spec = GridSpec { retention: Retention::Forever, ..GridSpec::new(0.1) };
        let mut grid = LiveGrid::new(Arc::new(spec));
        let (old, new): (Arc<dyn TileSource>, Arc<dyn TileSource>) = (Arc::new(Empty), Arc::new(Empty));
        let cold = |tile| ColdTile { source: Arc::clone(&old), tile: TileId(tile) };
        let models = vec![ModelSlot::Cold(cold(0)), ModelSlot::default(), ModelSlot::Cold(cold(2))];
        grid.generation = Arc::new(Generation { models });
        grid.sums = vec![SumsSlot::Cold(cold(0)), SumsSlot::default(), SumsSlot::Cold(cold(2))];
        grid.follow(&new);
        assert_eq!((Arc::strong_count(&old), Arc::strong_count(&new)), (1, 5));
        let tiles = grid.generation.models.iter().map(|slot| match slot {
            ModelSlot::Cold(cold) => Some(cold.tile.0),
            ModelSlot::Resident(_) => None,
        });
        assert_eq!(tiles.collect::<Vec<_>>(), [Some(0), None, Some(2)]);
    }
}
