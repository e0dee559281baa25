//! The rules for reading the rows of a file: its own columns, its own words, and times without a zone.
//!
//! Invariant: without rules a file is read by its header, with UTC times; common words are known. A time in a zone is
//! the instant that the order of rows allows.

use std::collections::HashMap;

use tidemap_model::{
    LocalInstant, RowKind, Zone,
    time::{InvalidTime, parse_time},
    words::{NO_VALUE, ONES, ZEROS},
};

use super::shown;
use crate::pattern::matches;

/// The meaning of a word.
#[derive(Clone, Copy, Debug, PartialEq)]
pub enum Meaning {
    /// A value.
    Value(f64),
    /// No value is known from then on.
    NoValue,
}

/// The rules for reading the rows of a file.
#[derive(Clone, Debug, Default)]
pub struct RowRules {
    /// Names of the columns in the file, in lower case: of time, state and value. `None`: the usual name.
    pub columns: [Option<String>; 3],
    /// Words of the file, in lower case, beside the common words.
    pub words: HashMap<String, Meaning>,
    /// The zone of times that have none; `None`: such times are refused.
    pub zone: Option<Zone>,
    /// Patterns of the names of states ([`crate::pattern::matches`]), each with whether their values are labels of a
    /// categorical state. The first that fits decides; values of other states are no labels.
    pub labelled: Vec<(Vec<char>, bool)>,
    /// The kind of the rows. A change may have no value; an event without a value is one event.
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
        /// The form that it should have.
        form: &'static str,
    },
    /// A column that no row needs.
    #[error("{0:?} is no column of observations: name time, state or value, as in time=last_changed")]
    Column(String),
    /// A word or a column twice.
    #[error("{0:?} is named twice")]
    Twice(String),
    /// The value of a word is not a number.
    #[error("{word:?} means {value:?}: use a number, or none where the sensor has no value")]
    Value {
        /// The word.
        word: String,
        /// The text that should be its value.
        value: String,
    },
}

impl RowRules {
    /// Whether the values of a state are labels.
    pub(super) fn has_labels(&self, state: &str) -> bool {
        if self.labelled.is_empty() {
            return false;
        }
        let name: Vec<char> = state.chars().collect();
        self.labelled.iter().find(|(pattern, _)| matches(pattern, &name)).is_some_and(|(_, has_labels)| *has_labels)
    }

    /// Columns as in `time=last_changed,state=entity_id,value=state`.
    ///
    /// # Errors
    /// The part of the text that is not a rule.
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
    /// The part of the text that is not a rule.
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

    /// The meaning of a text that is not a number; `None`: the text is unknown.
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

/// The fault of a time, and the right form, if the time is written in the form of some programs.
fn invalid_time(text: &str, error: &InvalidTime) -> String {
    match (error, other_format(text)) {
        (InvalidTime::Malformed(_), Some(how)) => format!("time {:?} {how}", shown(text)),
        _ => format!("time {error}"),
    }
}

/// The format of a date that is no RFC 3339, and what to write; `None`: it is not known.
fn other_format(text: &str) -> Option<&'static str> {
    let lower = text.to_lowercase();
    let is_half_day = [" am", " pm"].iter().any(|half| lower.ends_with(half)) || lower.ends_with("a.m.");
    let date = text.split([' ', 'T', ',']).next().unwrap_or(text);
    let parts: Vec<&str> = date.split(['.', '/', '-']).collect();
    let digits: Vec<usize> =
        parts.iter().map(|part| if part.bytes().all(|byte| byte.is_ascii_digit()) { part.len() } else { 0 }).collect();
    let separator = date.chars().find(|letter| !letter.is_ascii_digit());
    match (digits.as_slice(), separator) {
        ([1 | 2, 1 | 2, 2 | 4], Some('.')) => {
            Some("is a date as day.month.year: write the year first, as in 2025-02-01 08:00:00")
        }
        ([1 | 2, 1 | 2, 2 | 4], Some(_)) => Some(
            "is a date that begins with the day or with the month, which is not known: write the year first, as in \
             2025-02-01 08:00:00",
        ),
        ([4, 1 | 2, 1 | 2], Some('/' | '.')) => {
            Some("is a date without hyphens: write it with hyphens, as in 2025-02-01 08:00:00")
        }
        _ if is_half_day => Some("has a clock of twelve hours: write one of 24 hours, as in 2025-02-01 20:00:00"),
        _ if !text.is_empty() && text.replacen(',', ".", 1).parse::<f64>().is_ok() => {
            Some("is a number with a comma: write a point, as in 1738396800.5")
        }
        _ if lower.chars().any(|letter| letter.is_alphabetic())
            && text.chars().any(|letter| letter.is_ascii_digit()) =>
        {
            Some(
                "is not a time that is known: write the year first, in digits, as in 2025-02-01 08:00:00, or Unix seconds",
            )
        }
        _ => None,
    }
}

/// The times of a file, and the times of each state so far: they decide which of two equal local times is meant.
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
                error => invalid_time(text, &error),
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
            known => known.map_err(|error| invalid_time(text, &error))?,
        };
        let newest = self.newest.entry(state.to_owned()).or_insert(nanos);
        *newest = nanos.max(*newest);
        Ok(nanos)
    }
}

#[test]
fn the_error_of_a_date_of_another_program_names_the_right_form() {
    for (text, words) in [
        ("01.02.2025 08:00", "day.month.year"),
        ("1/2/2025", "begins with the day or with the month"),
        ("02-01-2025 08:00:00", "begins with the day or with the month"),
        ("2025/02/01 08:00", "write it with hyphens"),
        ("2025-02-01 08:00 PM", "24 hours"),
        ("1738396800,5", "write a point"),
        ("Sat Feb  1 08:00:00 2025", "the year first, in digits"),
        ("soon", "is not a time: use Unix seconds"),
    ] {
        let error = FileTimes::default().read(None, "door", text).expect_err(text);
        assert!(error.contains(words) && error.contains(&format!("{text:?}")), "{text}: {error}");
        let error = FileTimes::default().read(Some(&Zone::utc()), "door", text).expect_err(text);
        assert!(error.contains(words), "{text}: {error}");
    }
}
