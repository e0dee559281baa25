//! The table of tiles of a stream on the receiving side: what the stream last showed of each tile, and which tiles its
//! last scan saw.
//!
//! Invariant: masks are kept as sent, also beyond the extent of the grid, because digests and later flips refer to
//! them. `digest` and `cells` are sums over the tiles of `runs`. A malformed scan puts the slots that it named in doubt
//! until a scan sends their masks whole: the sender may believe that they changed.

use std::{collections::HashSet, sync::Arc};

use tidemap_grid::{
    index::{CellBox, TILE_LIMIT, TileIndex},
    mask::{Mask, TileMasks},
    spec::GridSpec,
};

use super::{
    ScanError,
    digest::{index_crc, masks_digest},
};
use crate::convert::{InvalidField, OverLimit};

/// Cells of a tile of a flat grid.
pub(super) const LAYER: Mask = Mask([u64::MAX, 0, 0, 0, 0, 0, 0, 0]);

/// One tile of the table.
#[derive(Debug)]
pub(super) struct TableSlot {
    pub masks: TileMasks,
    digest: u64,
    index_crc: u32,
    /// Cells within the grid's extent; `None`: all.
    within: Option<Box<Mask>>,
    /// Whether the sender may believe that it has shown something else.
    pub is_in_doubt: bool,
}

impl TableSlot {
    /// The given cells that lie within the grid's extent.
    pub(crate) fn cut(&self, cells: Mask) -> Mask {
        self.within.as_ref().map_or(cells, |within| cells & **within)
    }

    /// Whether every cell lies within the grid's extent.
    pub(crate) fn is_whole(&self) -> bool {
        self.within.is_none()
    }

    fn cells(&self) -> u64 {
        u64::from(self.cut(self.masks.observed()).count())
    }
}

/// The tiles that a stream has shown.
#[derive(Debug)]
pub(super) struct DecoderTable {
    pub is_flat: bool,
    extent: Option<CellBox>,
    pub slots: Vec<TableSlot>,
    known: HashSet<TileIndex>,
    /// The slots seen last, as runs.
    pub runs: Vec<(u32, u32)>,
    /// The slots of `runs` one by one, without those that have no cell in the extent of the grid.
    pub seen: Arc<[u32]>,
    pub digest: u64,
    /// Cells observed within the grid's extent.
    pub cells: u64,
    /// Whether future slots are in doubt.
    is_rest_in_doubt: bool,
}

impl DecoderTable {
    pub(crate) fn new(spec: Option<&GridSpec>) -> DecoderTable {
        DecoderTable {
            is_flat: spec.is_some_and(|spec| spec.is_flat),
            // Without an extent every tile that the wire allows lies within.
            extent: spec.filter(|spec| spec.extent.is_some()).map(GridSpec::allowed),
            slots: Vec::new(),
            known: HashSet::new(),
            runs: Vec::new(),
            seen: Arc::from([]),
            digest: 0,
            cells: 0,
            is_rest_in_doubt: false,
        }
    }

    /// Adds tiles to the table: all or none.
    pub(crate) fn extend(&mut self, new_tiles: &[i32], max_tiles: usize) -> Result<Vec<TileIndex>, ScanError> {
        let (triples, rest) = new_tiles.as_chunks::<3>();
        if !rest.is_empty() {
            let text = format!("{} entries are not x, y, z of each tile", new_tiles.len());
            return Err(InvalidField::new("scans.new_tiles", text).into());
        }
        let tiles = self.slots.len() + triples.len();
        OverLimit::check("tiles of one stream", tiles, max_tiles, "setting max_scan_tiles")?;
        let mut added = HashSet::with_capacity(triples.len());
        let mut indices = Vec::with_capacity(triples.len());
        for (number, &[x, y, z]) in triples.iter().enumerate() {
            let index = TileIndex { x, y, z };
            let wrong = if !index.is_valid() {
                format!("it must be within ±{TILE_LIMIT} along each axis")
            } else if self.is_flat && z != 0 {
                "z must be 0 in a flat grid".to_owned()
            } else if self.known.contains(&index) || !added.insert(index) {
                "it is in the stream's table already".to_owned()
            } else {
                indices.push(index);
                continue;
            };
            let field = format!("scans.new_tiles[{}]", 3 * number);
            return Err(InvalidField::new(field, format!("tile {x}, {y}, {z}: {wrong}")).into());
        }
        for &index in &indices {
            self.known.insert(index);
            let index_crc = index_crc(index);
            let masks = TileMasks::default();
            let digest = masks_digest(index_crc, &masks);
            let within = self.within(index).map(Box::new);
            self.slots.push(TableSlot { masks, digest, index_crc, within, is_in_doubt: self.is_rest_in_doubt });
        }
        Ok(indices)
    }

