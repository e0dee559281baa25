//! Tests the properties of `mean.rs`.

use proptest::prelude::*;

use super::*;
use crate::Sample;

fn sample(secs: i64, value: f64) -> Sample {
    Sample { utc_nanos: secs.saturating_mul(1_000_000_000), offset_secs: 0, value }
}

const NOON: Moment = Moment { utc_nanos: 12 * 3_600_000_000_000, offset_secs: 0 };

#[test]
fn a_reading_one_half_life_old_counts_half() {
    let samples = [sample(0, 1.0), sample(3600, 0.0)];
    let plain = Mean::train(Readings::new(&samples)).unwrap();
    assert!((plain.predict(NOON) - 0.5).abs() < 1e-12);
    let readings = Readings { half_life_secs: Some(3600.0), ..Readings::new(&samples) };
    assert!((Mean::train(readings).unwrap().predict(NOON) - 1.0 / 3.0).abs() < 1e-12);
}

#[test]
fn nothing_and_nan_are_refused() {
    assert_eq!(Mean::train(Readings::new(&[])), Err(CannotTrain::NoReadings));
    for value in [f64::NAN, f64::INFINITY] {
        assert!(matches!(Mean::train(Readings::new(&[sample(0, value)])), Err(CannotTrain::Parameter { .. })));
    }
    for mean in [f64::NAN, f64::NEG_INFINITY] {
        assert!(Mean::from_parts(MeanParts { mean }).is_err());
    }
}

proptest! {
    #[test]
    fn it_is_the_mean_and_survives_storage(values in prop::collection::vec(-5.0..5.0_f64, 1..200)) {
        let samples: Vec<Sample> = values.iter().map(|&value| sample(0, value)).collect();
        let model = Mean::train(Readings::new(&samples)).unwrap();
        let expected = values.iter().sum::<f64>() / values.len() as f64;
        prop_assert!((model.predict(NOON) - expected).abs() < 1e-12);
        prop_assert_eq!(Mean::from_parts(model.to_parts()), Ok(model));
    }

    #[test]
    fn it_lies_among_the_readings_however_large(
        values in prop::collection::vec(prop::num::f64::NORMAL, 1..50),
        half_life in prop::option::of(prop::num::f64::ANY),
    ) {
        let at = |(year, &value): (usize, &f64)| sample(year as i64 * 315_000_000, value);
        let samples: Vec<Sample> = values.iter().enumerate().map(at).collect();
        let mean = Mean::train(Readings { half_life_secs: half_life, ..Readings::new(&samples) }).unwrap().mean();
        let lowest = values.iter().copied().fold(f64::INFINITY, f64::min);
        let highest = values.iter().copied().fold(f64::NEG_INFINITY, f64::max);
        prop_assert!((lowest..=highest).contains(&mean), "{}", mean);
    }
}
