//! The forward-backward algorithm over readings of a hidden two-state chain: its expected changes, and the errors of
//! the sensor.
//!
//! L. Rabiner, "A Tutorial on Hidden Markov Models", 1989, section III, with a transition that depends on the time
//! between two readings. Invariant: expected counts of a pair of readings add up to 1.

use super::{Bin, Rates};
use crate::models::markov_chain::likelihood::Transitions;

/// The error probabilities of a sensor of a state of two values.
#[derive(Clone, Copy, Debug, PartialEq, Default)]
pub struct SensorNoise {
    /// m, the probability to read 0 when the state is 1; a learned one is at most 0.45.
    pub miss: f64,
    /// f, the probability to read 1 when the state is 0; a learned one is at most 0.45.
    pub false_alarm: f64,
}

/// The highest probability of an error: with more, readings could not be distinguished from their opposite.
pub(super) const NOISE_MAX: f64 = 0.45;
/// The errors with which the search on the readings of a first day begins.
const BEGIN: f64 = 0.05;
/// The prior: this many errors …
const PRIOR_ERRORS: f64 = 0.5;
/// … in this many readings at each value.
const PRIOR_READINGS: f64 = 10.0;

impl SensorNoise {
    /// The errors with which a search begins.
    pub(super) fn begin() -> SensorNoise {
        SensorNoise { miss: BEGIN, false_alarm: BEGIN }
    }

    /// The probability of a reading if the state is 0, and if it is 1.
    pub(super) fn likelihoods(self, is_one: bool) -> [f64; 2] {
        if is_one { [self.false_alarm, 1.0 - self.miss] } else { [1.0 - self.false_alarm, self.miss] }
    }

    /// The probability to read 1, from that of being 1.
    pub(super) fn reading(self, probability: f64) -> f64 {
        self.false_alarm + (1.0 - self.miss - self.false_alarm) * probability
    }
}

/// Expected readings at the hidden values.
#[derive(Clone, Copy, Debug, PartialEq, Default)]
pub(super) struct ErrorSums {
    /// Readings while the state is 1.
    pub(super) ones: f64,
    /// Readings of 0 while the state is 1.
    pub(super) misses: f64,
    /// Readings while the state is 0.
    pub(super) zeros: f64,
    /// Readings of 1 while the state is 0.
    pub(super) false_alarms: f64,
}

impl ErrorSums {
    pub(super) fn merge(&mut self, other: &ErrorSums) {
        self.ones += other.ones;
        self.misses += other.misses;
        self.zeros += other.zeros;
        self.false_alarms += other.false_alarms;
    }

    pub(super) fn scale(&mut self, factor: f64) {
        for sum in [&mut self.ones, &mut self.misses, &mut self.zeros, &mut self.false_alarms] {
            *sum *= factor;
        }
    }

    /// The errors that these sums give.
    pub(super) fn noise(&self) -> SensorNoise {
        let share = |errors: f64, readings: f64| ((errors + PRIOR_ERRORS) / (readings + PRIOR_READINGS)).min(NOISE_MAX);
        SensorNoise { miss: share(self.misses, self.ones), false_alarm: share(self.false_alarms, self.zeros) }
    }
}

/// The expected counts of a pass over readings.
#[derive(Clone, Debug, Default)]
pub(super) struct Expected {
    pub(super) transitions: Transitions,
    pub(super) errors: ErrorSums,
    /// The probability of 1 at each reading.
    pub(super) ones: Vec<f64>,
}

/// The logarithm of the probability of the readings from index `from` on, given those before, in nats.
pub(super) fn log_likelihood(bins: &[Bin], from: usize, rates: Rates, noise: SensorNoise) -> f64 {
    let (mut one, mut last, mut sum) = (rates.share(), None, 0.0);
    for (at, &(nanos, is_one)) in bins.iter().enumerate() {
        if let Some(last) = last {
            one = rates.after(one, secs(last, nanos));
        }
        let [low, high] = noise.likelihoods(is_one);
        let [low, high] = [(1.0 - one) * low, one * high];
        // Rounding aside, noise-free readings never contradict what is possible.
        let total = (low + high).max(f64::MIN_POSITIVE);
        one = high / total;
        if at >= from {
            sum += libm::log(total);
        }
        last = Some(nanos);
    }
    sum
}

/// The expected hidden values, changes and errors of the sensor, given readings.
pub(super) fn expect(bins: &[Bin], rates: Rates, noise: SensorNoise) -> Expected {
    let share = rates.share();
    let mut ones = Vec::with_capacity(bins.len());
    // For each reading the sum by which its probabilities are divided to add up to 1, and e^(-(α+β)Δ) of the gap before
    // it.
    let mut scales = Vec::with_capacity(bins.len());
    let (mut one, mut last) = (share, None::<i64>);
    // Most readings come at equal gaps.
    let (mut gap_secs, mut kept) = (f64::INFINITY, 0.0);
    for &(nanos, is_one) in bins {
        let gap = last.map_or(f64::INFINITY, |last| secs(last, nanos));
        if gap != gap_secs {
            (gap_secs, kept) = (gap, libm::exp(-rates.sum() * gap));
        }
        one = share + (one - share) * kept;
        let [low, high] = noise.likelihoods(is_one);
        let total = ((1.0 - one) * low + one * high).max(f64::MIN_POSITIVE);
        one = one * high / total;
        ones.push(one);
        scales.push((total, kept));
        last = Some(nanos);
    }
    let mut expected = Expected::default();
    let mut after = [1.0, 1.0];
    for at in (0..bins.len()).rev() {
        let ((_, is_one), filtered) = (bins[at], ones[at]);
        let smoothed = filtered * after[1] / ((1.0 - filtered) * after[0] + filtered * after[1]).max(f64::MIN_POSITIVE);
        ones[at] = smoothed;
        expected.errors.ones += smoothed;
        expected.errors.zeros += 1.0 - smoothed;
        if is_one {
            expected.errors.false_alarms += 1.0 - smoothed;
        } else {
            expected.errors.misses += smoothed;
        }
        let Some(before) = at.checked_sub(1) else { break };
        let (total, kept) = scales[at];
        let (rise, fall) = (share * (1.0 - kept), (1.0 - share) * (1.0 - kept));
        let [low, high] = noise.likelihoods(is_one);
        let (low, high) = (low * after[0] / total, high * after[1] / total);
        let one = ones[before];
        let pairs =
            [(1.0 - one) * (1.0 - rise) * low, (1.0 - one) * rise * high, one * fall * low, one * (1.0 - fall) * high];
        let sum = pairs.iter().sum::<f64>().max(f64::MIN_POSITIVE);
        let gap_nanos = bins[at].0.abs_diff(bins[before].0);
        expected.transitions.add_by_octave(gap_nanos, pairs.map(|pair| pair / sum));
        after = [(1.0 - rise) * low + rise * high, fall * low + (1.0 - fall) * high];
    }
    expected.ones = ones;
    expected
}

fn secs(earlier_nanos: i64, later_nanos: i64) -> f64 {
    later_nanos.abs_diff(earlier_nanos) as f64 / 1e9
}
