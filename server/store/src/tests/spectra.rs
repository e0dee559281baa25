//! States whose sums have no room in memory: learned, saved and restored as if they had, and published alike.

use std::{collections::VecDeque, sync::Arc};

use rand::{Rng as _, SeedableRng as _, rngs::SmallRng};
use tidemap_map::{
    event::{Envelope, Event, NewState, Observations, OffsetRun, SequenceSpan, StateKind, UpdateCause, UpdateStart},
    ids::{ProducerId, StateId},
    live_map::LiveMap,
    name::{ProducerKey, StateName},
    snapshot::MapSnapshot,
    spec::MapSpec,
};

use super::example::{append, options, spec};
use crate::{MapId, Store, StoreOptions};

const DAY_NANOS: i64 = 86_400_000_000_000;
const STATES: u32 = 7;
const DAYS: i64 = 8;

/// Days of readings: some states have many, some one a day, some none on most days; an update follows each day.
fn events(seed: u64) -> Vec<Event> {
    let mut random = SmallRng::seed_from_u64(seed);
    let mut events = Vec::new();
    let mut sequence = 0;
    for day in 0..DAYS {
        let mut readings: Vec<(StateId, i64, f64)> = Vec::new();
        for state in 0..STATES {
            let number = match state {
                0..3 => random.random_range(30..70),
                3..5 => 1,
                _ => u32::from(random.random_bool(0.3)) * random.random_range(1..200),
            };
            readings.extend((0..number).map(|_| {
                let nanos = day * DAY_NANOS + random.random_range(0..DAY_NANOS);
                (
                    StateId(state),
                    nanos,
                    if state % 2 == 0 { random.random() } else { f64::from(random.random::<bool>()) },
                )
            }));
        }
        // Every state is there from the first day on.
        let new = |id| {
            NewState::sampled(
                StateId(id),
                StateName::new(&format!("door {id}")).expect("valid"),
                StateKind::Probability,
            )
        };
        let first_sequence = sequence + 1;
        sequence += readings.len() as u64;
        let is_first = day == 0;
        events.push(Event::Observations(
            Envelope {
                producer: ProducerId(0),
                new_producer: is_first.then(|| ProducerKey::new("robot", "doors").expect("valid").into()),
                incarnation: 1,
                span: SequenceSpan { first: first_sequence, last: sequence, content_crc: 0 },
                received_nanos: 100 * DAY_NANOS,
                refused: Vec::new(),
            },
            Observations {
                new_states: if is_first { (0..STATES).map(new).collect() } else { Vec::new() },
                states: readings.iter().map(|reading| reading.0).collect(),
                times_nanos: readings.iter().map(|reading| reading.1).collect(),
                values: readings.iter().map(|reading| reading.2).collect(),
                offsets: vec![OffsetRun { offset_secs: 3600, count: readings.len() as u32 }],
                failures: Vec::new(),
                runs: Vec::new(),
            },
        ));
        let cut_nanos = (day + 1) * DAY_NANOS - random.random_range(0..DAY_NANOS / 4);
        let generation = day as u64 + 1;
        events.push(Event::UpdateStart(UpdateStart { generation, cut_nanos, cause: UpdateCause::Midnight }));
    }
    events
}

/// The snapshots of a map that has all in memory, by position.
fn expected(spec: &MapSpec, events: &[Event]) -> Vec<Option<MapSnapshot>> {
    let mut map = LiveMap::new(Arc::new(spec.clone()));
    let apply = |(position, event): (u64, &Event)| {
        let work = map.apply(position, event).expect("fits")?;
        Some(map.finish_update(work.run(&std::sync::atomic::AtomicU64::new(0)).expect("runs")))
    };
    (1..).zip(events).map(apply).collect()
}

/// Bytes of sums in memory.
fn in_memory(snapshot: &MapSnapshot) -> u64 {
    let cells = snapshot.states.iter().filter_map(|state| state.model.accumulator().cell());
    cells.map(|cell| cell.bytes() as u64).sum()
}

