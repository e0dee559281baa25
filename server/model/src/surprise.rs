//! Runs of observations that a model did not expect, with the prediction of the model before it learned them.
//!
//! An update learns the readings of a door that was left open, and later models predict the open door. So each unusual
//! observation is judged before it is learned, and the result is kept here. The unit is not a single observation, but a
//! run of observations on the same side of the prediction. A run begins with an unusual observation and continues with
//! all that were less likely than the contrary: the second night of an open door is less unusual, because the first was
//! learned. A state keeps a bounded number of runs. If there are more, the weakest is removed; a run counts half as
//! much for every month of age.
//!
//! The surprise of a run is counted in half-hour bins, not in observations: only the first observation of each
//! half-hour counts. So a robot that stands at a door for an hour is not more surprised than a robot that observes it
//! twice.
//!
//! Invariant: at most [`RUNS_MAX`] runs, ascending by their first time; equal observations in the same order give the
//! same runs, for any division into updates.

use crate::InvalidParts;

#[cfg(test)]
mod tests;

/// Maximum number of runs of a state.
pub const RUNS_MAX: usize = 64;
/// The least certainty of a model about the contrary for an observation to be kept; for other values than
/// probabilities, the confidence of the interval outside of which the value must lie.
pub const KEPT_CONFIDENCE: f64 = 0.9;
/// Length of a half-hour bin, whose observations count once, in nanoseconds.
const BIN_NANOS: i64 = 1_800_000_000_000;
/// A run ends after this time without an unusual observation, in nanoseconds: a day.
const GAP_MAX_NANOS: i64 = 86_400_000_000_000;
/// A run that is older by this much counts half, in seconds: thirty days.
const HALF_LIFE_SECS: f64 = 30.0 * 86_400.0;
/// The least probability that counts: ten bits per bin. So a model that is too certain does not outweigh all others.
const PROBABILITY_MIN: f64 = 1.0 / 1024.0;

/// The surprise of an observation that had this probability, in bits: 0 to 10.
pub fn observed_bits(probability: f64) -> f64 {
    -libm::log2(probability.clamp(PROBABILITY_MIN, 1.0))
}

/// A run of observations that were not expected.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct SurpriseRun {
    /// Time of the first observation, nanoseconds UTC.
    pub first_nanos: i64,
    /// Time of the last observation that was less likely than the contrary, nanoseconds UTC.
    pub last_nanos: i64,
    /// Number of observations that were less likely than the contrary.
    pub observations: u64,
    /// Whether the observations lie above the prediction: open where closed was expected.
    pub is_above: bool,
    /// The value of the most surprising observation, in the bounds of the state's kind.
    pub value: f64,
    /// The model's prediction for `value`'s observation. For a probability: the probability of the value 1. For other
    /// kinds: the probability of a value at least as far from the prediction, to either side. In `[0,1]`.
    pub probability: f64,
    /// The probability of `value`, the least of the run. In `[0,1]`.
    pub observed_probability: f64,
    /// The sum of the surprise of all bins, in bits; above 0.
    pub bits: f64,
}

/// An observation, and the prediction of a model that had not learned it.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct JudgedReading {
    /// Time of the observation, nanoseconds UTC.
    pub utc_nanos: i64,
    /// The observed value.
    pub value: f64,
    /// [`SurpriseRun::probability`] of the observation.
    pub probability: f64,
    /// [`SurpriseRun::observed_probability`] of the observation.
    pub observed_probability: f64,
    /// Whether the value lies above the prediction; for a probability, whether the value is 0.5 or more.
    pub is_above: bool,
    /// Whether the observation was unusual.
    pub is_unusual: bool,
    /// Whether the observation continues a run, because it was less likely than the contrary, or was unusual.
    pub is_unexpected: bool,
}

/// The unusual observations of one state.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct Surprises {
    runs: Vec<SurpriseRun>,
    /// Whether the run with the newest observation continues with the next unusual one.
    is_open: bool,
    dropped: u64,
}

impl Surprises {
    /// The runs, ascending by their first time.
    pub fn runs(&self) -> &[SurpriseRun] {
        &self.runs
    }

    /// Whether the run with the newest observation continues with the next unusual one on the same side.
    pub fn is_open(&self) -> bool {
        self.is_open
    }

    /// Number of runs that were removed to make room.
    pub fn dropped(&self) -> u64 {
        self.dropped
    }

