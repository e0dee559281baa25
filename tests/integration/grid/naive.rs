//! The naive model of one cell: every bin and every phasor by itself, in f64, after T-RO 2017,
//! equations 10 to 13, with local days scored before they are learned.
//!
//! Invariant: only the formulas are shared with the daemon.

use std::{collections::BTreeMap, f64::consts::TAU};

const SECOND_NANOS: i64 = 1_000_000_000;
const DAY_NANOS: i64 = 86_400 * SECOND_NANOS;
const WEEK_NANOS: i64 = 7 * DAY_NANOS;
/// Harmonics of a week.
const HARMONICS: usize = 168;
const ORDERS: usize = 16;
/// 2025-03-30T01:00:00Z: clocks in London go forward.
const SUMMER_NANOS: i64 = 1_743_296_400 * SECOND_NANOS;

/// Time in London.
fn civil(utc_nanos: i64) -> i64 {
    if utc_nanos < SUMMER_NANOS { utc_nanos } else { utc_nanos + 3_600 * SECOND_NANOS }
}

/// The local hour.
fn hour(utc_nanos: i64) -> i64 {
    civil(utc_nanos).div_euclid(3_600 * SECOND_NANOS)
}

/// 1 for a day of the weekend.
fn kind_of_day(day: i64) -> usize {
    usize::from((day + 3).rem_euclid(7) >= 5)
}

fn phasor(harmonic: usize, utc_nanos: i64) -> (f64, f64) {
    let turned = i128::from(civil(utc_nanos)) * (harmonic as i128 + 1) % i128::from(WEEK_NANOS);
    let (sin, cos) = (TAU * turned as f64 / WEEK_NANOS as f64).sin_cos();
    (cos, sin)
}

/// Time, weight and value of a reading.
pub(crate) type Reading = (i64, f64, bool);

/// Length of a bin.
const BIN_NANOS: i64 = 1_800 * SECOND_NANOS;

/// The bins of a cell before a cut: the mean time of each bin's scans, and the higher of two levels where the log odds
/// of the cell's readings add up to more than 0. `scans`: the times of all scans of the grid.
pub(crate) fn bins(scans: &[i64], odds: &[(i64, f64)], cut_nanos: i64, levels: (f64, f64)) -> Vec<Reading> {
    let mut times: BTreeMap<i64, Vec<i64>> = BTreeMap::new();
    for &time in scans.iter().filter(|time| **time < cut_nanos) {
        times.entry(time / BIN_NANOS).or_default().push(time);
    }
    let mut sums: BTreeMap<i64, f64> = BTreeMap::new();
    for (time, odds) in odds.iter().filter(|(time, _)| *time < cut_nanos) {
        *sums.entry(time / BIN_NANOS).or_default() += odds;
    }
    let of_bin = |(bin, odds): (i64, f64)| {
        let times = &times[&bin];
        let sum: i128 = times.iter().map(|time| i128::from(*time)).sum();
        let mean = i64::try_from(sum / times.len() as i128).expect("a time");
        // Sums of a few equal numbers may miss 0 by their rounding.
        let is_occupied = odds > 1e-6;
        (mean, if is_occupied { levels.1 } else { levels.0 }, is_occupied)
    };
    sums.into_iter().map(of_bin).collect()
}

/// A complex sum of each harmonic.
type Sums = [(f64, f64); HARMONICS];

/// The phasors of times, each computed once.
#[derive(Default)]
pub(crate) struct Phasors(BTreeMap<i64, Vec<(f64, f64)>>);

impl Phasors {
    pub(crate) fn add(&mut self, utc_nanos: i64) {
        let all = || (0..HARMONICS).map(|harmonic| phasor(harmonic, utc_nanos)).collect();
        self.0.entry(utc_nanos).or_insert_with(all);
    }
}

