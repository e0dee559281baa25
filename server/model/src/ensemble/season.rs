//! The rhythm of the year of a state, and its values in the same season of earlier years.
//!
//! The half-hour bins of five days are averaged to one five-day mean. A rhythm of up to three harmonics of the year is
//! fitted by least squares as soon as the record spans a year; each order is weighted by how well it explains the
//! means, counted as independent ones, and its amplitude is lowered by the amplitude that noise would have. So on noise
//! the rhythm is the mean. The values of the same days of earlier years are used beside it, and keep sharp edges. Where
//! the map names the year as a period, a record of nine tenths of a year is enough, and one harmonic needs no evidence,
//! but its amplitude is lowered all the same. Invariant: predictions lie strictly between 0 and 1.

use nalgebra::{Cholesky, DMatrix, DVector};

use super::stack::clip;
use crate::LocalDay;
use crate::special::square;

/// Number of days in one mean.
const BIN_DAYS: i64 = 5;
/// Maximum number of means: four years.
const FIVE_DAYS_MAX: usize = 293;
const YEAR_DAYS: f64 = 365.25;
/// Maximum number of harmonics of the year.
const ORDERS: usize = 3;
/// A record, extended by one of its usual gaps, must span this share of a year.
const YEAR_SEEN: f64 = 0.99;
/// The share of a year that a record must span where the map names the year as a period.
const EXPECTED_YEAR_SEEN: f64 = 0.9;
/// The mean squared error of an order counts as larger by this.
const ERROR_MIN: f64 = 0.02;
/// The log evidence that each further harmonic must gain, per log of the number of independent means.
const COST: f64 = 1.5;
/// The log evidence that a rhythm of any order must gain in addition.
const COST_OF_ANY: f64 = 0.7;
const RIDGE: f64 = 0.3;
/// With fewer means the rhythm is fitted every day, else with each new mean.
const OFTEN_SOLVED: usize = 40;
/// Means less than this many days apart are neighbours.
const ADJACENT_DAYS: f64 = 7.5;
/// The rhythm counts as this many bins, beside the bins of the same days of earlier years.
const RHYTHM_BINS: f64 = 4.0;
/// The weight of the five days before and of the five days after.
const BESIDE: f64 = 0.25;
/// Number of earlier years that are used.
const YEARS: i64 = 4;

/// The half-hour bins of five days.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub(super) struct FiveDays {
    /// The first observed day.
    pub(super) day: i32,
    pub(super) mean: f32,
    pub(super) bins: f32,
}

impl FiveDays {
    fn number(self) -> i64 {
        i64::from(self.day).div_euclid(BIN_DAYS)
    }
}

/// Means of five days each, and the rhythm of the year that follows from them.
#[derive(Clone, Debug)]
pub(super) struct Season {
    pub(super) five_days: Vec<FiveDays>,
    pub(super) first: Option<LocalDay>,
    pub(super) last: Option<LocalDay>,
    /// Number of gaps between observed days in each class; see [`GAPS`].
    pub(super) gaps: [u32; GAPS.len()],
    pub(super) rhythm: Rhythm,
    /// The map names the year as a period. This field is not stored; each update sets it before it learns.
    pub(super) is_expected: bool,
}

/// The longest gap of each class, in days. Longer gaps count in the last class: a record does not span a hole of
/// months.
pub(super) const GAPS: [i64; 5] = [1, 2, 7, 15, 31];

/// A rhythm of the year.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(super) struct Rhythm {
    pub(super) mean: f64,
    /// Amplitudes of cosine and sine by harmonic, averaged over the orders.
    pub(super) waves: [[f64; 2]; ORDERS],
}

/// The rhythm of one order, fitted to the means.
struct Solved {
    order: usize,
    independent: f64,
    squared_error: f64,
    coefficients: Vec<f64>,
    shrunk: f64,
}

fn phases(day: f64) -> [[f64; 2]; ORDERS] {
    [1.0, 2.0, 3.0].map(|harmonic| {
        let angle = std::f64::consts::TAU * harmonic * day / YEAR_DAYS;
        [libm::cos(angle), libm::sin(angle)]
    })
}

