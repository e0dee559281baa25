//! The likelihood of a two-state chain seen at irregular times, and its maximum.
//!
//! Parameters are the sum λ = α + β and the share π = α/λ: for a given λ the logarithm of the likelihood is concave in
//! π, so that two nested searches in one dimension find the maximum. Invariant: nothing here is NaN.

use std::collections::BTreeMap;

use crate::StopSignal;

/// Gaps whose logarithms round to the same multiple of this are merged.
const LOG_GAP_STEP: f64 = 0.02;
/// The prior: this many rises and as many falls …
const PRIOR_CHANGES: f64 = 0.5;
/// … in this many seconds at each of the two values.
const PRIOR_SECS: f64 = 3600.0;
/// ln λ is searched in this range (λ from one change in 3,000 years to ten a nanosecond), first at this distance.
const LOG_RATES: (f64, f64) = (-25.0, 23.0);
const LOG_RATE_STEP: f64 = 0.5;
/// Fisher scoring: its steps, the longest of them, how often one is halved, and the gain that ends it.
const SCORINGS_MAX: usize = 40;
const SCORING_STEP_MAX: f64 = 2.0;
const SCORING_HALVINGS: usize = 12;
const SCORING_GAIN_MIN: f64 = 1e-9;

/// Counts of staying and changing over gaps of about the same length.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub(crate) struct GapCounts {
    pub(crate) weight: f64,
    pub(crate) gap_secs_sum: f64,
    /// Weight of pairs that stayed 0, rose, fell and stayed 1.
    pub(crate) low: f64,
    pub(crate) rises: f64,
    pub(crate) falls: f64,
    pub(crate) high: f64,
}

/// A log posterior at a point, its gradient and its Fisher information.
struct Slope {
    value: f64,
    gradient: [f64; 2],
    information: [[f64; 2]; 2],
}

/// Sufficient statistics of successive readings for the rates.
#[derive(Clone, Debug, Default, PartialEq)]
pub(crate) struct Transitions {
    pub(crate) by_gap: BTreeMap<i32, GapCounts>,
}

impl Transitions {
    /// Counts a pair of readings in `[0,1]`; a gap of 0 says nothing.
    pub(crate) fn add(&mut self, gap_nanos: u64, from: f64, to: f64, weight: f64) {
        if gap_nanos == 0 {
            return;
        }
        let gap_secs = gap_nanos as f64 / 1e9;
        let counts = self.by_gap.entry((gap_secs.ln() / LOG_GAP_STEP).round() as i32).or_default();
        counts.weight += weight;
        counts.gap_secs_sum += weight * gap_secs;
        counts.low += weight * (1.0 - from.max(to));
        counts.rises += weight * (to - from).max(0.0);
        counts.falls += weight * (from - to).max(0.0);
        counts.high += weight * from.min(to);
    }

    /// Counts a pair of readings with the probabilities that it stayed 0, rose, fell and stayed 1. Gaps of the same
    /// octave count as one, so that the memory is constant; a gap of 0 says nothing.
    pub(crate) fn add_by_octave(&mut self, gap_nanos: u64, [low, rise, fall, high]: [f64; 4]) {
        let Some(octave) = gap_nanos.checked_ilog2() else { return };
        let counts = self.by_gap.entry(octave as i32).or_default();
        counts.weight += 1.0;
        counts.gap_secs_sum += gap_nanos as f64 / 1e9;
        counts.low += low;
        counts.rises += rise;
        counts.falls += fall;
        counts.high += high;
    }

    /// Adds the counts of others, whose gaps are merged in the same way.
    pub(crate) fn merge(&mut self, other: &Transitions) {
        for (gap, more) in &other.by_gap {
            let counts = self.by_gap.entry(*gap).or_default();
            counts.weight += more.weight;
            counts.gap_secs_sum += more.gap_secs_sum;
            counts.low += more.low;
            counts.rises += more.rises;
            counts.falls += more.falls;
            counts.high += more.high;
        }
    }

