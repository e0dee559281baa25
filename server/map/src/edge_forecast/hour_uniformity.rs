//! How uniform the hours of an edge are, as the number of reports that the edge as a whole counts for one hour.
//!
//! An edge that fails now and then, at any time, must not be avoided at an hour at which it happened to fail. A door
//! that is shut at night must be known as shut after few reports of the night. The reports decide between the two
//! cases: the success of each hour is drawn from a Beta distribution about the edge's own success, and the strength of
//! the distribution is the strength with the highest likelihood (empirical Bayes with the beta-binomial distribution;
//! B. Efron, "Large-Scale Inference", 2010, chapter 1).
//!
//! Invariant: the result is one of [`STRENGTHS`]. It is the lowest if the reports do not decide.

use libm::lgamma;
use tidemap_model::models::HourTable;

use super::{DAY_HOURS, PRIOR_REPORTS, WEEK_HOURS};

/// The candidate weights, in reports.
const STRENGTHS: [f64; 4] = [PRIOR_REPORTS, 8.0, 32.0, 128.0];

/// Weight, in reports, of an edge as the prior of one of its hours. `prior`: the success probability of the map's
/// edges, above 0 and below 1, with the weight of [`PRIOR_REPORTS`] reports.
pub(super) fn hour_uniformity(table: &HourTable, prior: f64) -> f64 {
    // Hours of weekdays, then of the weekend.
    let mut hours = [[0.0_f64; 2]; 2 * DAY_HOURS];
    for hour in 0..WEEK_HOURS {
        let [count, passed] = table.readings(hour);
        let is_weekend = hour / DAY_HOURS >= 5;
        let sums = &mut hours[hour % DAY_HOURS + if is_weekend { DAY_HOURS } else { 0 }];
        sums[0] += count;
        sums[1] += passed;
    }
    let [tried, passed] = hours.iter().fold([0.0, 0.0], |sums, hour| [sums[0] + hour[0], sums[1] + hour[1]]);
    let mean = (passed + PRIOR_REPORTS * prior) / (tried + PRIOR_REPORTS);
    let mut best = (STRENGTHS[0], f64::NEG_INFINITY);
    for strength in STRENGTHS {
        let [a, b] = [strength * mean, strength * (1.0 - mean)];
        let before = lgamma(strength) - lgamma(a) - lgamma(b);
        let of_hour = |&[tried, passed]: &[f64; 2]| {
            let failed = (tried - passed).max(0.0);
            before + lgamma(a + passed) + lgamma(b + failed) - lgamma(strength + tried)
        };
        let likelihood: f64 = hours.iter().filter(|hour| hour[0] > 0.0).map(of_hour).sum();
        // Rounding must not make an edge uniform.
        if likelihood > best.1 + 1e-6 || best.1 == f64::NEG_INFINITY {
            best = (strength, likelihood);
        }
    }
    best.0
}
