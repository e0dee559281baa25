//! The times at which the cells of a tile were observed on one day. Cells observed at the same times are kept together,
//! and the groups of the tile are split accordingly.
//!
//! Invariant: times are toggles: ascending numbers of scans, among those that saw the tile, at which a bit changes; the
//! bit is clear before the first.

use super::super::{
    day::{Bit, DayTile},
    index::TILE_CELLS,
    mask::Mask,
    tile::Group,
};

/// The toggles of cells of which a bit changed within the day, and the values that they showed.
#[derive(Debug, Default)]
pub(super) struct DayToggles {
    /// Cells observed at the same times: the toggles of their observed bit, and the cells.
    pub(super) observed: Vec<(Vec<u32>, Mask)>,
    /// Cells that were ever read as occupied.
    pub(super) ever_occupied: Mask,
    /// Cells that were ever read as free.
    pub(super) ever_free: Mask,
    /// Per cell the toggles of the occupied bit, for cells that have any; by cell.
    pub(super) occupied: Vec<(u16, Vec<u32>)>,
}

/// Numbers scans among those of some ranges.
struct Compact<'a> {
    ranges: &'a [(u32, u32)],
    before: u32,
}

impl Compact<'_> {
    /// The number of a scan; called in ascending order.
    fn number(&mut self, scan: u32) -> u32 {
        while let Some(&(first, end)) = self.ranges.first() {
            if scan < end {
                return self.before + scan.saturating_sub(first);
            }
            self.before += end - first;
            self.ranges = &self.ranges[1..];
        }
        self.before
    }
}

impl DayToggles {
    pub(super) fn new(tile: &DayTile, ranges: &[(u32, u32)]) -> DayToggles {
        let mut compact = Compact { ranges, before: 0 };
        let (mut observed, mut occupied) = (tile.first.observed(), tile.first.occupied());
        let (mut ever_occupied, mut ever_free) = (occupied, observed.without(occupied));
        let mut occupied_toggles = CellToggles::starting_with(occupied);
        // Toggles are collected only for cells whose observed bit flips within the day.
        let mut observed_toggles = CellToggles::starting_with(Mask::EMPTY);
        for of_scan in tile.flips.chunk_by(|one, other| one.scan == other.scan) {
            let Some(first) = of_scan.first() else { continue };
            let number = compact.number(first.scan);
            for flip in of_scan {
                let cell = flip.cell();
                match flip.bit() {
                    Bit::Observed => {
                        observed_toggles.push(cell, number, observed.contains(cell));
                        observed.flip(cell);
                    }
                    Bit::Occupied => {
                        occupied_toggles.push(cell, number, false);
                        occupied.flip(cell);
                    }
                }
            }
            ever_occupied |= occupied;
            ever_free |= observed.without(occupied);
        }
        let steady = tile.first.observed().without(observed_toggles.cells);
        let mut alike: Vec<(Vec<u32>, Mask)> =
            observed_toggles.into_cells().map(|(cell, toggles)| (toggles, Mask::of(cell))).collect();
        if !steady.is_empty() {
            alike.push((vec![0], steady));
        }
        alike.sort_unstable_by(|(one, _), (other, _)| one.cmp(other));
        alike.dedup_by(|(toggles, cells), (kept, all)| {
            let is_alike = toggles == kept;
            if is_alike {
                *all |= *cells;
            }
            is_alike
        });
        DayToggles { observed: alike, ever_occupied, ever_free, occupied: occupied_toggles.into_cells().collect() }
    }
}

/// The toggles of a bit by cell.
struct CellToggles {
    of_cells: Vec<Vec<u32>>,
    /// The cells that have toggles.
    cells: Mask,
}

impl CellToggles {
    /// Toggles of a bit that is set in the first scan for these cells.
    fn starting_with(cells: Mask) -> CellToggles {
        let mut of_cells = vec![Vec::new(); TILE_CELLS];
        for cell in cells.cells() {
            of_cells[usize::from(cell)] = vec![0];
        }
        CellToggles { of_cells, cells }
    }

    /// Adds a toggle of a cell. `was_set`: whether the bit was set before, used for the cell's first toggle.
    fn push(&mut self, cell: u16, number: u32, was_set: bool) {
        let Some(toggles) = self.of_cells.get_mut(usize::from(cell)) else { return };
        if toggles.is_empty() && was_set {
            toggles.push(0);
        }
        toggles.push(number);
        self.cells.insert(cell);
    }

    /// The cells that have toggles, ascending, with their toggles.
    fn into_cells(self) -> impl Iterator<Item = (u16, Vec<u32>)> {
        let cells = self.cells;
        (0..).zip(self.of_cells).filter(move |(cell, _)| cells.contains(*cell))
    }
}

/// An observation group after the day: the group it was part of, and its toggles on the day.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) struct SplitGroup {
    pub(super) cells: Mask,
    /// Index of the group before; `None`: never observed before.
    pub(super) before: Option<usize>,
    /// Index into [`DayToggles::observed`]; `None`: not observed on the day.
    pub(super) toggles: Option<usize>,
    /// Whether the sum of the group is whole; otherwise the tile's runs hold the rest of it.
    pub(super) is_summed: bool,
}

/// Splits the groups where their cells were observed at different times, and adds groups of new cells. The result
/// ascends by the lowest cell of each group.
pub(super) fn split_groups(groups: &[Group], toggles: &[(Vec<u32>, Mask)]) -> Vec<SplitGroup> {
    let mut alike = [None; TILE_CELLS];
    for (index, (_, cells)) in toggles.iter().enumerate() {
        for cell in cells.cells() {
            alike[usize::from(cell)] = Some(index);
        }
    }
    let seen = toggles.iter().fold(Mask::EMPTY, |all, (_, cells)| all | *cells);
    let known = groups.iter().fold(Mask::EMPTY, |all, group| all | group.cells);
    let mut split = Vec::with_capacity(groups.len() + toggles.len());
    let mut add = |mut rest: Mask, before: Option<usize>| {
        while let Some(cell) = rest.first() {
            let toggles_of = alike.get(usize::from(cell)).copied().flatten();
            let cells = match toggles_of.and_then(|index: usize| toggles.get(index)) {
                Some((_, cells)) => rest & *cells,
                None => rest.without(seen),
            };
            split.push(SplitGroup { cells, before, toggles: toggles_of, is_summed: true });
            rest = rest.without(cells);
        }
    };
    for (before, group) in groups.iter().enumerate() {
        add(group.cells, Some(before));
    }
    add(seen.without(known), None);
    split.sort_unstable_by_key(|group| group.cells.first());
    split
}

/// Splits groups into cells that have or get a spectrum, whose sums are whole, and other cells.
pub(super) fn part_by_spectrum(split: Vec<SplitGroup>, with_spectrum: Mask) -> Vec<SplitGroup> {
    let halves = |group: SplitGroup| {
        let summed = SplitGroup { cells: group.cells & with_spectrum, is_summed: true, ..group };
        let others = SplitGroup { cells: group.cells.without(with_spectrum), is_summed: false, ..group };
        [summed, others]
    };
    let mut split: Vec<SplitGroup> =
        split.into_iter().flat_map(halves).filter(|group| !group.cells.is_empty()).collect();
    split.sort_unstable_by_key(|group| group.cells.first());
    split
}
