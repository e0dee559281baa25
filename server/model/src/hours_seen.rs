//! The evidence for each hour of the day, in half-hour bins, and how the evidence limits the prediction of a model.
//!
//! The evidence of an hour is the number of its own observed bins, plus a share for nearby hours. The share depends on
//! the correlation of the two hours. Invariant: more bins never reduce the evidence of an hour, and no prediction is
//! exactly 0 or 1 unless the mean is.

use crate::{LocalDay, civil::NANOS_PER_SEC};

/// Hours of a day.
pub(crate) const HOURS: usize = 24;
/// One value for each hour of the day.
pub(crate) type Hours = [f64; HOURS];

const HOUR_NANOS: i64 = 3_600 * NANOS_PER_SEC;
/// The first weekday of the weekend; Monday is 0.
pub(crate) const SATURDAY: usize = 5;

/// The kind of day of a weekday, 0 for Monday: 1 for the weekend, else 0.
pub(crate) fn kind_of_day(weekday: usize) -> usize {
    usize::from(weekday >= SATURDAY)
}

/// The squared correlation of hours that are so many hours apart.
const NEAR: [f64; 4] = [1.0, 0.4, 0.18, 0.05];
/// The factor for the other kind of day: bins of weekdays are weaker evidence for weekends, and the reverse.
const OTHER_KIND: f64 = 0.6;
/// The greatest share of one hour's evidence that counts for another hour.
const SHARE_MAX: f64 = 0.95;
/// The number of bins with which a prediction keeps half of its model's distance from the mean.
const HALF_KEPT: f64 = 0.5;
/// The number of bins that the mean counts as, if a model is certain.
const MEAN_BINS: f64 = 0.5;
/// Steps of the stored numbers in a doubling of 1 + 4 bins.
const STEPS: f64 = 16.0;
/// The stored number of an hour that counts as known, whatever the number of bins.
const KNOWN: u8 = u8::MAX;

/// The equivalent number of bins by hour, of weekdays, then of weekends. `bins`: the number of observed bins in the
/// same order.
pub(crate) fn equivalent_bins(bins: &[Hours; 2]) -> [Hours; 2] {
    let mut equivalent = *bins;
    for (kind, hours) in equivalent.iter_mut().enumerate() {
        for (hour, known) in hours.iter_mut().enumerate() {
            for (other_kind, of_kind) in bins.iter().enumerate() {
                for (apart, &near) in NEAR.iter().enumerate() {
                    let share = if other_kind == kind { near } else { near * OTHER_KIND };
                    let mut add = |number: f64| {
                        // The evidence of so many bins for their own hour, times the correlation of that hour with this
                        // one.
                        let share = (share * number / (number + 1.0)).min(SHARE_MAX);
                        *known += share / (1.0 - share);
                    };
                    match apart {
                        0 if other_kind == kind => {}
                        0 => add(of_kind[hour]),
                        _ => {
                            add(of_kind[(hour + apart) % HOURS]);
                            add(of_kind[(hour + HOURS - apart) % HOURS]);
                        }
                    }
                }
            }
        }
    }
    equivalent
}

/// The weight of the members' prediction at an hour with so many equivalent bins; the smooth table has the rest.
pub(crate) fn evidence(equivalent_bins: f64) -> f64 {
    let square = equivalent_bins * equivalent_bins;
    square / (square + HALF_KEPT * HALF_KEPT)
}

/// The kind of day, 0 for weekdays and 1 for weekends, and the hour of a local civil time in nanoseconds since
/// 1970-01-01T00:00 local.
pub fn kind_and_hour(civil_nanos: i64) -> (usize, usize) {
    let kind = kind_of_day(LocalDay::of_civil_nanos(civil_nanos).weekday());
    // 0 to 23.
    (kind, civil_nanos.div_euclid(HOUR_NANOS).rem_euclid(HOURS as i64) as usize)
}

/// The equivalent number of bins of each hour of weekdays and of weekends, a byte each, to 5 %. By default every hour
/// is known.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct HoursSeen {
    steps: [[u8; HOURS]; 2],
}

impl Default for HoursSeen {
    fn default() -> HoursSeen {
        HoursSeen { steps: [[KNOWN; HOURS]; 2] }
    }
}

