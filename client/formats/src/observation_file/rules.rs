//! How the rows of a file are read: its own columns, its own words, and times without a zone.
//!
//! Invariant: without rules a file is read as its header says, with UTC times; words that everybody uses are known.
//! A time that is read in a zone is the one that the order of rows allows.

use std::collections::HashMap;

use tidemap_model::{
    LocalInstant, RowKind, Zone,
    time::{InvalidTime, parse_time},
    words::{NO_VALUE, ONES, ZEROS},
};

use super::shown;

/// What a word says.
#[derive(Clone, Copy, Debug, PartialEq)]
pub enum Meaning {
    /// A value.
    Value(f64),
    /// No value is known from then on.
    NoValue,
}

/// How the rows of a file are read.
#[derive(Clone, Debug, Default)]
pub struct RowRules {
    /// Names of the columns in the file, in lower case: of time, state and value. `None`: the usual name.
    pub columns: [Option<String>; 3],
    /// Words of the file, in lower case, beside those that everybody uses.
    pub words: HashMap<String, Meaning>,
    /// The zone of times that have none; `None`: such times are refused.
    pub zone: Option<Zone>,
    /// What rows are. A change may have no value; an event without one is one event.
    pub kind: RowKind,
}

/// Why a text is no rule.
#[derive(Clone, Debug, PartialEq, Eq, thiserror::Error)]
pub enum InvalidRule {
    /// A part is not NAME=NAME.
    #[error("{part:?} is not {form}")]
    Form {
        /// The part.
        part: String,
        /// What it should be.
        form: &'static str,
    },
    /// A column that no row needs.
    #[error("{0:?} is no column of observations: name time, state or value, as in time=last_changed")]
    Column(String),
    /// A word or a column twice.
    #[error("{0:?} is named twice")]
    Twice(String),
    /// What a word should stand for is no number.
    #[error("{word:?} stands for {value:?}: use a number, or none where the sensor knows no value")]
    Value {
        /// The word.
        word: String,
        /// What it should stand for.
        value: String,
    },
}

impl RowRules {
    /// Columns as in `time=last_changed,state=entity_id,value=state`.
    ///
    /// # Errors
    /// What is no rule.
    pub fn parse_columns(text: &str) -> Result<[Option<String>; 3], InvalidRule> {
        let mut columns = [None, None, None];
        for part in text.split(',') {
            let form = || InvalidRule::Form { part: part.to_owned(), form: "COLUMN=NAME, as in time=last_changed" };
            let (column, name) = part.split_once('=').ok_or_else(form)?;
            let place = ["time", "state", "value"].iter().position(|known| *known == column.trim());
            let column = place.and_then(|place| columns.get_mut(place));
            let column = column.ok_or_else(|| InvalidRule::Column(part.trim().to_owned()))?;
            if name.trim().is_empty() {
                return Err(form());
            }
            if column.replace(name.trim().to_lowercase()).is_some() {
                return Err(InvalidRule::Twice(part.trim().to_owned()));
            }
        }
        Ok(columns)
    }

    /// Words as in `on=1,off=0,half=0.5,jammed=none`.
    ///
    /// # Errors
    /// What is no rule.
    pub fn parse_words(text: &str) -> Result<HashMap<String, Meaning>, InvalidRule> {
        let mut words = HashMap::new();
        for part in text.split(',') {
            let form = || InvalidRule::Form { part: part.to_owned(), form: "WORD=NUMBER, as in on=1" };
            let (word, value) = part.rsplit_once('=').ok_or_else(form)?;
            let (word, value) = (word.trim().to_lowercase(), value.trim());
            let number = value.parse().ok().filter(|number: &f64| number.is_finite());
            let meaning = match number {
                Some(number) => Meaning::Value(number),
                None if NO_VALUE.contains(&value.to_lowercase().as_str()) && !value.is_empty() => Meaning::NoValue,
                None => return Err(InvalidRule::Value { word, value: value.to_owned() }),
            };
            if words.contains_key(&word) {
                return Err(InvalidRule::Twice(word));
            }
            words.insert(word, meaning);
        }
        Ok(words)
    }

    /// What a text that is no number says; `None`: nobody knows.
    pub(super) fn meaning(&self, text: &str) -> Option<Meaning> {
        let word = text.to_lowercase();
        if let Some(meaning) = self.words.get(&word) {
            return Some(*meaning);
        }
        if NO_VALUE.contains(&word.as_str()) {
            return Some(Meaning::NoValue);
        }
        if self.kind == RowKind::Events {
            return Some(Meaning::Value(1.0));
        }
        match (ONES.contains(&word.as_str()), ZEROS.contains(&word.as_str())) {
            (true, _) => Some(Meaning::Value(1.0)),
            (_, true) => Some(Meaning::Value(0.0)),
            _ => None,
        }
    }
}

/// The times of a file, with those of each state so far: they tell which of two equal local times is meant.
#[derive(Clone, Debug, Default)]
pub(super) struct FileTimes {
    newest: HashMap<String, i64>,
}

impl FileTimes {
    /// The time of a row of a state, nanoseconds UTC.
    pub(super) fn read(&mut self, zone: Option<&Zone>, state: &str, text: &str) -> Result<i64, String> {
        let Some(zone) = zone else {
            return parse_time(text).map_err(|error| match error {
                InvalidTime::NoOffset(_) => format!("time {error}, or read such times in the map's zone with --local"),
                error => format!("time {error}"),
            });
        };
        let nanos = match parse_time(text) {
            Err(InvalidTime::NoOffset(_)) => match zone.local_instant(text) {
                Some(LocalInstant::Once(nanos)) => nanos,
                Some(LocalInstant::Twice(first, second)) => {
                    let is_later = self.newest.get(state).is_some_and(|newest| *newest > first);
                    if is_later { second } else { first }
                }
                Some(LocalInstant::Never) => {
                    let zone = zone.name();
                    return Err(format!(
                        "time {:?} does not exist in {zone}: clocks were set forward over it",
                        shown(text)
                    ));
                }
                None => return Err(format!("time {:?} is before 1970 or after 2262", shown(text))),
            },
            known => known.map_err(|error| format!("time {error}"))?,
        };
        let newest = self.newest.entry(state.to_owned()).or_insert(nanos);
        *newest = nanos.max(*newest);
        Ok(nanos)
    }
}
