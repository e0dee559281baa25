//! Tests tiles that are processed in several batches.

use std::collections::HashSet;

use tidemap_model::Periodicities;

use super::*;
use crate::{
    index::TileIndex,
    scan::{CellRef, LoggedScan, ScanSource, Scans},
    snapshot::GridSnapshot,
    tests::{HOUR, apply, empty, learn},
};

mod support;

/// The number of different sums that the groups of all tiles have.
fn sums(snapshot: &GridSnapshot) -> usize {
    let sums: Vec<Arc<TileSums>> = snapshot.sums.iter().map(|slot| slot.get().expect("in memory")).collect();
    sums.iter().flat_map(|sums| sums.shared()).map(Arc::as_ptr).collect::<HashSet<_>>().len()
}

/// Scans of one day of a fixed sensor that sees all cells of some tiles, and some of them change.
fn fixed_day(day: i64, tiles: u32) -> Scans {
    let scan = |number: i64| LoggedScan {
        utc_nanos: (24 * day + number) * HOUR,
        offset_secs: 0,
        source: ScanSource::Cells,
        seen: Some((0..tiles).map(TileId).collect()),
        observed_flips: if (day, number) == (0, 0) { (0..tiles * 512).map(CellRef).collect() } else { Vec::new() },
        occupied_flips: (0..tiles).map(|tile| CellRef(tile * 512 + u32::try_from(number).expect("small"))).collect(),
    };
    let new_tiles = (0..i32::try_from(tiles).expect("few")).map(|x| TileIndex { x, y: 0, z: 0 });
    Scans {
        new_tiles: if day == 0 { new_tiles.collect() } else { Vec::new() },
        scans: (0..8).map(scan).collect(),
        ..Scans::default()
    }
}

#[test]
fn tiles_seen_alike_share_their_sums_across_batches() {
    // The limits are so low that a few tiles are many.
    let limits =
        UpdateLimits { chunk_scans: 3, summed_groups_max: 2, runs_per_sum: 4, batch_cells_min: 2, batch_cells_max: 4 };
    let periodicities = Periodicities::harmonics(36 * HOUR, 20).expect("valid");
    let mut grid = empty();
    for day in 0..3 {
        apply(&mut grid, &fixed_day(day, 12));
        let (snapshot, [tiles, learned]) = learn(&mut grid, 24 * (day + 1) * HOUR, &periodicities, limits);
        assert_eq!((tiles, learned), (12, 12));
        assert_eq!((snapshot.sums.len(), sums(&snapshot)), (12, 1), "day {day}");
    }
}
