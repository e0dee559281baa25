//! The bytes of format 1, as far as format 2 still uses it. A difference here means that existing data directories
//! cannot be read any more: do not change the files in `golden/`; make a new format.

use std::{
    fs,
    path::{Path, PathBuf},
    sync::Arc,
};

use tidemap_map::{
    event::{Envelope, Event, NewState, Observations, OffsetRun, SequenceSpan, StateKind, UpdateCause, UpdateStart},
    ids::{ProducerId, RefusalReason, StateId},
    name::{MapName, ProducerKey, StateName},
    snapshot::{MapSnapshot, ProducerMark, StateSnapshot},
    spec::MapSpec,
};
use tidemap_model::{
    Accumulator, AccumulatorParts, Component, LocalDay, OrderCriterion, OrderErrors, OrderErrorsParts, Periodicities,
    Persistence, PersistenceParts, SpectralModel, StateModel, Zone,
};

use super::example::{append, content, copy, options};
use crate::{MapId, Source, Store, index::tests_only::rows_checksum};

const FILES: [&str; 4] = [
    "MANIFEST",
    "maps/00000001/MAP",
    "maps/00000001/checkpoints/00000000000000000003.tmc",
    "maps/00000001/log/00000000000000000001.log",
];

/// A folder of an older format.
pub(super) fn folder(name: &str) -> PathBuf {
    Path::new(env!("CARGO_MANIFEST_DIR")).join("src/tests/golden").join(name)
}

fn golden() -> PathBuf {
    folder("format-1")
}

fn spec() -> MapSpec {
    MapSpec {
        zone: Zone::named("Europe/Prague").expect("known"),
        periodicities: Periodicities::list(vec![604_800_000_000_000, 86_400_000_000_000]).expect("valid"),
        criterion: OrderCriterion::ZeroOne,
        created_nanos: 1_700_000_000_123_456_789,
        ..MapSpec::new(MapName::new("office").expect("valid"))
    }
}

fn events() -> Vec<Event> {
    let envelope = Envelope {
        producer: ProducerId(0),
        new_producer: Some(ProducerKey::new("robot", "door").expect("valid").into()),
        incarnation: 2,
        span: SequenceSpan { first: 1, last: 12, content_crc: 0x1234_5678 },
        received_nanos: 1_700_000_001_000_000_000,
        refused: vec![(3, RefusalReason::Value), (12, RefusalReason::StateKind)],
    };
    let first = Observations {
        new_states: vec![NewState {
            id: StateId(0),
            name: StateName::new("Küche").expect("valid"),
            shape: StateKind::Probability.into(),
        }],
        states: vec![StateId(0); 10],
        times_nanos: (0..10).map(|i| 1_700_000_000_000_000_000 + i * 1_000_000_000).collect(),
        values: vec![0.0, 1.0, 1.0, 0.0, 0.0, 0.0, 0.0, 1.0, 1.0, 1.0],
        offsets: vec![OffsetRun { count: 4, offset_secs: 3600 }, OffsetRun { count: 6, offset_secs: 7200 }],
        failures: Vec::new(),
    };
    let later = Envelope {
        new_producer: None,
        span: SequenceSpan { first: 13, last: 15, ..envelope.span },
        refused: vec![],
        ..envelope.clone()
    };
    let second = Observations {
        new_states: vec![NewState {
            id: StateId(1),
            name: StateName::new("door").expect("valid"),
            shape: StateKind::Probability.into(),
        }],
        states: vec![StateId(1), StateId(0), StateId(300)],
        times_nanos: vec![5, 1_700_000_100_000_000_000, 7],
        values: vec![0.1, 1.0, -0.0],
        offsets: vec![OffsetRun { count: 3, offset_secs: -16_200 }],
        failures: Vec::new(),
    };
    let floats = Observations { values: vec![0.25; 3], ..second.clone() };
    let cut_nanos = 1_700_000_050_000_000_000;
    vec![
        Event::Observations(envelope, first),
        Event::Observations(later.clone(), second),
        Event::UpdateStart(UpdateStart { generation: 1, cut_nanos, cause: UpdateCause::DataTime }),
        Event::Observations(later, floats),
    ]
}

