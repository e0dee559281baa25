//! The samples that rows of changes and events stand for, on a map's civil time.
//!
//! Invariant: a sample without a value is a row that ends a hold; no reading is one.

use tidemap_model::{OffsetCache, Reporting, Row, Sample};

use crate::{history::Reading, ids::StateId, view::MapView};

/// Samples of a state that reports changes or events as rows.
pub(crate) fn rows_of(samples: &[Sample]) -> Vec<Row> {
    samples.iter().map(|sample| row((sample.utc_nanos, sample.value))).collect()
}

/// A reading as a sample.
pub(crate) fn sample_at(offsets: &mut OffsetCache, (utc_nanos, value): Reading) -> Sample {
    Sample { utc_nanos, offset_secs: offsets.offset_secs(utc_nanos), value }
}

/// The samples that rows stand for. The rows ascend by time.
pub(crate) fn samples_of(
    reporting: Reporting,
    rows: &[Sample],
    horizon_nanos: i64,
    offsets: &mut OffsetCache,
) -> Vec<Sample> {
    reporting.readings(rows_of(rows), horizon_nanos).map(|reading| sample_at(offsets, reading)).collect()
}

fn row((nanos, value): Reading) -> Row {
    (nanos, (!value.is_nan()).then_some(value))
}

impl MapView {
    /// What observations of a state that updates have learned stand for: the observations themselves, or the readings
    /// that rows of changes and events stand for. They ascend by time.
    #[must_use]
    pub fn readings_of(&self, id: StateId, observed: Vec<Reading>) -> Vec<Reading> {
        let Some(learned) = self.model(id).learned_rows() else { return observed };
        let rows = observed.into_iter().map(row).collect();
        self.model(id).reporting().readings(rows, learned.next_nanos).collect()
    }

    /// What all observations of a state stand for, learned or not; ascending by time.
    #[must_use]
    pub fn observed_readings_of(&self, id: StateId, observed: Vec<Reading>) -> Vec<Reading> {
        let reporting = self.info(id).map_or(Reporting::Samples, |info| info.reporting);
        if !reporting.may_end() {
            return observed;
        }
        let rows = observed.into_iter().map(row).collect();
        reporting.readings(rows, self.known_to(id)).collect()
    }

    /// Nothing is known of a state that reports changes or events from then on.
    fn known_to(&self, id: StateId) -> i64 {
        self.live(id).persistence.last().map_or(0, |(nanos, _)| nanos.saturating_add(1))
    }

    /// What pending observations of a state stand for, which no update has learned; ascending by time.
    #[must_use]
    pub fn pending_readings_of(&self, id: StateId, mut pending: Vec<Reading>) -> Vec<Reading> {
        pending.sort_by_key(|(nanos, _)| *nanos);
        let Some(info) = self.info(id).filter(|info| info.reporting.may_end()) else { return pending };
        let learned = self.model(id).learned_rows().copied().unwrap_or_default();
        learned.learn(info.reporting, pending.into_iter().map(row).collect(), self.known_to(id)).0.collect()
    }
}
