//! The progress of learning the rows of a state.
//!
//! Invariant: an instant is learned once. Rows that come late, about instants that were learned without them, are
//! learned as readings, unless all rows are learned anew; rows from before the first learned instant hold up to it. If
//! learning stops early, the rows from there on wait here, and learning continues as if it had not stopped.

use std::sync::Arc;

use super::{
    Hold, Reporting, Row,
    readings::{RowReadings, RowSpan, later, sum},
};

/// The progress of learning the rows of a state.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct LearnedRows {
    /// Number of rows, those that wait included.
    pub rows: u64,
    /// The first instant that was learned; `None` if none was.
    pub first_nanos: Option<i64>,
    /// The next instant to learn; 0 before the first.
    pub next_nanos: i64,
    /// The newest row.
    pub newest: Option<Row>,
    /// Number of events since the next instant, which wait for the end of their step; `None` if there is no row since
    /// then.
    pub open_events: Option<f64>,
    /// Rows that were received and are not learned, because learning stopped before them; ascending by time.
    pub waiting: Arc<[Row]>,
}

impl LearnedRows {
    /// The readings that new rows represent after the rows learned before, and the progress with them. The rows ascend
    /// by time; the last of equal times counts. `horizon_nanos`: the rows are complete up to this time, exclusive;
    /// later rows move it.
    pub fn learn(self, reporting: Reporting, rows: Vec<Row>, horizon_nanos: i64) -> (RowReadings, LearnedRows) {
        self.learn_before(reporting, rows, horizon_nanos, i64::MAX)
    }

    /// Does the same as [`LearnedRows::learn`], but everything at `stop_nanos` or later waits for the next call.
    pub fn learn_before(
        self,
        reporting: Reporting,
        rows: Vec<Row>,
        horizon_nanos: i64,
        stop_nanos: i64,
    ) -> (RowReadings, LearnedRows) {
        let taken = self.rows + rows.len() as u64;
        let mut rows = self.with_waiting(rows);
        let waiting = rows.split_off(rows.partition_point(|(nanos, _)| *nanos < stop_nanos));
        let before = LearnedRows { rows: taken, waiting: waiting.into(), ..self };
        before.learn_all(reporting, rows, horizon_nanos.min(stop_nanos))
    }

    /// The rows together with the waiting rows, ascending by time. Waiting rows come first at equal times.
    fn with_waiting(&self, rows: Vec<Row>) -> Vec<Row> {
        if self.waiting.is_empty() {
            return rows;
        }
        let mut all = self.waiting.to_vec();
        all.extend(rows);
        all.sort_by_key(|(nanos, _)| *nanos);
        all
    }

    /// An upper bound of the number of readings that [`LearnedRows::learn_before`] returns: it exceeds that number by
    /// at most two for each row, and three. The cost grows with the rows, not with the readings.
    #[must_use]
    pub fn readings_before(&self, reporting: Reporting, rows: &[Row], horizon_nanos: i64, stop_nanos: i64) -> u64 {
        let Some(hold) = reporting.hold() else { return rows.len() as u64 };
        let first_nanos = self.first_nanos.unwrap_or(i64::MIN).min(stop_nanos);
        // A row just before the first instant may still give the value from there on.
        let early_before = first_nanos.min(self.in_time_nanos(reporting, hold));
        let (early, rest) = rows.split_at(rows.partition_point(|(nanos, _)| *nanos < early_before));
        let early = RowWalk { row: None, at_nanos: i64::MIN, readings: 0 }.to(hold, early, first_nanos);
        let merged = (!self.waiting.is_empty()).then(|| self.with_waiting(rest.to_vec()));
        let rest = merged.as_deref().unwrap_or(rest).iter().take_while(|(nanos, _)| *nanos < stop_nanos);
        // Late events are readings themselves; nothing holds from them on.
        let is_late = |nanos| !reporting.is_changes() && self.is_late(reporting, nanos);
        let (late, rest): (Vec<&Row>, Vec<&Row>) = rest.partition(|(nanos, _)| is_late(*nanos));
        // The step of the newest row may have begun with events, and end with the next reading.
        let begun = u64::from(self.newest.is_some());
        let readings = early.readings.saturating_add(late.len() as u64).saturating_add(begun);
        let held = RowWalk { row: self.newest, at_nanos: self.next_nanos, readings };
        held.to(hold, rest, horizon_nanos.min(stop_nanos)).readings
    }

