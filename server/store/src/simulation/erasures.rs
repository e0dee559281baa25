//! A kill, a power cut or a failing call at every step of an erasure: the map is as before, or without the states.

use std::{io::ErrorKind, path::Path, sync::Arc};

use rand::{SeedableRng as _, rngs::SmallRng};
use tidemap_map::{
    erasure::StateErasure, event::Event, history::HistoryPiece, ids::StateId, snapshot::MapSnapshot, spec::MapSpec,
};
use tidemap_model::Sample;

use super::{
    disk::{Fault, SimulatedDisk},
    make_directory,
};
use crate::{
    EraseError, MapId, OpenError, Repair, Store, StoreOptions,
    committer::Committer,
    disk::Disk as _,
    index::Index,
    store::open::Parts,
    tests::{
        example::{self, event},
        grid_example,
    },
};

mod parts;

const MAP: MapId = MapId(1);
const ERASED: [StateId; 2] = [StateId(0), StateId(2)];
const EVENTS: u64 = 19;

/// The contents of a map.
#[derive(Debug, PartialEq)]
struct Content {
    snapshot: MapSnapshot,
    events: Vec<(u64, Event)>,
    history: Vec<(StateId, Vec<Sample>)>,
}

fn started(disk: &SimulatedDisk, committer: &Arc<Committer>) -> Result<Store, OpenError> {
    Store::assemble(Parts {
        disk: Arc::new(disk.clone()),
        directory: "/data".into(),
        options: StoreOptions { segment_bytes: 1200, spectrum_cache_bytes: 100, ..StoreOptions::default() },
        store_id: String::new(),
        is_new: false,
        index: Index::none(),
        committer: Arc::clone(committer),
        repairs: Vec::new(),
        lock: None,
    })
}

fn content(store: &Store, spec: &MapSpec) -> Content {
    let opened = store.open_map(MAP, spec).expect("opens");
    let snapshot = opened.snapshot.expect("saved");
    let events = opened.replay.map(|entry| entry.expect("whole")).collect();
    let history = store.history(MAP).expect("known");
    let state_history = |id: u32| (StateId(id), history.state(StateId(id), i64::MIN, i64::MAX).expect("readable"));
    Content { snapshot, events, history: (0..6).map(state_history).collect() }
}

/// A disk with a map, and the map without the states.
fn filled(spec: &MapSpec) -> (SimulatedDisk, Content, Content) {
    let disk = SimulatedDisk::new(SmallRng::seed_from_u64(5));
    make_directory(&disk);
    let committer = Arc::default();
    let store = started(&disk, &committer).expect("starts");
    store.create_map(spec).expect("creates");
    let log = store.open_map(MAP, spec).expect("opens").log;
    let mut pieces = Vec::new();
    for position in 1..=EVENTS {
        log.append(&event(position), Box::new(|done| assert!(done.is_ok()))).expect("queued");
        committer.commit(committer.take_now());
        if position % 5 == 0 {
            let mut piece = grid_example::piece(position / 5, 19_000, &mut SmallRng::seed_from_u64(position));
            if spec.grid.is_none() {
                piece.days.clear();
            }
            let snapshot_at = |position| match &spec.grid {
                Some(_) => grid_example::snapshot(spec, position, 3),
                None => example::snapshot(spec, position, 3),
            };
            store
                .save(MAP, &MapSnapshot { history: vec![Arc::new(piece.clone())], ..snapshot_at(position) })
                .expect("saves");
            pieces.push(piece);
        }
    }
    drop((store, log));
    let store = started(&disk, &Arc::default()).expect("starts");
    let before = content(&store, spec);
    let mut erasure = StateErasure::new(ERASED.to_vec());
    let snapshot = erasure.snapshot(before.snapshot.clone());
    let events = before.events.iter().map(|(position, event)| (*position, erasure.event(*position, event.clone())));
    let mut after = Content { events: events.collect(), history: Vec::new(), snapshot };
    let pieces: Vec<HistoryPiece> = pieces.iter().filter_map(|piece| erasure.piece(piece)).collect();
    after.history = (0..6)
        .map(|id| {
            let states = pieces.iter().flat_map(|piece| &piece.states).filter(|(state, _)| state.0 == id);
            let mut samples: Vec<Sample> = states.flat_map(|(_, samples)| samples.clone()).collect();
            samples.sort_by_key(|sample| sample.utc_nanos);
            (StateId(id), samples)
        })
        .collect();
    (disk.kill(), before, after)
}

