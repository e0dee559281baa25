//! Tests bands of values: their width, and that they contain the prediction.

use proptest::prelude::*;

use super::*;

fn moments(days: f64, mean: f64, deviation: f64) -> HourMoments {
    let squares = days * mean * mean + (days - 1.0).max(0.0) * deviation * deviation;
    HourMoments { days, sum: days * mean, sum_of_squares: squares }
}

#[test]
fn many_days_determine_the_width_of_the_band_and_few_days_widen_it() {
    let width = |days| value_interval(StateKind::Continuous, 3.0, moments(days, 3.0, 0.5), 4.0, 0.9).width();
    // The width is 2 z σ.
    assert!((width(10_000.0) - 2.0 * 1.64485 * 0.5).abs() < 0.01, "{}", width(10_000.0));
    assert!(width(2.0) > 2.0 * width(10_000.0) && width(0.0) > width(2.0));
}

#[test]
fn a_count_is_never_below_zero() {
    let band = value_interval(StateKind::Count, 0.5, moments(20.0, 0.5, 2.0), 4.0, 0.9);
    assert!(band.lower == 0.0 && band.upper > 2.0, "{band:?}");
}

proptest! {
    #[test]
    fn a_band_is_finite_and_holds_its_prediction(
        p in any::<f64>(), days in any::<f64>(), sum in any::<f64>(), squares in any::<f64>(),
        readings in any::<f64>(), level in any::<f64>(),
    ) {
        for kind in [StateKind::Continuous, StateKind::Count] {
            let band = value_interval(kind, p, HourMoments { days, sum, sum_of_squares: squares }, readings, level);
            prop_assert!(band.contains(kind.saturate(p)), "{kind:?} {band:?}");
            prop_assert!(kind.bounds().contains(&band.lower) && kind.bounds().contains(&band.upper), "{band:?}");
        }
    }
}
