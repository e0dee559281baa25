//! A map with a grid through the store and back: continuing from a checkpoint gives the same as continuing without.

use std::{collections::VecDeque, sync::Arc};

use rand::{Rng as _, SeedableRng as _, rngs::SmallRng};
use tidemap_grid::{
    index::{TileId, TileIndex},
    scan::{CellRef, LoggedScan, ScanSource, Scans},
};
use tidemap_map::{
    event::{Envelope, Event, SequenceSpan, UpdateCause, UpdateStart},
    ids::ProducerId,
    live_map::LiveMap,
    name::ProducerKey,
    snapshot::MapSnapshot,
    spec::MapSpec,
};

use super::{
    example::{append, options},
    grid_example::{DAY_NANOS, spec},
};
use crate::{MapId, Source, Store, StoreOptions};

const TILES: u32 = 6;
const EVENTS: u64 = 12;
const PER_EVENT: u64 = 10;

/// Scans of half a day, and an update at the end of each day; positions from 1.
fn events() -> Vec<Event> {
    let mut random = SmallRng::seed_from_u64(9);
    let mut events = Vec::new();
    for number in 0..EVENTS {
        let first = number * PER_EVENT + 1;
        let scan = |sequence: u64| {
            let mut flips: Vec<CellRef> = (0..8)
                .map(|_| CellRef::new(TileId(random.random_range(0..TILES)), random.random_range(0..4) * 9))
                .collect();
            flips.sort_unstable();
            flips.dedup();
            let is_first = sequence == 1;
            LoggedScan {
                utc_nanos: sequence as i64 * (DAY_NANOS / 20),
                offset_secs: 0,
                source: ScanSource::Cells,
                seen: (sequence % 7 == 1).then(|| (0..TILES).map(TileId).collect()),
                observed_flips: if is_first { (0..TILES * 512).map(CellRef).collect() } else { Vec::new() },
                occupied_flips: flips,
            }
        };
        let is_first = number == 0;
        let tiles = (0..TILES as i32).map(|x| TileIndex { x, y: 0, z: 0 });
        events.push(Event::Scans(
            Envelope {
                producer: ProducerId(0),
                new_producer: is_first.then(|| ProducerKey::new("robot", "lidar").expect("valid").into()),
                incarnation: 1,
                span: SequenceSpan { first, last: first + PER_EVENT - 1, content_crc: 0 },
                received_nanos: 100 * DAY_NANOS,
                refused: Vec::new(),
            },
            Scans {
                new_tiles: if is_first { tiles.collect() } else { Vec::new() },
                scans: (first..first + PER_EVENT).map(scan).collect(),
                ..Scans::default()
            },
        ));
        if number % 2 == 1 {
            let generation = number / 2 + 1;
            // The update does not learn all scans, so that some stay pending.
            let cut_nanos = generation as i64 * DAY_NANOS - DAY_NANOS / 9;
            let start = UpdateStart { generation, cut_nanos, cause: UpdateCause::Midnight };
            events.push(Event::UpdateStart(start));
        }
    }
    events
}

/// Applies an event; returns the result of an update.
fn apply(map: &mut LiveMap, position: u64, event: &Event) -> Option<MapSnapshot> {
    let work = map.apply(position, event).expect("fits")?;
    let result = work.run(&std::sync::atomic::AtomicU64::new(0)).expect("runs");
    Some(map.finish_update(result))
}

fn last_snapshot(spec: &MapSpec, events: &[Event]) -> MapSnapshot {
    let mut map = LiveMap::new(Arc::new(spec.clone()));
    let snapshots = (1..).zip(events).filter_map(|(position, event)| apply(&mut map, position, event));
    snapshots.last().expect("an update")
}

#[test]
fn a_map_goes_on_from_its_checkpoint_as_if_nothing_had_happened() {
    let spec = spec("office");
    let events = events();
    let expected = last_snapshot(&spec, &events);
    for tile_cache_bytes in [0, 5000, 1 << 30] {
        let directory = tempfile::tempdir().expect("temporary directory");
        let options = || StoreOptions { tile_cache_bytes, segment_bytes: 500, ..options() };
        let mut rest: VecDeque<&Event> = events.iter().collect();
        let mut newest = None;
        // Restarted after every third record, with updates that were not saved run once more.
        while !rest.is_empty() {
            let store = Store::open(directory.path(), options()).expect("opens");
            let id = store.maps().first().map_or_else(|| store.create_map(&spec).expect("creates"), |(map, _)| *map);
            assert_eq!(id, MapId(1));
            let opened = store.open_map(id, &spec).expect("opens");
            let is_new = matches!(opened.source, Source::Empty | Source::Log);
            assert!(is_new || opened.source == Source::Checkpoint);
            let covered = opened.snapshot.as_ref().map_or(0, |snapshot| snapshot.position);
            let mut map = match opened.snapshot {
                Some(snapshot) => LiveMap::restore(Arc::new(spec.clone()), snapshot),
                None => LiveMap::new(Arc::new(spec.clone())),
            };
            for item in opened.replay {
                let (position, event) = item.expect("readable");
                if position <= covered {
                    map.recover_pending(position, &event).expect("fits");
                } else if let Some(snapshot) = apply(&mut map, position, &event) {
                    newest = Some(snapshot);
                }
            }
            for _ in 0..3 {
                let Some(event) = rest.pop_front() else { break };
                let position = append(&opened.log, event).expect("appends");
                if let Some(snapshot) = apply(&mut map, position, event) {
                    if snapshot.generation.is_multiple_of(2) {
                        store.save(id, &snapshot).expect("saves");
                    }
                    newest = Some(snapshot);
                }
            }
        }
        assert_eq!(newest.as_ref().map(|snapshot| &snapshot.grid), Some(&expected.grid), "{tile_cache_bytes} bytes");
    }
}

#[test]
fn an_update_that_was_cut_off_is_run_again() {
    let spec = spec("office");
    let events = events();
    let expected = last_snapshot(&spec, &events);
    let (update, before) = events.split_last().expect("some");
    for tile_cache_bytes in [0, 5000, 1 << 30] {
        let directory = tempfile::tempdir().expect("temporary directory");
        let options = || StoreOptions { tile_cache_bytes, ..options() };
        {
            let store = Store::open(directory.path(), options()).expect("opens");
            let id = store.create_map(&spec).expect("creates");
            let opened = store.open_map(id, &spec).expect("opens");
            let mut map = LiveMap::new(Arc::new(spec.clone()));
            for event in before {
                let position = append(&opened.log, event).expect("appends");
                if let Some(snapshot) = apply(&mut map, position, event) {
                    store.save(id, &snapshot).expect("saves");
                }
            }
            append(&opened.log, update).expect("appends");
        }
        for start in 0..3 {
            let store = Store::open(directory.path(), options()).expect("opens");
            let opened = store.open_map(MapId(1), &spec).expect("opens");
            let snapshot = opened.snapshot.expect("saved");
            let covered = snapshot.position;
            let mut map = LiveMap::restore(Arc::new(spec.clone()), snapshot);
            let mut work = None;
            for item in opened.replay {
                let (position, event) = item.expect("readable");
                if position <= covered {
                    map.recover_pending(position, &event).expect("fits");
                } else if let Some(started) = map.apply(position, &event).expect("fits") {
                    work = Some(started);
                }
            }
            let work = work.expect("repeated");
            let snapshot = map.finish_update(work.run(&std::sync::atomic::AtomicU64::new(0)).expect("runs"));
            assert_eq!(snapshot.grid, expected.grid, "{tile_cache_bytes} bytes, start {start}");
        }
    }
}