    /// Forgetting: lowers the weight of all pairs so far.
    pub(crate) fn scale(&mut self, factor: f64) {
        for counts in self.by_gap.values_mut() {
            let GapCounts { weight, gap_secs_sum, low, rises, falls, high } = counts;
            [weight, gap_secs_sum, low, rises, falls, high].into_iter().for_each(|sum| *sum *= factor);
        }
    }

    /// Whether nothing was counted.
    pub(crate) fn is_empty(&self) -> bool {
        self.by_gap.is_empty()
    }

    /// The mean gap between two readings, in seconds; 0 without pairs.
    pub(crate) fn mean_gap_secs(&self) -> f64 {
        let [weight, secs] = self
            .by_gap
            .values()
            .fold([0.0; 2], |[weight, secs], counts| [weight + counts.weight, secs + counts.gap_secs_sum]);
        if weight > 0.0 { secs / weight } else { 0.0 }
    }

    /// (λ, π) of the highest posterior density near a pair that is about right, and its logarithm, by Fisher scoring in
    /// (ln λ, logit π): a few evaluations, where the search over all rates takes thousands.
    pub(crate) fn most_likely_near(&self, (rate, share): (f64, f64)) -> ((f64, f64), f64) {
        let mut at = [rate.ln().clamp(LOG_RATES.0, LOG_RATES.1), (share / (1.0 - share)).ln().clamp(-34.0, 34.0)];
        let mut slope = self.slope(at);
        for _ in 0..SCORINGS_MAX {
            let [[ll, ls], [_, ss]] = slope.information;
            let determinant = (ll * ss - ls * ls).max(f64::MIN_POSITIVE);
            let [by_rate, by_share] = slope.gradient;
            let mut step = [(ss * by_rate - ls * by_share) / determinant, (ll * by_share - ls * by_rate) / determinant];
            step.iter_mut().for_each(|step| *step = step.clamp(-SCORING_STEP_MAX, SCORING_STEP_MAX));
            let mut better = None;
            for _ in 0..SCORING_HALVINGS {
                let next = [(at[0] + step[0]).clamp(LOG_RATES.0, LOG_RATES.1), (at[1] + step[1]).clamp(-34.0, 34.0)];
                let there = self.slope(next);
                if there.value > slope.value {
                    better = Some((next, there));
                    break;
                }
                step.iter_mut().for_each(|step| *step *= 0.5);
            }
            let Some((next, there)) = better else { break };
            let gained = there.value - slope.value;
            (at, slope) = (next, there);
            if gained < SCORING_GAIN_MIN {
                break;
            }
        }
        ((at[0].exp(), logistic(at[1])), slope.value)
    }

    /// The log posterior at (ln λ, logit π), with its first derivatives and the expected second ones.
    fn slope(&self, [log_rate, logit]: [f64; 2]) -> Slope {
        let (rate, share) = (log_rate.exp(), logistic(logit));
        let other = logistic(-logit);
        let spread = share * other;
        let (prior, secs) = (2.0 * PRIOR_CHANGES, PRIOR_SECS * rate);
        let mut slope = Slope {
            value: PRIOR_CHANGES * spread.max(f64::MIN_POSITIVE).ln() + prior * log_rate - secs,
            gradient: [prior - secs, PRIOR_CHANGES * (other - share)],
            information: [[secs, 0.0], [0.0, prior * spread]],
        };
        for counts in self.by_gap.values() {
            let gaps = rate * counts.gap_secs_sum / counts.weight;
            let (mixed, by_rate) = (-(-gaps).exp_m1(), gaps * (-gaps).exp());
            // From 0 to 1, then from 1 to 0: changes, stays, and the derivatives of the probability of a change.
            let rise = (counts.rises, counts.low, share * mixed, [share * by_rate, spread * mixed]);
            let fall = (counts.falls, counts.high, other * mixed, [other * by_rate, -spread * mixed]);
            for (changes, stays, probability, [dl, ds]) in [rise, fall] {
                if changes + stays <= 0.0 {
                    continue;
                }
                let change = probability.max(f64::MIN_POSITIVE);
                let stay = (1.0 - probability).max(f64::EPSILON);
                slope.value += changes * change.ln() + stays * (-probability).ln_1p().max(-40.0);
                let score = changes / change - stays / stay;
                slope.gradient[0] += score * dl;
                slope.gradient[1] += score * ds;
                let weight = (changes + stays) / (change * stay);
                slope.information[0][0] += weight * dl * dl;
                slope.information[0][1] += weight * dl * ds;
                slope.information[1][1] += weight * ds * ds;
            }
        }
        slope
    }

