//! The readings of a state that has few. They are stored in place of the sums over them.
//!
//! A reading takes 16 bytes, a sum 32 for each candidate periodicity. Invariant: the sums over the readings, batch by
//! batch, are bit for bit those that were computed when the readings came.

use crate::{InvalidParts, Sample, StateKind};

/// With more batches, sums are kept instead: computing them again takes about a microsecond for each.
const BATCHES_MAX: usize = 32;
/// With more readings, sums are kept instead: they need not be in memory.
const READINGS_MAX: usize = 48;

/// Readings, in the batches in which they were added.
#[derive(Clone, Debug, PartialEq, Default)]
pub struct ShortRecord {
    /// Local civil time in nanoseconds since 1970-01-01T00:00 local, and value.
    pub readings: Vec<(i64, f64)>,
    /// The number of readings of each batch, at least 1.
    pub batches: Vec<u32>,
}

impl ShortRecord {
    /// This record with one more batch; `None` if it is then too long to be worth it for that number of periodicities.
    pub(super) fn with(mut self, samples: &[Sample], periodicities: usize) -> Option<ShortRecord> {
        if samples.is_empty() {
            return Some(self);
        }
        let readings = self.readings.len() + samples.len();
        if readings > periodicities.min(READINGS_MAX) || self.batches.len() >= BATCHES_MAX {
            return None;
        }
        self.readings.reserve_exact(samples.len());
        self.readings.extend(samples.iter().map(|sample| (sample.civil_nanos(), sample.value)));
        self.batches.reserve_exact(1);
        // There are at most as many samples as periodicities.
        self.batches.push(samples.len() as u32);
        Some(self)
    }

    /// The batches, as samples of a map whose local time is UTC.
    pub(super) fn batches(&self) -> impl Iterator<Item = Vec<Sample>> + '_ {
        let sample = |&(utc_nanos, value): &(i64, f64)| Sample { utc_nanos, offset_secs: 0, value };
        let mut rest = self.readings.as_slice();
        self.batches.iter().map(move |&length| {
            let (batch, later) = rest.split_at(rest.len().min(length as usize));
            rest = later;
            batch.iter().map(sample).collect()
        })
    }

    /// Refuses a record that has another number of readings, or a value that the kind does not allow.
    pub(super) fn check(&self, kind: StateKind, observations: u64) -> Result<(), InvalidParts> {
        let found = self.readings.len() as f64;
        let in_batches: u64 = self.batches.iter().map(|&length| u64::from(length)).sum();
        if self.readings.len() as u64 != observations || in_batches != observations || self.batches.contains(&0) {
            return Err(InvalidParts::OutOfRange { field: "number of readings", found });
        }
        self.readings.iter().try_for_each(|&(_, value)| InvalidParts::check("reading", value, kind.bounds()))
    }
}