/// The learned model.
#[derive(Clone, Debug, Default)]
pub(crate) struct Naive {
    pub mean: f64,
    pub folded: u64,
    pub order: usize,
    /// The order with the lowest error.
    best: usize,
    pub errors: [f64; ORDERS],
    /// Harmonic and γ, strongest first.
    components: Vec<(usize, f64, f64)>,
    /// Whether two components are equally strong, so that another choice is equally valid.
    pub is_tied: bool,
    pub tau_secs: f64,
    pub last: Option<(i64, f64)>,
    /// Single hours with a reading, by hour of weekdays and of weekends.
    hours: [[f64; 24]; 2],
}

impl Naive {
    /// Learns bins, and remembers readings in the order of their arrival.
    pub(crate) fn new(readings: &[Reading], bins: &[Reading], phasors: &mut Phasors) -> Self {
        bins.iter().for_each(|(time, ..)| phasors.add(*time));
        let mut learned = Self { mean: 0.5, ..Self::default() };
        learned.persist(readings);
        let folded = bins;
        let (mut a, mut b, mut sum) = ([(0.0, 0.0); HARMONICS], [(0.0, 0.0); HARMONICS], 0.0);
        let mut day_before = None;
        // Until a cell has been read as both free and occupied, its mean is its prediction and nothing is scored.
        let mut seen = [false; 2];
        for of_day in folded.chunk_by(|one, next| civil(one.0) / DAY_NANOS == civil(next.0) / DAY_NANOS) {
            let day = civil(of_day[0].0) / DAY_NANOS;
            of_day.iter().for_each(|(.., is_occupied)| seen[usize::from(*is_occupied)] = true);
            let has_changed = seen == [true; 2];
            if let Some(before) = day_before.replace(day).filter(|_| has_changed) {
                learned.score(of_day, if day > before { 0.93 } else { 1.0 }, phasors);
            }
            for (time, value, _) in of_day {
                let row = &phasors.0[time];
                for harmonic in 0..HARMONICS {
                    let (cos, sin) = row[harmonic];
                    b[harmonic] = (b[harmonic].0 + cos, b[harmonic].1 - sin);
                    if *value != 0.0 {
                        a[harmonic] = (a[harmonic].0 + value * cos, a[harmonic].1 - value * sin);
                    }
                }
                sum += value;
            }
            learned.folded += of_day.len() as u64;
            for of_hour in of_day.chunk_by(|one, next| hour(one.0) == hour(next.0)) {
                let hour = hour(of_hour[0].0);
                learned.hours[kind_of_day(hour / 24)][hour as usize % 24] += 1.0;
            }
            learned.mean = sum / learned.folded as f64;
            if has_changed {
                learned.train([&a, &b], of_day[of_day.len() - 1].0 - folded[0].0);
                let hours: f64 = learned.hours.as_flattened().iter().sum();
                learned.order = learned.best.min((hours / 8.0 - 1.0).max(0.0) as usize);
            }
        }
        learned
    }

    fn persist(&mut self, readings: &[Reading]) {
        let (mut pairs, mut rates) = (0.0, 1.0 / 3600.0);
        for &(time, value, _) in readings {
            if let Some((last_time, last_value)) = self.last {
                if time <= last_time {
                    continue;
                }
                pairs += 1.0;
                rates += (value - last_value).abs() / ((time - last_time) as f64 / 1e9);
            }
            self.last = Some((time, value));
        }
        self.tau_secs = (1.0 + pairs) / rates;
    }

    fn score(&mut self, of_day: &[Reading], kept: f64, phasors: &Phasors) {
        self.errors = self.errors.map(|error| error * kept);
        for (time, value, _) in of_day {
            let row = &phasors.0[time];
            let mut p = self.mean;
            for order in 0..ORDERS {
                if let Some((harmonic, re, im)) = order.checked_sub(1).and_then(|at| self.components.get(at)) {
                    p += 2.0 * (re * row[*harmonic].0 - im * row[*harmonic].1);
                }
                self.errors[order] += (p.clamp(0.0, 1.0) - value).powi(2);
            }
        }
        let lowest = self.errors.iter().copied().fold(f64::INFINITY, f64::min);
        self.best = self.errors.iter().position(|&error| error <= lowest * 1.001).expect("one is the lowest");
    }