    fn learn_all(self, reporting: Reporting, rows: Vec<Row>, horizon_nanos: i64) -> (RowReadings, LearnedRows) {
        let after_rows = rows.last().map_or(i64::MIN, |(nanos, _)| nanos.saturating_add(1));
        let horizon_nanos = horizon_nanos.max(after_rows);
        let Some(hold) = reporting.hold() else {
            let readings = RowSpan { end_nanos: horizon_nanos, ..RowSpan::of(reporting, rows, i64::MIN) };
            return (RowReadings::new([readings]), self);
        };
        let Some(first_nanos) = self.first_nanos else {
            let Some(from_nanos) = rows.first().map(|row| start(reporting, hold, row)) else {
                return (RowReadings::new([]), self);
            };
            let begun = LearnedRows { first_nanos: Some(from_nanos), next_nanos: from_nanos, ..self };
            let (span, learned) = begun.go_on(reporting, hold, rows, horizon_nanos);
            return (RowReadings::new([span]), learned);
        };
        let mut early = rows;
        let new = early.split_off(early.partition_point(|(nanos, _)| *nanos < self.in_time_nanos(reporting, hold)));
        let late = early.split_off(early.partition_point(|(nanos, _)| *nanos < first_nanos));
        let mut learned = self.clone();
        let mut spans = Vec::new();
        if let Some(from_nanos) = early.first().map(|row| start(reporting, hold, row)) {
            learned.first_nanos = Some(from_nanos.min(first_nanos));
            spans.push(RowSpan { end_nanos: first_nanos, ..RowSpan::of(reporting, early, from_nanos) });
        }
        if let Some(&last) = late.last() {
            // A change between the newest row and the last learned instant gives the value from there on.
            if reporting.is_changes() {
                learned.newest = later(self.newest, last);
            }
            let late = if reporting.is_changes() { late } else { by_step(hold, &late) };
            spans.push(RowSpan { end_nanos: self.next_nanos, ..RowSpan::of(Reporting::Samples, late, i64::MIN) });
        }
        let (span, learned) = learned.go_on(reporting, hold, new, horizon_nanos);
        spans.push(span);
        (RowReadings::new(spans), learned)
    }

    /// The readings from the next instant on.
    fn go_on(self, reporting: Reporting, hold: Hold, rows: Vec<Row>, horizon_nanos: i64) -> (RowSpan, LearnedRows) {
        let end_nanos = if reporting.is_changes() { hold.ceil(horizon_nanos) } else { hold.floor(horizon_nanos) };
        let end_nanos = end_nanos.max(self.next_nanos);
        let first_open = rows.partition_point(|(nanos, _)| *nanos < end_nanos);
        let open_events = rows.iter().skip(first_open).fold(None, |open, (_, events)| sum(open, *events));
        // No step ends before the horizon, so open steps stay open.
        let (waiting, ended) =
            if end_nanos > self.next_nanos { (None, self.open_events) } else { (self.open_events, None) };
        let newest = rows.last().map_or(self.newest, |&row| later(self.newest, row));
        let span = RowSpan {
            end_nanos,
            held: self.newest,
            open_events: ended,
            ..RowSpan::of(reporting, rows, self.next_nanos)
        };
        let open_events = if reporting.is_changes() { None } else { sum(waiting, open_events) };
        (span, LearnedRows { next_nanos: end_nanos, newest, open_events, ..self })
    }

    /// Whether a row of this time changes readings that have been learned.
    #[must_use]
    pub fn is_late(&self, reporting: Reporting, nanos: i64) -> bool {
        let Some(hold) = reporting.hold() else { return false };
        self.first_nanos.is_some() && nanos < self.in_time_nanos(reporting, hold)
    }

    /// The time from which rows are about instants that were not learned.
    fn in_time_nanos(&self, reporting: Reporting, hold: Hold) -> i64 {
        if reporting.is_changes() {
            self.next_nanos.saturating_sub(hold.step_nanos()).saturating_add(1)
        } else {
            self.next_nanos
        }
    }
}

/// A walk over rows that counts the readings that they represent.
struct RowWalk {
    /// The newest row so far.
    row: Option<Row>,
    /// The time up to which readings are counted.
    at_nanos: i64,
    readings: u64,
}

impl RowWalk {
    /// Walks over these rows; the last row holds up to the end.
    fn to<'a>(mut self, hold: Hold, rows: impl IntoIterator<Item = &'a Row>, end_nanos: i64) -> RowWalk {
        for &(nanos, value) in rows {
            self = self.hold_to(hold, nanos);
            self.row = later(self.row, (nanos, value));
            self.at_nanos = self.at_nanos.max(nanos);
            self.readings = self.readings.saturating_add(1);
        }
        self.hold_to(hold, end_nanos)
    }

    /// Lets the newest row hold up to a time, plus one step for rounding.
    fn hold_to(mut self, hold: Hold, to_nanos: i64) -> RowWalk {
        if let Some((nanos, Some(_))) = self.row {
            let held_to = to_nanos.min(nanos.saturating_add(hold.max_nanos()));
            let held_nanos = held_to.saturating_sub(self.at_nanos.max(nanos)).max(0).unsigned_abs();
            let steps = held_nanos / hold.step_nanos().unsigned_abs().max(1) + 1;
            self.readings = self.readings.saturating_add(steps);
        }
        self
    }
}

/// The first instant for which a row gives a value.
fn start(reporting: Reporting, hold: Hold, (nanos, _): &Row) -> i64 {
    if reporting.is_changes() { hold.ceil(*nanos) } else { hold.floor(*nanos) }
}

/// The number of events of each step that has any, at its beginning.
fn by_step(hold: Hold, rows: &[Row]) -> Vec<Row> {
    let mut steps: Vec<(i64, Option<f64>)> = Vec::new();
    for (nanos, events) in rows.iter().filter_map(|(nanos, events)| Some((*nanos, (*events)?))) {
        let step = hold.floor(nanos);
        match steps.last_mut() {
            Some((known, Some(sum))) if *known == step => *sum += events,
            _ => steps.push((step, Some(events))),
        }
    }
    steps
}
