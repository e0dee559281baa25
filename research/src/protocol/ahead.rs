//! The lead times of predictions: the key `ahead`.
//!
//! Invariant: a list has each lead time once.

use std::fmt;

use tidemap_model::time::{format_duration, parse_duration};

use super::{
    ProtocolError,
    keys::parsed,
    raw::{Word, Words},
};

/// Maximum number of lead times; each repeats the predictions of all test sets.
const LAGS_MAX: usize = 32;
/// The name of [`Ahead::Next`].
const NEXT: &str = "next";

/// The lead time of a predicted reading after the newest reading that is known.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Ahead {
    /// The reading before it is known.
    Next,
    /// Readings that are at least this many nanoseconds older are known.
    Nanos(i64),
}

impl fmt::Display for Ahead {
    /// Writes the name of the lead time in protocols.
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        match self {
            Self::Next => f.write_str(NEXT),
            Self::Nanos(nanos) => f.write_str(&format_duration(*nanos)),
        }
    }
}

/// The lead times of a protocol, in its order; none if it has no such key.
pub(super) fn read(written: Option<Words>) -> Result<Vec<Ahead>, ProtocolError> {
    const KEY: &str = "ahead";
    const RIGHT: &str = "next (the reading before is known), or a duration such as 1h, or a list of them";
    let Some(Words { line, words }) = written else { return Ok(Vec::new()) };
    if words.is_empty() || words.len() > LAGS_MAX {
        let found = Word { line, text: format!("a list of {}", words.len()) };
        return Err(ProtocolError::value(KEY, &found, &format!("1 to {LAGS_MAX} times, each {RIGHT}")));
    }
    let mut lags: Vec<Ahead> = Vec::with_capacity(words.len());
    for word in &words {
        let lag = parsed(word, KEY, RIGHT, |text| match text {
            NEXT => Some(Ahead::Next),
            text => parse_duration(text).ok().filter(|&nanos| nanos > 0).map(Ahead::Nanos),
        })?;
        if lags.contains(&lag) {
            return Err(ProtocolError::value(KEY, word, "each once"));
        }
        lags.push(lag);
    }
    Ok(lags)
}
