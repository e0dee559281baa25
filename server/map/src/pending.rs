//! Observations that no update has folded in yet, per state, in order of arrival.
//!
//! Invariant: an observation is pending exactly if it is durable and every update since has had a cut at or before its
//! time. `replay_from` never exceeds the log position of a pending observation.

use std::collections::BTreeMap;

use tidemap_model::Sample;

use crate::event::StateId;

const DAY_NANOS: i64 = 86_400_000_000_000;

#[derive(Debug, Default)]
pub struct Pending {
    by_state: Vec<Vec<Sample>>,
    total: u64,
    /// Per UTC day of the observations: a log position at or before all of them.
    first_positions: BTreeMap<i64, u64>,
    last_day: i64,
    received_nanos: Option<i64>,
}

impl Pending {
    pub fn total(&self) -> u64 {
        self.total
    }

    pub fn push(&mut self, position: u64, state: StateId, sample: Sample) {
        let index = state.0 as usize;
        if index >= self.by_state.len() {
            self.by_state.resize_with(index + 1, Vec::new);
        }
        self.by_state[index].push(sample);
        self.total += 1;
        let day = sample.utc_nanos.div_euclid(DAY_NANOS);
        if day != self.last_day || self.first_positions.is_empty() {
            self.first_positions.entry(day).or_insert(position);
            self.last_day = day;
        }
    }

    /// Notes when observations were received.
    pub fn received(&mut self, received_nanos: i64) {
        self.received_nanos = Some(self.received_nanos.map_or(received_nanos, |known| known.min(received_nanos)));
    }

    /// When the first of the pending observations was received, or earlier.
    pub fn received_nanos(&self) -> Option<i64> {
        self.received_nanos
    }

    /// Takes what lies before the cut, per state that has any, and leaves the rest.
    pub fn take_before(&mut self, cut_nanos: i64) -> Vec<(StateId, Vec<Sample>)> {
        let mut taken = Vec::new();
        for (index, samples) in self.by_state.iter_mut().enumerate() {
            if samples.is_empty() {
                continue;
            }
            let part = if samples.iter().all(|sample| sample.utc_nanos < cut_nanos) {
                std::mem::take(samples)
            } else {
                let (before, after) = samples.iter().partition(|sample| sample.utc_nanos < cut_nanos);
                *samples = after;
                before
            };
            if !part.is_empty() {
                self.total -= part.len() as u64;
                taken.push((StateId(u32::try_from(index).unwrap_or(u32::MAX)), part));
            }
        }
        if self.total == 0 {
            self.first_positions.clear();
            self.received_nanos = None;
        } else {
            // The cut's own day may hold observations on either side; it keeps its position, which is early enough.
            self.first_positions = self.first_positions.split_off(&cut_nanos.div_euclid(DAY_NANOS));
        }
        taken
    }

    /// Log position from which all pending observations are found again, or `end` where there are none.
    pub fn replay_from(&self, end: u64) -> u64 {
        self.first_positions.values().copied().min().unwrap_or(end).min(end)
    }

    /// An instant at or before the oldest pending observation, nanoseconds UTC.
    pub fn oldest_nanos(&self) -> Option<i64> {
        self.first_positions.keys().next().map(|day| day * DAY_NANOS)
    }
}
