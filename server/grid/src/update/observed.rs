//! When the cells of a tile were observed on one day: cells observed alike together, and the groups of the tile split
//! by it.
//!
//! Invariant: times are toggles: ascending numbers of scans, among those that saw the tile, at which a bit changes; the
//! bit is clear before the first.

use std::collections::BTreeMap;

use super::super::{
    day::{Bit, DayTile},
    index::TILE_CELLS,
    mask::Mask,
    tile::Group,
};

/// The toggles of cells that changed a bit within the day, and what they showed.
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
    /// The number of a scan; asked in ascending order.
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
        let start = |bits: Mask| bits.cells().map(|cell| (cell, vec![0])).collect::<BTreeMap<u16, Vec<u32>>>();
        let mut occupied_toggles = start(occupied);
        // Only of cells whose observed bit flips within the day.
        let mut observed_toggles: BTreeMap<u16, Vec<u32>> = BTreeMap::new();
        for of_scan in tile.flips.chunk_by(|one, other| one.scan == other.scan) {
            let Some(first) = of_scan.first() else { continue };
            let number = compact.number(first.scan);
            for flip in of_scan {
                let cell = flip.cell();
                match flip.bit() {
                    Bit::Observed => {
                        let was_observed = observed.contains(cell);
                        let from_start = || if was_observed { vec![0] } else { Vec::new() };
                        observed_toggles.entry(cell).or_insert_with(from_start).push(number);
                        observed.flip(cell);
                    }
                    Bit::Occupied => {
                        occupied_toggles.entry(cell).or_default().push(number);
                        occupied.flip(cell);
                    }
                }
            }
            ever_occupied |= occupied;
            ever_free |= observed.without(occupied);
        }
        let mut alike: BTreeMap<Vec<u32>, Mask> = BTreeMap::new();
        let mut steady = tile.first.observed();
        for (cell, toggles) in observed_toggles {
            if steady.contains(cell) {
                steady.flip(cell);
            }
            alike.entry(toggles).or_default().insert(cell);
        }
        if !steady.is_empty() {
            *alike.entry(vec![0]).or_default() |= steady;
        }
        DayToggles {
            observed: alike.into_iter().collect(),
            ever_occupied,
            ever_free,
            occupied: occupied_toggles.into_iter().collect(),
        }
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
    /// Whether its sum is whole; otherwise the tile's runs hold the rest of it.
    pub(super) is_summed: bool,
}

/// Splits the groups where their cells were observed at different times, and adds groups of new cells. Ascending by
/// their lowest cell.
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

/// Splits groups into cells that have or get a spectrum, whose sums are whole, and others.
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
