//! Persistence alone: a state that is 0 or 1 and changes at constant rates, predicted from its newest reading.
//!
//! The model is the continuous-time Markov chain of RAS 2017, section 4.2. It ignores the time of day, so far from the
//! newest reading it predicts a constant. Invariant: both rates are positive and finite, every prediction lies in
//! `[0,1]`.

use super::mean::check_values;
use super::{CannotTrain, Moment, Readings, TemporalModel};
use crate::InvalidParts;

pub(crate) mod likelihood;
use likelihood::Transitions;

#[cfg(test)]
mod tests;

/// The limits of rates: one change per 300 years and one per nanosecond.
const RATE_RANGE: std::ops::RangeInclusive<f64> = 1e-12..=1e10;

/// The two-state continuous-time Markov chain of a state (RAS 2017, eq. 5 and 6).
///
/// p(t) = π + (s - π)·e^(-(α+β)(t-T)), with π = α/(α+β) and the newest reading s at T.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct MarkovChain {
    parts: MarkovChainParts,
}

/// The parts of a [`MarkovChain`], for storage.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct MarkovChainParts {
    /// α: changes from 0 to 1 per second of being 0; above 0.
    pub rise_per_sec: f64,
    /// β: changes from 1 to 0 per second of being 1; above 0.
    pub fall_per_sec: f64,
    /// Time of the newest reading: UTC, nanoseconds since 1970.
    pub last_nanos: i64,
    /// Value of the newest reading, in `[0,1]`.
    pub last_value: f64,
}

impl MarkovChain {
    /// Trains the rates that make the readings most likely, for any gaps between them.
    ///
    /// For two successive readings s and s' in `[0,1]` with a gap Δ, max(0, s'-s) counts as a rise, max(0, s-s') as a
    /// fall and the rest as staying, so that an uncertain but steady state does not seem to change. The likelihood is
    /// that of the chain observed at both ends of Δ: it allows for changes that were missed in between, and a gap of
    /// years is evidence only for how often the state is 1. Readings with equal times are no evidence for rates. A
    /// prior of half a rise and half a fall in an hour at each value (a mean time between changes of the order of the
    /// persistence model's hour) keeps both rates above 0 if no change was observed. Gaps within 2 % of each other
    /// count as one gap of their mean length: the likelihood depends on such differences in second order only.
    ///
    /// # Errors
    /// [`CannotTrain`] where there are no readings or a value is outside `[0,1]`.
    pub fn train(readings: Readings<'_>) -> Result<MarkovChain, CannotTrain> {
        check_values(readings, 0.0..=1.0, "0 to 1")?;
        let Some(last) = readings.samples.last() else { return Err(CannotTrain::NoReadings) };
        let mut transitions = Transitions::default();
        for (pair, weight) in readings.samples.windows(2).zip(readings.weights().skip(1)) {
            let gap_nanos = pair[1].utc_nanos.abs_diff(pair[0].utc_nanos);
            transitions.add(gap_nanos, pair[0].value, pair[1].value, weight);
        }
        let (sum, share) = transitions.most_likely(readings.stop);
        readings.stop.check()?;
        let rate = |rate: f64| rate.clamp(*RATE_RANGE.start(), *RATE_RANGE.end());
        Ok(MarkovChain {
            parts: MarkovChainParts {
                rise_per_sec: rate(sum * share),
                fall_per_sec: rate(sum * (1.0 - share)),
                last_nanos: last.utc_nanos,
                last_value: last.value,
            },
        })
    }

    /// Replaces the newest reading without changing the rates; a reading that is older than the newest, or outside
    /// `[0,1]`, changes nothing.
    pub fn observe(&mut self, utc_nanos: i64, value: f64) {
        if utc_nanos >= self.parts.last_nanos && (0.0..=1.0).contains(&value) {
            (self.parts.last_nanos, self.parts.last_value) = (utc_nanos, value);
        }
    }

    /// π: the share of time in which the state is 1 in the long run, above 0 and below 1.
    pub fn stationary(&self) -> f64 {
        self.parts.rise_per_sec / (self.parts.rise_per_sec + self.parts.fall_per_sec)
    }

    /// 1/(α+β): after this many seconds the influence of a reading has fallen to 1/e.
    pub fn memory_secs(&self) -> f64 {
        1.0 / (self.parts.rise_per_sec + self.parts.fall_per_sec)
    }

    /// The parts to store.
    pub fn to_parts(&self) -> MarkovChainParts {
        self.parts
    }

    /// A model from stored parts.
    ///
    /// # Errors
    /// [`InvalidParts`] where a rate is not positive and finite or the value is outside `[0,1]`.
    pub fn from_parts(parts: MarkovChainParts) -> Result<MarkovChain, InvalidParts> {
        InvalidParts::check("rise rate", parts.rise_per_sec, RATE_RANGE)?;
        InvalidParts::check("fall rate", parts.fall_per_sec, RATE_RANGE)?;
        InvalidParts::check("last value", parts.last_value, 0.0..=1.0)?;
        Ok(MarkovChain { parts })
    }
}

impl TemporalModel for MarkovChain {
    /// Predicts with the chain after the newest reading, and the stationary probability before it.
    fn predict(&self, at: Moment) -> f64 {
        let stationary = self.stationary();
        if at.utc_nanos < self.parts.last_nanos {
            return stationary;
        }
        debug_assert!(stationary > 0.0 && stationary < 1.0, "both rates are positive: {stationary}");
        let elapsed_secs = at.utc_nanos.abs_diff(self.parts.last_nanos) as f64 / 1e9;
        let kept = libm::exp(-elapsed_secs / self.memory_secs());
        (stationary * (1.0 - kept) + self.parts.last_value * kept).clamp(0.0, 1.0)
    }
}
