//! Tests the properties of `histogram.rs`: against a naive oracle, and the table of hours against the histogram itself.

use proptest::prelude::*;

use super::*;
use crate::Sample;

const HOUR_NANOS: i64 = 3_600_000_000_000;
const DAY_NANOS: i64 = 24 * HOUR_NANOS;
/// Monday, 2024-01-01, as days since 1970.
const MONDAY: i64 = 19_723;

fn sample(utc_nanos: i64, value: f64) -> Sample {
    Sample { utc_nanos, offset_secs: 0, value }
}

fn at(utc_nanos: i64) -> Moment {
    Moment { utc_nanos, offset_secs: 0 }
}

/// Readings every ten minutes for some days from a Monday; the value depends on the day and hour.
fn days(count: i64, value: impl Fn(i64, i64) -> f64) -> Vec<Sample> {
    (0..count * 144)
        .map(|step| sample(MONDAY * DAY_NANOS + step * HOUR_NANOS / 6, value(step / 144, step % 144 / 6)))
        .collect()
}

fn trained(samples: &[Sample], cycle: HistogramCycle, bins: usize) -> Histogram {
    Histogram::train(Readings::new(samples), &HistogramSettings::new(cycle, bins)).unwrap()
}

#[test]
fn each_cycle_knows_its_own_rhythm() {
    let open = |day: i64, hour: i64| f64::from(u8::from(day % 7 < 5 && (8..17).contains(&hour)));
    let samples = days(70, open);
    for (cycle, bins, tolerance) in [(HistogramCycle::Week, 168, 0.02), (HistogramCycle::WeekdayWeekend, 24, 0.01)] {
        let histogram = trained(&samples, cycle, bins);
        for sample in &samples {
            assert!((histogram.predict(sample.moment()) - sample.value).abs() < tolerance, "{cycle:?} {sample:?}");
        }
    }
    // The day mixes weekday and weekend: five of seven days are open at noon.
    let day = trained(&samples, HistogramCycle::Day, 24);
    assert!((day.predict(at(12 * HOUR_NANOS)) - 5.0 / 7.0).abs() < 0.002);
    assert!(day.predict(at(3 * HOUR_NANOS)) < 0.002);
}

#[test]
fn it_keeps_to_the_local_clock() {
    let samples = days(10, |_, hour| f64::from(u8::from(hour >= 12)));
    let day = trained(&samples, HistogramCycle::Day, 2);
    let eleven = MONDAY * DAY_NANOS + 11 * HOUR_NANOS;
    assert!(day.predict(Moment { utc_nanos: eleven, offset_secs: 3600 }) > 0.99);
    assert!(day.predict(Moment { utc_nanos: eleven, offset_secs: 3599 }) < 0.01);
}

#[test]
fn a_bin_with_little_data_leans_on_the_mean() {
    let mut samples = days(10, |_, hour| if hour == 3 { 1.0 } else { 0.0 });
    samples.retain(|sample| sample.utc_nanos % DAY_NANOS < 6 * HOUR_NANOS);
    let mean = 1.0 / 6.0;
    let histogram = trained(&samples, HistogramCycle::Day, 24);
    assert!((histogram.predict(at(12 * HOUR_NANOS)) - mean).abs() < 1e-12);
    assert!(histogram.weight(at(12 * HOUR_NANOS)).abs() < 1e-12);
    assert!((histogram.weight(at(3 * HOUR_NANOS)) - 60.0).abs() < 1e-12);
    let settings = HistogramSettings { prior_readings: 20.0, ..HistogramSettings::new(HistogramCycle::Day, 24) };
    let shrunk = Histogram::train(Readings::new(&samples), &settings).unwrap();
    assert!((shrunk.predict(at(3 * HOUR_NANOS)) - (60.0 + 20.0 * mean) / 80.0).abs() < 1e-12);
}

#[test]
fn smoothing_spreads_over_midnight_and_keeps_the_mean() {
    let samples = days(7, |_, hour| if hour == 0 { 1.0 } else { 0.0 });
    let settings = HistogramSettings {
        smoothing_bins: 1.5,
        prior_readings: 0.0,
        ..HistogramSettings::new(HistogramCycle::Day, 24)
    };
    let histogram = Histogram::train(Readings::new(&samples), &settings).unwrap();
    let value = |hour: i64| histogram.predict(at(hour * HOUR_NANOS));
    assert!((value(1) - value(23)).abs() < 1e-12);
    assert!(value(0) > value(1) && value(1) > value(2) && value(2) > 0.0 && value(12) < 1e-12);
    let mean = (0..24).map(value).sum::<f64>() / 24.0;
    assert!((mean - 1.0 / 24.0).abs() < 1e-12);
    // Saturday's evening does not affect a weekday's morning.
    let weekend = days(14, |day, _| if day % 7 >= 5 { 1.0 } else { 0.0 });
    let settings = HistogramSettings { cycle: HistogramCycle::WeekdayWeekend, ..settings };
    let histogram = Histogram::train(Readings::new(&weekend), &settings).unwrap();
    for sample in &weekend {
        assert!((histogram.predict(sample.moment()) - sample.value).abs() < 1e-12);
    }
}

