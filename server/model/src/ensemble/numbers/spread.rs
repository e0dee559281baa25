//! The squared distances of the hours of the next day from their predictions.
//!
//! Invariant: variances are finite and not negative.

use super::super::bins::{DayBins, SLOTS};
use crate::{
    LocalDay,
    hours_seen::{HOURS, kind_of_day},
};

/// The share of the sums that remains after each further observed day.
const KEPT: f64 = 0.985;
/// The variance of all half-hour bins counts as this many hours, beside all hours of the day.
const FIRST_HOURS: f64 = 24.0;
/// All hours together count as this many days, beside one hour.
const ALL_DAYS: f64 = 3.0;

/// Sum of squared errors, and their number.
pub(super) type Squares = [f64; 2];

/// Squared errors of the means of hours.
#[derive(Clone, Debug, PartialEq)]
pub(super) struct Spread {
    /// The sums of weekdays, then of the weekend, by hour.
    pub(super) hours: [[Squares; HOURS]; 2],
}

/// The hours of a day that have bins, with the squared error of the mean of these.
pub(super) fn hour_errors<'a>(
    bins: &'a DayBins,
    forecast: &'a [f64; SLOTS],
) -> impl Iterator<Item = (usize, f64)> + 'a {
    (0..HOURS).filter_map(|hour| {
        let error = |slot: usize| Some(bins.value(slot)? - forecast[slot]);
        let (first, second) = (error(2 * hour), error(2 * hour + 1));
        let error = first.zip(second).map(|(one, two)| 0.5 * (one + two)).or(first).or(second)?;
        Some((hour, error * error))
    })
}

/// The mean of squares, shrunk towards another mean that counts as `weight` squares. The two are combined as a
/// geometric mean, so that a first guess that is far too wide is soon forgotten.
pub(super) fn shrunk([sum, number]: Squares, towards: f64, weight: f64) -> f64 {
    let ratio = sum / number / towards;
    if ratio > 0.0 && ratio.is_finite() { towards * libm::pow(ratio, number / (number + weight)) } else { towards }
}

impl Spread {
    pub(super) const fn new() -> Spread {
        Spread { hours: [[[0.0; 2]; HOURS]; 2] }
    }

    /// Learns from a day that was predicted before.
    pub(super) fn learn(&mut self, day: LocalDay, bins: &DayBins, forecast: &[f64; SLOTS]) {
        self.hours.as_flattened_mut().as_flattened_mut().iter_mut().for_each(|number| *number *= KEPT);
        let of_kind = &mut self.hours[kind_of_day(day.weekday())];
        for (hour, square) in hour_errors(bins, forecast) {
            of_kind[hour][0] += square;
            of_kind[hour][1] += 1.0;
        }
    }

    /// The mean squared error over all hours. `of_bins`: the variance of all bins.
    pub(super) fn of_all(&self, of_bins: f64) -> f64 {
        let sum = |place: usize| self.hours.as_flattened().iter().map(|squares| squares[place]).sum::<f64>();
        shrunk([sum(0), sum(1)], of_bins, FIRST_HOURS)
    }

    /// The mean squared error at a half-hour of a day, widened because an estimate from few days is uncertain.
    pub(super) fn variance(&self, day: LocalDay, slot: usize, of_bins: f64) -> f64 {
        let squares = self.hours[kind_of_day(day.weekday())][slot / 2];
        shrunk(squares, self.of_all(of_bins), ALL_DAYS) * (1.0 + 1.0 / squares[1].max(1.0))
    }
}
