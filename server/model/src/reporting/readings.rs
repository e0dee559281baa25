//! The readings that rows represent, one after the other.
//!
//! Invariant: the readings ascend by time, and need no more memory than the rows.

use super::{Hold, Reporting, Row};

/// A run of readings: rows, and the instants between which their readings are taken.
#[derive(Clone, Debug)]
pub(super) struct RowSpan {
    /// How the rows are read: as the state reports, or as readings.
    pub(super) reporting: Reporting,
    /// The rows, ascending by time.
    pub(super) rows: Vec<Row>,
    /// The row before `rows` that still holds.
    pub(super) held: Option<Row>,
    /// The first instant, a multiple of the step.
    pub(super) from_nanos: i64,
    /// The end, exclusive.
    pub(super) end_nanos: i64,
    /// Number of events since the first instant that are not among the rows; `None` if there was no such row.
    pub(super) open_events: Option<f64>,
}

/// The readings that rows represent: nanoseconds UTC and value, ascending. See the top of the file.
#[derive(Clone, Debug)]
pub struct RowReadings {
    /// The spans, last first.
    spans: Vec<Walk>,
    next: Option<(i64, f64)>,
}

/// The progress of reading a span.
#[derive(Clone, Debug)]
struct Walk {
    span: RowSpan,
    next_row: usize,
    at_nanos: i64,
}

impl RowSpan {
    /// A span of rows from an instant on; the caller has to set the end.
    pub(super) fn of(reporting: Reporting, rows: Vec<Row>, from_nanos: i64) -> RowSpan {
        RowSpan { reporting, rows, held: None, from_nanos, end_nanos: i64::MIN, open_events: None }
    }
}

impl RowReadings {
    /// The readings of spans in order of time that do not overlap.
    pub(super) fn new(spans: impl IntoIterator<Item = RowSpan>) -> RowReadings {
        let mut spans: Vec<Walk> =
            spans.into_iter().map(|span| Walk { next_row: 0, at_nanos: span.from_nanos, span }).collect();
        spans.reverse();
        let mut readings = RowReadings { spans, next: None };
        readings.next = readings.step();
        readings
    }

    /// Time of the next reading.
    pub fn next_nanos(&self) -> Option<i64> {
        self.next.map(|(nanos, _)| nanos)
    }

    fn step(&mut self) -> Option<(i64, f64)> {
        while let Some(walk) = self.spans.last_mut() {
            let next = match walk.span.reporting {
                Reporting::Samples => walk.next_sample(),
                Reporting::Changes(hold) => walk.next_held(hold),
                Reporting::Events(hold) => walk.next_count(hold),
            };
            if next.is_some() {
                return next;
            }
            self.spans.pop();
        }
        None
    }
}

impl Iterator for RowReadings {
    type Item = (i64, f64);

    fn next(&mut self) -> Option<(i64, f64)> {
        let next = self.next.take();
        if next.is_some() {
            self.next = self.step();
        }
        next
    }
}

impl Walk {
    fn row(&self) -> Option<Row> {
        self.span.rows.get(self.next_row).copied()
    }

    fn next_sample(&mut self) -> Option<(i64, f64)> {
        loop {
            let (nanos, value) = self.row().filter(|(nanos, _)| *nanos < self.span.end_nanos)?;
            self.next_row += 1;
            if let Some(value) = value {
                return Some((nanos, value));
            }
        }
    }

    /// The next instant at which a value holds.
    fn next_held(&mut self, hold: Hold) -> Option<(i64, f64)> {
        while self.at_nanos < self.span.end_nanos {
            let at = self.at_nanos;
            while let Some(row) = self.row().filter(|(nanos, _)| *nanos <= at) {
                self.span.held = later(self.span.held, row);
                self.next_row += 1;
            }
            match self.span.held {
                Some((nanos, Some(value))) if hold.reaches(nanos, at) => {
                    self.at_nanos = at.saturating_add(hold.step_nanos());
                    return Some((at, value));
                }
                _ => self.at_nanos = hold.ceil(self.row()?.0).max(at),
            }
        }
        None
    }

    /// The number of events in the next step for which the sensor has data, at its beginning.
    fn next_count(&mut self, hold: Hold) -> Option<(i64, f64)> {
        while self.at_nanos < self.span.end_nanos {
            let at = self.at_nanos;
            let end = at.saturating_add(hold.step_nanos());
            let holds =
                |held: Option<Row>| held.is_some_and(|(nanos, value)| value.is_some() && hold.reaches(nanos, at));
            let was_known = holds(self.span.held);
            let mut count = self.span.open_events.take();
            while let Some((nanos, events)) = self.row().filter(|(nanos, _)| *nanos < end) {
                count = sum(count, events);
                self.span.held = later(self.span.held, (nanos, events));
                self.next_row += 1;
            }
            if count.is_some() || (was_known && holds(self.span.held)) {
                self.at_nanos = end;
                return Some((at, count.unwrap_or(0.0)));
            }
            self.at_nanos = hold.floor(self.row()?.0).max(end);
        }
        None
    }
}

/// The newer of two rows; of equal times, the second one. A late row does not end the value of a newer one.
pub(super) fn later(known: Option<Row>, row: Row) -> Option<Row> {
    known.filter(|(newest, _)| *newest > row.0).or(Some(row))
}

/// The events plus those of another row; a row without a known value has none.
pub(super) fn sum(events: Option<f64>, more: Option<f64>) -> Option<f64> {
    match (events, more) {
        (Some(events), Some(more)) => Some(events + more),
        (one, other) => one.or(other),
    }
}