fn snapshot() -> MapSnapshot {
    let spec = spec();
    let accumulator = AccumulatorParts {
        observations: 10,
        weight: 10.0,
        sum: 5.0,
        sum_squares: 4.5,
        first_nanos: 1,
        last_nanos: 1_700_000_000_000_000_000,
        spectrum: vec![[0.5, -0.25, 1.5, -1.75], [0.1, 0.2, 0.3, 0.4]],
        short: None,
    };
    let component = Component { periodicity: 1, gamma_re: 0.125, gamma_im: -0.1 };
    let mut sums = [0.0; 16];
    sums[0] = 2.5;
    sums[15] = 0.1;
    let errors = OrderErrorsParts { sums, last_day: Some(LocalDay(19_675)) };
    let model = StateModel::from_parts(
        Accumulator::from_parts(&spec.periodicities, accumulator).expect("valid"),
        SpectralModel::from_parts(0.5, 10, vec![component]).expect("valid"),
        1,
        OrderErrors::from_parts(errors).expect("valid"),
    );
    let persistence =
        PersistenceParts { pairs: 9, change_rate_sum: 0.375, last: Some((1_700_000_009_000_000_000, 1.0)) };
    let persistence = Persistence::from_parts(persistence).expect("valid");
    let state = |name: &str, model: StateModel, persistence| StateSnapshot {
        name: StateName::new(name).expect("valid"),
        kind: StateKind::Probability,
        observations: 10,
        persistence,
        model: Arc::new(model),
    };
    MapSnapshot {
        position: 3,
        replay_from: 2,
        generation: 1,
        cut_nanos: 1_700_000_050_000_000_000,
        newest_nanos: 1_700_000_100_000_000_000,
        producers: vec![ProducerMark {
            key: ProducerKey::new("robot", "door").expect("valid"),
            incarnation: 2,
            durable_sequence: 15,
            content_crc: 0x1234_5678,
            sensor: None,
            received_nanos: None,
            recent: Vec::new(),
            has_scans: None,
        }],
        states: vec![
            state("Küche", model.expect("valid"), persistence),
            state("door", StateModel::new(&spec.periodicities), Persistence::default()),
        ],
        site: Arc::default(),
        grid: None,
        history: Vec::new(),
    }
}

/// A data directory of format 1 with the map number 1, whose spec this is.
pub(super) fn format_1(directory: &Path) -> MapSpec {
    copy(&golden(), directory);
    spec()
}

#[test]
fn logs_and_checkpoints_of_format_1_are_written_as_they_always_were() {
    let directory = tempfile::tempdir().expect("temporary directory");
    {
        let store = Store::open(directory.path(), options()).expect("opens");
        let map = store.create_map(&spec()).expect("creates");
        let log = store.open_map(map, &spec()).expect("opens").log;
        for event in events() {
            append(&log, &event).expect("appends");
        }
        store.save(map, &snapshot()).expect("saves");
    }
    // The manifest and the map's file are of the newest format.
    for file in &FILES[2..] {
        let written = fs::read(directory.path().join(file)).expect("readable");
        let is_same = fs::read(golden().join(file)).ok().as_ref() == Some(&written);
        assert!(is_same, "{file} is not written as it was; what is written now is in {}", directory.keep().display());
    }
    assert_eq!(rows_checksum(1, &snapshot()), 0x7C4A_1D88);
}

#[test]
fn format_1_is_read_as_it_always_was() {
    let directory = tempfile::tempdir().expect("temporary directory");
    copy(&golden(), directory.path());
    assert_eq!(content(directory.path()).iter().filter(|(_, content)| content.is_some()).count(), FILES.len());
    let store = Store::open(directory.path(), options()).expect("opens");
    assert_eq!(store.maps(), [(MapId(1), spec())]);
    // The observations that its updates have learned are in its log only.
    let history = store.history(MapId(1)).expect("known");
    assert_eq!((history.is_complete(), history.first_of_states().expect("readable")), (false, None));
    let opened = store.open_map(MapId(1), &spec()).expect("opens");
    assert_eq!((opened.source, opened.snapshot), (Source::Checkpoint, Some(snapshot())));
    let replayed: Vec<_> = opened.replay.map(|item| item.expect("readable")).collect();
    let expected: Vec<_> = (1..).zip(events()).skip(1).collect();
    assert_eq!(replayed, expected);
    // From here on it has format 4, and nothing else has changed.
    let manifest = fs::read_to_string(directory.path().join("MANIFEST")).expect("readable");
    assert!(manifest.starts_with("tidemap store\nformat 4\nstore 00112233445566778899aabbccddeeff\n"), "{manifest}");
    for file in &FILES[1..] {
        let read = |folder: &Path| fs::read(folder.join(file)).expect("readable");
        assert!(read(directory.path()) == read(&golden()), "{file}");
    }
}
