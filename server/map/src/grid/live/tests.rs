//! What events a grid refuses, and what a restored one still knows; what it makes of scans is tested with the whole grid.

use std::sync::Arc;

use super::*;
use crate::{
    event::{Event, ProducerId, UpdateCause},
    grid::{
        scan::{CellRef, LoggedScan, Scans},
        tests::world::spec,
    },
    live_map::LiveMap,
    name::ProducerKey,
};

fn scans(new_tiles: &[i32], scans: Vec<LoggedScan>) -> Scans {
    Scans {
        producer: ProducerId(0),
        new_producer: Some(ProducerKey::new("robot", "").expect("valid")),
        incarnation: 1,
        first_sequence: 1,
        last_sequence: 9,
        content_crc: 0,
        received_nanos: 1000,
        new_tiles: new_tiles.iter().map(|&x| TileIndex { x, y: 0, z: 0 }).collect(),
        scans,
        refused: Vec::new(),
    }
}

fn scan(seen: &[u32], observed: &[u32]) -> LoggedScan {
    LoggedScan {
        utc_nanos: 500,
        offset_secs: 0,
        seen: Some(seen.iter().map(|&tile| TileId(tile)).collect()),
        observed_flips: observed.iter().map(|&cell| CellRef(cell)).collect(),
        occupied_flips: Vec::new(),
    }
}

#[test]
fn events_that_do_not_follow_are_refused() {
    let map = LiveMap::new(Arc::new(spec(&mut 1)));
    let grid = map.grid().expect("a grid");
    assert_eq!(grid.check(&scans(&[5, 3], vec![scan(&[0, 1], &[0, 511, 512])])), Ok(()));
    for (event, why) in [
        (scans(&[5, 5], vec![]), "new"),
        (scans(&[i32::MAX], vec![]), "new"),
        (scans(&[5], vec![scan(&[0, 1], &[])]), "unknown"),
        (scans(&[5, 6], vec![scan(&[1, 0], &[])]), "ascend"),
        (scans(&[5, 6], vec![scan(&[0, 0], &[])]), "ascend"),
        (scans(&[5, 6], vec![scan(&[0], &[3, 3])]), "ascend"),
        (scans(&[5, 6], vec![scan(&[0], &[3, 600])]), "not see"),
        (scans(&[5, 6], vec![LoggedScan { seen: None, ..scan(&[], &[3]) }]), "not see"),
    ] {
        let said = grid.check(&event).expect_err(why);
        assert!(said.contains(why), "{said}");
    }
}

#[test]
fn a_restored_map_still_waits_to_fold_in_its_pending_scans() {
    let spec = Arc::new(spec(&mut 1));
    let mut map = LiveMap::new(Arc::clone(&spec));
    map.apply(1, &Event::Scans(scans(&[0], vec![scan(&[0], &[7])]))).expect("consistent");
    let start = map.plan_update(Some(400), 1000, UpdateCause::Midnight);
    let work = map.apply(2, &Event::UpdateStart(start)).expect("consistent").expect("an update");
    let snapshot = map.finish_update(work.run(&std::sync::atomic::AtomicU64::new(0)).expect("in memory"));
    let restored = LiveMap::restore(spec, snapshot);
    assert_eq!(map.pending(), restored.pending());
    assert!(restored.pending() > 0);
    assert_eq!(restored.pending_since_nanos(), Some(500));
    assert!(restored.pending_received_nanos().is_some());
    assert_eq!(restored.pending_received_nanos(), map.pending_received_nanos());
}

#[test]
fn tiles_of_scans_that_wait_are_counted_until_their_time_has_come() {
    let spec = Arc::new(spec(&mut 1));
    let mut map = LiveMap::new(Arc::clone(&spec));
    let ahead = |minutes: i64| 1000 + minutes * 60_000_000_000;
    let (one, other) = (
        LoggedScan { utc_nanos: ahead(10), ..scan(&[0, 1], &[7]) },
        LoggedScan { utc_nanos: ahead(20), ..scan(&[1], &[]) },
    );
    map.apply(1, &Event::Scans(scans(&[0, 4], vec![one, other]))).expect("consistent");
    assert_eq!(map.grid().expect("a grid").ahead_tiles(), 3);
    let update = |map: &mut LiveMap, position: u64, now: i64| {
        let start = map.plan_update(None, now, UpdateCause::Request);
        let work = map.apply(position, &Event::UpdateStart(start)).expect("consistent").expect("an update");
        map.finish_update(work.run(&std::sync::atomic::AtomicU64::new(0)).expect("in memory"))
    };
    let mut restored = LiveMap::restore(Arc::clone(&spec), update(&mut map, 2, 1000));
    assert_eq!((restored.pending(), restored.ahead()), (0, 2));
    assert!(restored.pending_received_nanos().is_some(), "makes an update due");
    assert_eq!(restored.pending_received_nanos(), map.pending_received_nanos());
    update(&mut restored, 3, ahead(10));
    assert_eq!(restored.grid().expect("a grid").ahead_tiles(), 1);
    update(&mut restored, 4, ahead(20));
    assert_eq!(restored.grid().expect("a grid").ahead_tiles(), 0);
}
