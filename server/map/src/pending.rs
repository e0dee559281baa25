//! Observations that no update has learned yet, per state, in order of arrival.
//!
//! Invariant: an observation is pending exactly if it is durable and the cut of every update since was at or before its
//! time. `replay_from` never exceeds the log position of a pending observation. Observations too far in the future of
//! the clock of their receipt wait separately: they are few, and must not count as work for an update.

use std::{
    cmp::Reverse,
    collections::{BTreeMap, HashMap},
};

use tidemap_model::Sample;

use crate::{
    history::origins::{self, OriginRun, Origins},
    ids::{ProducerId, StateId},
};

const DAY_NANOS: i64 = 86_400_000_000_000;

/// The pending observations of one UTC day, including those that wait separately.
#[derive(Clone, Copy, Debug)]
struct Day {
    /// A log position at or before all these observations.
    first_position: u64,
    /// The earliest time of these observations, or an earlier time, nanoseconds UTC.
    oldest_nanos: i64,
}

/// The origin of an observation.
#[derive(Clone, Copy, Debug)]
pub(crate) struct Origin {
    /// Log position of its event.
    pub position: u64,
    pub producer: ProducerId,
    /// The number of the observation among the observations of its state.
    pub number: u64,
}

/// An observation in the future of the clock. It waits separately from the others until the cut of an update has passed
/// it.
#[derive(Clone, Copy, Debug)]
struct FutureObservation {
    state: StateId,
    sample: Sample,
    producer: ProducerId,
    number: u64,
}

/// The pending observations of a state.
#[derive(Debug, Default)]
struct OfState {
    samples: Vec<Sample>,
    /// The origins of the observations in `samples`.
    runs: Vec<OriginRun>,
}

impl OfState {
    #[inline]
    fn push(&mut self, sample: Sample, producer: ProducerId, number: u64) {
        self.samples.push(sample);
        origins::push(&mut self.runs, producer, number);
    }
}

#[derive(Debug, Default)]
pub(crate) struct Pending {
    by_state: Vec<OfState>,
    total: u64,
    future: Vec<FutureObservation>,
    days: BTreeMap<i64, Day>,
    /// The day of the previous observation, and its earliest time: most observations need no other day.
    last: Option<(i64, i64)>,
    received_nanos: Option<i64>,
}

/// The observations that an update takes.
#[derive(Debug)]
pub(crate) struct Taken {
    /// The observations by state, in order of arrival; the observations that had waited separately come last.
    pub by_state: Vec<(StateId, Vec<Sample>)>,
    /// The origins of the observations of each entry of `by_state`.
    pub origins: Vec<Origins>,
    /// The observations that had waited separately, ascending by time.
    pub were_ahead: Vec<(StateId, Sample, ProducerId)>,
}

impl Pending {
    /// Number of observations that an update could learn.
    pub(crate) fn total(&self) -> u64 {
        self.total
    }

    /// Number of observations that wait until the clock has come near their time.
    pub(crate) fn future(&self) -> u64 {
        self.future.len() as u64
    }

    /// The observations of a state, in order of arrival; those that wait come last.
    pub(crate) fn of_state(&self, state: StateId) -> impl Iterator<Item = &Sample> {
        let pending = self.by_state.get(state.0 as usize).into_iter().flat_map(|of_state| &of_state.samples);
        pending.chain(self.future.iter().filter(move |ahead| ahead.state == state).map(|ahead| &ahead.sample))
    }

    /// Some of the observations that an update could learn, by state: the states with the largest numbers of such
    /// observations, at most `states_max`, ascending. `choose` takes from all observations of a state, in order of
    /// arrival.
    pub(crate) fn extract<T>(
        &self,
        states_max: usize,
        choose: impl Fn(StateId, &[Sample]) -> Vec<T>,
    ) -> Vec<(StateId, Vec<T>)> {
        let id = |index| StateId(u32::try_from(index).unwrap_or(u32::MAX));
        let all = self.by_state.iter().enumerate().map(|(index, of_state)| (id(index), &of_state.samples));
        let mut states: Vec<(StateId, &Vec<Sample>)> = all.filter(|(_, samples)| !samples.is_empty()).collect();
        if states.len() > states_max {
            states.select_nth_unstable_by_key(states_max, |(state, samples)| (Reverse(samples.len()), *state));
            states.truncate(states_max);
            states.sort_unstable_by_key(|(state, _)| *state);
        }
        states.into_iter().map(|(state, samples)| (state, choose(state, samples))).collect()
    }

    fn of_state_mut(&mut self, state: StateId) -> &mut OfState {
        let index = state.0 as usize;
        if index >= self.by_state.len() {
            self.by_state.resize_with(index + 1, OfState::default);
        }
        &mut self.by_state[index]
    }

    pub(crate) fn push(&mut self, state: StateId, sample: Sample, from: Origin) {
        self.of_state_mut(state).push(sample, from.producer, from.number);
        self.total += 1;
        self.note(from.position, sample.utc_nanos);
    }