    fn train(&mut self, [a, b]: [&Sums; 2], span_nanos: i64) {
        let n = self.folded as f64;
        let eligible =
            |harmonic: &usize| i128::from(span_nanos) * 100 * (*harmonic as i128 + 1) >= i128::from(WEEK_NANOS) * 99;
        let gamma = |harmonic: usize| {
            let (a, b) = (a[harmonic], b[harmonic]);
            (harmonic, (a.0 - self.mean * b.0) / n, (a.1 - self.mean * b.1) / n)
        };
        let power = |&(_, re, im): &(usize, f64, f64)| re * re + im * im;
        let mut all: Vec<(usize, f64, f64)> = (0..HARMONICS).filter(eligible).map(gamma).collect();
        all.retain(|component| power(component) > 0.0);
        all.sort_by(|one, next| power(next).total_cmp(&power(one)));
        let ties = all.windows(2).take(ORDERS - 1);
        self.is_tied |= ties.into_iter().any(|pair| power(&pair[0]) - power(&pair[1]) < 1e-9 * power(&pair[0]));
        all.truncate(ORDERS - 1);
        self.components = all;
    }

    /// The probability with `order` components.
    pub(crate) fn probability(&self, order: usize, utc_nanos: i64) -> f64 {
        let mut p = self.mean;
        for &(harmonic, re, im) in self.components.iter().take(order) {
            let (cos, sin) = phasor(harmonic, utc_nanos);
            p += 2.0 * (re * cos - im * sin);
        }
        p.clamp(0.0, 1.0)
    }

    /// The default prediction: near the mean at hours that were hardly observed.
    pub(crate) fn answer(&self, utc_nanos: i64) -> f64 {
        let hour = hour(utc_nanos);
        let looks = self.counted_looks(kind_of_day(hour / 24), hour as usize % 24);
        // Rounds as the daemon stores it: in sixteenths of a doubling.
        let looks = ((((1.0 + 4.0 * looks).log2() * 16.0).min(254.0).floor() / 16.0).exp2() - 1.0) / 4.0;
        let kept =
            self.mean + looks * looks / (looks * looks + 0.25) * (self.probability(self.order, utc_nanos) - self.mean);
        let of_mean = 0.5 / (0.5 + looks);
        kept.max(self.mean * of_mean).min(1.0 - (1.0 - self.mean) * of_mean)
    }

    /// The number of bins of an hour, with the evidence from bins of nearby hours and of the other kind of day.
    fn counted_looks(&self, kind: usize, hour: usize) -> f64 {
        let mut counted = self.hours[kind][hour];
        for (other_kind, hours) in self.hours.iter().enumerate() {
            for (other, looks) in hours.iter().enumerate() {
                let apart = other.abs_diff(hour).min(24 - other.abs_diff(hour));
                let near = [1.0, 0.4, 0.18, 0.05].get(apart).copied().unwrap_or(0.0);
                let share = if other_kind == kind { near } else { near * 0.6 };
                if (other_kind, other) != (kind, hour) {
                    let share = f64::min(share * looks / (looks + 1.0), 0.95);
                    counted += share / (1.0 - share);
                }
            }
        }
        counted
    }

    /// The default prediction with the last reading blended in.
    pub(crate) fn persistent(&self, utc_nanos: i64) -> f64 {
        let p = self.answer(utc_nanos);
        match self.last {
            Some((time, value)) if utc_nanos >= time => {
                let weight = (-((utc_nanos - time) as f64 / 1e9) / self.tau_secs).exp();
                value * weight + p * (1.0 - weight)
            }
            _ => p,
        }
    }
}
