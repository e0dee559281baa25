//! Times in the names of files, by a pattern like the patterns of strptime.
//!
//! Invariant: a name that does not match the whole pattern is refused, with the name and the pattern.

use std::{path::PathBuf, str::FromStr};

use jiff::fmt::strtime::BrokenDownTime;

use super::{FileTime, name_of, nanos_of};
use crate::commands::{UsageError, usage};

/// A pattern for names.
#[derive(Clone, Debug, PartialEq, Eq)]
pub(crate) struct NamePattern {
    text: String,
    /// The pattern without `*`.
    format: String,
    /// Whether any text may be before it, and behind it.
    is_open: [bool; 2],
}

impl FromStr for NamePattern {
    type Err = String;

    fn from_str(text: &str) -> Result<Self, String> {
        let right = || {
            format!(
                "{text:?}: a pattern has the date and time as %Y%m%d and %H%M%S, or Unix seconds as %s, such as \
                 'map_%Y%m%d_%H%M%S.yaml'; * is any text, at the start or the end only"
            )
        };
        let (format, is_after) = text.strip_suffix('*').map_or((text, false), |format| (format, true));
        let (format, is_before) = format.strip_prefix('*').map_or((format, false), |format| (format, true));
        // A sample shows whether the pattern can be read at all, and whether it gives a time.
        let sample = jiff::Timestamp::new(1_741_597_200, 123_456_789).unwrap_or_default();
        let sample = sample.to_zoned(jiff::tz::TimeZone::UTC);
        let name = jiff::fmt::strtime::format(format, &sample).map_err(|error| format!("{}: {error}", right()))?;
        let pattern = Self { text: text.to_owned(), format: format.to_owned(), is_open: [is_before, is_after] };
        if format.contains('*') || !format.contains('%') || pattern.time(&name).is_none() {
            return Err(right());
        }
        Ok(pattern)
    }
}

impl NamePattern {
    /// The times of files, by their names without folders.
    pub(super) fn times(&self, files: &[PathBuf]) -> anyhow::Result<Vec<FileTime>> {
        let time = |file: &PathBuf| -> Result<FileTime, UsageError> {
            let name = name_of(file);
            self.time(&name).ok_or_else(|| {
                UsageError(format!(
                    "{}: the name {name:?} does not match --times-from {:?}, or has no time between the years 1970 and \
                     2262",
                    file.display(),
                    self.text
                ))
            })
        };
        files.iter().map(time).collect::<Result<_, _>>().map_err(|error| usage(error.0))
    }

    /// The time in a name.
    fn time(&self, name: &str) -> Option<FileTime> {
        let [is_before, is_after] = self.is_open;
        let starts = name.char_indices().map(|(at, _)| at).take(if is_before { usize::MAX } else { 1 });
        let read = |rest: &str| match is_after {
            true => BrokenDownTime::parse_prefix(&self.format, rest).ok().map(|(read, _)| read),
            false => BrokenDownTime::parse(&self.format, rest).ok(),
        };
        starts.filter_map(|at| name.get(at..)).find_map(|rest| file_time(&read(rest)?))
    }
}

fn file_time(read: &BrokenDownTime) -> Option<FileTime> {
    if read.offset().is_some() || read.timestamp().is_some() || read.iana_time_zone().is_some() {
        let nanos = read.to_timestamp().ok()?.as_nanosecond();
        // For seconds since 1970, jiff omits the fraction.
        let fraction = read.subsec_nanosecond().filter(|_| read.timestamp().is_some() && nanos % 1_000_000_000 == 0);
        return nanos_of(nanos + i128::from(fraction.unwrap_or(0))).map(FileTime::Utc);
    }
    read.to_datetime().ok().map(FileTime::Clock)
}