#[test]
fn settings_out_of_range_are_refused() {
    let samples = [sample(0, 1.0)];
    let refused = |settings: HistogramSettings| {
        matches!(Histogram::train(Readings::new(&samples), &settings), Err(CannotTrain::Parameter { .. }))
    };
    for (cycle, max_bins) in
        [(HistogramCycle::Day, 1440), (HistogramCycle::Week, 10_080), (HistogramCycle::WeekdayWeekend, 1440)]
    {
        assert!(refused(HistogramSettings::new(cycle, 0)));
        assert!(refused(HistogramSettings::new(cycle, max_bins + 1)));
        assert!(!refused(HistogramSettings::new(cycle, max_bins)));
    }
    let good = HistogramSettings::new(HistogramCycle::Day, 24);
    for smoothing_bins in [-1.0, 6.1, f64::NAN] {
        assert!(refused(HistogramSettings { smoothing_bins, ..good }));
    }
    for prior_readings in [-1.0, 2e9, f64::NAN] {
        assert!(refused(HistogramSettings { prior_readings, ..good }));
    }
    assert_eq!(Histogram::train(Readings::new(&[]), &good), Err(CannotTrain::NoReadings));
    assert!(Histogram::train(Readings::new(&[sample(0, f64::NAN)]), &good).is_err());
}

#[test]
fn damaged_parts_are_refused() {
    let good = trained(&days(2, |_, _| 0.5), HistogramCycle::WeekdayWeekend, 3).to_parts();
    let damaged = |change: &dyn Fn(&mut HistogramParts)| {
        let mut parts = good.clone();
        change(&mut parts);
        Histogram::from_parts(parts).is_err()
    };
    assert!(!damaged(&|_| ()));
    assert!(damaged(&|parts| parts.values[0] = f64::NAN));
    assert!(damaged(&|parts| parts.weights[0] = -1.0));
    assert!(damaged(&|parts| parts.weights.truncate(5)));
    assert!(damaged(&|parts| {
        parts.values.truncate(5);
        parts.weights.truncate(5);
    }));
    let mut table = HourTable::default().to_parts();
    table.cells[7][0] = f64::INFINITY;
    assert!(HourTable::from_parts(&table).is_err());
    let mut table = HourTable::default().to_parts();
    table.days.truncate(47);
    assert!(HourTable::from_parts(&table).is_err());
}

#[test]
fn the_table_forgets() {
    let mut table = HourTable::default();
    table.add(&days(7, |_, _| 1.0));
    table.scale(f64::NAN);
    table.scale(0.25);
    table.add(&days(7, |_, _| 0.0));
    let histogram = table.histogram(HistogramCycle::Day, 1).unwrap();
    // There are 1008 readings of weight 1/4 and 1008 of weight 1; the prior is the mean itself.
    assert!((histogram.predict(at(0)) - 0.2).abs() < 1e-12);
    table.scale(-1.0);
    assert_eq!(table, HourTable::default());
    assert_eq!(table.histogram(HistogramCycle::Day, 24), None);
}

#[test]
fn the_spread_is_that_of_single_days() {
    let mut table = HourTable::default();
    assert_eq!(table.spread(9, false), None);
    // At nine o'clock the weekdays of two weeks have 0, 0.1, … 0.9.
    table.add(&days(
        14,
        |day, hour| if hour == 9 && day % 7 < 5 { (day % 7 + 5 * (day / 7)) as f64 / 10.0 } else { 0.0 },
    ));
    let spread = table.spread(9, false).unwrap();
    assert!((spread.days - 10.0).abs() < 1e-12 && (spread.mean - 0.45).abs() < 1e-12);
    assert!((spread.standard_deviation - (0.825_f64 / 9.0).sqrt()).abs() < 1e-9);
    let weekend = table.spread(9, true).unwrap();
    assert!((weekend.days - 4.0).abs() < 1e-12 && weekend.standard_deviation.abs() < 1e-12);
    assert_eq!(table.spread(24, false), None);
    assert!((table.observed_hours() - 14.0 * 24.0).abs() < 1e-9);
}

#[test]
fn a_table_is_compact() {
    let parts = HourTable::default().to_parts();
    assert!(size_of_val(parts.cells.as_slice()) + size_of_val(parts.days.as_slice()) <= 4096);
}

