//! Tests the properties of `spectral.rs`, against a naive oracle where there is one.

use proptest::prelude::*;

use super::*;
use crate::Sample;

const HOUR_NANOS: i64 = 3_600_000_000_000;
const DAY_NANOS: i64 = 24 * HOUR_NANOS;

fn trained(periodicities: &Periodicities, samples: &[Sample]) -> SpectralModel {
    let mut accumulator = Accumulator::new(periodicities);
    accumulator.add(periodicities, samples);
    SpectralModel::train(&accumulator, periodicities)
}

/// A sine of one day, sampled hourly for some days.
fn daily_sine(days: i64) -> Vec<Sample> {
    let value = |hour: i64| 0.4 + 0.3 * (std::f64::consts::TAU * (hour as f64 / 24.0) + 1.0).cos();
    let sample = |hour| Sample { utc_nanos: hour * HOUR_NANOS, offset_secs: 0, value: value(hour) };
    (0..24 * days).map(sample).collect()
}

#[test]
fn a_sine_is_found_and_predicted_as_it_is() {
    let week = Periodicities::default();
    let model = trained(&week, &daily_sine(28));
    let strongest = model.components()[0];
    assert_eq!(strongest.periodicity, 6);
    assert!((strongest.amplitude() - 0.3).abs() < 1e-9);
    assert!((strongest.phase_rad() - 1.0).abs() < 1e-9);
    for sample in daily_sine(60) {
        assert!((model.predict(&week, 1, sample.utc_nanos) - sample.value).abs() < 1e-9);
    }
}

#[test]
fn only_observed_periods_are_eligible() {
    // An hourly series of a week less an hour spans 0.994 of a week; less two hours, it spans 0.988.
    let week = Periodicities::default();
    let mut samples = daily_sine(7);
    samples[5].value = 1.0;
    let has_week = |samples: &[Sample]| trained(&week, samples).components().iter().any(|c| c.periodicity == 0);
    let mut sloped: Vec<Sample> = samples.iter().map(|s| Sample { value: s.utc_nanos as f64 / 1e15, ..*s }).collect();
    assert!(has_week(&sloped));
    sloped.pop();
    assert!(!has_week(&sloped));
    assert!(!trained(&week, &sloped).components().is_empty());
    assert!(trained(&week, &sloped[..1]).components().is_empty());
}

#[test]
fn a_state_that_never_changed_has_no_components() {
    let week = Periodicities::default();
    for value in [0.0, 1.0] {
        let samples: Vec<Sample> = daily_sine(28).iter().map(|s| Sample { value, ..*s }).collect();
        let model = trained(&week, &samples);
        assert!(model.components().is_empty());
        assert!((model.predict(&week, 15, DAY_NANOS) - value).abs() < 1e-15);
    }
}

#[test]
fn never_updated_answers_one_half() {
    let week = Periodicities::default();
    let model = SpectralModel::default();
    assert_eq!(SpectralModel::train(&Accumulator::new(&week), &week), model);
    assert!((model.predict(&week, 15, 123) - 0.5).abs() < 1e-15);
    assert_eq!(model.observations(), 0);
}

#[test]
fn the_strongest_come_first_and_equal_ones_by_index() {
    // One spike at phase 0: by symmetry all periods that divide the day evenly are equally strong.
    let week = Periodicities::default();
    let impulse =
        |hour: i64| Sample { utc_nanos: hour * HOUR_NANOS, offset_secs: 0, value: f64::from(u8::from(hour == 0)) };
    let model = trained(&week, &(0..24 * 7).map(impulse).collect::<Vec<_>>());
    assert_eq!(model.components().len(), ORDER_MAX);
    let amplitudes: Vec<f64> = model.components().iter().map(Component::amplitude).collect();
    assert!(amplitudes.is_sorted_by(|a, b| a >= b || (a - b).abs() < 1e-12));
    // Exact ties: a list, with a state that changes at the only time where both cosines are 1.
    let list = Periodicities::list(vec![8 * HOUR_NANOS, 4 * HOUR_NANOS, 2 * HOUR_NANOS]).unwrap();
    let tie = trained(&list, &[impulse(0), Sample { utc_nanos: 8 * HOUR_NANOS, offset_secs: 0, value: 0.0 }]);
    assert!(tie.components().is_sorted_by_key(|c| c.periodicity));
}