#[test]
fn sums_outside_of_memory_are_the_same_to_the_last_bit() {
    let spec = spec("office");
    for (seed, spectrum_cache_bytes) in [(1, 0), (2, 10_000), (3, 1 << 30)] {
        let mut random = SmallRng::seed_from_u64(seed);
        let events = events(seed);
        let expected = expected(&spec, &events);
        let directory = tempfile::tempdir().expect("temporary directory");
        let options = || StoreOptions { spectrum_cache_bytes, segment_bytes: 500, ..options() };
        let mut rest: VecDeque<&Event> = events.iter().collect();
        let mut generations = 0;
        // Restarted now and then, with updates that were not saved run once more.
        while !rest.is_empty() {
            let store = Store::open(directory.path(), options()).expect("opens");
            let id = store.maps().first().map_or_else(|| store.create_map(&spec).expect("creates"), |(map, _)| *map);
            let opened = store.open_map(id, &spec).expect("opens");
            let covered = opened.snapshot.as_ref().map_or(0, |snapshot| snapshot.position);
            let mut map = match opened.snapshot {
                Some(snapshot) => {
                    assert_eq!(Some(&snapshot), before_history(&expected, covered).as_ref());
                    assert!(in_memory(&snapshot) <= spectrum_cache_bytes);
                    LiveMap::restore(Arc::new(spec.clone()), snapshot)
                }
                None => LiveMap::new(Arc::new(spec.clone())),
            };
            let mut run = |map: &mut LiveMap, position, event: &Event, may_save: bool| {
                let Some(work) = map.apply(position, event).expect("fits") else { return };
                let work = work.with_room(store.spectrum_room(id));
                let snapshot = map.finish_update(work.run(&std::sync::atomic::AtomicU64::new(0)).expect("runs"));
                assert_eq!(Some(&snapshot), expected[position as usize - 1].as_ref(), "seed {seed}");
                assert!(in_memory(&snapshot) <= spectrum_cache_bytes);
                generations += 1;
                if may_save && random.random_bool(0.6) {
                    store.save(id, &snapshot).expect("saves");
                    assert!(in_memory(&snapshot) <= spectrum_cache_bytes);
                    assert_eq!(store.published(id, &spec), Some(snapshot.published()), "seed {seed}");
                }
            };
            for item in opened.replay {
                let (position, event) = item.expect("readable");
                if position <= covered {
                    map.recover_pending(position, &event).expect("fits");
                } else {
                    run(&mut map, position, &event, false);
                }
            }
            for _ in 0..SmallRng::seed_from_u64(seed + rest.len() as u64).random_range(2..7) {
                let Some(event) = rest.pop_front() else { break };
                let position = append(&opened.log, event).expect("appends");
                run(&mut map, position, event, true);
            }
        }
        assert!(generations >= DAYS);
        let folder = directory.path().join("maps/00000001/checkpoints");
        let names = std::fs::read_dir(folder).expect("readable").map(|entry| entry.expect("entry").file_name());
        assert!(names.into_iter().all(|name| name.to_string_lossy().ends_with(".tmc")), "no scratch file is left");
    }
}

/// The snapshot at a position as it is read back.
fn before_history(expected: &[Option<MapSnapshot>], position: u64) -> Option<MapSnapshot> {
    let snapshot = expected[position as usize - 1].clone()?;
    Some(MapSnapshot { history: Vec::new(), ..snapshot })
}

#[test]
fn an_update_whose_sums_cannot_be_read_fails_and_changes_nothing() {
    let spec = spec("office");
    let events = events(4);
    let directory = tempfile::tempdir().expect("temporary directory");
    let store = Store::open(directory.path(), StoreOptions { spectrum_cache_bytes: 0, ..options() }).expect("opens");
    assert_eq!(store.create_map(&spec).expect("creates"), MapId(1));
    let mut map = LiveMap::new(Arc::new(spec.clone()));
    let (update, before) = events.split_last().expect("some");
    for (position, event) in (1..).zip(before) {
        if let Some(work) = map.apply(position, event).expect("fits") {
            let snapshot = map.finish_update(work.run(&std::sync::atomic::AtomicU64::new(0)).expect("runs"));
            store.save(MapId(1), &snapshot).expect("saves");
        }
    }
    let folder = directory.path().join("maps/00000001/checkpoints");
    for file in std::fs::read_dir(folder).expect("readable") {
        let path = file.expect("entry").path();
        let length = std::fs::metadata(&path).expect("there").len();
        std::fs::OpenOptions::new().write(true).open(&path).expect("opens").set_len(length / 50).expect("cut");
    }
    let before = map.publish();
    let work = map.apply(events.len() as u64, update).expect("fits").expect("an update");
    let error = work.run(&std::sync::atomic::AtomicU64::new(0)).expect_err("the sums are gone").to_string();
    assert!(error.starts_with("state \"door ") && error.contains("is damaged or not readable"), "{error}");
    assert_eq!(map.publish().generation(), before.generation());
}