impl Rhythm {
    pub(super) const UNKNOWN: Rhythm = Rhythm { mean: 0.5, waves: [[0.0; 2]; ORDERS] };

    /// Whether the value differs between the days of a year.
    pub(super) fn is_known(&self) -> bool {
        self.waves != [[0.0; 2]; ORDERS]
    }

    /// The value on a day, for all hours.
    pub(super) fn at(&self, day: LocalDay) -> f64 {
        if !self.is_known() {
            return clip(self.mean);
        }
        let waves = phases(f64::from(day.0));
        let swing: f64 =
            self.waves.iter().flatten().zip(waves.iter().flatten()).map(|(wave, phase)| wave * phase).sum();
        clip(self.mean + swing)
    }
}

/// Compares what is stored.
impl PartialEq for Season {
    fn eq(&self, other: &Season) -> bool {
        let stored = |one: &Season| (one.first, one.last, one.gaps, one.rhythm);
        stored(self) == stored(other) && self.five_days == other.five_days
    }
}

impl Season {
    pub(super) const fn new() -> Season {
        Season {
            five_days: Vec::new(),
            first: None,
            last: None,
            gaps: [0; GAPS.len()],
            rhythm: Rhythm::UNKNOWN,
            is_expected: false,
        }
    }

    /// Learns the half-hour bins of a day: their sum and number, above 0.
    pub(super) fn learn(&mut self, day: LocalDay, sum: f64, bins: f64) {
        let number = i64::from(day.0).div_euclid(BIN_DAYS);
        let place = self.five_days.partition_point(|days| days.number() < number);
        let five_days = self.five_days.len();
        match self.five_days.get_mut(place).filter(|days| days.number() == number) {
            Some(days) => {
                let (before, all) = (f64::from(days.bins), f64::from(days.bins) + bins);
                days.mean = ((f64::from(days.mean) * before + sum) / all) as f32;
                days.bins = all as f32;
            }
            None => {
                self.five_days.insert(place, FiveDays { day: day.0, mean: (sum / bins) as f32, bins: bins as f32 });
                if self.five_days.len() > FIVE_DAYS_MAX {
                    self.five_days.remove(0);
                }
            }
        }
        if let Some(last) = self.last.filter(|&last| day > last) {
            let gap = i64::from(day.0) - i64::from(last.0);
            let class = GAPS.iter().position(|&longest| gap <= longest).unwrap_or(GAPS.len() - 1);
            self.gaps[class] = self.gaps[class].saturating_add(1);
        }
        self.first = Some(self.first.map_or(day, |first| first.min(day)));
        self.last = Some(self.last.map_or(day, |last| last.max(day)));
        // A year has too many means to fit the rhythm again every day.
        if self.five_days.len() != five_days || self.five_days.len() < OFTEN_SOLVED {
            self.rhythm = self.solve();
        }
    }

    /// About the median number of days from an observed day to the next.
    fn usual_gap(&self) -> f64 {
        let all: u32 = self.gaps.iter().sum();
        let mut so_far = 0;
        for (&longest, &number) in GAPS.iter().zip(&self.gaps) {
            so_far += number;
            if 2 * so_far > all {
                return longest as f64;
            }
        }
        0.0
    }

