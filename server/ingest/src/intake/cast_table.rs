//! The table of tiles of the scans that the server ray-casts for one stream, like a stream's own table.
//!
//! Invariant: the table never exceeds its limit; if a scan would need more, it restarts.

use std::{collections::HashMap, sync::Arc};

use tidemap_grid::{index::TileIndex, log_head::StreamScan, mask::TileMasks, scan::ScanSource};

#[derive(Debug)]
pub(super) struct CastTable {
    max_tiles: usize,
    ids: HashMap<TileIndex, u32>,
    masks: Vec<TileMasks>,
    seen: Arc<[u32]>,
}

/// A ray-cast scan for the writer.
#[derive(Debug)]
pub(super) struct CastScan {
    pub scan: StreamScan,
    /// The tiles that are new in the table.
    pub new_tiles: Vec<TileIndex>,
    /// Whether the table restarted before these tiles.
    pub restarts: bool,
}

impl CastTable {
    pub(super) fn new(max_tiles: usize) -> CastTable {
        CastTable { max_tiles, ids: HashMap::new(), masks: Vec::new(), seen: Arc::from([]) }
    }

    /// The changes of a scan that shows these tiles.
    pub(super) fn show(
        &mut self,
        (utc_nanos, source): (i64, ScanSource),
        tiles: &[(TileIndex, TileMasks)],
    ) -> CastScan {
        let unknown = tiles.iter().filter(|(index, _)| !self.ids.contains_key(index)).count();
        let restarts = self.masks.len() + unknown > self.max_tiles;
        if restarts {
            *self = CastTable::new(self.max_tiles);
        }
        let mut new_tiles = Vec::new();
        let mut shown: Vec<(u32, TileMasks)> = Vec::with_capacity(tiles.len());
        for &(index, masks) in tiles {
            let next = u32::try_from(self.masks.len()).unwrap_or(u32::MAX);
            let slot = *self.ids.entry(index).or_insert(next);
            if slot == next {
                self.masks.push(TileMasks::default());
                new_tiles.push(index);
            }
            shown.push((slot, masks));
        }
        shown.sort_unstable_by_key(|(slot, _)| *slot);
        let (mut observed_flips, mut occupied_flips) = (Vec::new(), Vec::new());
        for &(slot, masks) in &shown {
            let Some(known) = self.masks.get_mut(slot as usize) else { continue };
            let before = std::mem::replace(known, masks);
            let cell = |place: u16| slot * 512 + u32::from(place);
            observed_flips.extend((before.observed() ^ masks.observed()).cells().map(cell));
            occupied_flips.extend((before.occupied() ^ masks.occupied()).cells().map(cell));
        }
        if !shown.iter().map(|(slot, _)| slot).eq(self.seen.iter()) {
            self.seen = shown.iter().map(|(slot, _)| *slot).collect();
        }
        let scan = StreamScan { utc_nanos, source, seen: Arc::clone(&self.seen), observed_flips, occupied_flips };
        CastScan { scan, new_tiles, restarts }
    }
}
