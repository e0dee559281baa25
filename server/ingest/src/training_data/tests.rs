//! Tests that readings are the same, whether they come from files or from memory.

use std::path::Path;

use tidemap_map::{
    event::UpdateCause,
    history::origins::{OriginRun, Origins},
    ids::{ProducerId, StateId},
    live_map::LiveMap,
    name::MapName,
    snapshot::MapSnapshot,
    spec::MapSpec,
};
use tidemap_store::{MapId, Store, StoreOptions};

use super::*;

const HOUR: i64 = 3_600_000_000_000;

fn spec() -> MapSpec {
    MapSpec::new(MapName::new("office").expect("valid"))
}

/// The history that six updates have learned: two states, with equal times and some late observations.
fn pieces() -> Vec<Arc<HistoryPiece>> {
    let sample = |hour: i64, value: f64| Sample { utc_nanos: hour * HOUR, offset_secs: 0, value };
    let piece = |generation: u64| {
        let hour = 48 + 24 * generation as i64;
        // Values identify the updates.
        let value = generation as f64 / 8.0;
        let always = vec![sample(hour, value), sample(hour, value + 0.01), sample(hour - 30, value + 0.02)];
        let origins = |first: u64, count: u32| Origins {
            runs: vec![OriginRun { producer: ProducerId(1), first, count }],
            ..Origins::default()
        };
        let mut states = vec![(StateId(1), always)];
        let mut observers = vec![origins(3 * generation - 2, 3)];
        if generation.is_multiple_of(2) {
            states.push((StateId(4), vec![sample(hour + 1, value), sample(24, value)]));
            observers.push(origins(generation - 1, 2));
        }
        let piece = HistoryPiece {
            from_nanos: (hour - 30).min(24) * HOUR,
            to_nanos: (hour + 1) * HOUR,
            ..HistoryPiece::new(generation)
        };
        Arc::new(HistoryPiece { states, origins: observers, ..piece })
    };
    (1..=6).map(piece).collect()
}

/// A store whose history has these pieces.
fn saved(folder: &Path, pieces: &[Arc<HistoryPiece>]) -> Store {
    let store = Store::open(folder, StoreOptions { new_store_id: "00".repeat(16), ..StoreOptions::default() });
    let store = store.expect("a store");
    assert_eq!(store.create_map(&spec()).expect("created"), MapId(1));
    let mut map = LiveMap::new(Arc::new(spec()));
    let start = map.plan_update(None, 0, UpdateCause::Request);
    let work = map.apply(1, &tidemap_map::event::Event::UpdateStart(start)).expect("consistent").expect("an update");
    let snapshot = map.finish_update(work.run(&std::sync::atomic::AtomicU64::new(0)).expect("in memory"));
    store.save(MapId(1), &MapSnapshot { history: pieces.to_vec(), ..snapshot }).expect("saved");
    store
}

#[test]
fn what_is_given_does_not_depend_on_what_was_saved() {
    let pieces = pieces();
    let wanted: Vec<ReadingsRequest> = [(1, 0), (4, 30 * HOUR), (2, 0), (1, 50 * HOUR)]
        .map(|(state, from_nanos)| ReadingsRequest { state: StateId(state), from_nanos })
        .to_vec();
    for generation in 1..=7_u64 {
        let mut all: Vec<Vec<Sample>> = Vec::new();
        for wanted in &wanted {
            let before = pieces.iter().filter(|piece| piece.generation < generation).flat_map(|piece| &piece.states);
            let samples = before.filter(|(state, _)| *state == wanted.state).flat_map(|(_, samples)| samples);
            let mut samples: Vec<Sample> =
                samples.filter(|sample| sample.utc_nanos >= wanted.from_nanos).copied().collect();
            samples.sort_by_key(|sample| sample.utc_nanos);
            all.push(samples);
        }
        for files in 0..=6 {
            let folder = tempfile::tempdir().expect("temporary folder");
            let history = saved(folder.path(), &pieces[..files]).history(MapId(1)).expect("known");
            // A piece that a save has written without the writer's knowledge is in both.
            for unsaved in files.saturating_sub(2)..=files {
                let mut unsaved = pieces[unsaved..].to_vec();
                unsaved.reverse();
                let folded = TrainingData::before(generation, history.clone(), unsaved);
                assert_eq!(folded.readings(&wanted).as_ref(), Ok(&all), "{files} files, generation {generation}");
            }
        }
    }
}

#[test]
fn a_damaged_file_is_an_error_that_names_it() {
    let folder = tempfile::tempdir().expect("temporary folder");
    let history = saved(folder.path(), &pieces()).history(MapId(1)).expect("known");
    let file = folder.path().join("maps/00000001/history/00000000000000000002.states.tmh");
    std::fs::write(&file, "nothing").expect("written");
    let wanted = [ReadingsRequest { state: StateId(1), from_nanos: 0 }];
    let error = TrainingData::before(7, history.clone(), Vec::new()).readings(&wanted).expect_err("damaged");
    assert!(error.contains("00000000000000000002.states.tmh"), "{error}");
    assert!(TrainingData::before(2, history, Vec::new()).readings(&wanted).is_ok(), "it is not requested");
}
