//! Tests the properties of `flow.rs`, against sums over all intervals in plain f64.

use proptest::prelude::*;
use rand::rngs::SmallRng;
use rand::{Rng, SeedableRng};

use super::*;

const SEC: i64 = 1_000_000_000;
const DAY_SECS: i64 = 86_400;

fn moment(secs: i64) -> Moment {
    Moment { utc_nanos: secs * SEC, offset_secs: 0 }
}

fn detection(secs: i64, place_m: [f64; 2], direction_rad: f64) -> FlowDetection {
    FlowDetection { moment: moment(secs), place_m, direction_rad }
}

fn two_cells() -> FlowOptions {
    FlowOptions::new(FlowRaster { low_m: [0.0, 0.0], edge_m: 1.0, counts: [2, 1] })
}

fn learned(detections: &[FlowDetection], options: &FlowOptions) -> FlowModel {
    FlowModel::train(detections, &Periodicities::default(), options, StopSignal::NEVER).unwrap()
}

/// People who walk east in the morning and west in the afternoon, in the first cell, on some days.
fn streams(days: i64, seed: u64) -> Vec<FlowDetection> {
    let mut random = SmallRng::seed_from_u64(seed);
    let mut found = Vec::new();
    for interval in 0..days * 144 {
        let hour = interval % 144 / 6;
        for _ in 0..3 {
            if (7..17).contains(&hour) && random.random_bool(0.4) {
                let direction = if hour < 12 { 0.0 } else { std::f64::consts::PI };
                let strays = random.random_range(-0.3..0.3);
                found.push(detection(interval * 600 + 300, [0.5, 0.5], direction + strays));
            }
        }
    }
    found
}

/// The flow of the first cell at a time of day.
fn at_hour(model: &FlowModel, day: i64, hour: i64) -> CellFlow {
    model.at(moment(day * DAY_SECS + hour * 3_600)).into_iter().find(|flow| flow.cell == 0).expect("a cell")
}

#[test]
fn streams_that_turn_at_noon_are_expected_to_turn() {
    let model = learned(&streams(21, 1), &two_cells());
    let (morning, afternoon, night) = (at_hour(&model, 23, 9), at_hour(&model, 23, 15), at_hour(&model, 23, 2));
    assert!(morning.shares()[0] > 0.85 && morning.shares()[4] < 0.1, "{:?}", morning.shares());
    assert!(afternoon.shares()[4] > 0.85 && afternoon.shares()[0] < 0.1, "{:?}", afternoon.shares());
    let expected = 3.0 * 0.4 / 600.0;
    assert!((morning.total_per_sec() / expected - 1.0).abs() < 0.3, "{}", morning.total_per_sec());
    assert!(night.total_per_sec() < 0.1 * expected, "{}", night.total_per_sec());
}

#[test]
fn without_a_rhythm_the_order_is_mostly_0() {
    let steady = |seed| {
        let mut random = SmallRng::seed_from_u64(seed);
        let times: Vec<i64> = (0..14 * 144).filter(|_| random.random_bool(0.5)).collect();
        let walk = |step: i64| detection(step * 600, [0.5, 0.5], random.random_range(0.0..6.0));
        learned(&times.into_iter().map(walk).collect::<Vec<_>>(), &two_cells())
    };
    let orders: Vec<usize> = (0..20).flat_map(|seed| steady(seed).orders().next()).map(|(_, order)| order).collect();
    assert!(orders.iter().filter(|&&order| order == 0).count() >= 18, "{orders:?}");
}

#[test]
fn few_days_have_no_rhythm_yet() {
    let model = learned(&streams(3, 2), &two_cells());
    assert_eq!(model.orders().collect::<Vec<_>>(), [(0, 0)]);
    assert_eq!(at_hour(&model, 9, 9), at_hour(&model, 9, 15));
}

#[test]
fn without_components_the_order_stays_0() {
    let options = FlowOptions { order_max: 0, ..two_cells() };
    let model = learned(&streams(21, 1), &options);
    let shares = at_hour(&model, 23, 9).shares();
    assert!((shares[0] - 0.5).abs() < 0.05 && (shares[4] - 0.5).abs() < 0.05, "{shares:?}");
}

