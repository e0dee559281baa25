//! Advice about the content of a file: rows that are probably of another kind than they were sent as.
//!
//! Invariant: memory is bounded, whatever the file; advice changes nothing.

use std::collections::HashMap;

use tidemap_client::maps::RowKind;
use tidemap_formats::observation_file::ObservationRow;

use super::next_steps::NextSteps;

/// Maximum number of states that are watched.
const STATES_MAX: usize = 10_000;
/// With fewer rows there is no advice about a state.
const ROWS_MIN: u64 = 20;
/// Share of rows that differ from the row before from which on they are probably changes.
const CHANGES_MIN: f64 = 0.95;

/// The statistics of the rows of a state.
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
    /// Rows that were refused for an unknown word.
    unknown_words: u64,
}

/// The statistics of the rows of a file.
#[derive(Debug, Default)]
pub(crate) struct RowAdvice {
    states: HashMap<String, Seen>,
    /// Rows with an unknown word, of states without a valid row before them.
    unknown_words: HashMap<String, u64>,
}

impl RowAdvice {
    /// Counts a valid row.
    pub(crate) fn see(&mut self, row: &ObservationRow) {
        if row.position.is_some() || (self.states.len() >= STATES_MAX && !self.states.contains_key(&row.state)) {
            return;
        }
        let value = row.value;
        let Some(seen) = self.states.get_mut(&row.state) else {
            let has_two_values = value == 0.0 || value == 1.0;
            let first_nanos = row.time_nanos;
            let seen =
                Seen { rows: 1, changes: 0, last: value, first_nanos, at_first: 1, has_two_values, unknown_words: 0 };
            self.states.insert(row.state.clone(), seen);
            return;
        };
        seen.rows += 1;
        seen.changes += u64::from(seen.last.to_bits() != value.to_bits());
        seen.last = value;
        seen.at_first += u64::from(seen.first_nanos == row.time_nanos);
        seen.has_two_values &= value == 0.0 || value == 1.0;
    }

    /// Counts a row that is refused for an unknown word.
    pub(crate) fn see_unknown_word(&mut self, row: &ObservationRow) {
        if let Some(seen) = self.states.get_mut(&row.state) {
            seen.unknown_words += 1;
        } else if !row.state.is_empty() && self.unknown_words.len() < STATES_MAX {
            *self.unknown_words.entry(row.state.clone()).or_default() += 1;
        }
    }

    /// The lines of advice. `kind`: the kind as which the rows were sent.
    pub(crate) fn lines(&self, kind: RowKind, steps: &NextSteps<'_>) -> Vec<String> {
        let looks_like = |_: &str, seen: &Seen| {
            seen.rows >= ROWS_MIN && seen.has_two_values && seen.changes as f64 >= CHANGES_MIN * (seen.rows - 1) as f64
        };
        let mut lines = Vec::new();
        if let Some((states, first)) = self.states_that(looks_like).filter(|_| kind == RowKind::Samples) {
            lines.push(format!(
                "{states}: nearly every row differs from the row before. If the sensor reports changes only, these \
                 rows have a wrong meaning as they are: {}",
                steps.as_changes(first)
            ));
        }
        let is_one_value = |name: &str, seen: &Seen| {
            let unknown = seen.unknown_words + self.unknown_words.get(name).copied().unwrap_or_default();
            seen.changes == 0 && !seen.last.is_nan() && unknown > 0 && seen.has_two_values
        };
        if let Some((states, first)) = self.states_that(is_one_value) {
            let value = self.states.get(first).map_or(f64::NAN, |seen| seen.last);
            lines.push(format!(
                "these states have only one value, {value} for the first, because the words of their other rows are \
                 not known: {states}. Give the meanings of these words, as in --values WORD=0"
            ));
        }
        let never_changes = |name: &str, seen: &Seen| {
            let is_whole = seen.unknown_words == 0 && !self.unknown_words.contains_key(name);
            seen.rows >= ROWS_MIN && seen.changes == 0 && !seen.last.is_nan() && is_whole
        };
        if let Some((states, first)) = self.states_that(never_changes).filter(|_| kind == RowKind::Changes) {
            lines.push(format!(
                "{states}: all rows have one value, so that nothing ever changes. If each row is an event, {}",
                steps.as_events(first)
            ));
        }
        let is_at_once = |_: &str, seen: &Seen| seen.rows >= ROWS_MIN && seen.at_first == seen.rows;
        if let Some((states, _)) = self.states_that(is_at_once) {
            lines.push(format!("{states}: all rows have the same time. Were digits of the times lost?"));
        }
        lines
    }

    /// The states to which this applies, in words, and the first of these states; `None`: there are none.
    fn states_that(&self, is_true: impl Fn(&str, &Seen) -> bool) -> Option<(String, &str)> {
        let mut names: Vec<&str> =
            self.states.iter().filter(|(name, seen)| is_true(name, seen)).map(|(name, _)| name.as_str()).collect();
        names.sort_unstable();
        let first = *names.first()?;
        let words = match names.len() {
            1 => format!("state {first:?}"),
            2 => format!("state {first:?} and one more"),
            count => format!("state {first:?} and {} more", count - 1),
        };
        Some((words, first))
    }
}
