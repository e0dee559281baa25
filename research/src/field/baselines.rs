//! Baselines: predictions of a state that anybody can make with a table.
//!
//! Invariant: a prediction uses the readings that were learned before it, and no others. Each reading counts once.

use tidemap_model::{Sample, StateKind};

use super::lead::{HOUR_NANOS, Lead};
use crate::tally::{Tally, WEEK_HOURS, bounded};

/// The names of the baselines, in the order of [`Baselines::predict`].
pub const BASELINES: [&str; 5] = ["mean", "hour of week", "hour of week, fading", "newest", "weeks before"];

const WEEK_NANOS: i64 = WEEK_HOURS as i64 * HOUR_NANOS;
/// A reading of the same time of an earlier week is at most this far from that time.
const AROUND_NANOS: i64 = HOUR_NANOS / 2;
/// 1970-01-01 was a Thursday; weeks begin on Monday.
const EPOCH_HOUR_OF_WEEK: i64 = 3 * 24;

/// The tables of one state.
#[derive(Clone, Debug)]
pub(super) struct Baselines {
    kind: StateKind,
    all: Tally,
    hours: Vec<Tally>,
    fading: Vec<Tally>,
    /// The number of learned readings.
    readings: usize,
}

impl Baselines {
    /// Tables without readings.
    pub(super) fn new(kind: StateKind) -> Self {
        let week = vec![Tally::default(); WEEK_HOURS];
        Self { kind, all: Tally::default(), hours: week.clone(), fading: week, readings: 0 }
    }

    /// Whether nothing was learned.
    pub(super) fn is_empty(&self) -> bool {
        self.readings == 0
    }

    /// Learns a reading.
    pub(super) fn learn(&mut self, sample: Sample) {
        let hour = hour_of_week(sample);
        for tally in [&mut self.all, &mut self.hours[hour], &mut self.fading[hour]] {
            tally.add(sample.value);
        }
        self.readings += 1;
    }

    /// Lets the readings of the fading table count less, once a midnight.
    pub(super) fn fade(&mut self) {
        for tally in &mut self.fading {
            *tally = tally.a_day_later();
        }
    }

    /// The value at the time of a reading, by each of [`BASELINES`]. `readings` begin with the learned ones.
    pub(super) fn predict(&self, readings: &[Sample], at: Sample, lead: Lead) -> [f64; BASELINES.len()] {
        let known = &readings[..self.readings.min(readings.len())];
        let hour = hour_of_week(at);
        let is_probability = self.kind == StateKind::Probability;
        let all = if is_probability { self.all.laplace() } else { self.all.mean() };
        let single = |value: f64| if is_probability { bounded(value) } else { value };
        let of_hour = |tally: Tally| if is_probability { tally.laplace() } else { tally.shrunk(all) };
        [
            all,
            of_hour(self.hours[hour]),
            self.fading[hour].shrunk(all),
            single(known.last().map_or(all, |newest| newest.value)),
            single(weeks_before(known, at, lead.weeks()).unwrap_or(all)),
        ]
    }
}

/// The reading whose local time is nearest to that of a reading, whole weeks earlier.
fn weeks_before(known: &[Sample], at: Sample, weeks: i64) -> Option<f64> {
    let then = at.utc_nanos.saturating_sub(weeks * WEEK_NANOS);
    let from = known.partition_point(|sample| sample.utc_nanos < then - 2 * HOUR_NANOS);
    let until = known.partition_point(|sample| sample.utc_nanos <= then + 2 * HOUR_NANOS);
    let civil = at.civil_nanos() - weeks * WEEK_NANOS;
    let distance = |sample: &Sample| (sample.civil_nanos() - civil).abs();
    let nearest = known.get(from..until)?.iter().min_by_key(|sample| distance(sample))?;
    (distance(nearest) <= AROUND_NANOS).then_some(nearest.value)
}

/// The local hour of a reading, 0 for Monday's first.
fn hour_of_week(at: Sample) -> usize {
    (at.civil_nanos().div_euclid(HOUR_NANOS) + EPOCH_HOUR_OF_WEEK).rem_euclid(WEEK_HOURS as i64) as usize
}