impl HoursSeen {
    /// Computes the evidence from the number of bins at each hour of weekdays, then of weekends.
    pub fn of_bins(bins: &[[f64; 24]; 2]) -> HoursSeen {
        let steps = |bins: f64| (STEPS * libm::log2(1.0 + 4.0 * bins.max(0.0))).min(f64::from(KNOWN - 1)) as u8;
        HoursSeen { steps: equivalent_bins(bins).map(|hours| hours.map(steps)) }
    }

    /// The effect of the evidence on predictions for a local civil time, in nanoseconds since 1970-01-01T00:00 local.
    pub fn at(&self, civil_nanos: i64) -> Evidence {
        let (kind, hour) = kind_and_hour(civil_nanos);
        let steps = self.steps[kind][hour];
        if steps == KNOWN {
            return Evidence::WHOLE;
        }
        let bins = (libm::exp2(f64::from(steps) / STEPS) - 1.0) / 4.0;
        Evidence { kept: evidence(bins), of_mean: MEAN_BINS / (MEAN_BINS + bins) }
    }

    /// The bytes to store: weekdays, then weekends.
    pub fn to_bytes(self) -> Vec<u8> {
        self.steps.as_flattened().to_vec()
    }

    /// Reads the evidence from stored bytes; `None` unless there are 48.
    pub fn from_bytes(bytes: &[u8]) -> Option<HoursSeen> {
        let (steps, rest) = bytes.as_chunks::<HOURS>();
        Some(HoursSeen { steps: steps.try_into().ok().filter(|_| rest.is_empty())? })
    }
}

/// The effect of the evidence at an hour on a model's prediction.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Evidence {
    /// The share that is kept of the prediction's distance from the mean.
    kept: f64,
    /// The share of the mean below which no prediction falls.
    of_mean: f64,
}

impl Evidence {
    /// Every prediction stays as it is.
    pub const WHOLE: Evidence = Evidence { kept: 1.0, of_mean: 0.0 };

    /// Whether every prediction stays as it is.
    pub fn is_whole(self) -> bool {
        self == Evidence::WHOLE
    }

    /// Returns the tempered prediction for a model's `answer`: the fewer the bins, the nearer it is to the `mean`. It
    /// is never nearer to 0 or 1 than the evidence allows. Both arguments are in `[0,1]`.
    #[inline]
    pub fn temper(self, mean: f64, answer: f64) -> f64 {
        let kept = mean + self.kept * (answer - mean);
        kept.max(mean * self.of_mean).min(1.0 - (1.0 - mean) * self.of_mean)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn bins_inform_about_hours_nearby_and_not_about_others() {
        let mut bins = [[0.0; HOURS]; 2];
        bins[0][12] = 30.0;
        let known = equivalent_bins(&bins);
        assert_eq!((known[0][12], known[0][20], known[1][3]), (30.0, 0.0, 0.0));
        assert!(known[0][11] > known[0][10] && known[0][10] > known[0][9] && known[0][9] > 0.0);
        assert_eq!(known[0][11], known[0][13]);
        assert!(known[1][12] > 0.5 && known[1][12] < known[0][12]);
        assert!(evidence(0.0) == 0.0 && evidence(0.5) == 0.5 && evidence(5.0) > 0.98);
    }

    #[test]
    fn predictions_are_drawn_to_the_mean_where_bins_are_few() {
        let mut bins = [[0.0; HOURS]; 2];
        bins[0][9] = 40.0;
        let seen = HoursSeen::of_bins(&bins);
        // 1970-01-01 was a Thursday.
        let at = |hour: i64| seen.at(hour * HOUR_NANOS);
        assert_eq!(at(20).temper(0.3, 1.0), 0.3, "no observation nearby");
        assert!((0.98..1.0).contains(&at(9).temper(0.3, 1.0)) && (1e-4..0.02).contains(&at(9).temper(0.3, 0.0)));
        assert!(at(10).temper(0.3, 1.0) < at(9).temper(0.3, 1.0));
        assert_eq!(at(9).temper(1.0, 1.0), 1.0);
        assert!(HoursSeen::default().at(0).is_whole() && Evidence::WHOLE.temper(0.3, 1.0) == 1.0);
        let known = equivalent_bins(&bins)[0][9];
        assert!((at(9).kept - evidence(known)).abs() < 1e-3);
        assert_eq!(HoursSeen::from_bytes(&seen.to_bytes()), Some(seen));
        assert_eq!((HoursSeen::from_bytes(&[0; 47]), HoursSeen::from_bytes(&[0; 49])), (None, None));
    }
}
