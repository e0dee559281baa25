//! Tests of properties that every kind in the catalogue has.

use super::*;
use crate::{
    Periodicities, Sample,
    models::{CannotTrain, Moment, Readings, TemporalModel},
};

/// Twenty-one days of hourly readings, the same on every day, in the bounds of every kind of state.
fn samples() -> Vec<Sample> {
    let value = |hour: i64| if (9..17).contains(&(hour % 24)) { 1.0 } else { 0.0 };
    let sample = |hour: i64| Sample { utc_nanos: hour * 3_600_000_000_000, offset_secs: 0, value: value(hour) };
    (0..21 * 24).map(sample).collect()
}

fn train(kind: ModelKind, state_kind: StateKind) -> TrainedModel {
    let samples = samples();
    kind.train(Readings::new(&samples), state_kind, &Periodicities::default()).unwrap()
}

fn supported(kind: ModelKind) -> impl Iterator<Item = StateKind> {
    StateKind::ALL.into_iter().filter(move |&state_kind| kind.supports(state_kind))
}

#[test]
fn every_kind_is_there_once_and_is_trained_on_what_supports_it() {
    for (place, kind) in ModelKind::ALL.into_iter().enumerate() {
        assert_eq!(ModelKind::ALL.iter().position(|other| other.name() == kind.name()), Some(place), "{kind}");
        for state_kind in supported(kind) {
            let model = train(kind, state_kind);
            for hour in 0..48 {
                let at = Moment { utc_nanos: (21 * 24 + hour) * 3_600_000_000_000, offset_secs: 0 };
                assert!(state_kind.bounds().contains(&model.predict(at)), "{kind} of {state_kind:?}");
            }
            let nothing = kind.train(Readings::new(&[]), state_kind, &Periodicities::default());
            assert!(matches!(nothing, Err(CannotTrain::NoReadings)), "{kind}: {nothing:?}");
        }
    }
}

#[test]
fn what_is_trained_at_night_comes_back_from_its_stored_parts_as_the_same_kind() {
    for kind in TRAINED_AT_NIGHT {
        assert!(kind.needs_readings(), "{kind}");
        for state_kind in supported(kind) {
            let model = train(kind, state_kind);
            assert_eq!(model.kind_at_night(), Some(kind));
            let parts = model.to_parts().unwrap_or_else(|| panic!("{kind} has no parts: see to_parts"));
            for other in StateKind::ALL {
                let read = TrainedModel::from_parts_of(other, parts.clone());
                let is_hypertime = kind.hypertime_options().is_some();
                let is_alike =
                    !is_hypertime || (other == StateKind::Probability) == (state_kind == StateKind::Probability);
                assert_eq!(read.ok(), (kind.supports(other) && is_alike).then(|| model.clone()), "{kind} of {other:?}");
            }
        }
    }
}

#[test]
fn stored_numbers_of_choices_stay_what_they_are() {
    let stored = [
        (0, "spectral"),
        (1, "histogram:24"),
        (2, "histogram:weekend:24"),
        (3, "histogram:week:168"),
        (128, "calibrated"),
        (129, "pergam:3"),
        (130, "hypertime-em:3"),
        (131, "hypertime-km:3"),
        (132, "poisson"),
    ];
    for id in 0..=u8::MAX {
        let expected = stored.iter().find(|(stored, _)| *stored == id).map(|(_, name)| (*name).to_owned());
        assert_eq!(ModelKind::from_id(id).map(|kind| kind.to_string()), expected, "{id}");
    }
    for (id, kind) in (0..=u8::MAX).filter_map(|id| Some((id, ModelKind::from_id(id)?))) {
        assert_eq!(kind.id(), Some(id));
    }
    assert_eq!(ModelKind::Pergam { gaussians: 4, period_nanos: ModelKind::PERIOD_NANOS }.id(), None);
    assert_eq!(ModelKind::Auto.id(), None);
}

#[test]
fn states_are_supported_by_the_meaning_of_their_values() {
    let names = |state_kind| {
        let kinds = ModelKind::ALL.into_iter().filter(move |kind| !kind.supports(state_kind));
        kinds.map(ModelKind::name).collect::<Vec<_>>()
    };
    assert_eq!(names(StateKind::Probability), ["poisson"]);
    assert_eq!(names(StateKind::Continuous), ["persistence", "uniform", "pergam", "poisson"]);
    assert_eq!(names(StateKind::Count), ["persistence", "uniform", "pergam"]);
}

#[test]
fn every_parameter_in_the_table_is_read() {
    let values = [
        ("bins", "12"),
        ("cycle", "week"),
        ("smoothing_bins", "1.5"),
        ("prior_readings", "2"),
        ("order", "3"),
        ("period_base", "1d"),
        ("period_count", "24"),
        ("gaussians", "2"),
        ("period", "12h"),
        ("clusters", "2"),
        ("seed", "7"),
        ("bin", "10m"),
    ];
    for kind in ModelKind::ALL {
        assert_eq!(kind.has_order(), kind.info().parameters.contains(&"order"), "{kind}");
        for name in kind.info().parameters {
            let (_, value) = values.iter().find(|(known, _)| known == name).unwrap();
            let set = ParameterSet::new(kind, &[(name, value)]).unwrap();
            assert_eq!(set.shown(), format!("{name}={value}"));
            let wrong = ParameterSet::new(kind, &[(name, "x")]).unwrap_err().to_string();
            assert!(wrong.starts_with(&format!("{name} has to be ")), "{kind}: {wrong}");
        }
    }
}
