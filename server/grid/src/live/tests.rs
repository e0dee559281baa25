//! Tests scans that cannot follow the earlier scans.

use super::*;
use crate::{
    scan::{CellRef, LoggedScan, ScanSource, Scans},
    tests::empty,
};

fn scans(new_tiles: &[i32], scans: Vec<LoggedScan>) -> Scans {
    Scans { new_tiles: new_tiles.iter().map(|&x| TileIndex { x, y: 0, z: 0 }).collect(), scans, ..Scans::default() }
}

fn scan(seen: &[u32], observed: &[u32]) -> LoggedScan {
    LoggedScan {
        utc_nanos: 500,
        offset_secs: 0,
        source: ScanSource::Cells,
        seen: Some(seen.iter().map(|&tile| TileId(tile)).collect()),
        observed_flips: observed.iter().map(|&cell| CellRef(cell)).collect(),
        occupied_flips: Vec::new(),
    }
}

#[test]
fn events_that_do_not_follow_are_refused() {
    let grid = empty();
    assert_eq!(grid.check(&scans(&[5, 3], vec![scan(&[0, 1], &[0, 511, 512])])), Ok(()));
    for (event, why) in [
        (scans(&[5, 5], vec![]), InvalidScans::TileNotNew),
        (scans(&[i32::MAX], vec![]), InvalidScans::TileNotNew),
        (scans(&[5], vec![scan(&[0, 1], &[])]), InvalidScans::UnknownTile),
        (scans(&[5, 6], vec![scan(&[1, 0], &[])]), InvalidScans::TilesNotAscending),
        (scans(&[5, 6], vec![scan(&[0, 0], &[])]), InvalidScans::TilesNotAscending),
        (scans(&[5, 6], vec![scan(&[0], &[3, 3])]), InvalidScans::CellsNotAscending),
        (scans(&[5, 6], vec![scan(&[0], &[3, 600])]), InvalidScans::TileNotSeen),
        (scans(&[5, 6], vec![LoggedScan { seen: None, ..scan(&[], &[3]) }]), InvalidScans::TileNotSeen),
    ] {
        assert_eq!(grid.check(&event), Err(why));
    }
}
