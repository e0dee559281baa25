//! Records the producers of the observations of a state that an update learned, and the order in which they arrived.
//!
//! Observations of a state are numbered from 1 in the order of their arrival, as the state counts them. An update
//! learns them in this order, without the observations at or after its cut, which a later update learns: their numbers
//! determine their places.
//!
//! Invariant: the counts of the runs add up to the number of observations.

use crate::ids::ProducerId;

/// Consecutive observations of one producer with consecutive numbers.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct OriginRun {
    /// The producer.
    pub producer: ProducerId,
    /// Number of the first observation.
    pub first: u64,
    /// Number of observations.
    pub count: u32,
}

/// The origins of the observations of a state, in the order in which a history piece has them.
#[derive(Clone, Debug, Default, PartialEq, Eq)]
pub struct Origins {
    /// The runs of observations.
    pub runs: Vec<OriginRun>,
    /// The number of observations, the last ones, that had waited because their time was later than the clock.
    pub ahead: u32,
    /// Number of the last observation that had arrived when the update began; 0 where none had waited.
    pub arrived: u64,
    /// Whether the update ran early, to free memory.
    pub is_early: bool,
    /// This field has no meaning any more: updates do not set it.
    pub is_crowded: bool,
}

impl Origins {
    /// Adds an observation.
    pub(crate) fn push(&mut self, producer: ProducerId, number: u64) {
        push(&mut self.runs, producer, number);
    }

    /// The origins of `count` observations from a place on.
    #[must_use]
    pub fn part(&self, from: usize, count: usize) -> Self {
        let mut runs = Vec::new();
        self.each().skip(from).take(count).for_each(|(producer, number)| push(&mut runs, producer, number));
        // The observations that had waited are the last of all.
        let all: u64 = self.runs.iter().map(|run| u64::from(run.count)).sum();
        let first_ahead = all.saturating_sub(u64::from(self.ahead));
        let ahead = ((from + count) as u64).min(all).saturating_sub(first_ahead.max(from as u64));
        Self { runs, ahead: u32::try_from(ahead).unwrap_or(u32::MAX), ..*self }
    }

    /// Adds the origins of the observations that follow.
    pub fn extend(&mut self, later: &Self) {
        later.each().for_each(|(producer, number)| self.push(producer, number));
        self.ahead = self.ahead.saturating_add(later.ahead);
    }

    /// Producer and number of each observation.
    pub fn each(&self) -> impl Iterator<Item = (ProducerId, u64)> {
        each(&self.runs)
    }
}

/// Adds an observation to runs.
#[inline]
pub(crate) fn push(runs: &mut Vec<OriginRun>, producer: ProducerId, number: u64) {
    match runs.last_mut() {
        Some(run) if run.producer == producer && run.first + u64::from(run.count) == number && run.count < u32::MAX => {
            run.count += 1;
        }
        _ => runs.push(OriginRun { producer, first: number, count: 1 }),
    }
}

/// Producer and number of each observation of runs.
pub(crate) fn each(runs: &[OriginRun]) -> impl Iterator<Item = (ProducerId, u64)> {
    runs.iter().flat_map(|run| (0..u64::from(run.count)).map(|at| (run.producer, run.first.saturating_add(at))))
}
