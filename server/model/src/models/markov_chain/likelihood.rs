//! The likelihood of a two-state chain that is observed at irregular times, and its maximum.
//!
//! Parameters are the sum λ = α + β and the share π = α/λ, searched in (ln λ, logit π) by Fisher scoring: steps are the
//! gradient divided by the expected second derivatives, halved as long as they do not increase the likelihood.
//! Invariant: nothing here is NaN.

use std::collections::BTreeMap;

use crate::StopSignal;

/// Gaps whose logarithms round to the same multiple of this are merged.
const LOG_GAP_STEP: f64 = 0.02;
/// The prior: this many rises and this many falls …
const PRIOR_CHANGES: f64 = 0.5;
/// … in this many seconds at each of the two values.
const PRIOR_SECS: f64 = 3600.0;
/// ln λ is in this range: from one change in 3,000 years to ten a nanosecond.
const LOG_RATES: (f64, f64) = (-25.0, 23.0);
/// The distance of the ln λ from which all rates are searched, since there may be more than one maximum.
const LOG_RATE_STEP: f64 = 3.0;
/// logit π is within this distance of 0.
const LOGIT_MAX: f64 = 34.0;
/// The limits of Fisher scoring: number of steps, longest step, number of halvings of a step, and the gain that ends
/// it.
const SCORINGS_MAX: usize = 40;
const SCORING_STEP_MAX: f64 = 2.0;
const SCORING_HALVINGS: usize = 12;
const SCORING_GAIN_MIN: f64 = 1e-12;

/// Counts of staying and changing over gaps of about the same length.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub(crate) struct GapCounts {
    pub(crate) weight: f64,
    pub(crate) gap_secs_sum: f64,
    /// Weights of pairs that stayed 0, rose, fell and stayed 1.
    pub(crate) low: f64,
    pub(crate) rises: f64,
    pub(crate) falls: f64,
    pub(crate) high: f64,
}

/// A log posterior at a point, its gradient and its Fisher information.
pub(super) struct Slope {
    pub(super) value: f64,
    gradient: [f64; 2],
    information: [[f64; 2]; 2],
}

/// Sufficient statistics of successive readings for the rates.
#[derive(Clone, Debug, Default, PartialEq)]
pub(crate) struct Transitions {
    pub(crate) by_gap: BTreeMap<i32, GapCounts>,
}

impl Transitions {
    /// Counts a pair of readings in `[0,1]`; a gap of 0 has no information.
    pub(crate) fn add(&mut self, gap_nanos: u64, from: f64, to: f64, weight: f64) {
        if gap_nanos == 0 {
            return;
        }
        let gap_secs = gap_nanos as f64 / 1e9;
        let counts = self.by_gap.entry((libm::log(gap_secs) / LOG_GAP_STEP).round() as i32).or_default();
        counts.weight += weight;
        counts.gap_secs_sum += weight * gap_secs;
        counts.low += weight * (1.0 - from.max(to));
        counts.rises += weight * (to - from).max(0.0);
        counts.falls += weight * (from - to).max(0.0);
        counts.high += weight * from.min(to);
    }

    /// Counts a pair of readings with the probabilities that it stayed 0, rose, fell and stayed 1. Gaps of the same
    /// octave count as one, so that the memory is constant; a gap of 0 has no information.
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

    /// Adds the counts of `other`, whose gaps are merged in the same way.
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

    /// Lowers the weight of all pairs so far (forgetting).
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

    /// (λ, π) of the highest posterior density; not to be used if the signal is set.
    pub(crate) fn most_likely(&self, stop: StopSignal<'_>) -> (f64, f64) {
        let (from, to) = LOG_RATES;
        let starts = (0..).map(|step| from + f64::from(step) * LOG_RATE_STEP).take_while(|&start| start <= to);
        let found = starts.take_while(|_| !stop.is_set()).map(|start| self.climb([start, 0.0]));
        let best = found.max_by(|(_, one), (_, other)| one.total_cmp(other));
        best.map_or((1.0, 0.5), |(pair, _)| pair)
    }

    /// (λ, π) of the highest posterior density near a pair that is approximately right.
    pub(crate) fn most_likely_near(&self, (rate, share): (f64, f64)) -> (f64, f64) {
        self.climb([libm::log(rate), libm::log(share / (1.0 - share))]).0
    }

    /// (λ, π) of a maximum of the posterior density, with its logarithm. `from`: ln λ and logit π.
    fn climb(&self, from: [f64; 2]) -> ((f64, f64), f64) {
        let mut at = [from[0].clamp(LOG_RATES.0, LOG_RATES.1), from[1].clamp(-LOGIT_MAX, LOGIT_MAX)];
        let mut slope = self.slope(at);
        for _ in 0..SCORINGS_MAX {
            let [[ll, ls], [_, ss]] = slope.information;
            let determinant = (ll * ss - ls * ls).max(f64::MIN_POSITIVE);
            let [by_rate, by_share] = slope.gradient;
            let mut step = [(ss * by_rate - ls * by_share) / determinant, (ll * by_share - ls * by_rate) / determinant];
            step.iter_mut().for_each(|step| *step = step.clamp(-SCORING_STEP_MAX, SCORING_STEP_MAX));
            let mut better = None;
            for _ in 0..SCORING_HALVINGS {
                let next =
                    [(at[0] + step[0]).clamp(LOG_RATES.0, LOG_RATES.1), (at[1] + step[1]).clamp(-LOGIT_MAX, LOGIT_MAX)];
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
        ((libm::exp(at[0]), logistic(at[1])), slope.value)
    }

    /// The log posterior at (ln λ, logit π), with its first derivatives and the expected second ones.
    pub(super) fn slope(&self, [log_rate, logit]: [f64; 2]) -> Slope {
        let (rate, share) = (libm::exp(log_rate), logistic(logit));
        let other = logistic(-logit);
        let spread = share * other;
        let (prior, secs) = (2.0 * PRIOR_CHANGES, PRIOR_SECS * rate);
        let mut slope = Slope {
            value: PRIOR_CHANGES * libm::log(spread.max(f64::MIN_POSITIVE)) + prior * log_rate - secs,
            gradient: [prior - secs, PRIOR_CHANGES * (other - share)],
            information: [[secs, 0.0], [0.0, prior * spread]],
        };
        for counts in self.by_gap.values() {
            let gaps = rate * counts.gap_secs_sum / counts.weight;
            let (mixed, by_rate) = (-libm::expm1(-gaps), gaps * libm::exp(-gaps));
            // The first is from 0 to 1, the second from 1 to 0: changes, stays, and the derivatives of the probability
            // of a change.
            let rise = (counts.rises, counts.low, share * mixed, [share * by_rate, spread * mixed]);
            let fall = (counts.falls, counts.high, other * mixed, [other * by_rate, -spread * mixed]);
            for (changes, stays, probability, [dl, ds]) in [rise, fall] {
                if changes + stays <= 0.0 {
                    continue;
                }
                let change = probability.max(f64::MIN_POSITIVE);
                let stay = (1.0 - probability).max(f64::EPSILON);
                slope.value += changes * libm::log(change) + stays * libm::log1p(-probability).max(-40.0);
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
}

fn logistic(x: f64) -> f64 {
    1.0 / (1.0 + libm::exp(-x))
}
