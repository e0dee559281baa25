//! The map of `golden.rs` that has states with all that is known apart from their spectrum.

use std::sync::Arc;

use tidemap_grid::spec::Retention;
use tidemap_map::{
    event::{Event, StateKind, UpdateCause, UpdateStart},
    name::{MapName, StateName},
    snapshot::{MapSnapshot, StateSnapshot},
    spec::MapSpec,
};
use tidemap_model::{
    Accumulator, AccumulatorParts, Alternatives, AlternativesParts, Component, EnabledModels, GapsParts, LocalDay,
    OrderErrors, OrderErrorsParts, Periodicities, Persistence, PersistenceParts, Recent, Sample, SpectralModel,
    StateModel, TrainedModelParts, TrainingRecordParts, UpdateRules, Zone,
    models::{CalibratedParts, ChangeAlarmParts, DayErrors, HourTableParts, OrderGainsParts},
};

use super::{golden::Golden, golden_belief, golden_categorical, golden_numbers, golden_rows, golden_sensor};

pub(super) fn spec() -> MapSpec {
    MapSpec {
        zone: Zone::named("Europe/Prague").expect("known"),
        periodicities: Periodicities::list(vec![604_800_000_000_000, 86_400_000_000_000]).expect("valid"),
        created_nanos: 1_700_000_000_123_456_789,
        half_life_nanos: Some(30 * 86_400_000_000_000),
        prior: 0.25,
        retention: Retention::Duration(90 * 86_400_000_000_000),
        models: super::golden::models(),
        ..MapSpec::new(MapName::new("clinic").expect("valid"))
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
        weight: None,
        choice: if calibrated.flatten().is_some() { 128 } else { 2 },
        alarm: ChangeAlarmParts {
            kinds: [kind(20.5), kind(8.0)],
            typical_observations: 1440.0,
            sum: 0.75,
            last_day: Some(LocalDay(19_675)),
            alarm_day: Some(LocalDay(-3)),
        },
        succession: PersistenceParts { pairs: 9, change_rate_sum: 0.375, last: Some((1_700_000_009_000_000_000, 1.0)) },
        changes: 4.25,
        gaps: GapsParts { count: 70, kept: vec![(7, 60)] },
        supported: 3,
        gains: OrderGainsParts { days: 21.5, sum: 0.75, squares: 0.0625 },
        days: 28,
        since: None,
        ensemble: None,
        numbers: None,
        trained: Vec::from_iter(calibrated.map(|error_sum| TrainingRecordParts {
            model: TrainedModelParts::Calibrated(CalibratedParts {
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
        recent: Recent::default(),
        newest_row: None,
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
            few(),
            StateSnapshot { name: StateName::new("desk").expect("valid"), ..golden_belief::known() },
            StateSnapshot { name: StateName::new("window").expect("valid"), ..golden_rows::known() },
            StateSnapshot { name: StateName::new("light").expect("valid"), ..golden_sensor::known() },
            golden_numbers::known(),
            golden_categorical::label("activity/sleep"),
            golden_categorical::label("activity/eat"),
        ],
        site: Arc::default(),
        grid: None,
        history: Vec::new(),
    }
}

/// A state with few readings, which are kept instead of its spectrum.
fn few() -> StateSnapshot {
    let sample = |hour: i64| Sample { utc_nanos: hour * 3_600_000_000_000, offset_secs: 3600, value: 1.0 };
    let mut model = StateModel::new(&spec().periodicities);
    let rules = UpdateRules { models: EnabledModels::SPECTRAL, ..spec().update_rules() };
    model.update(&spec().periodicities, rules, vec![sample(400_000)]);
    assert!(model.accumulator().to_parts().short.is_some(), "one reading takes less room than the spectrum");
    StateSnapshot { observations: 1, model: Arc::new(model), ..state("hatch", alternatives(None)) }
}

pub(super) fn map() -> Golden {
    Golden { spec: spec(), events: vec![update()], snapshot: snapshot(), rows: 0xE54B_97C3 }
}
