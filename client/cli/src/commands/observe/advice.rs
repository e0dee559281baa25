//! What a file looks like: advice about rows that are probably not what they were sent as.
//!
//! Invariant: memory is bounded, whatever the file; advice changes nothing.

use std::collections::HashMap;

use tidemap_formats::observation_file::ObservationRow;

/// Maximum number of states that are watched.
const STATES_MAX: usize = 10_000;
/// With fewer rows a state looks like nothing.
const ROWS_MIN: u64 = 20;
/// Share of rows that differ from the row before from which they look like changes.
const CHANGES_MIN: f64 = 0.95;

/// What was seen of a state.
#[derive(Clone, Copy, Debug)]
struct Seen {
    rows: u64,
    /// Rows that differ from the row before.
    changes: u64,
    last: f64,
    first_nanos: i64,
    /// Rows at the time of the first.
    at_first: u64,
    has_two_values: bool,
}

/// What was seen of a file.
#[derive(Debug, Default)]
pub(crate) struct RowAdvice {
    states: HashMap<String, Seen>,
}

impl RowAdvice {
    /// Looks at a valid row.
    pub(crate) fn see(&mut self, row: &ObservationRow) {
        if row.position.is_some() || (self.states.len() >= STATES_MAX && !self.states.contains_key(&row.state)) {
            return;
        }
        let value = row.value;
        let Some(seen) = self.states.get_mut(&row.state) else {
            let has_two_values = value == 0.0 || value == 1.0;
            let first_nanos = row.time_nanos;
            let seen = Seen { rows: 1, changes: 0, last: value, first_nanos, at_first: 1, has_two_values };
            self.states.insert(row.state.clone(), seen);
            return;
        };
        seen.rows += 1;
        seen.changes += u64::from(seen.last.to_bits() != value.to_bits());
        seen.last = value;
        seen.at_first += u64::from(seen.first_nanos == row.time_nanos);
        seen.has_two_values &= value == 0.0 || value == 1.0;
    }

    /// What is to be told. `are_samples`: the rows were sent as readings.
    pub(crate) fn lines(&self, are_samples: bool) -> Vec<String> {
        let looks_like = |seen: &Seen| {
            seen.rows >= ROWS_MIN && seen.has_two_values && seen.changes as f64 >= CHANGES_MIN * (seen.rows - 1) as f64
        };
        let mut lines = Vec::new();
        if let Some(states) = self.states_that(looks_like).filter(|_| are_samples) {
            lines.push(format!(
                "{states}: nearly every row differs from the row before. If the sensor reports changes only, these rows \
                 say something wrong as they are: erase the state (tidemap erase MAP --state NAME), and send the file with \
                 --changes and a --producer or --label of its own"
            ));
        }
        let is_at_once = |seen: &Seen| seen.rows >= ROWS_MIN && seen.at_first == seen.rows;
        if let Some(states) = self.states_that(is_at_once) {
            lines.push(format!("{states}: all rows have the same time. Were digits of the times lost?"));
        }
        lines
    }

    /// The states of which this is true, in words; `None`: there are none.
    fn states_that(&self, is_true: impl Fn(&Seen) -> bool) -> Option<String> {
        let mut names: Vec<&str> =
            self.states.iter().filter(|(_, seen)| is_true(seen)).map(|(name, _)| name.as_str()).collect();
        names.sort_unstable();
        let first = *names.first()?;
        Some(match names.len() {
            1 => format!("state {first:?}"),
            2 => format!("state {first:?} and one more"),
            count => format!("state {first:?} and {} more", count - 1),
        })
    }
}
