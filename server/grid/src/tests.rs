//! Helpers that the tests of a grid share: a grid that takes scans and learns them, without a map around it.
//!
//! Invariant: all random values are drawn from seeds.

use std::sync::{Arc, atomic::AtomicU64};

use tidemap_model::{OrderCriterion, Periodicities};

use crate::{
    live::LiveGrid,
    scan::Scans,
    snapshot::GridSnapshot,
    spec::{Evidence, GridSpec},
    update::rules::UpdateLimits,
};

pub(crate) const SECOND: i64 = 1_000_000_000;
pub(crate) const HOUR: i64 = 3600 * SECOND;

pub(crate) fn empty() -> LiveGrid {
    LiveGrid::new(Arc::new(GridSpec { evidence: Evidence::Readings, ..GridSpec::new(0.1) }))
}

/// Applies scans of the grid's own sensor. None of them has to wait.
pub(crate) fn apply(grid: &mut LiveGrid, scans: &Scans) {
    assert_eq!(grid.check(scans), Ok(()));
    grid.apply(scans, None, i64::MAX);
}

/// Learns all scans before an instant. Also returns the number of tiles that the update reported before the run, and
/// the number that it learned.
pub(crate) fn learn(
    grid: &mut LiveGrid,
    cut_nanos: i64,
    periodicities: &Periodicities,
    limits: UpdateLimits,
) -> (GridSnapshot, [u64; 2]) {
    let (work, basis, _) = grid.start_update(cut_nanos, periodicities, OrderCriterion::default());
    let (progress, tiles) = (AtomicU64::new(0), work.busy_tiles());
    let result = work.with_limits(limits).run(&progress).expect("in memory");
    (grid.finish_update(basis, result.generation, result.sums), [tiles, progress.into_inner()])
}

/// A random number below `below`.
pub(crate) fn random(rng: &mut u64, below: usize) -> usize {
    // The generator is SplitMix64.
    *rng = rng.wrapping_add(0x9e37_79b9_7f4a_7c15);
    let mixed = (*rng ^ *rng >> 30).wrapping_mul(0xbf58_476d_1ce4_e5b9);
    let mixed = (mixed ^ mixed >> 27).wrapping_mul(0x94d0_49bb_1331_11eb);
    (((u128::from(mixed ^ mixed >> 31)) * below as u128) >> 64) as usize
}
