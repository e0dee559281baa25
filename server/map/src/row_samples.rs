//! The samples that rows of changes and events represent, on a map's civil time.
//!
//! Invariant: a sample without a value is a row that ends a hold; a reading always has a value. No more readings are
//! made than are requested, however many the rows represent.

use std::ops::Range;

use tidemap_model::{LearnedRows, OffsetCache, Reporting, Row, Sample};

use crate::{history::Reading, ids::StateId, view::MapView};

/// Samples of a state that reports changes or events as rows.
pub(crate) fn rows_of(samples: &[Sample]) -> Vec<Row> {
    samples.iter().map(Sample::row).collect()
}

/// A reading as a sample.
pub(crate) fn sample_at(offsets: &mut OffsetCache, (utc_nanos, value): Reading) -> Sample {
    Sample { utc_nanos, offset_secs: offsets.offset_secs(utc_nanos), value }
}

/// The samples that rows represent. The rows ascend by time.
pub(crate) fn samples_of(
    reporting: Reporting,
    rows: &[Sample],
    horizon_nanos: i64,
    offsets: &mut OffsetCache,
) -> Vec<Sample> {
    reporting.readings(rows_of(rows), horizon_nanos).map(|reading| sample_at(offsets, reading)).collect()
}

/// The readings that are requested.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct RequestedReadings {
    /// The readings from the first instant up to but not including the last, nanoseconds UTC.
    pub within_nanos: Range<i64>,
    /// Maximum number of readings; the first ones are returned.
    pub at_most: usize,
}

impl RequestedReadings {
    /// The readings that rows represent, if `learned` has been learned before them.
    fn read(&self, learned: LearnedRows, reporting: Reporting, rows: Vec<Reading>, horizon_nanos: i64) -> Vec<Reading> {
        let rows = rows.into_iter().map(|(nanos, value)| (nanos, (!value.is_nan()).then_some(value))).collect();
        let readings = learned.learn(reporting, rows, horizon_nanos).0;
        let readings = readings.skip_while(|(nanos, _)| *nanos < self.within_nanos.start);
        readings.take_while(|(nanos, _)| *nanos < self.within_nanos.end).take(self.at_most).collect()
    }

    /// Observations that are readings themselves.
    fn keep(&self, mut readings: Vec<Reading>) -> Vec<Reading> {
        readings.retain(|(nanos, _)| self.within_nanos.contains(nanos));
        readings.truncate(self.at_most);
        readings
    }
}

impl MapView {
    /// The times of the observations that determine the values of a state within an interval, nanoseconds UTC: a row
    /// may hold into the interval, and events are counted up to the end of a step.
    #[must_use]
    pub fn rows_about(&self, id: StateId, within_nanos: &Range<i64>) -> Range<i64> {
        let Range { start, end } = *within_nanos;
        match self.reporting(id) {
            Reporting::Samples => start..end,
            Reporting::Changes(hold) => start.saturating_sub(hold.max_nanos())..end,
            Reporting::Events(hold) => start.saturating_sub(hold.max_nanos())..end.saturating_add(hold.step_nanos()),
        }
    }

    /// The readings that learned observations of a state represent: the observations themselves, or the readings that
    /// rows of changes and events represent. Both ascend by time.
    #[must_use]
    pub fn learned_readings(&self, id: StateId, observed: Vec<Reading>, requested: &RequestedReadings) -> Vec<Reading> {
        match self.model(id).learned_rows() {
            None => requested.keep(observed),
            Some(rows) => requested.read(LearnedRows::default(), self.reporting(id), observed, rows.next_nanos),
        }
    }

    /// The readings that all observations of a state represent, learned or not. Both ascend by time. The readings of an
    /// interval need the observations of [`MapView::rows_about`] the interval.
    #[must_use]
    pub fn observed_readings(
        &self,
        id: StateId,
        observed: Vec<Reading>,
        requested: &RequestedReadings,
    ) -> Vec<Reading> {
        if !self.reporting(id).may_end() {
            return requested.keep(observed);
        }
        requested.read(LearnedRows::default(), self.reporting(id), observed, self.known_to(id))
    }

    /// The readings that pending observations of a state represent, which no update has learned; ascending by time.
    #[must_use]
    pub fn pending_readings(
        &self,
        id: StateId,
        mut pending: Vec<Reading>,
        requested: &RequestedReadings,
    ) -> Vec<Reading> {
        pending.sort_by_key(|(nanos, _)| *nanos);
        if !self.reporting(id).may_end() {
            return requested.keep(pending);
        }
        let learned = self.model(id).learned_rows().cloned().unwrap_or_default();
        requested.read(learned, self.reporting(id), pending, self.known_to(id))
    }

    fn reporting(&self, id: StateId) -> Reporting {
        self.info(id).map_or(Reporting::Samples, |info| info.reporting)
    }

    /// The time from which on the value of a state that reports changes or events is not known.
    fn known_to(&self, id: StateId) -> i64 {
        self.live(id).persistence.last().map_or(0, |(nanos, _)| nanos.saturating_add(1))
    }
}
