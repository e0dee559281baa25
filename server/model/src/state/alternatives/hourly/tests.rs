//! The errors in one pass against those of full histograms.

use proptest::prelude::*;

use super::*;
use crate::models::TemporalModel as _;

/// The prediction of the spectral model.
const SPECTRAL: f64 = 0.4;
const SEC: i64 = 1_000_000_000;

fn any_samples(length: std::ops::Range<usize>, span_secs: i64) -> impl Strategy<Value = Vec<Sample>> {
    let value = prop_oneof![0.0..=1.0, Just(0.0), Just(1.0), Just(0.5), -1e9..1e9, Just(1e150), Just(f64::MAX)];
    // Changes of summer time: hours are repeated or skipped.
    let offset_secs = prop_oneof![Just(0), Just(0), Just(3_600), Just(-12_600)];
    let sample = (-span_secs..span_secs, offset_secs, value);
    proptest::collection::vec(sample, length).prop_map(|mut samples| {
        samples.sort_by_key(|sample| sample.0);
        let sample = |(secs, offset_secs, value)| Sample { utc_nanos: secs * SEC, offset_secs, value };
        samples.into_iter().map(sample).collect()
    })
}

proptest! {
    #[test]
    fn one_pass_finds_what_histograms_have(
        read in any_samples(0..300, 3_000_000),
        faded in prop_oneof![Just(1.0), 0.0..1.0, Just(1e-12)],
        scored in any_samples(0..100, 200_000),
        zero_one in any::<bool>(),
    ) {
        let criterion = if zero_one { OrderCriterion::ZeroOne } else { OrderCriterion::SquaredError };
        let mut known = Alternatives::default();
        known.hours.add(&read);
        known.hours.scale(faded);
        let found = known.score_histograms(criterion, &scored, &|_| SPECTRAL);
        let made: Option<Vec<_>> = HISTOGRAMS.into_iter().map(|kind| known.histogram(kind)).collect();
        prop_assert_eq!(found.is_some(), made.is_some());
        let made = made.unwrap_or_default();
        let known_mean = known.hours.mean().unwrap_or_default();
        for (found, histogram) in found.iter().flatten().zip(&made) {
            let naive = scored.iter().fold((0.0, 0.0), |(squared, by_criterion), sample| {
                let known = histogram.has_readings_near(sample.moment());
                let predicted = if known { histogram.predict(sample.moment()) } else { SPECTRAL };
                let difference = (predicted - sample.value).powi(2);
                let has_own = histogram.weight(sample.moment()) > 0.0;
                let compared = if has_own { predicted } else { known_mean };
                let wrong = f64::from(u8::from((compared >= 0.5) != (sample.value >= 0.5)));
                let compared = (compared - sample.value).powi(2);
                (squared + difference, by_criterion + if zero_one { wrong } else { compared })
            });
            let is_near = |one: f64, other: f64| one == other || (one - other).abs() <= 1e-9 * other.abs();
            prop_assert!(is_near(found.squared, naive.0), "{} and {}", found.squared, naive.0);
            prop_assert!(is_near(found.by_criterion, naive.1), "{} and {}", found.by_criterion, naive.1);
        }
    }
}