    /// (λ, π) of the highest posterior density; not to be used if the signal is set.
    pub(crate) fn most_likely(&self, stop: StopSignal<'_>) -> (f64, f64) {
        let (from, to) = LOG_RATES;
        let steps = ((to - from) / LOG_RATE_STEP) as usize;
        let value = |log_rate: f64| self.profile(log_rate).0;
        let grid = (0..=steps).map(|step| from + step as f64 * LOG_RATE_STEP);
        let best = grid
            .take_while(|_| !stop.is_set())
            .map(|at| (value(at), at))
            .fold((f64::NEG_INFINITY, from), |best, next| if next.0 > best.0 { next } else { best });
        let at = golden_section(best.1 - LOG_RATE_STEP, best.1 + LOG_RATE_STEP, value);
        (at.exp(), self.profile(at).1)
    }

    /// For a sum of rates, the highest log posterior and the share that has it.
    fn profile(&self, log_rate: f64) -> (f64, f64) {
        let rate = log_rate.exp();
        // Per gap the probability 1 - e^(-λΔ) that the reading before is forgotten; exact where it is tiny.
        let gaps: Vec<(f64, GapCounts)> = self
            .by_gap
            .values()
            .map(|counts| (-(-rate * counts.gap_secs_sum / counts.weight).exp_m1(), *counts))
            .collect();
        // The slope in π falls from +∞ to -∞, since the prior has a half of either change.
        let slope = |share: f64| {
            let mut slope = PRIOR_CHANGES / share - PRIOR_CHANGES / (1.0 - share);
            for &(mixed, counts) in &gaps {
                slope += counts.rises / share - counts.falls / (1.0 - share);
                slope += counts.high * mixed / (1.0 - (1.0 - share) * mixed);
                slope -= counts.low * mixed / (1.0 - share * mixed);
            }
            slope
        };
        // In the logit, so that shares near 0 and 1 are found as precisely as others.
        let (mut low, mut high) = (-34.0, 34.0);
        for _ in 0..60 {
            let middle = 0.5 * (low + high);
            if slope(logistic(middle)) > 0.0 { low = middle } else { high = middle }
        }
        let share = logistic(0.5 * (low + high));
        // The Gamma densities of α and β, in π and λ.
        let mut value =
            PRIOR_CHANGES * (share * (1.0 - share)).ln() + 2.0 * PRIOR_CHANGES * log_rate - PRIOR_SECS * rate;
        for &(mixed, counts) in &gaps {
            // λ and Δ are positive, so this is 0 only by underflow, far from the maximum.
            let log_mixed = mixed.max(f64::MIN_POSITIVE).ln();
            value += counts.rises * (share.ln() + log_mixed) + counts.falls * ((1.0 - share).ln() + log_mixed);
            value += counts.low * (-share * mixed).ln_1p() + counts.high * (-(1.0 - share) * mixed).ln_1p();
        }
        (value, share)
    }
}

fn logistic(x: f64) -> f64 {
    1.0 / (1.0 + (-x).exp())
}

/// The position of the maximum of a unimodal function between two points, to 1e-7 of the distance.
fn golden_section(mut low: f64, mut high: f64, value: impl Fn(f64) -> f64) -> f64 {
    const RATIO: f64 = 0.618_033_988_749_894_9;
    let (mut left, mut right) = (high - RATIO * (high - low), low + RATIO * (high - low));
    let (mut at_left, mut at_right) = (value(left), value(right));
    for _ in 0..34 {
        if at_left >= at_right {
            (high, right, at_right) = (right, left, at_left);
            left = high - RATIO * (high - low);
            at_left = value(left);
        } else {
            (low, left, at_left) = (left, right, at_right);
            right = low + RATIO * (high - low);
            at_right = value(right);
        }
    }
    0.5 * (low + high)
}