    /// Reads the runs from stored parts.
    ///
    /// # Errors
    /// [`InvalidParts`] where there are too many runs, or a number is outside its range.
    pub fn from_parts(runs: Vec<SurpriseRun>, is_open: bool, dropped: u64) -> Result<Surprises, InvalidParts> {
        InvalidParts::check("number of runs", runs.len() as f64, 0.0..=RUNS_MAX as f64)?;
        for run in &runs {
            InvalidParts::check("value of a run", run.value, f64::MIN..=f64::MAX)?;
            InvalidParts::check("probability of a run", run.probability, 0.0..=1.0)?;
            InvalidParts::check("probability of what a run observed", run.observed_probability, 0.0..=1.0)?;
            InvalidParts::check("surprise of a run", run.bits, 0.0..=f64::MAX)?;
            let (first_nanos, last_nanos) = (run.first_nanos, run.last_nanos);
            if first_nanos > last_nanos {
                return Err(InvalidParts::TimesReversed { first_nanos, last_nanos });
            }
        }
        if let Some(pair) = runs.windows(2).find(|pair| pair[0].first_nanos > pair[1].first_nanos) {
            let (first_nanos, last_nanos) = (pair[0].first_nanos, pair[1].first_nanos);
            return Err(InvalidParts::TimesReversed { first_nanos, last_nanos });
        }
        Ok(Surprises { runs, is_open, dropped })
    }

    /// Adds an observation. An observation that is older than the newest unusual one is kept as a run of its own.
    pub fn observe(&mut self, reading: JudgedReading) {
        let newest = self.newest();
        let continued = newest.and_then(|index| self.runs.get_mut(index)).filter(|run| {
            let gap = reading.utc_nanos.saturating_sub(run.last_nanos);
            self.is_open && run.is_above == reading.is_above && (0..=GAP_MAX_NANOS).contains(&gap)
        });
        match continued {
            Some(run) if reading.is_unexpected => run.extend(reading),
            // An expected observation on the same side does not end the run: the door is still open.
            Some(_) => {}
            None if reading.is_unusual => self.begin(reading),
            None => {
                let is_newer = newest.and_then(|index| self.runs.get(index));
                if is_newer.is_none_or(|run| reading.utc_nanos >= run.last_nanos) {
                    self.is_open = false;
                }
            }
        }
    }

    /// Keeps at most the strongest runs for which `keeps` holds.
    pub fn retain(&mut self, keeps: impl Fn(&SurpriseRun) -> bool) {
        let (newest, before) = (self.newest(), self.runs.len());
        let is_kept = newest.and_then(|index| self.runs.get(index)).is_some_and(&keeps);
        self.runs.retain(keeps);
        self.is_open &= is_kept;
        self.dropped += (before - self.runs.len()) as u64;
    }

    /// Index of the run with the newest observation.
    fn newest(&self) -> Option<usize> {
        (0..self.runs.len()).max_by_key(|&index| self.runs[index].last_nanos)
    }

    fn begin(&mut self, reading: JudgedReading) {
        let is_newest = self.runs.iter().all(|run| run.last_nanos <= reading.utc_nanos);
        let run = SurpriseRun {
            first_nanos: reading.utc_nanos,
            last_nanos: reading.utc_nanos,
            observations: 1,
            is_above: reading.is_above,
            value: reading.value,
            probability: reading.probability,
            observed_probability: reading.observed_probability,
            bits: observed_bits(reading.observed_probability),
        };
        let at = self.runs.partition_point(|other| other.first_nanos <= run.first_nanos);
        self.runs.insert(at, run);
        self.is_open |= is_newest;
        if self.runs.len() > RUNS_MAX {
            self.drop_weakest();
        }
    }

    /// Removes the weakest run, but never the newest, because it may have only begun.
    fn drop_weakest(&mut self) {
        let Some(newest) = self.newest() else { return };
        let newest_nanos = self.runs[newest].last_nanos;
        let strength = |index: usize| {
            let run = &self.runs[index];
            let age_secs = newest_nanos.saturating_sub(run.last_nanos) as f64 / 1e9;
            run.bits * libm::exp2(-age_secs / HALF_LIFE_SECS)
        };
        let others = (0..self.runs.len()).filter(|&index| index != newest);
        if let Some(weakest) = others.min_by(|&one, &other| strength(one).total_cmp(&strength(other))) {
            self.runs.remove(weakest);
            self.dropped += 1;
        }
    }
}

impl SurpriseRun {
    fn extend(&mut self, reading: JudgedReading) {
        if reading.utc_nanos.div_euclid(BIN_NANOS) > self.last_nanos.div_euclid(BIN_NANOS) {
            self.bits += observed_bits(reading.observed_probability);
        }
        self.last_nanos = reading.utc_nanos;
        self.observations += 1;
        if reading.observed_probability < self.observed_probability {
            self.value = reading.value;
            self.probability = reading.probability;
            self.observed_probability = reading.observed_probability;
        }
    }
}
