//! The data that every acknowledged observation changes at once, before any update: the last value of a state and, for
//! a state that reports changes or events, the current value that follows from its newest row.
//!
//! Invariant: a state of samples has no newest row. The result depends only on the observations, their order of
//! arrival, and the time up to which rows hold.

use tidemap_model::{Hold, Persistence, Recent, Reporting, Sample};

use crate::ids::ProducerId;

/// A row that arrives at most this long after its time, in nanoseconds, is still valid for now: its sensor is
/// connected.
const LIVE_NANOS: i64 = 3_600_000_000_000;

/// The newest row of a state.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct NewestRow {
    /// Time of the row, nanoseconds UTC.
    pub nanos: i64,
    /// Whether the row has a value; if not, no value is known from its time on.
    pub has_value: bool,
    /// Whether the row arrived when it was made, not with a recording: in that case the absence of a newer row means
    /// that nothing changed.
    pub is_live: bool,
    /// The producer that sent the row.
    pub producer: ProducerId,
    /// For events: the number of events in the row's step.
    pub events: f64,
}

/// The data that every acknowledged observation changes at once.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct LiveState {
    /// Observations acknowledged.
    pub observations: u64,
    /// Last value and persistence.
    pub persistence: Persistence,
    /// The recent readings.
    pub recent: Recent,
    /// The newest row, where rows are changes or events.
    pub newest_row: Option<NewestRow>,
}

impl LiveState {
    /// Time of the newest observation, nanoseconds UTC.
    #[must_use]
    pub fn last_nanos(&self) -> Option<i64> {
        let last = self.persistence.last().map(|(nanos, _)| nanos);
        self.newest_row.map(|newest| newest.nanos).or(last)
    }

    /// Applies an observation whose time has come.
    pub(crate) fn observe(&mut self, sample: &Sample) {
        self.persistence.observe(sample.utc_nanos, sample.value);
        self.recent.observe(sample.utc_nanos, sample.value);
    }
}

/// The producer of a row and the time of its receipt.
#[derive(Clone, Copy, Debug)]
pub(crate) struct Delivery {
    pub(crate) producer: ProducerId,
    pub(crate) received_nanos: i64,
}

impl LiveState {
    /// Applies a row whose time has come.
    pub(crate) fn observe_row(&mut self, reporting: Reporting, sample: &Sample, arrival: Delivery) {
        let Some(hold) = reporting.hold() else { return self.observe(sample) };
        if self.newest_row.is_some_and(|newest| newest.nanos > sample.utc_nanos) {
            return;
        }
        let mut events = sample.value;
        match reporting {
            Reporting::Events(_) => {
                let step = step_of(hold, sample.utc_nanos);
                match self.newest_row {
                    Some(newest) if step_of(hold, newest.nanos) == step => {
                        events = newest.events + if events.is_nan() { 0.0 } else { events };
                    }
                    _ => self.count_to(hold, step),
                }
            }
            _ => {
                self.hold_to(hold, sample.utc_nanos.saturating_sub(hold.step_nanos()));
                if sample.value.is_nan() {
                    self.hold_to(hold, sample.utc_nanos);
                } else {
                    self.observe(sample);
                }
            }
        }
        self.newest_row = Some(NewestRow {
            nanos: sample.utc_nanos,
            has_value: !sample.value.is_nan(),
            is_live: arrival.received_nanos.saturating_sub(sample.utc_nanos) <= LIVE_NANOS,
            producer: arrival.producer,
            events: if events.is_nan() { 0.0 } else { events },
        });
    }

    /// The state at a time, as it follows from its newest row. `now_nanos`: no newer row is known at that time;
    /// `data_nanos`: the latest time of all data of the map, which is used for a recording.
    pub(crate) fn at(mut self, reporting: Reporting, now_nanos: Option<i64>, data_nanos: i64) -> LiveState {
        let (Some(hold), Some(newest)) = (reporting.hold(), self.newest_row) else { return self };
        let until = now_nanos.filter(|_| newest.is_live).unwrap_or(data_nanos);
        match reporting {
            Reporting::Events(_) => self.count_to(hold, step_of(hold, until)),
            _ => self.hold_to(hold, until),
        }
        self
    }

    /// Extends the value of the newest row up to a time, if the row allows it.
    fn hold_to(&mut self, hold: Hold, until_nanos: i64) {
        let (Some(newest), Some((_, value))) = (self.newest_row, self.persistence.last()) else { return };
        let until = until_nanos.min(newest.nanos.saturating_add(hold.max_nanos()));
        if newest.has_value {
            self.persistence.hold(until, hold.step_nanos());
            self.recent.observe(until, value);
        }
    }

    /// Counts the steps before this one as ended.
    fn count_to(&mut self, hold: Hold, step: i64) {
        let Some(newest) = self.newest_row else { return };
        let of_newest = step_of(hold, newest.nanos);
        if of_newest >= step {
            return;
        }
        let mut ended = |nanos: i64, events: f64| {
            self.persistence.observe(nanos, events);
            self.recent.observe(nanos, events);
        };
        if newest.has_value || newest.events > 0.0 {
            ended(of_newest, newest.events);
        }
        // The last step that has ended without an event.
        let last =
            step.saturating_sub(hold.step_nanos()).min(step_of(hold, newest.nanos.saturating_add(hold.max_nanos())));
        if newest.has_value && last > of_newest {
            ended(last, 0.0);
        }
    }
}

/// The beginning of the step that contains a time.
fn step_of(hold: Hold, nanos: i64) -> i64 {
    nanos - nanos.rem_euclid(hold.step_nanos())
}
