//! The lines of text files, and of binary files that start with text.
//!
//! Invariant: a line without a line end is an error, because a truncated number is still a valid number; except for the
//! last line of the announced data, whose end some writers leave out. Bytes after the lines read so far are untouched,
//! so that binary data can follow.

use std::str::FromStr;

use super::error::{FilePlace, FormatError, FormatProblem, shown};

/// Reads a file line by line.
pub(crate) struct Lines<'a> {
    bytes: &'a [u8],
    at: usize,
    number: u64,
}

/// One line, without its end.
#[derive(Clone, Copy, Debug)]
pub(crate) struct Line<'a> {
    /// The number of the line, from 1.
    pub number: u64,
    /// The line without its ending.
    pub text: &'a str,
}

impl<'a> Lines<'a> {
    /// A reader that starts at the first line.
    pub(crate) fn new(bytes: &'a [u8]) -> Self {
        Self { bytes, at: 0, number: 0 }
    }

    /// The next line; none at the end of the file.
    pub(crate) fn next_line(&mut self) -> Result<Option<Line<'a>>, FormatError> {
        self.next(false)
    }

    fn next(&mut self, may_lack_end: bool) -> Result<Option<Line<'a>>, FormatError> {
        let rest = self.rest();
        if rest.is_empty() {
            return Ok(None);
        }
        self.number += 1;
        let place = FilePlace::Line(self.number);
        let length = match rest.iter().position(|&byte| byte == b'\n') {
            Some(length) => length,
            None if may_lack_end => rest.len(),
            None => return Err(FormatError { place, problem: FormatProblem::NoLineEnd }),
        };
        self.at += length + 1;
        match std::str::from_utf8(&rest[..length]) {
            Ok(text) => Ok(Some(Line { number: self.number, text })),
            Err(_) => Err(FormatError::value(place, "the line", "not UTF-8", "text")),
        }
    }

    /// The next line that is not blank.
    pub(crate) fn next_full(&mut self) -> Result<Option<Line<'a>>, FormatError> {
        self.next_data(false)
    }

    /// The next line that is not blank. If `is_last`, its line end may be missing.
    pub(crate) fn next_data(&mut self, is_last: bool) -> Result<Option<Line<'a>>, FormatError> {
        while let Some(line) = self.next(is_last)? {
            if line.words().next().is_some() {
                return Ok(Some(line));
            }
        }
        Ok(None)
    }

    /// The bytes not read yet.
    pub(crate) fn rest(&self) -> &'a [u8] {
        self.bytes.get(self.at..).unwrap_or_default()
    }

    /// Position of the next byte in the file.
    pub(crate) fn at(&self) -> u64 {
        self.at as u64
    }

    /// Number of the last line read; 0 before the first.
    pub(crate) fn number(&self) -> u64 {
        self.number
    }
}

impl<'a> Line<'a> {
    /// The place of the line in the file, for an error.
    pub(crate) fn place(&self) -> FilePlace {
        FilePlace::Line(self.number)
    }

    /// The words of the line, split at white space.
    pub(crate) fn words(&self) -> std::str::SplitAsciiWhitespace<'a> {
        self.text.split_ascii_whitespace()
    }

    /// An error about this line.
    pub(crate) fn wrong(&self, what: impl Into<String>, found: &str, right: impl Into<String>) -> FormatError {
        FormatError::value(self.place(), what, shown(found), right)
    }

    /// Reads a word of this line.
    pub(crate) fn parse<T: FromStr>(&self, what: &str, word: Option<&str>, right: &str) -> Result<T, FormatError> {
        let word = word.ok_or_else(|| FormatError::missing(self.place(), what, format!("write {right}")))?;
        word.parse().map_err(|_| self.wrong(what, word, right))
    }

    /// Reads a word of this line as a name.
    pub(crate) fn parse_name(&self, word: Option<&'a str>, what: &str) -> Result<&'a str, FormatError> {
        word.ok_or_else(|| FormatError::missing(self.place(), what, "write a name"))
    }
}
