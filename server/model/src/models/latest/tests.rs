//! Tests the properties of `latest.rs`.

use super::*;
use crate::Sample;

fn sample(utc_nanos: i64, value: f64) -> Sample {
    Sample { utc_nanos, offset_secs: 0, value }
}

fn at(utc_nanos: i64) -> Moment {
    Moment { utc_nanos, offset_secs: 3600 }
}

#[test]
fn the_newest_value_holds_and_before_the_first_the_first() {
    let samples = [sample(10, 0.25), sample(20, 1.0), sample(30, 0.0), sample(30, 0.75)];
    let mut model = Latest::train(Readings::new(&samples)).unwrap();
    for (nanos, expected) in [(i64::MIN, 0.25), (9, 0.25), (10, 0.75), (25, 0.75), (30, 0.75), (i64::MAX, 0.75)] {
        assert_eq!(model.predict(at(nanos)), expected, "at {nanos}");
    }
    model.observe(29, 0.5);
    model.observe(31, f64::NAN);
    assert_eq!(model.predict(at(31)), 0.75);
    model.observe(30, 0.125);
    assert_eq!(model.predict(at(31)), 0.125);
    assert_eq!(Latest::from_parts(model.to_parts()), Ok(model));
}

#[test]
fn nonsense_is_refused() {
    assert_eq!(Latest::train(Readings::new(&[])), Err(CannotTrain::NoReadings));
    assert!(Latest::train(Readings::new(&[sample(0, f64::NAN)])).is_err());
    let good = LatestParts { first_nanos: 1, first_value: 0.0, last_nanos: 2, last_value: 1.0 };
    assert!(Latest::from_parts(good).is_ok());
    assert!(Latest::from_parts(LatestParts { last_nanos: 0, ..good }).is_err());
    assert!(Latest::from_parts(LatestParts { first_value: f64::NAN, ..good }).is_err());
    assert!(Latest::from_parts(LatestParts { last_value: f64::INFINITY, ..good }).is_err());
}
