//! How much the hours of an edge differ, and so as how many reports the edge as a whole counts for an hour of its own.
//!
//! An edge that fails now and then at any time is not to be shunned at an hour at which it happened to fail; a door that is
//! shut at night is to be known as shut after few reports of the night. Which of the two an edge is, its reports tell: the
//! chance of each hour is drawn from a Beta distribution about the edge's own, and its strength is the one under which
//! the reports are likeliest (empirical Bayes with the beta-binomial distribution; B. Efron,
//! "Large-Scale Inference", 2010, chapter 1). Invariant: one of [`STRENGTHS`], the least where reports do not tell.

use libm::lgamma;
use tidemap_model::models::HourTable;

use super::{DAY_HOURS, PRIOR_REPORTS, WEEK_HOURS};

/// As how many reports an edge may count for an hour.
const STRENGTHS: [f64; 4] = [PRIOR_REPORTS, 8.0, 32.0, 128.0];

/// As how many reports an edge counts for one of its hours; `prior`: how likely edges of the map are passed, of
/// [`PRIOR_REPORTS`] reports' weight, above 0 and below 1.
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
        // Rounding does not make an edge steady.
        if likelihood > best.1 + 1e-6 || best.1 == f64::NEG_INFINITY {
            best = (strength, likelihood);
        }
    }
    best.0
}