    /// The cells of a tile that lie within the extent; `None` if all do.
    fn within(&self, index: TileIndex) -> Option<Mask> {
        let extent = self.extent?;
        let mut common = index.cells().intersection(&extent);
        if self.is_flat {
            // The cells above the layer are never used: the tile counts as whole.
            let whole = index.cells();
            (common.min.z, common.max.z) = (whole.min.z, whole.max.z);
        }
        if common == index.cells() {
            return None;
        }
        let mut within = Mask::EMPTY;
        if !common.is_empty() {
            for place in Mask::FULL.cells().filter(|&place| common.contains(index.cell(place))) {
                within.insert(place);
            }
        }
        Some(within)
    }

    /// Approximate memory, bytes.
    pub(crate) fn bytes(&self) -> usize {
        let cut = self.slots.iter().filter(|slot| !slot.is_whole()).count();
        let per_slot = size_of::<TableSlot>() + 2 * size_of::<TileIndex>();
        self.slots.len() * per_slot + cut * size_of::<Mask>() + 4 * self.seen.len() + 8 * self.runs.len()
    }

    /// Puts slots in doubt; `None`: all slots, including future ones.
    pub(crate) fn doubt(&mut self, slots: Option<&[u32]>) {
        match slots {
            Some(slots) => {
                for &number in slots {
                    if let Some(slot) = self.slots.get_mut(number as usize) {
                        slot.is_in_doubt = true;
                    }
                }
            }
            None => {
                self.slots.iter_mut().for_each(|slot| slot.is_in_doubt = true);
                self.is_rest_in_doubt = true;
            }
        }
    }

    /// Ends the doubt about slots whose masks were sent whole.
    pub(crate) fn trust(&mut self, slots: &[u32]) {
        for &number in slots {
            if let Some(slot) = self.slots.get_mut(number as usize) {
                slot.is_in_doubt = false;
            }
        }
    }

    /// Applies a scan: its changed masks, and its runs if it sees other slots than the previous scan.
    pub(crate) fn take(&mut self, changes: &[(u32, TileMasks)], runs: Option<&mut Vec<(u32, u32)>>) {
        for &(slot, masks) in changes {
            let Some(slot) = self.slots.get_mut(slot as usize) else { continue };
            self.digest = self.digest.wrapping_sub(slot.digest);
            let moves_cells = slot.masks.observed() != masks.observed();
            self.cells = self.cells.wrapping_sub(if moves_cells { slot.cells() } else { 0 });
            slot.masks = masks;
            slot.digest = masks_digest(slot.index_crc, &masks);
            self.digest = self.digest.wrapping_add(slot.digest);
            self.cells = self.cells.wrapping_add(if moves_cells { slot.cells() } else { 0 });
        }
        let Some(runs) = runs else { return };
        std::mem::swap(&mut self.runs, runs);
        (self.digest, self.cells) = (0, 0);
        let mut seen = Vec::with_capacity(self.runs.iter().map(|(first, end)| (end - first) as usize).sum());
        for number in self.runs.iter().flat_map(|&(first, end)| first..end) {
            let Some(slot) = self.slots.get(number as usize) else { continue };
            self.digest = self.digest.wrapping_add(slot.digest);
            self.cells += slot.cells();
            if slot.within.as_ref().is_none_or(|within| !within.is_empty()) {
                seen.push(number);
            }
        }
        self.seen = seen.into();
    }
}
