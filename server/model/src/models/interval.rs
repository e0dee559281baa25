//! Credible intervals of predictions.
//!
//! The interval of a moment is the band that contains the mean of the state over the hour around it with a given
//! probability. Single readings of a door are 0 or 1 and need no band. The share of the hour in which the door is open
//! differs from day to day, and this share matters for a plan. The hour's mean is assumed to follow a Beta distribution
//! whose mean is the prediction and whose variance is the recorded variance between days for this hour of the day. With
//! few days, both are shrunk towards all hours and towards the prior. Invariant: 0 ≤ lower ≤ p ≤ upper ≤ 1.

use super::HourSpread;

mod beta;
mod single;
mod values;

pub use beta::credible_interval;
pub use single::value_tail;
pub use values::{value_interval, value_interval_of};

#[cfg(test)]
mod tests;

/// A band of values in `[0,1]`, both ends included.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Interval {
    /// The lower end, at most the prediction.
    pub lower: f64,
    /// The upper end, at least the prediction.
    pub upper: f64,
}

impl Interval {
    /// Upper end minus lower end, in `[0,1]`.
    pub fn width(self) -> f64 {
        self.upper - self.lower
    }

    /// Whether a value lies in the band; never for NaN.
    pub fn contains(self, value: f64) -> bool {
        (self.lower..=self.upper).contains(&value)
    }
}

/// The means of one hour of the day on single days, as sums over days.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct HourMoments {
    /// Number of days on which the hour was observed; fractional with forgetting. 0 if it never was.
    pub days: f64,
    /// Sum of the hour's means on these days, each in `[0,1]`.
    pub sum: f64,
    /// Sum of the squares of these means.
    pub sum_of_squares: f64,
}

impl HourMoments {
    /// Adds the sums over the days of both.
    #[must_use]
    pub fn and(self, other: HourMoments) -> HourMoments {
        HourMoments {
            days: self.days + other.days,
            sum: self.sum + other.sum,
            sum_of_squares: self.sum_of_squares + other.sum_of_squares,
        }
    }

    /// Variance between the hour's means on these days, at least 0, finite; 0 with fewer than two days. It is valid for
    /// values of any kind.
    #[must_use]
    pub fn variance(self) -> f64 {
        if self.days.is_nan() || self.days <= 1.0 {
            return 0.0;
        }
        let variance = (self.sum_of_squares - self.sum * (self.sum / self.days)) / (self.days - 1.0);
        if variance.is_finite() { variance.max(0.0) } else { 0.0 }
    }

    /// These sums, limited to values that hourly means in `[0,1]` can have.
    fn plausible(self) -> HourMoments {
        let number = |found: f64, max: f64| if found > 0.0 { found.min(max) } else { 0.0 };
        let days = number(self.days, 1e12);
        let sum = number(self.sum, days);
        let least = if days > 0.0 { sum * sum / days } else { 0.0 };
        HourMoments { days, sum, sum_of_squares: number(self.sum_of_squares, sum).max(least) }
    }

    /// The variance between days as a share of the largest possible variance for the mean, in `[0,1]`, and its weight
    /// in days. The share is 1 if every hour is 0 or 1 as a whole, and 0 if all days are alike. An hour that is nearly
    /// always 0, or nearly always 1, has little weight.
    fn scatter(self) -> (f64, f64) {
        let HourMoments { days, sum, sum_of_squares } = self.plausible();
        if days <= 1.0 {
            return (0.0, 0.0);
        }
        let mean = sum / days;
        let variance = (sum_of_squares - sum * mean).max(0.0) / (days - 1.0);
        // m(1 - m) lacks the variance of the mean itself.
        let largest = mean * (1.0 - mean) + variance / days;
        if largest <= 0.0 {
            (0.0, 0.0)
        } else {
            ((variance / largest).min(1.0), (days - 1.0) * (4.0 * largest).min(1.0))
        }
    }
}

impl From<HourSpread> for HourMoments {
    fn from(spread: HourSpread) -> HourMoments {
        let HourSpread { days, mean, standard_deviation } = spread;
        let between = standard_deviation * standard_deviation * (days - 1.0).max(0.0);
        HourMoments { days, sum: days * mean, sum_of_squares: days * mean * mean + between }
    }
}
