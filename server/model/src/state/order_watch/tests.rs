//! The promises of `order_watch.rs`.

use super::*;

#[test]
fn parts_make_the_same_again_and_what_cannot_be_is_refused() {
    let mut watch = OrderWatch::of_constant(Some(true));
    let week = Periodicities::default();
    let (mut errors, squared) = (OrderErrors::default(), [3.0; ORDER_MAX + 1]);
    let scores = DayScores { errors: &squared, squared: &squared, scored: 10, order: 0, unit: 1.0 };
    watch.score(LocalDay(3), &week, &mut errors, scores);
    watch.learn(2, 0.25, Some(false));
    assert_eq!(watch.last(), Some(false));
    let parts = watch.to_parts();
    assert_eq!(OrderWatch::from_parts(parts), Ok(watch));
    assert!(OrderWatch::from_parts(OrderWatchParts { supported: 16, ..parts }).is_err());
    assert!(OrderWatch::from_parts(OrderWatchParts { change_rate_sum: f64::NAN, ..parts }).is_err());
    assert!(OrderWatch::from_parts(OrderWatchParts { change_rate_sum: -1.0, ..parts }).is_err());
}

#[test]
fn components_beyond_what_noise_shows_are_supported() {
    let week = Periodicities::default();
    let strong = crate::Component { periodicity: 6, gamma_re: 0.2, gamma_im: 0.0 };
    let model = SpectralModel::from_parts(0.5, 1000, vec![strong]).unwrap();
    let readings = LearnedReadings {
        pairs: 1000,
        span_secs: 3e6,
        observed_hours: 800.0,
        mean: 0.5,
        difference: 1.0,
        remembered: 1.0,
    };
    let mut watch = OrderWatch::of_constant(None);
    // Half of the pairs change, as in noise.
    watch.learn(500, 500.0 / 3000.0, Some(true));
    watch.support(&model, &week, readings);
    assert_eq!(watch.supported_order(), 1);
    let mut noise = watch;
    let weak = crate::Component { gamma_re: 0.01, ..strong };
    noise.support(&SpectralModel::from_parts(0.5, 1000, vec![weak]).unwrap(), &week, readings);
    assert_eq!(noise.supported_order(), 0);
}
