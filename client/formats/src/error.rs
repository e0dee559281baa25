//! Errors in files.
//!
//! Invariant: an error names its place in the file, the value found and the values allowed; quoted text is short and
//! printable.

use std::fmt;

/// Maximum number of characters that an error quotes.
const QUOTED_CHARS_MAX: usize = 40;

/// An error in a file.
#[derive(Clone, Debug, PartialEq, Eq, thiserror::Error)]
#[error("{place}: {problem}")]
pub struct FormatError {
    /// The place of the error in the file.
    pub place: FilePlace,
    /// The problem at that place.
    pub problem: FormatProblem,
}

/// A place in a file.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum FilePlace {
    /// A line, from 1.
    Line(u64),
    /// A byte, from 0.
    Byte(u64),
}

/// A problem in a file.
#[derive(Clone, Debug, PartialEq, Eq, thiserror::Error)]
#[allow(missing_docs, reason = "the message of each variant names its fields")]
pub enum FormatProblem {
    /// A value is not allowed.
    #[error("{what} is {found}; it has to be {right}")]
    Value { what: String, found: String, right: String },
    /// A required part is missing.
    #[error("{what} is missing: {right}")]
    Missing { what: String, right: String },
    /// The file ends before the end that its header announces.
    #[error("the file ends early: {what} takes {needs} {unit} and {has} are there; copy the file again")]
    CutOff { what: String, needs: u64, has: u64, unit: &'static str },
    /// The last line may be truncated.
    #[error("the last line has no line end, so the file may be cut off; if it is whole, end it with a line end")]
    NoLineEnd,
    /// Bytes follow the end that the header announces.
    #[error("{count} bytes follow {what}, where the file must end")]
    Trailing { count: u64, what: String },
    /// A limit is exceeded.
    #[error("{what} is {found}; at most {max} can be read, so cut the file into parts or thin it out")]
    TooMany { what: String, found: u64, max: u64 },
}

impl FormatError {
    /// A value is not allowed.
    pub fn value(
        place: FilePlace,
        what: impl Into<String>,
        found: impl fmt::Display,
        right: impl Into<String>,
    ) -> Self {
        Self {
            place,
            problem: FormatProblem::Value { what: what.into(), found: found.to_string(), right: right.into() },
        }
    }

    /// A required part is missing.
    pub fn missing(place: FilePlace, what: impl Into<String>, right: impl Into<String>) -> Self {
        Self { place, problem: FormatProblem::Missing { what: what.into(), right: right.into() } }
    }

    /// Too few bytes.
    pub fn cut_off(at: u64, what: impl Into<String>, needs: u64, has: u64) -> Self {
        Self {
            place: FilePlace::Byte(at),
            problem: FormatProblem::CutOff { what: what.into(), needs, has, unit: "bytes" },
        }
    }

    /// Too few lines.
    pub fn lines_cut_off(line: u64, what: impl Into<String>, needs: u64, has: u64) -> Self {
        Self {
            place: FilePlace::Line(line),
            problem: FormatProblem::CutOff { what: what.into(), needs, has, unit: "lines" },
        }
    }

    /// A limit is exceeded.
    pub fn too_many(place: FilePlace, what: impl Into<String>, found: u64, max: u64) -> Self {
        Self { place, problem: FormatProblem::TooMany { what: what.into(), found, max } }
    }

    /// Bytes after the end.
    pub fn trailing(at: u64, count: u64, what: impl Into<String>) -> Self {
        Self { place: FilePlace::Byte(at), problem: FormatProblem::Trailing { count, what: what.into() } }
    }
}

impl fmt::Display for FilePlace {
    fn fmt(&self, out: &mut fmt::Formatter<'_>) -> fmt::Result {
        match self {
            Self::Line(line) => write!(out, "line {line}"),
            Self::Byte(byte) => write!(out, "byte {byte}"),
        }
    }
}

/// Text of a file as error messages quote it: escaped and shortened.
pub(crate) fn shown(text: &str) -> String {
    match text.char_indices().nth(QUOTED_CHARS_MAX) {
        None => format!("{text:?}"),
        Some((end, _)) => format!("{:?}…", &text[..end]),
    }
}

/// The start of a file as error messages quote it.
pub(crate) fn shown_start(bytes: &[u8]) -> String {
    let start = bytes.split(|&byte| byte == b'\n').next().unwrap_or_default();
    let start = &start[..start.len().min(4 * QUOTED_CHARS_MAX)];
    if bytes.is_empty() { "nothing: the file is empty".to_owned() } else { shown(&String::from_utf8_lossy(start)) }
}