fn is_erased(store: &Store, spec: &MapSpec, (before, after): (&Content, &Content)) -> bool {
    let found = content(store, spec);
    assert!(found == *before || found == *after, "neither the map before nor the map after");
    found == *after
}

fn states_erased(store: &Store) -> Result<(), EraseError> {
    store.erase_states(MAP, &ERASED).map(drop)
}

fn erasing_with_faults(spec: &MapSpec) {
    let (disk, before, after) = filled(spec);
    with_faults(spec, &disk, (&before, &after), &states_erased);
}

/// Erases with a fault at every call: the map has one of two contents, whatever happens.
fn with_faults(
    spec: &MapSpec,
    disk: &SimulatedDisk,
    both: (&Content, &Content),
    erase: &dyn Fn(&Store) -> Result<(), EraseError>,
) {
    let calls = {
        let disk = disk.kill();
        let store = started(&disk, &Arc::default()).expect("starts");
        let before = disk.calls();
        erase(&store).expect("erases");
        assert!(is_erased(&store, spec, both));
        let names = disk.list(Path::new("/data/maps")).expect("listed");
        assert_eq!(names, ["00000001"], "nothing is left beside");
        disk.calls() - before
    };
    assert!(calls > 40, "{calls}");
    let (mut killed, mut failed, mut completed) = (0, 0, 0);
    for call in 0..calls {
        for (is_sticky, is_power_cut) in [(true, false), (true, true), (false, false)] {
            let disk = disk.kill();
            let store = started(&disk, &Arc::default()).expect("starts");
            let call = disk.calls() + call;
            disk.set_fault(Some(Fault { call, kind: ErrorKind::Other, is_sticky }));
            let erased = erase(&store);
            disk.set_fault(None);
            if !is_sticky && store.set_aside().is_empty() {
                // The daemon goes on with the map.
                assert_eq!(is_erased(&store, spec, both), erased.is_ok() || !failed_before(&disk), "call {call}");
                failed += 1;
            }
            drop(store);
            // A start that is killed too, and one that is not.
            let disk = if is_power_cut { disk.power_cut() } else { disk.kill() };
            let call = disk.calls() + call % 17;
            disk.set_fault(Some(Fault { call, kind: ErrorKind::Other, is_sticky: true }));
            drop(started(&disk, &Arc::default()));
            let disk = if is_power_cut { disk.power_cut() } else { disk.kill() };
            let store = started(&disk, &Arc::default()).expect("starts");
            completed += u64::from(store.repairs().contains(&Repair::ErasureCompleted { map: MAP }));
            let now = is_erased(&store, spec, both);
            assert!(now || erased.is_err(), "call {call}: reported as erased");
            let names = disk.list(Path::new("/data/maps")).expect("listed");
            assert_eq!(names, ["00000001"], "nothing is left beside");
            killed += u64::from(now);
        }
    }
    assert!(killed > 20 && failed > 20 && completed > 10, "too little was tried: {killed} {failed} {completed}");
}

/// Whether the map's folder is the one from before.
fn failed_before(disk: &SimulatedDisk) -> bool {
    !disk.list(Path::new("/data/maps/00000001")).expect("listed").iter().any(|name| name == "ERASURES")
}

#[test]
fn an_erasure_that_is_cut_off_at_any_call_is_repeated_or_complete() {
    erasing_with_faults(&example::spec("home"));
}

#[test]
fn so_is_one_from_a_map_with_a_grid() {
    erasing_with_faults(&grid_example::spec("home"));
}