/// Readings of about a month, at any second, in order.
fn readings() -> impl Strategy<Value = Vec<Sample>> {
    prop::collection::vec((0..30 * 86_400_i64, 0.0..=1.0_f64), 1..150).prop_map(|mut rows| {
        rows.sort_by_key(|row| row.0);
        let nanos = |secs: i64| MONDAY * DAY_NANOS + secs * 1_000_000_000;
        rows.into_iter().map(|(secs, value)| Sample { utc_nanos: nanos(secs), offset_secs: 3600, value }).collect()
    })
}

proptest! {
    #[test]
    fn a_bin_is_the_mean_of_its_readings(samples in readings(), bins in 1..200_usize) {
        let settings = HistogramSettings { prior_readings: 2.5, ..HistogramSettings::new(HistogramCycle::Day, bins) };
        let histogram = Histogram::train(Readings::new(&samples), &settings).unwrap();
        let bin_of = |sample: &Sample| {
            let secs = (sample.utc_nanos / 1_000_000_000 + 3600) % 86_400;
            secs as usize * bins / 86_400
        };
        let mean = samples.iter().map(|sample| sample.value).sum::<f64>() / samples.len() as f64;
        for sample in &samples {
            let alike: Vec<f64> =
                samples.iter().filter(|other| bin_of(other) == bin_of(sample)).map(|other| other.value).collect();
            let expected = (alike.iter().sum::<f64>() + 2.5 * mean) / (alike.len() as f64 + 2.5);
            prop_assert!((histogram.predict(sample.moment()) - expected).abs() < 1e-12);
        }
        prop_assert_eq!(Histogram::from_parts(histogram.to_parts()), Ok(histogram));
    }

    #[test]
    fn the_table_gives_the_histograms_of_its_readings_in_any_batching(
        samples in readings(),
        batches in 1..6_usize,
        seed in any::<u64>(),
    ) {
        // Batches contain whole hours, in any order.
        let mut table = HourTable::default();
        let mut at_once = HourTable::default();
        at_once.add(&samples);
        for batch in 0..batches {
            let mut part: Vec<Sample> = samples
                .iter()
                .filter(|sample| (sample.civil_nanos() / HOUR_NANOS) as usize % batches == batch)
                .copied()
                .collect();
            part.sort_by_key(|sample| sample.utc_nanos as u64 ^ seed);
            table.add(&part);
        }
        let flat = |table: &HourTable| {
            let parts = table.to_parts();
            [parts.cells.as_flattened(), parts.days.as_flattened()].concat()
        };
        for (found, expected) in flat(&table).iter().zip(flat(&at_once)) {
            prop_assert!((found - expected).abs() < 1e-9);
        }
        prop_assert_eq!(HourTable::from_parts(&table.to_parts()), Ok(table.clone()));
        for cycle in [HistogramCycle::Day, HistogramCycle::Week, HistogramCycle::WeekdayWeekend] {
            for bins in 1..=168 {
                let hours = if cycle == HistogramCycle::Week { 168 } else { 24 };
                let Some(histogram) = table.histogram(cycle, bins) else {
                    prop_assert!(hours % bins != 0);
                    continue;
                };
                prop_assert!(hours % bins == 0);
                let (found, expected) = (histogram.to_parts(), trained(&samples, cycle, bins).to_parts());
                for (found, expected) in found.values.iter().zip(&expected.values) {
                    prop_assert!((found - expected).abs() < 1e-9, "{:?} {}", cycle, bins);
                }
                prop_assert_eq!(found.weights, expected.weights);
            }
        }
    }

    #[test]
    fn any_time_has_a_finite_answer(
        values in prop::collection::vec((any::<i64>(), prop::num::f64::NORMAL), 1..20),
        when in any::<i64>(),
        offset_secs in any::<i32>(),
        smoothing_bins in 0.0..=6.0_f64,
    ) {
        let mut samples: Vec<Sample> = values.iter().map(|&(nanos, value)| sample(nanos, value)).collect();
        samples.sort_by_key(|sample| sample.utc_nanos);
        let mut table = HourTable::default();
        table.add(&samples);
        let when = Moment { utc_nanos: when, offset_secs };
        for cycle in [HistogramCycle::Day, HistogramCycle::Week, HistogramCycle::WeekdayWeekend] {
            let settings = HistogramSettings { smoothing_bins, ..HistogramSettings::new(cycle, 24) };
            let histogram = Histogram::train(Readings::new(&samples), &settings).unwrap();
            prop_assert!(histogram.predict(when).is_finite());
            prop_assert!(table.histogram(cycle, 24).unwrap().predict(when).is_finite());
        }
        for hour in 0..24 {
            for spread in [table.spread(hour, false), table.spread(hour, true)].into_iter().flatten() {
                prop_assert!(spread.mean.is_finite() && spread.standard_deviation.is_finite());
            }
        }
    }
}