    fn solve(&self) -> Rhythm {
        let bins: f64 = self.five_days.iter().map(|days| f64::from(days.bins)).sum();
        let sum: f64 = self.five_days.iter().map(|days| f64::from(days.bins) * f64::from(days.mean)).sum();
        let mean = (sum + 0.5) / (bins + 1.0);
        let flat = Rhythm { mean, waves: [[0.0; 2]; ORDERS] };
        let span = self.first.zip(self.last).map_or(0.0, |(first, last)| f64::from(last.0) - f64::from(first.0));
        let year_seen = if self.is_expected { EXPECTED_YEAR_SEEN } else { YEAR_SEEN };
        if self.five_days.len() < 6 || span + self.usual_gap() < year_seen * YEAR_DAYS {
            return flat;
        }
        let number = self.five_days.len() as f64;
        let values: Vec<f64> = self.five_days.iter().map(|days| f64::from(days.mean)).collect();
        let centre = values.iter().sum::<f64>() / number;
        let flat_error: f64 = values.iter().map(|value| square(value - centre)).sum();
        let solved: Vec<Solved> =
            (1..=ORDERS).filter_map(|order| self.solve_order(order, &values, flat_error)).collect();
        let Some(independent) = solved.iter().map(|solved| solved.independent).reduce(f64::min) else { return flat };
        let evidence = |order: usize, error: f64| {
            let (costly, of_any) = match self.is_expected {
                true => (order.saturating_sub(1), 0.0),
                false => (order, if order > 0 { COST_OF_ANY } else { 0.0 }),
            };
            let cost = COST * costly as f64 * libm::log(independent.max(2.0)) + of_any;
            -0.5 * independent * libm::log(error / number + ERROR_MIN) - cost
        };
        let of_flat = evidence(0, flat_error);
        let highest = solved.iter().map(|one| evidence(one.order, one.squared_error)).fold(of_flat, f64::max);
        let (mut all, mut rhythm) = (libm::exp(of_flat - highest), Rhythm { mean: 0.0, ..flat });
        rhythm.mean = all * mean;
        for one in &solved {
            let share = libm::exp(evidence(one.order, one.squared_error) - highest);
            all += share;
            let Some((&constant, waves)) = one.coefficients.split_first().filter(|_| one.shrunk > 0.0) else {
                rhythm.mean += share * mean;
                continue;
            };
            rhythm.mean += share * constant;
            for (wave, coefficient) in rhythm.waves.as_flattened_mut().iter_mut().zip(waves) {
                *wave += share * one.shrunk * coefficient;
            }
        }
        rhythm.mean /= all;
        rhythm.waves.as_flattened_mut().iter_mut().for_each(|wave| *wave /= all);
        rhythm
    }

    fn solve_order(&self, order: usize, values: &[f64], flat_error: f64) -> Option<Solved> {
        let (number, width) = (values.len(), 2 * order + 1);
        if number < 3 * width {
            return None;
        }
        let basis = DMatrix::from_fn(number, width, |row, column| {
            let day = self.five_days.get(row).map_or(0.0, |days| f64::from(days.day));
            if column == 0 { 1.0 } else { phases(day)[(column - 1) / 2][(column - 1) % 2] }
        });
        let values = DVector::from_column_slice(values);
        let mut squares = basis.tr_mul(&basis);
        for at in 0..width {
            squares[(at, at)] += if at == 0 { 1e-6 } else { RIDGE };
        }
        let coefficients = Cholesky::new(squares)?.solve(&basis.tr_mul(&values));
        let errors = values - basis * &coefficients;
        let squared_error = errors.norm_squared();
        let adjacent: Vec<f64> = (1..number)
            .filter(|&at| {
                let days =
                    self.five_days.get(at).zip(self.five_days.get(at - 1)).map(|(days, before)| days.day - before.day);
                days.is_some_and(|days| f64::from(days) < ADJACENT_DAYS)
            })
            .map(|at| errors[at] * errors[at - 1])
            .collect();
        let dependence =
            if adjacent.len() > 3 { (adjacent.iter().sum::<f64>() / squared_error.max(1e-9)).max(0.0) } else { 0.0 };
        let independent = (number as f64 * (1.0 - dependence) / (1.0 + dependence)).max(4.0);
        // The variation that the same number of waves would explain in noise, and the variation that the waves explain.
        let (waves, number) = (2.0 * order as f64, number as f64);
        let noise = waves * squared_error / (independent - waves - 1.0).max(1.0);
        let explained = ((flat_error - squared_error) * independent / number).max(1e-9);
        let coefficients = coefficients.iter().copied().collect();
        Some(Solved { order, independent, squared_error, coefficients, shrunk: (1.0 - noise / explained).max(0.0) })
    }

