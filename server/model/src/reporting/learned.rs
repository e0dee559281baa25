//! How far the rows of a state have been learned.
//!
//! Invariant: an instant is learned once. Rows that come late, about instants that were learned without them, are
//! learned as the readings that they are, unless all rows are learned anew; rows from before everything that was
//! learned hold up to there.

use super::{
    Hold, Reporting, Row,
    readings::{RowReadings, RowSpan, sum},
};

/// How far the rows of a state have been learned.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct LearnedRows {
    /// Number of rows.
    pub rows: u64,
    /// The first instant that was learned; `None`: none was.
    pub first_nanos: Option<i64>,
    /// The next instant to learn; 0 before the first.
    pub next_nanos: i64,
    /// The newest row.
    pub newest: Option<Row>,
    /// Events since the next instant, which wait for the end of their step; `None`: there is no row of such.
    pub open_events: Option<f64>,
}

impl LearnedRows {
    /// The readings that new rows stand for, after the rows learned before, and what is learned with them. The rows
    /// ascend by time; the last of equal times counts. `horizon_nanos`: the rows are known to be complete up to there,
    /// exclusive; later rows move it.
    pub fn learn(self, reporting: Reporting, rows: Vec<Row>, horizon_nanos: i64) -> (RowReadings, LearnedRows) {
        let after_rows = rows.last().map_or(i64::MIN, |(nanos, _)| nanos.saturating_add(1));
        let horizon_nanos = horizon_nanos.max(after_rows);
        let after = LearnedRows { rows: self.rows + rows.len() as u64, ..self };
        let Some(hold) = reporting.hold() else {
            let readings = RowSpan { end_nanos: horizon_nanos, ..RowSpan::of(reporting, rows, i64::MIN) };
            return (RowReadings::new([readings]), after);
        };
        let Some(first_nanos) = self.first_nanos else {
            let Some(from_nanos) = rows.first().map(|row| start(reporting, hold, row)) else {
                return (RowReadings::new([]), after);
            };
            let begun = LearnedRows { first_nanos: Some(from_nanos), next_nanos: from_nanos, ..after };
            let (span, learned) = begun.go_on(reporting, hold, rows, horizon_nanos);
            return (RowReadings::new([span]), learned);
        };
        let mut early = rows;
        let new = early.split_off(early.partition_point(|(nanos, _)| *nanos < self.in_time_nanos(reporting, hold)));
        let late = early.split_off(early.partition_point(|(nanos, _)| *nanos < first_nanos));
        let mut learned = after;
        let mut spans = Vec::new();
        if let Some(from_nanos) = early.first().map(|row| start(reporting, hold, row)) {
            learned.first_nanos = Some(from_nanos.min(first_nanos));
            spans.push(RowSpan { end_nanos: first_nanos, ..RowSpan::of(reporting, early, from_nanos) });
        }
        if let Some(&last) = late.last() {
            // A change between the newest row and the last instant that was learned says what holds from there on.
            if reporting.is_changes() && self.newest.is_none_or(|newest| last.0 >= newest.0) {
                learned.newest = Some(last);
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
        // No step ends before the horizon: what was open is open still.
        let (waiting, ended) =
            if end_nanos > self.next_nanos { (None, self.open_events) } else { (self.open_events, None) };
        let learned = LearnedRows {
            next_nanos: end_nanos,
            newest: rows.last().copied().or(self.newest),
            open_events: if reporting.is_changes() { None } else { sum(waiting, open_events) },
            ..self
        };
        (
            RowSpan {
                end_nanos,
                held: self.newest,
                open_events: ended,
                ..RowSpan::of(reporting, rows, self.next_nanos)
            },
            learned,
        )
    }

    /// Whether a row of this time changes readings that have been learned.
    #[must_use]
    pub fn is_late(&self, reporting: Reporting, nanos: i64) -> bool {
        let Some(hold) = reporting.hold() else { return false };
        self.first_nanos.is_some() && nanos < self.in_time_nanos(reporting, hold)
    }

    /// Rows at this time or later are about instants that were not learned.
    fn in_time_nanos(&self, reporting: Reporting, hold: Hold) -> i64 {
        if reporting.is_changes() {
            self.next_nanos.saturating_sub(hold.step_nanos()).saturating_add(1)
        } else {
            self.next_nanos
        }
    }
}

/// The first instant that a row says something about.
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
