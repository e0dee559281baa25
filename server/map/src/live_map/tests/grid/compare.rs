//! Compares every cell of the map with the oracle.
//!
//! Invariant: a comparison changes nothing except the oracle's choice among equals.

use tidemap_grid::{
    day::GridDay,
    index::{TileId, TileIndex},
    mask::Mask,
    tile::TileModel,
    view::GridView,
};
use tidemap_model::{
    InstantPhasors, ORDER_MAX,
    selector::{Blend, ModelKind, ModelSelector},
};

use super::{
    oracle::{gammas, near},
    world::{HOUR, World},
};

fn selectors() -> Vec<ModelSelector> {
    let mut selectors = Vec::new();
    for kind in [ModelKind::Auto, ModelKind::Mean, ModelKind::Latest, ModelKind::Spectral] {
        for order in [None, Some(0), Some(2), Some(ORDER_MAX)] {
            let blends = [Blend::None, Blend::Persistence, Blend::Memory];
            selectors.extend(blends.map(|blend| ModelSelector { kind, order, blend }));
        }
    }
    selectors
}

impl World {
    /// Compares all values of a view.
    pub(crate) fn compare(&mut self, at: &str) {
        let view = self.map.publish();
        let grid = view.grid().expect("a grid").clone();
        assert_eq!(grid.cell_observations(), self.oracle.cell_observations, "{at}: cell observations");
        assert_eq!((grid.scans(), grid.pending_scans()), (self.scans.count, self.scans.pending()), "{at}: scans");
        let all = self.grid().days().iter().map(GridDay::changes).sum::<u64>();
        assert_eq!(self.grid().pending_changes(), all, "{at}: pending changes");
        for id in (0..u32::try_from(grid.tiles()).expect("few")).map(TileId) {
            let index = grid.live(id).expect("a tile").index;
            assert_eq!(grid.find(index), Some(id));
            let model = grid.model(id).expect("in memory");
            check_shape(&model, at);
            self.compare_tile(&grid, index, id, &model, at);
        }
        // Each comparison uses one time and one selector: many steps make many comparisons.
        let times = [0, 7 * HOUR + 12_345, 1_711_900_000_000_000_000, 1_730_000_000_000_000_000];
        let utc_nanos = times[self.draw_number(times.len())];
        let selectors = selectors();
        let selector = selectors[self.draw_number(selectors.len())];
        let civil = utc_nanos + i64::from(self.spec.zone.offset_secs(utc_nanos)) * 1_000_000_000;
        let phasors = InstantPhasors::new(&self.spec.periodicities, civil);
        self.compare_predictions(&grid, utc_nanos, &phasors, selector, at);
    }

    fn compare_tile(&mut self, grid: &GridView, index: TileIndex, id: TileId, model: &TileModel, at: &str) {
        let (mut known, mut changed, mut learned) = (Mask::EMPTY, Mask::EMPTY, Mask::EMPTY);
        for cell in 0..512 {
            let place = index.cell(cell);
            let described = grid.describe(place).expect("in memory");
            let Some(oracle) = self.oracle.known(place) else {
                assert!(described.is_none(), "{at}: tile {index:?}, cell {cell} is known");
                continue;
            };
            let at = format!("{at}, tile {index:?}, cell {cell}");
            known.insert(cell);
            oracle.compare(&described.unwrap_or_else(|| panic!("{at}: unknown")), &at);
            if !oracle.folded.is_empty() {
                learned.insert(cell);
            }
            if oracle.has_changed() {
                changed.insert(cell);
            } else if let Some(read) = oracle.folded.first() {
                assert_eq!(model.always_occupied.contains(cell), read.is_occupied, "{at}: always occupied");
            }
            if let Some(group) = model.group_of(cell) {
                assert_eq!(
                    Some(group.last_nanos),
                    oracle.folded.iter().map(|read| read.sample.utc_nanos).max(),
                    "{at}: last"
                );
            }
        }
        let live = grid.live(id).expect("a tile");
        assert_eq!((live.known, model.observed(), model.changed()), (known, learned, changed), "{at}: masks");
        for model in &model.cells {
            let at = format!("{at}, tile {index:?}, cell {}", model.cell);
            let periodicities = self.spec.periodicities.clone();
            let oracle = self.oracle.cells.get_mut(&(index, model.cell)).expect("known");
            oracle.compare_model(model, &periodicities, &at);
        }
    }