    pub(crate) fn push_future(&mut self, state: StateId, sample: Sample, from: Origin) {
        self.future.push(FutureObservation { state, sample, producer: from.producer, number: from.number });
        self.note(from.position, sample.utc_nanos);
    }

    /// Raises the numbers of the observations of states.
    pub(crate) fn raise(&mut self, by: &HashMap<StateId, u64>) {
        for (state, by) in by {
            let runs = self.by_state.get_mut(state.0 as usize).into_iter().flat_map(|of_state| &mut of_state.runs);
            runs.for_each(|run| run.first += by);
        }
        for ahead in &mut self.future {
            ahead.number += by.get(&ahead.state).copied().unwrap_or(0);
        }
    }

    fn note(&mut self, position: u64, utc_nanos: i64) {
        let day = utc_nanos.div_euclid(DAY_NANOS);
        if self.last.is_some_and(|(last, oldest)| last == day && oldest <= utc_nanos) {
            return;
        }
        let entry = self.days.entry(day).or_insert(Day { first_position: position, oldest_nanos: utc_nanos });
        entry.oldest_nanos = entry.oldest_nanos.min(utc_nanos);
        self.last = Some((day, entry.oldest_nanos));
    }

    /// Records that nothing is pending, scans included.
    pub(crate) fn all_taken(&mut self) {
        self.received_nanos = None;
    }

    /// Records when observations were received.
    pub(crate) fn received(&mut self, received_nanos: i64) {
        self.received_nanos = Some(self.received_nanos.map_or(received_nanos, |known| known.min(received_nanos)));
    }

    /// The time at which the first of the pending observations was received, or an earlier time.
    pub(crate) fn received_nanos(&self) -> Option<i64> {
        self.received_nanos
    }

    /// Takes the observations before the cut, per state, and leaves the rest.
    pub(crate) fn take_before(&mut self, cut_nanos: i64) -> Taken {
        let (mut ended, future) = std::mem::take(&mut self.future)
            .into_iter()
            .partition::<Vec<_>, _>(|ahead| ahead.sample.utc_nanos < cut_nanos);
        self.future = future;
        let mut ahead_of: BTreeMap<StateId, u32> = BTreeMap::new();
        for ahead in &ended {
            *ahead_of.entry(ahead.state).or_default() += 1;
            self.of_state_mut(ahead.state).push(ahead.sample, ahead.producer, ahead.number);
            self.total += 1;
        }
        let (mut by_state, mut origins) = (Vec::new(), Vec::new());
        for (index, of_state) in self.by_state.iter_mut().enumerate() {
            if of_state.samples.is_empty() {
                continue;
            }
            let part = if of_state.samples.iter().all(|sample| sample.utc_nanos < cut_nanos) {
                std::mem::take(of_state)
            } else {
                let (mut before, mut after) = (OfState::default(), OfState::default());
                for (&sample, (producer, number)) in of_state.samples.iter().zip(origins::each(&of_state.runs)) {
                    let side = if sample.utc_nanos < cut_nanos { &mut before } else { &mut after };
                    side.push(sample, producer, number);
                }
                *of_state = after;
                before
            };
            if !part.samples.is_empty() {
                self.total -= part.samples.len() as u64;
                let state = StateId(u32::try_from(index).unwrap_or(u32::MAX));
                let ahead = ahead_of.get(&state).copied().unwrap_or(0);
                by_state.push((state, part.samples));
                origins.push(Origins { runs: part.runs, ahead, ..Origins::default() });
            }
        }
        ended.sort_by_key(|ahead| ahead.sample.utc_nanos);
        let were_ahead = ended.into_iter().map(|ahead| (ahead.state, ahead.sample, ahead.producer)).collect();
        if self.total == 0 && self.future.is_empty() {
            self.days.clear();
        } else {
            // The cut's own day may hold observations on either side; it keeps its position, which is early enough.
            self.days = self.days.split_off(&cut_nanos.div_euclid(DAY_NANOS));
            if let Some(mut first) = self.days.first_entry() {
                first.get_mut().oldest_nanos = first.get().oldest_nanos.max(cut_nanos);
            }
        }
        self.last = None;
        Taken { by_state, origins, were_ahead }
    }

    /// Log position from which a replay finds all pending observations; `end` if nothing is pending.
    pub(crate) fn replay_from(&self, end: u64) -> u64 {
        self.days.values().map(|day| day.first_position).min().unwrap_or(end).min(end)
    }

    /// The earliest time of the pending observations, or an earlier time, nanoseconds UTC.
    pub(crate) fn oldest_nanos(&self) -> Option<i64> {
        self.days.values().next().map(|day| day.oldest_nanos)
    }

    /// The latest time before `limit_nanos` of the observations that wait separately.
    pub(crate) fn newest_future_before(&self, limit_nanos: i64) -> Option<i64> {
        self.future.iter().map(|ahead| ahead.sample.utc_nanos).filter(|&nanos| nanos < limit_nanos).max()
    }
}
