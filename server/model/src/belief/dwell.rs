//! The time for which a state keeps a value: a density of completed dwells, and the probability that a dwell lasts
//! longer.
//!
//! The density is a kernel estimate in the logarithm of time over completed dwells, with the kernel width that predicts
//! each dwell best from the others, plus an exponential with the mean of the dwells and the weight of one dwell.
//! Invariant: a survival falls from 1 towards 0 with age, and never reaches 0.

use std::sync::Arc;

use super::{Rates, SensorNoise, noise::Expected};
use crate::special::square;
use crate::{belief::Bin, special::normal_tail};

/// Maximum number of completed dwells that are kept at each value; if there are more, every second one is forgotten.
pub(super) const DWELLS_MAX: usize = 48;
/// With fewer dwells at a value, the state counts as a chain with constant rates.
pub(super) const DWELLS_MIN: u32 = 8;
/// The kernel widths to choose from, in ln(time).
const WIDTHS: [f64; 4] = [0.05, 0.12, 0.3, 0.8];
/// Number of ages at which a survival is stored.
const NODES: usize = 128;
/// The stored ages reach this many kernel widths beyond the dwells.
const MARGIN: f64 = 3.0;
/// Dwells are used only where the mean gap between readings is at most this share of the chain's 1/(α+β).
const GAP_SHARE_MAX: f64 = 0.5;
/// After a gap longer than this many mean gaps and than this many seconds, the value may have changed and changed back.
const BREAK_GAPS: f64 = 8.0;
const BREAK_SECS: f64 = 600.0;
/// A survival is computed again when the number of its dwells has grown by one in this many, or by [`DWELLS_MAX`].
const FRESH_SHARE: u32 = 8;

/// A dwell that has not ended.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub(super) struct UnendedDwell {
    pub(super) is_one: bool,
    /// The time at which it began, UTC nanoseconds, and the uncertainty of this time, in seconds; `None`: before the
    /// first reading.
    pub(super) since: Option<(i64, f64)>,
    /// The time of its newest reading, UTC nanoseconds.
    pub(super) last_nanos: i64,
}

/// Completed dwells at one value.
#[derive(Clone, Debug, Default, PartialEq)]
pub(super) struct OfValue {
    /// The lengths in seconds from which the survival is computed, in order of time.
    pub(super) secs: Vec<f32>,
    /// The number of dwells of which these lengths are a selection.
    pub(super) count: u32,
    /// The lengths of the dwells that have ended since then.
    pub(super) fresh: Vec<f32>,
}

impl OfValue {
    /// Selects from the fresh dwells: of the first 48 each is kept, then every second, fourth, and so on, evenly over
    /// time.
    fn take_fresh(&mut self) {
        for secs in std::mem::take(&mut self.fresh) {
            let mut stride = self.stride();
            if self.count.is_multiple_of(stride) {
                if self.secs.len() == DWELLS_MAX {
                    let mut keep = false;
                    self.secs.retain(|_| {
                        keep = !keep;
                        keep
                    });
                    stride *= 2;
                }
                if self.count.is_multiple_of(stride) {
                    self.secs.push(secs);
                }
            }
            self.count = self.count.saturating_add(1);
        }
    }

    fn stride(&self) -> u32 {
        let mut stride: u32 = 1;
        while u64::from(stride) * (DWELLS_MAX as u64) < u64::from(self.count) {
            stride *= 2;
        }
        stride
    }

    fn is_stale(&self) -> bool {
        let share = self.count.min(DWELLS_MAX as u32 * FRESH_SHARE) / FRESH_SHARE;
        self.fresh.len() as u64 >= u64::from(share.max(1))
    }
}

/// The dwells of a state at 0 and at 1.
#[derive(Clone, Debug, Default, PartialEq)]
pub(super) struct Dwells {
    pub(super) of_value: [OfValue; 2],
    pub(super) open: Option<UnendedDwell>,
    survivals: Option<Arc<[Survival; 2]>>,
}

impl Dwells {
    /// A copy without the data that only learning needs.
    pub(super) fn published(&self) -> Dwells {
        let of_value = |lengths: &OfValue| OfValue { fresh: Vec::new(), ..lengths.clone() };
        Dwells { of_value: self.of_value.each_ref().map(of_value), open: None, survivals: self.survivals.clone() }
    }

    /// The survivals of 0 and 1, where enough dwells were completed at both.
    pub(super) fn survivals(&self) -> Option<&[Survival; 2]> {
        self.survivals.as_deref()
    }

    /// Whether dwells are known, with readings at this mean gap.
    pub(super) fn are_known(&self, rates: Rates, mean_gap_secs: f64) -> bool {
        self.survivals.is_some() && mean_gap_secs * rates.sum() <= GAP_SHARE_MAX
    }