#[test]
fn damaged_parts_are_refused() {
    let component = Component { periodicity: 3, gamma_re: 0.1, gamma_im: -0.1 };
    let model = SpectralModel::from_parts(0.25, 10, vec![component]).unwrap();
    assert_eq!((model.mean(), model.observations(), model.components()), (0.25, 10, &[component][..]));
    assert!(SpectralModel::from_parts(f64::NAN, 1, vec![]).is_err());
    assert!(SpectralModel::from_parts(1.5, 1, vec![]).is_err());
    assert!(SpectralModel::from_parts(0.5, 1, vec![Component { gamma_im: f64::INFINITY, ..component }]).is_err());
    let too_many = SpectralModel::from_parts(0.5, 1, vec![component; ORDER_MAX + 1]);
    assert_eq!(too_many, Err(InvalidParts::OrderTooHigh { found: 16 }));
}

fn any_model() -> impl Strategy<Value = SpectralModel> {
    let component = (0_u32..200, -0.3..0.3, -0.3..0.3).prop_map(|(periodicity, gamma_re, gamma_im)| Component {
        periodicity,
        gamma_re,
        gamma_im,
    });
    (0.0..=1.0, proptest::collection::vec(component, 0..=ORDER_MAX))
        .prop_map(|(mean, components)| SpectralModel::from_parts(mean, 9, components).unwrap())
}

/// The prediction by its formula; periodicities that do not exist add nothing.
fn oracle(model: &SpectralModel, order: usize, civil: i64) -> f64 {
    let week_turns = i128::from(civil).rem_euclid(i128::from(7 * DAY_NANOS)) as f64 / (7 * DAY_NANOS) as f64;
    let term = |c: &Component| {
        let angle = std::f64::consts::TAU * f64::from(c.periodicity + 1) * week_turns;
        if c.periodicity < 168 { c.amplitude() * (angle + c.phase_rad()).cos() } else { 0.0 }
    };
    (model.mean() + model.components().iter().take(order).map(term).sum::<f64>()).clamp(0.0, 1.0)
}

proptest! {
    #![proptest_config(ProptestConfig::with_cases(64))]

    #[test]
    fn all_ways_to_predict_agree(
        model in any_model(),
        order in 0_usize..20,
        times in proptest::collection::vec(0..=i64::MAX, 0..90),
        chosen in proptest::collection::vec(0_u32..200, 0..4),
    ) {
        let week = Periodicities::default();
        let own: Vec<u32> = model.components().iter().map(|c| c.periodicity).collect();
        let tables = [
            PhasorTable::new(&week, &times),
            PhasorTable::only(&week, &times, &own),
            PhasorTable::only(&week, &times, &chosen),
        ];
        let expected: Vec<f64> = times.iter().map(|&civil| oracle(&model, order, civil)).collect();
        for table in &tables {
            let mut out = vec![-1.0; times.len() + 3];
            model.predict_into(order, table, &mut out);
            for (i, (&civil, expected)) in times.iter().zip(&expected).enumerate() {
                prop_assert!((model.predict(&week, order, civil) - expected).abs() < 1e-10);
                prop_assert!((out[i] - expected).abs() < 1e-10, "{} {expected}", out[i]);
                prop_assert!((0.0..=1.0).contains(&out[i]));
            }
            prop_assert_eq!(&out[times.len()..], &[-1.0; 3]);
            let mut short = vec![-1.0; times.len() / 2];
            model.predict_into(order, table, &mut short);
            prop_assert!(short.iter().zip(&out).all(|(short, out)| (short - out).abs() < 1e-12));
        }
    }
}

#[test]
fn every_instruction_set_gives_the_same_predictions() {
    let week = Periodicities::default();
    let samples = daily_sine(9);
    let times: Vec<i64> = samples.iter().take(211).map(Sample::civil_nanos).collect();
    let (model, table) = (trained(&week, &samples), PhasorTable::new(&week, &times));
    let mut terms = [Term::default(); ORDER_MAX];
    let terms = model.terms(ORDER_MAX, &table, &mut terms).unwrap();
    for length in (0..42).chain([times.len()]) {
        check_instruction_sets(&model, terms, &times[..length]);
    }
    let nothing = SpectralModel::from_parts(-0.0, 0, Vec::new()).unwrap();
    check_instruction_sets(&nothing, &[], &times[..21]);
}

fn check_instruction_sets(model: &SpectralModel, terms: &[Term<'_>], times: &[i64]) {
    let week = Periodicities::default();
    let mut first = None;
    for arch in crate::phasor::every_arch() {
        let mut out = vec![0.0; times.len()];
        arch.dispatch(Predict { mean: model.mean(), terms, times: times.len(), out: &mut out });
        for (&found, &civil) in out.iter().zip(times) {
            assert!((found - model.predict(&week, ORDER_MAX, civil)).abs() < 1e-10);
        }
        let bits: Vec<u64> = out.iter().map(|out| out.to_bits()).collect();
        assert_eq!(first.get_or_insert_with(|| bits.clone()), &bits, "{arch:?}");
    }
}
