//! The bytes of format 2: states with all data apart from their spectrum. A difference here means that existing data
//! directories in the cannot be read any more: do not change the files in `golden/`; make a new format.

use std::{
    fs,
    path::{Path, PathBuf},
    sync::Arc,
};

use tidemap_grid::spec::Retention;
use tidemap_map::{
    event::{Event, StateKind, UpdateCause, UpdateStart},
    name::{MapName, StateName},
    snapshot::{MapSnapshot, StateSnapshot},
    spec::MapSpec,
};
use tidemap_model::{
    Accumulator, AccumulatorParts, Alternatives, AlternativesParts, Component, FitParts, FittedModelParts, GapsParts,
    LocalDay, OrderErrors, OrderErrorsParts, Periodicities, Persistence, PersistenceParts, SpectralModel, StateModel,
    Zone,
    models::{CalibratedParts, ChangeAlarmParts, DayErrors, HourTableParts, OrderGainsParts},
};

use super::example::{append, content, copy, options};
use crate::{MapId, Source, Store, index::tests_only::rows_checksum};

pub(super) const FILES: [&str; 4] = [
    "MANIFEST",
    "maps/00000001/MAP",
    "maps/00000001/checkpoints/00000000000000000001.tmc",
    "maps/00000001/log/00000000000000000001.log",
];

fn golden() -> PathBuf {
    Path::new(env!("CARGO_MANIFEST_DIR")).join("src/tests/golden/format-2-states")
}

pub(super) fn spec() -> MapSpec {
    MapSpec {
        zone: Zone::named("Europe/Prague").expect("known"),
        periodicities: Periodicities::list(vec![604_800_000_000_000, 86_400_000_000_000]).expect("valid"),
        created_nanos: 1_700_000_000_123_456_789,
        half_life_nanos: Some(30 * 86_400_000_000_000),
        prior: 0.25,
        retention: Retention::Duration(90 * 86_400_000_000_000),
        ..MapSpec::new(MapName::new("office").expect("valid"))
    }
}

pub(super) fn update() -> Event {
    let cut_nanos = 1_700_000_050_000_000_000;
    Event::UpdateStart(UpdateStart { generation: 1, cut_nanos, cause: UpdateCause::Midnight })
}

pub(super) fn alternatives(calibrated: Option<Option<f64>>) -> Alternatives {
    let cells = (0..168).map(|hour| [f64::from(hour), f64::from(hour) / 4.0]).collect();
    let days = (0..48).map(|hour| [f64::from(hour) + 0.5, f64::from(hour) / 8.0, f64::from(hour) / 16.0]).collect();
    let kind = |days| DayErrors { days, mean: 0.25, variance: 0.0625 };
    let parts = AlternativesParts {
        hours: HourTableParts { cells, days },
        error_sums: vec![4.0, 3.5, 0.1, 7.25],
        last_day: Some(LocalDay(19_675)),
        learned_day: Some(LocalDay(19_676)),
        choice: if calibrated.flatten().is_some() { 128 } else { 2 },
        alarm: ChangeAlarmParts {
            kinds: [kind(20.5), kind(8.0)],
            typical_observations: 1440.0,
            sum: 0.75,
            last_day: Some(LocalDay(19_675)),
            rang: Some(LocalDay(-3)),
        },
        succession: PersistenceParts { pairs: 9, change_rate_sum: 0.375, last: Some((1_700_000_009_000_000_000, 1.0)) },
        changes: None,
        gaps: GapsParts::default(),
        supported: 3,
        gains: OrderGainsParts::default(),
        days: 28,
        since: None,
        fits: Vec::from_iter(calibrated.map(|error_sum| FitParts {
            model: FittedModelParts::Calibrated(CalibratedParts {
                observations: 40_320,
                lowest: 0.0,
                highest: 1.0,
                profile: (0..1008).map(|slot| f64::from(slot) / 1008.0).collect(),
            }),
            day: LocalDay(19_670),
            error_sum,
        })),
    };
    Alternatives::from_parts(parts).expect("valid")
}

pub(super) fn state(name: &str, alternatives: Alternatives) -> StateSnapshot {
    state_of(StateKind::Probability, name, alternatives)
}

pub(super) fn state_of(kind: StateKind, name: &str, alternatives: Alternatives) -> StateSnapshot {
    let spec = spec();
    let accumulator = AccumulatorParts {
        observations: 10,
        weight: 7.5,
        sum: 5.0,
        sum_squares: 4.5,
        first_nanos: 1,
        last_nanos: 1_700_000_000_000_000_000,
        spectrum: vec![[0.5, -0.25, 1.5, -1.75], [0.1, 0.2, 0.3, 0.4]],
        short: None,
    };
    let component = Component { periodicity: 1, gamma_re: 0.125, gamma_im: -0.1 };
    let mut sums = [0.0; 16];
    sums[1] = 4.0;
    let errors = OrderErrorsParts { sums, last_day: Some(LocalDay(19_675)) };
    let model = StateModel::from_parts(
        Accumulator::from_parts_of(kind, &spec.periodicities, accumulator).expect("valid"),
        SpectralModel::from_parts_of(kind, 0.5, 10, vec![component]).expect("valid"),
        1,
        OrderErrors::from_parts(errors).expect("valid"),
    );
    StateSnapshot {
        name: StateName::new(name).expect("valid"),
        kind,
        observations: 10,
        persistence: Persistence::default(),
        model: Arc::new(model.expect("valid").with_alternatives(alternatives)),
    }
}

pub(super) fn snapshot() -> MapSnapshot {
    MapSnapshot {
        position: 1,
        replay_from: 1,
        generation: 1,
        cut_nanos: 1_700_000_050_000_000_000,
        newest_nanos: 1_700_000_100_000_000_000,
        producers: Vec::new(),
        states: vec![
            state("door", alternatives(Some(Some(2.75)))),
            state("new door", alternatives(Some(None))),
            state("gate", alternatives(None)),
        ],
        site: Arc::default(),
        grid: None,
        history: Vec::new(),
    }
}

#[test]
fn states_of_format_2_are_written_as_they_always_were() {
    let directory = tempfile::tempdir().expect("temporary directory");
    {
        let store = Store::open(directory.path(), options()).expect("opens");
        let map = store.create_map(&spec()).expect("creates");
        let log = store.open_map(map, &spec()).expect("opens").log;
        append(&log, &update()).expect("appends");
        store.save(map, &snapshot()).expect("saves");
    }
    // The manifest names the present format.
    for file in &FILES[1..] {
        let written = fs::read(directory.path().join(file)).expect("readable");
        let is_same = fs::read(golden().join(file)).ok().as_ref() == Some(&written);
        assert!(is_same, "{file} is not written as it was; what is written now is in {}", directory.keep().display());
    }
    assert_eq!(rows_checksum(1, &snapshot()), 0xA8B8_D973);
}

#[test]
fn states_of_format_2_are_read_as_they_always_were() {
    let directory = tempfile::tempdir().expect("temporary directory");
    copy(&golden(), directory.path());
    assert_eq!(content(directory.path()).iter().filter(|(_, content)| content.is_some()).count(), FILES.len());
    let store = Store::open(directory.path(), options()).expect("opens");
    assert_eq!(store.maps(), [(MapId(1), spec())]);
    let opened = store.open_map(MapId(1), &spec()).expect("opens");
    assert_eq!((opened.source, opened.snapshot), (Source::Checkpoint, Some(snapshot())));
    let replayed: Vec<_> = opened.replay.map(|item| item.expect("readable")).collect();
    assert_eq!(replayed, [(1, update())]);
}
