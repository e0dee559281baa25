//! Tests the properties of `order.rs`, against a naive oracle where there is one.

use super::*;

fn errors(given: &[(usize, f64)]) -> [f64; ORDER_MAX + 1] {
    let mut errors = [1000.0; ORDER_MAX + 1];
    for &(order, error) in given {
        errors[order] = error;
    }
    errors
}

fn best_of(given: &[(usize, f64)]) -> usize {
    let mut order_errors = OrderErrors::default();
    order_errors.record(LocalDay(0), &errors(given));
    order_errors.best()
}

#[test]
fn the_lowest_error_wins_and_near_ties_go_to_the_lower_order() {
    assert_eq!(OrderErrors::default().best(), 0);
    assert_eq!(best_of(&[(3, 10.0), (7, 9.0)]), 7);
    assert_eq!(best_of(&[(3, 10.0), (7, 10.0)]), 3);
    assert_eq!(best_of(&[(3, 10.009), (7, 10.0)]), 3);
    assert_eq!(best_of(&[(3, 10.011), (7, 10.0)]), 7);
    // Each error is compared with the lowest, not with its neighbour.
    assert_eq!(best_of(&[(2, 10.018), (3, 10.009), (7, 10.0)]), 3);
    assert_eq!(best_of(&[(4, 0.0), (9, 0.0)]), 4);
}

#[test]
fn errors_fade_with_the_days_that_are_observed() {
    let mut order_errors = OrderErrors::default();
    order_errors.record(LocalDay(100), &[2.0; ORDER_MAX + 1]);
    order_errors.record(LocalDay(101), &[1.0; ORDER_MAX + 1]);
    assert!((order_errors.sums()[5] - (2.0 * 0.93 + 1.0)).abs() < 1e-12);
    order_errors.record(LocalDay(111), &[0.5; ORDER_MAX + 1]);
    // The next record is ten days later, but one observed day.
    let expected = (2.0 * 0.93 + 1.0) * 0.93 + 0.5;
    assert!((order_errors.sums()[5] - expected).abs() < 1e-12);
    assert_eq!(order_errors.last_day(), Some(LocalDay(111)));
}

#[test]
fn the_same_and_an_earlier_day_add_without_fading() {
    let mut order_errors = OrderErrors::default();
    for day in [100, 100, 98] {
        order_errors.record(LocalDay(day), &[1.0; ORDER_MAX + 1]);
    }
    assert!((order_errors.sums()[0] - 3.0).abs() < 1e-12);
    assert_eq!(order_errors.last_day(), Some(LocalDay(100)));
}

#[test]
fn yesterday_outweighs_a_month_ago() {
    let mut order_errors = OrderErrors::default();
    order_errors.record(LocalDay(0), &errors(&[(1, 5.0), (2, 20.0)]));
    assert_eq!(order_errors.best(), 1);
    for day in 1..=30 {
        order_errors.record(LocalDay(day), &errors(&[(1, 9.0), (2, 8.0)]));
    }
    assert_eq!(order_errors.best(), 2);
}

#[test]
fn a_place_that_is_seen_monthly_is_judged_by_all_its_bins() {
    let mut order_errors = OrderErrors::default();
    for month in 0..11 {
        order_errors.record(LocalDay(30 * month), &errors(&[(1, 5.0), (2, 8.0)]));
    }
    // Order 2 predicts one day better, but by less than it loses on the others together.
    order_errors.record(LocalDay(330), &errors(&[(1, 9.0), (2, 0.0)]));
    assert_eq!(order_errors.best(), 1);
}

#[test]
fn extreme_days_keep_the_sums_finite() {
    let mut order_errors = OrderErrors::default();
    order_errors.record(LocalDay(i32::MIN), &[1.0; ORDER_MAX + 1]);
    order_errors.record(LocalDay(i32::MAX), &[1.0; ORDER_MAX + 1]);
    assert!((order_errors.sums()[15] - 1.93).abs() < 1e-12);
    assert_eq!(OrderErrors::from_parts(order_errors.to_parts()), Ok(order_errors));
    let damaged = OrderErrorsParts { sums: [f64::NAN; ORDER_MAX + 1], last_day: None };
    assert!(OrderErrors::from_parts(damaged).is_err());
}