    fn compare_predictions(
        &self,
        grid: &GridView,
        utc_nanos: i64,
        phasors: &InstantPhasors,
        selector: ModelSelector,
        at: &str,
    ) {
        for id in (0..u32::try_from(grid.tiles()).expect("few")).map(TileId) {
            let tile = grid.predict_tile(id, utc_nanos, phasors, selector).expect("in memory");
            for cell in 0..512_u16 {
                let found = f64::from(tile.probabilities[usize::from(cell)]);
                let Some(oracle) = self.oracle.known(tile.index.cell(cell)) else {
                    assert!(!tile.known.contains(cell) && found == 0.0, "{at}: unknown");
                    continue;
                };
                assert!(tile.known.contains(cell), "{at}: known");
                let civil = phasors.civil_nanos();
                let expected = oracle.probability(selector, civil, utc_nanos, &self.spec.periodicities);
                let is_near = (found - expected).abs() < 2e-7;
                assert!(is_near, "{at}: {found}, not {expected}, of cell {cell} of {:?} by {selector:?}", tile.index);
            }
        }
    }

    /// Compares the sums of all changed cells with those of another world, and both with the oracle's.
    pub(crate) fn compare_sums(&self, other: &World, at: &str) {
        for (&(index, cell), oracle) in &self.oracle.cells {
            let at = format!("{at}, tile {index:?}, cell {cell}");
            let mut all = [self, other].map(|world| world.gammas(index, cell));
            assert_eq!(all[0].is_some(), oracle.has_changed(), "{at}");
            assert_eq!(all[0].is_some(), all[1].is_some(), "{at}");
            let expected = gammas(&oracle.model.accumulator().to_parts());
            for found in all.iter_mut().filter_map(Option::take) {
                for (found, expected) in found.iter().zip(&expected) {
                    near(found.0, expected.0, 1e-9, &at, "real part of γ");
                    near(found.1, expected.1, 1e-9, &at, "imaginary part of γ");
                }
            }
        }
    }

    fn gammas(&self, index: TileIndex, cell: u16) -> Option<Vec<(f64, f64)>> {
        let snapshot = self.snapshot.as_ref()?.grid.as_ref()?;
        let id = self.grid().find(index)?.0 as usize;
        let (model, sums) = (snapshot.models.get(id)?.get().ok()?, snapshot.sums.get(id)?.get().ok()?);
        let at = model.cells.iter().position(|model| model.cell == cell)?;
        let (a, group) = (sums.cells.get(at)?.as_slice(), model.group_of(cell)?);
        let of_group = model.groups.iter().position(|other| other == group)?;
        let b = sums.groups.get(of_group)?.as_slice();
        let n = model.weight(of_group);
        let (free, occupied) = self.spec.grid.as_ref()?.sensor.levels();
        let mean = (model.weights(of_group).alpha + model.occupied_weight(at)) / n;
        let weighted = sums.sensors.as_ref().and_then(|sensors| sensors.groups[of_group].as_ref());
        let alpha = |k: usize| weighted.map_or(0.0, |weighted| weighted.alpha.as_slice()[k]);
        let gamma = |k: usize| (occupied - free) * (a[k] + alpha(k) - mean * b[k]) / n;
        let half = a.len() / 2;
        Some((0..half).map(|k| (gamma(k), gamma(half + k))).collect())
    }
}

/// Checks that groups are disjoint and ordered by their lowest cell, that changed cells ascend, and that the model
/// holds no room that it does not use.
fn check_shape(model: &TileModel, at: &str) {
    let all: u32 = model.groups.iter().map(|group| group.cells.count()).sum();
    assert_eq!(all, model.observed().count(), "{at}: groups overlap");
    assert!(model.groups.is_sorted_by_key(|group| group.cells.first()), "{at}: groups");
    assert!(model.cells.is_sorted_by(|one, next| one.cell < next.cell), "{at}: cells");
    assert!(model.always_occupied.without(model.observed()).is_empty(), "{at}: always occupied");
    assert!((model.always_occupied & model.changed()).is_empty(), "{at}: always occupied and changed");
    assert_eq!(
        (model.groups.capacity(), model.cells.capacity()),
        (model.groups.len(), model.cells.len()),
        "{at}: room"
    );
    if let Some(weights) = &model.sensors {
        let lengths = (weights.groups.len(), weights.occupied.len());
        assert_eq!(lengths, (model.groups.len(), model.cells.len()), "{at}: weights");
        assert!([0, model.groups.len()].contains(&weights.fades.len()), "{at}: fading");
    }
}