    /// The mean of the state on the same days of earlier years, shrunk towards the value of `rhythm` on the day.
    pub(super) fn years_ago(&self, day: LocalDay, rhythm: &Rhythm) -> f64 {
        let (mut sum, mut number) = (RHYTHM_BINS * rhythm.at(day), RHYTHM_BINS);
        for years in 1..=YEARS {
            let then = (f64::from(day.0) - years as f64 * YEAR_DAYS) / BIN_DAYS as f64;
            let middle = then.floor() as i64;
            for (at, share) in [(middle - 1, BESIDE), (middle, 1.0), (middle + 1, BESIDE)] {
                let place = self.five_days.partition_point(|known| known.number() < at);
                if let Some(known) = self.five_days.get(place).filter(|known| known.number() == at) {
                    sum += share * f64::from(known.bins) * f64::from(known.mean);
                    number += share * f64::from(known.bins);
                }
            }
        }
        clip(sum / number)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn season(days: std::ops::Range<i32>, every: usize, value: impl Fn(i32) -> f64) -> Season {
        let mut season = Season::new();
        days.step_by(every).for_each(|day| season.learn(LocalDay(day), value(day), 1.0));
        season
    }

    #[test]
    fn a_long_season_is_known_after_a_year_and_not_before() {
        let open = |day: i32| f64::from(u8::from(day.rem_euclid(365) < 182));
        let short = season(0..200, 1, open);
        assert_eq!(short.rhythm.waves, [[0.0; 2]; ORDERS]);
        let long = season(0..700, 1, open);
        let wrong = (700..1065).filter(|&day| (long.rhythm.at(LocalDay(day)) - open(day)).abs() > 0.5).count();
        assert!(wrong < 20, "{wrong} days of the rhythm");
        let wrong = |day: &i32| (long.years_ago(LocalDay(*day), &long.rhythm) - open(*day)).abs() > 0.5;
        assert!((700..1065).filter(wrong).count() < 6);
    }

    #[test]
    fn a_year_that_is_named_needs_fewer_bins() {
        // The season has eleven monthly bins; the bins of the winter differ.
        let swing = |is_expected: bool| {
            let mut season = Season { is_expected, ..Season::new() };
            (0..11).for_each(|month| season.learn(LocalDay(30 * month), f64::from(u8::from(month < 4)), 1.0));
            season.rhythm.at(LocalDay(45 + 365)) - season.rhythm.at(LocalDay(230 + 365))
        };
        assert!(swing(true) > 0.5 && swing(false) == 0.0, "{} {}", swing(true), swing(false));
        // A rhythm fitted to values without a yearly rhythm stays nearly flat.
        let mut season = Season { is_expected: true, ..Season::new() };
        (0..11).for_each(|month| season.learn(LocalDay(30 * month), f64::from(u8::from(month % 3 == 0)), 1.0));
        assert!(season.rhythm.waves.as_flattened().iter().all(|wave| wave.abs() < 0.05), "{:?}", season.rhythm);
    }

    #[test]
    fn noise_has_no_season() {
        // A fixed sequence without a rhythm of a year.
        let noise = |day: i32| f64::from(u8::from((day.wrapping_mul(2_654_435_761_u32 as i32) as u32) >> 16 & 7 < 2));
        let season = season(0..800, 1, noise);
        let swing =
            (0..365).map(|day| (season.rhythm.at(LocalDay(day)) - season.rhythm.mean).abs()).fold(0.0, f64::max);
        assert!(swing < 0.03, "{swing}");
    }

    #[test]
    fn means_are_bounded_and_late_days_join_theirs() {
        let mut long = season(0..3000, 1, |_| 1.0);
        assert_eq!(long.five_days.len(), FIVE_DAYS_MAX);
        let five_days = long.five_days.len();
        long.learn(LocalDay(2500), 0.0, 2.0);
        assert_eq!(long.five_days.len(), five_days);
        assert!(long.five_days.is_sorted_by_key(|days| days.day));
    }
}
