//! Why a file cannot be read.
//!
//! Invariant: an error says where in the file it is, what is there, and what would be right; what it quotes of the file
//! is short and printable, whatever the file holds.

use std::fmt;

/// Most characters of the file that an error quotes.
const SHOWN_CHARS_MAX: usize = 40;

/// A file that cannot be read: where, and why.
#[derive(Clone, Debug, PartialEq, Eq, thiserror::Error)]
#[error("{place}: {problem}")]
pub struct FormatError {
    /// Where in the file.
    pub place: FilePlace,
    /// What is wrong there.
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

/// What is wrong with a file.
#[derive(Clone, Debug, PartialEq, Eq, thiserror::Error)]
pub enum FormatProblem {
    /// A value that may not be.
    #[error("{what} is {found}; it has to be {right}")]
    Value {
        /// Of what.
        what: String,
        /// The value found.
        found: String,
        /// What would be right.
        right: String,
    },
    /// Something that has to be there and is not.
    #[error("{what} is missing: {right}")]
    Missing {
        /// What.
        what: String,
        /// What would be right.
        right: String,
    },
    /// The file ends before all that it announces.
    #[error("the file ends early: {what} takes {needs} {unit} and {has} are there; copy the file again")]
    CutOff {
        /// What was being read.
        what: String,
        /// How much of it there has to be, or at least.
        needs: u64,
        /// How much of it there is.
        has: u64,
        /// What is counted.
        unit: &'static str,
    },
    /// The last line may go on.
    #[error("the last line has no line end, so the file may be cut off; if it is whole, end it with a line end")]
    NoLineEnd,
    /// More bytes than the file announces.
    #[error("{count} bytes follow {what}, where the file has to end")]
    Trailing {
        /// How many.
        count: u64,
        /// After what.
        what: String,
    },
    /// More than is read from one file.
    #[error("{what} is {found}; at most {most} can be read, so cut the file into parts or thin it out")]
    TooMany {
        /// What.
        what: String,
        /// How many the file has or announces.
        found: u64,
        /// How many are read.
        most: u64,
    },
}

impl FormatError {
    /// A value that may not be.
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

    /// Something that has to be there and is not.
    pub fn missing(place: FilePlace, what: impl Into<String>, right: impl Into<String>) -> Self {
        Self { place, problem: FormatProblem::Missing { what: what.into(), right: right.into() } }
    }

    /// Fewer bytes than something takes.
    pub fn cut_off(at: u64, what: impl Into<String>, needs: u64, has: u64) -> Self {
        Self {
            place: FilePlace::Byte(at),
            problem: FormatProblem::CutOff { what: what.into(), needs, has, unit: "bytes" },
        }
    }

    /// Fewer lines than something takes.
    pub fn lines_cut_off(line: u64, what: impl Into<String>, needs: u64, has: u64) -> Self {
        Self {
            place: FilePlace::Line(line),
            problem: FormatProblem::CutOff { what: what.into(), needs, has, unit: "lines" },
        }
    }

    /// More than is read from one file.
    pub fn too_many(place: FilePlace, what: impl Into<String>, found: u64, most: u64) -> Self {
        Self { place, problem: FormatProblem::TooMany { what: what.into(), found, most } }
    }

    /// Bytes behind the end.
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

/// Text of a file for an error message: quoted, escaped, shortened.
pub fn shown(text: &str) -> String {
    match text.char_indices().nth(SHOWN_CHARS_MAX) {
        None => format!("{text:?}"),
        Some((end, _)) => format!("{:?}…", &text[..end]),
    }
}

/// The start of a file for an error message.
pub fn shown_start(bytes: &[u8]) -> String {
    let start = bytes.split(|&byte| byte == b'\n').next().unwrap_or_default();
    let start = &start[..start.len().min(4 * SHOWN_CHARS_MAX)];
    if bytes.is_empty() { "nothing: the file is empty".to_owned() } else { shown(&String::from_utf8_lossy(start)) }
}