    /// Learns the dwells of a day from the readings and the probability of 1 at each.
    pub(super) fn learn(&mut self, bins: &[Bin], expected: &Expected, mean_gap_secs: f64) {
        let longest = (BREAK_GAPS * mean_gap_secs).max(BREAK_SECS);
        for (&(nanos, _), &one) in bins.iter().zip(&expected.ones) {
            let is_one = one > 0.5;
            let begins = UnendedDwell { is_one, since: None, last_nanos: nanos };
            let Some(open) = self.open.filter(|open| secs(open.last_nanos, nanos) <= longest) else {
                self.open = Some(begins);
                continue;
            };
            if open.is_one == is_one {
                self.open = Some(UnendedDwell { last_nanos: nanos, ..open });
                continue;
            }
            let gap = secs(open.last_nanos, nanos);
            let changed = open.last_nanos.saturating_add((nanos - open.last_nanos) / 2);
            if let Some((since, before)) = open.since {
                let length = secs(since, changed);
                if length >= gap.max(before) {
                    self.of_value[usize::from(open.is_one)].fresh.push(length as f32);
                }
            }
            self.open = Some(UnendedDwell { since: Some((changed, gap)), ..begins });
        }
        if self.of_value.iter().any(OfValue::is_stale) {
            self.of_value.iter_mut().for_each(OfValue::take_fresh);
            self.build();
        }
    }

    pub(super) fn build(&mut self) {
        let [low, high] = &self.of_value;
        let are_enough = low.count.min(high.count) >= DWELLS_MIN;
        self.survivals = are_enough.then(|| Arc::new([Survival::of(&low.secs), Survival::of(&high.secs)]));
    }
}

fn secs(earlier_nanos: i64, later_nanos: i64) -> f64 {
    later_nanos.abs_diff(earlier_nanos) as f64 / 1e9
}

/// The probability that a dwell lasts longer than an age.
#[derive(Clone, Debug, PartialEq)]
pub(super) struct Survival {
    /// ln of the first stored age, and the stored ages per 1 of ln(age).
    first: f64,
    per_log: f64,
    last_secs: f64,
    mean_secs: f64,
    values: [f32; NODES],
}

impl Survival {
    /// The survival of completed dwells, at least one.
    pub(super) fn of(dwells: &[f32]) -> Survival {
        let logs: Vec<f64> = dwells.iter().map(|&secs| libm::log(f64::from(secs).max(1e-3))).collect();
        let mean_secs = dwells.iter().map(|&secs| f64::from(secs)).sum::<f64>().max(1e-3) / dwells.len().max(1) as f64;
        let width = WIDTHS
            .into_iter()
            .map(|width| (left_out(&logs, width, mean_secs), width))
            .fold((f64::NEG_INFINITY, WIDTHS[0]), |best, next| if next.0 > best.0 { next } else { best })
            .1;
        let (low, high) =
            logs.iter().fold((f64::INFINITY, f64::NEG_INFINITY), |(low, high), &log| (low.min(log), high.max(log)));
        let (first, last) = (low - MARGIN * width, high + MARGIN * width);
        let step = (last - first) / (NODES - 1) as f64;
        let values = std::array::from_fn(|node| {
            let log = first + step * node as f64;
            let kernels: f64 = logs.iter().map(|dwell| normal_tail((log - dwell) / width)).sum();
            ((kernels + libm::exp(-libm::exp(log) / mean_secs)) / (logs.len() + 1) as f64) as f32
        });
        Survival { first, per_log: 1.0 / step, last_secs: libm::exp(last), mean_secs, values }
    }

    /// The probability that a dwell lasts longer than this many seconds, above 0.
    pub(super) fn at(&self, age_secs: f64) -> f64 {
        let place = (libm::log(age_secs.max(1e-9)) - self.first) * self.per_log;
        let value = |node: usize| f64::from(self.values[node.min(NODES - 1)]);
        if place <= 0.0 {
            // Falls in a straight line to the first stored age.
            return 1.0 - (1.0 - value(0)) * libm::exp(place / self.per_log);
        }
        if place >= (NODES - 1) as f64 {
            let tail = libm::exp((self.last_secs - age_secs) / self.mean_secs);
            return (value(NODES - 1) * tail).max(f64::MIN_POSITIVE);
        }
        let node = place as usize;
        value(node) + (value(node + 1) - value(node)) * (place - node as f64)
    }

    /// The mean length of a dwell in seconds.
    pub(super) fn mean_secs(&self) -> f64 {
        self.mean_secs
    }
}

/// The sum of the log densities of the dwells in ln(time), each estimated from the other dwells; without a constant
/// term.
fn left_out(logs: &[f64], width: f64, mean_secs: f64) -> f64 {
    let density = |at: usize, log: f64| {
        let others = logs.iter().enumerate().filter(|(other, _)| *other != at);
        let kernels: f64 = others.map(|(_, other)| libm::exp(-0.5 * square((log - other) / width))).sum();
        let share = libm::exp(log) / mean_secs;
        kernels / (width * std::f64::consts::TAU.sqrt()) + share * libm::exp(-share)
    };
    logs.iter().enumerate().map(|(at, &log)| libm::log(density(at, log).max(1e-300))).sum()
}

/// The logarithm of the probability of readings, for each of the two values. The probability of a reading counts as at
/// least 0.001, since a span may hide a change.
pub(super) fn evidence(noise: SensorNoise, ones: u16, zeros: u16) -> [f64; 2] {
    const RARE: f64 = 1e-3;
    let log = |probability: f64, count: u16| f64::from(count) * libm::log(probability.max(RARE));
    let sum = |of_one: [f64; 2], of_zero: [f64; 2], value: usize| log(of_one[value], ones) + log(of_zero[value], zeros);
    let (of_one, of_zero) = (noise.likelihoods(true), noise.likelihoods(false));
    [sum(of_one, of_zero, 0), sum(of_one, of_zero, 1)]
}