#[test]
fn directions_go_to_the_nearest_bin() {
    let options = two_cells();
    for (degrees, bin) in [(0.0, 0), (22.0, 0), (23.0, 1), (90.0, 2), (-90.0, 6), (-22.0, 0), (359.0, 0), (720.0, 0)] {
        assert_eq!(options.direction(f64::to_radians(degrees)), bin, "{degrees}");
    }
}

#[test]
fn only_what_lies_in_the_raster_counts() {
    let raster = FlowRaster { low_m: [-1.0, 2.0], edge_m: 0.5, counts: [4, 3] };
    assert_eq!(
        [[-1.0, 2.0], [0.99, 3.49], [-1.01, 2.0], [1.0, 2.0], [0.0, f64::NAN]].map(|place| raster.cell(place)),
        [Some(0), Some(11), None, None, None]
    );
    assert_eq!(raster.middle_m(11), [0.75, 3.25]);
    let options = FlowOptions::new(raster);
    let model = learned(&[detection(0, [0.0, 2.0], 0.0), detection(60, [9.0, 2.0], 0.0)], &options);
    assert_eq!((model.detections(), model.at(moment(0)).len()), (1, 1));
    assert!(model.unseen_per_sec() > 0.0 && model.unseen_per_sec() < model.at(moment(0))[0].per_sec[0]);
}

#[test]
fn what_cannot_be_learned_is_refused() {
    let refused = |detections: &[FlowDetection], options: FlowOptions| {
        FlowModel::train(detections, &Periodicities::default(), &options, StopSignal::NEVER).unwrap_err()
    };
    let one = detection(0, [0.5, 0.5], 0.0);
    assert_eq!(refused(&[], two_cells()), CannotTrain::NoReadings);
    assert_eq!(refused(&[detection(0, [5.0, 0.5], 0.0)], two_cells()), CannotTrain::NoReadings);
    let is_parameter = |error| matches!(error, CannotTrain::Parameter { .. });
    assert!(is_parameter(refused(&[detection(0, [0.5, f64::NAN], 0.0)], two_cells())));
    assert!(is_parameter(refused(&[detection(0, [0.5, 0.5], f64::INFINITY)], two_cells())));
    assert!(is_parameter(refused(&[one], FlowOptions { directions: 3, ..two_cells() })));
    assert!(is_parameter(refused(&[one], FlowOptions { interval_nanos: 1, ..two_cells() })));
    let huge = FlowRaster { counts: [usize::MAX, 2], ..two_cells().raster };
    assert!(is_parameter(refused(&[one], FlowOptions { raster: huge, ..two_cells() })));
    let stopped = FlowModel::train(&[one], &Periodicities::default(), &two_cells(), StopSignal::new(&|| true));
    assert!(matches!(stopped, Err(CannotTrain::Stop(_))));
}

#[test]
fn old_detections_fade_with_the_half_life() {
    // People walk east in the first weeks, and north since.
    let walk = |step: i64| detection(step * 3_600, [0.5, 0.5], if step < 14 * 24 { 0.0 } else { 1.57 });
    let detections: Vec<FlowDetection> = (0..28 * 24).map(walk).collect();
    let north = |half_life_secs| {
        let model = learned(&detections, &FlowOptions { half_life_secs, order_max: 0, ..two_cells() });
        at_hour(&model, 30, 9).shares()[2]
    };
    assert!((north(None) - 0.5).abs() < 0.01, "{}", north(None));
    assert!(north(Some(3.0 * 86_400.0)) > 0.9, "{}", north(Some(3.0 * 86_400.0)));
}

#[test]
fn rhythms_are_found_with_a_short_half_life_too() {
    // At the end of the days that are learned for the choice, weights are a thousandth of the weights at the end of all
    // days.
    let options = FlowOptions { half_life_secs: Some(43_200.0), ..two_cells() };
    let model = learned(&streams(21, 1), &options);
    assert!(model.orders().all(|(_, order)| order >= 1), "{:?}", model.orders().collect::<Vec<_>>());
    assert!(at_hour(&model, 23, 9).shares()[0] > 0.8 && at_hour(&model, 23, 15).shares()[4] > 0.8);
}

/// Rates by order of one cell, from sums over all intervals before `end`: direction, then interval.
struct Naive {
    counts: Vec<Vec<f64>>,
    periods: Vec<f64>,
}

impl Naive {
    fn rates(&self, end: usize, order: usize, at_secs: &[f64]) -> Vec<Vec<f64>> {
        let days = (end as f64 / 144.0).ceil();
        let directions = self.counts.len() as f64;
        let of_direction = |counts: &Vec<f64>| {
            let counts = &counts[..end];
            let total: f64 = counts.iter().sum();
            let mean = (0.5 / directions + total) / (1.0 + end as f64);
            let floor = (0.5 / directions / (1.0 + days)).min(mean);
            let centred = total / end as f64;
            let mut found: Vec<(f64, f64, f64)> = Vec::new();
            for period in self.periods.iter().filter(|period| (end - 1) as f64 * 600.0 >= 0.99 * **period) {
                let (mut re, mut im) = (0.0, 0.0);
                for (interval, count) in counts.iter().enumerate() {
                    let phase = TAU * ((interval as f64 + 0.5) * 600.0) / period;
                    re += (count - centred) * phase.cos() / end as f64;
                    im -= (count - centred) * phase.sin() / end as f64;
                }
                found.push((re, im, *period));
            }
            found.sort_by(|one, other| other.0.hypot(other.1).total_cmp(&one.0.hypot(one.1)));
            if total == 0.0 {
                found.clear();
            }
            let rate = |secs: &f64| {
                let wave = |&(re, im, period): &(f64, f64, f64)| {
                    let phase = TAU * secs / period;
                    2.0 * (re * phase.cos() - im * phase.sin())
                };
                (mean + found.iter().take(order).map(wave).sum::<f64>()).max(floor)
            };
            at_secs.iter().map(rate).collect()
        };
        self.counts.iter().map(of_direction).collect()
    }

    fn log_likelihood(&self, from: usize, order: usize) -> f64 {
        let intervals = self.counts[0].len();
        let times: Vec<f64> = (from..intervals).map(|interval| (interval as f64 + 0.5) * 600.0).collect();
        let rates = self.rates(from, order, &times);
        let of_direction = |(rates, counts): (&Vec<f64>, &Vec<f64>)| -> f64 {
            rates.iter().zip(&counts[from..]).map(|(rate, count)| count * rate.ln() - rate).sum()
        };
        rates.iter().zip(&self.counts).map(of_direction).sum()
    }
}

proptest! {
    #![proptest_config(ProptestConfig::with_cases(24))]

    #[test]
    fn rates_are_those_of_sums_over_all_intervals(
        seed in any::<u64>(), days in 4_i64..12, often in 0.02_f64..0.6, turn in 0_i64..24, at in 0_i64..2_000_000,
    ) {
        let mut random = SmallRng::seed_from_u64(seed);
        let mut counts = vec![vec![0.0; (days * 144) as usize]; 4];
        let mut detections = Vec::new();
        for interval in 0..days * 144 {
            // Both ends have a detection, so that the intervals are known.
            let is_end = interval == 0 || interval == days * 144 - 1;
            while is_end && detections.last().is_none_or(|last: &FlowDetection| last.moment != moment(interval * 600 + 5))
                || random.random_bool(often)
            {
                let bin = if interval % 144 / 6 < turn { random.random_range(0..2) } else { random.random_range(0..4) };
                counts[bin][interval as usize] += 1.0;
                detections.push(detection(interval * 600 + 5, [1.5, 0.5], bin as f64 * TAU / 4.0));
            }
        }
        let options = FlowOptions { directions: 4, ..two_cells() };
        let model = learned(&detections, &options);
        let (_, order) = model.orders().next().expect("a cell");
        let periods = (1..=168).map(|k| 604_800.0 / f64::from(k)).collect();
        let naive = Naive { counts, periods };
        let expected = naive.rates((days * 144) as usize, order, &[at as f64]);
        for (found, expected) in model.at(moment(at))[0].per_sec.iter().zip(&expected) {
            let expected = expected[0] / 600.0;
            prop_assert!((found - expected).abs() <= 1e-9 + 1e-6 * expected, "{found} instead of {expected}");
        }
        let held_from = ((days - days / 4) * 144) as usize;
        let likely: Vec<f64> = (0..=15).map(|order| naive.log_likelihood(held_from, order)).collect();
        let highest = likely.iter().copied().fold(f64::NEG_INFINITY, f64::max);
        prop_assert!(likely[order] >= highest - 3.0 - 1e-6, "order {order} of {likely:?}");
        prop_assert!(likely[..order].iter().all(|lower| *lower <= highest - 3.0 + 1e-6), "order {order} of {likely:?}");
    }
}
