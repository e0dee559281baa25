//! The times of files of scans: `--at` and `--every`, the names of the files, or a list.
//!
//! Invariant: every file has a time, or the command ends before anything is sent; only a file whose local time does not
//! exist is left out. A time without a zone is read only if the user states `--local` or `--utc`.

mod numbered;
mod pattern;

use std::{
    collections::HashMap,
    path::{Path, PathBuf},
};

use anyhow::Context as _;
use clap::Args;
use jiff::{
    civil::DateTime,
    tz::{AmbiguousOffset, TimeZone, TimeZoneDatabase},
};
use tidemap_formats::observation_file::split_row;
use tidemap_model::time::{InvalidTime, parse_time};

use self::pattern::NamePattern;
use crate::{
    commands::{UsageError, files, times, usage},
    progress::status_line,
};

/// How the files get their times.
#[derive(Debug, Args)]
pub(crate) struct FileTimeArgs {
    /// Time of the scan, or of the first scan if there are several files; not for .tms files
    #[arg(long, value_name = "TIME", value_parser = times::time)]
    at: Option<i64>,
    /// Time from one file to the next
    #[arg(long, value_name = "DURATION", value_parser = times::duration)]
    every: Option<i64>,
    /// Reads the time of each file from its name, by a pattern for the whole name without folders, such as
    /// 'map_%Y%m%d_%H%M%S.yaml': %Y year, %m month, %d day, %H hour, %M minute, %S second, %.f fraction of a second, %s
    /// Unix seconds, %z offset from UTC; * at the start or the end is any text
    #[arg(long, value_name = "PATTERN", conflicts_with_all = ["at", "every", "times_file"])]
    times_from: Option<NamePattern>,
    /// Reads the time of each file from a CSV file with the columns file,time
    #[arg(long, value_name = "CSV", conflicts_with_all = ["at", "every"])]
    times_file: Option<PathBuf>,
    /// Times without a zone, in names or in the list, are in the map's time zone
    #[arg(long, conflicts_with = "utc")]
    local: bool,
    /// Times without a zone, in names or in the list, are UTC
    #[arg(long)]
    utc: bool,
}

/// A time as a name or a list has it.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
enum FileTime {
    /// Nanoseconds UTC.
    Utc(i64),
    /// The time that a clock showed.
    Clock(DateTime),
}

/// The times of files, one for each.
#[derive(Debug, PartialEq, Eq)]
pub(super) struct FileTimes {
    times: Vec<FileTime>,
    /// Whether the files themselves state when they were made, so that their order does not matter.
    are_own: bool,
    is_utc: bool,
}

/// Files with their times, and files without one with the reason.
type TimedAndRefused<T> = (Vec<(PathBuf, T, i64)>, Vec<(PathBuf, String)>);

impl FileTimeArgs {
    /// Whether any is given.
    pub(super) fn is_given(&self) -> bool {
        let Self { at, every, times_from, times_file, local, utc } = self;
        at.is_some() || every.is_some() || times_from.is_some() || times_file.is_some() || *local || *utc
    }

    /// The times of the files.
    ///
    /// # Errors
    /// A file has no time, or a time has no zone and no option states one; this is checked before the daemon is
    /// contacted.
    pub(super) fn of(&self, files: &[PathBuf]) -> anyhow::Result<FileTimes> {
        let (times, are_own) = match (&self.times_from, &self.times_file) {
            (Some(pattern), _) => (pattern.times(files)?, true),
            (None, Some(list)) => {
                let text = files::read_text(list)?;
                (listed(&text, files).with_context(|| list.display().to_string())?, true)
            }
            (None, None) => (self.spaced(files)?, false),
        };
        let clock = times.iter().position(|time| matches!(time, FileTime::Clock(_)));
        if let Some(file) = clock.and_then(|index| files.get(index)).filter(|_| !self.local && !self.utc) {
            let text = "its time has no zone: add --local if it is in the map's time zone, or --utc if it is UTC";
            return Err(usage(format!("{}: {text}", file.display())));
        }
        if clock.is_none() && (self.local || self.utc) {
            let option = if self.local { "--local" } else { "--utc" };
            return Err(usage(format!("{option} is for times without a zone, and there is none: leave it out")));
        }
        Ok(FileTimes { times, are_own, is_utc: self.utc })
    }

    /// Times from `--at` on, in steps of `--every`.
    fn spaced(&self, files: &[PathBuf]) -> anyhow::Result<Vec<FileTime>> {
        let right = "give the time of the scan with --at; or --times-from PATTERN reads it from the file's name, and \
                     --times-file CSV from a list";
        let at = self.at.ok_or_else(|| UsageError(right.to_owned()))?;
        let count = files.len();
        let every = match self.every {
            Some(every) => every,
            None if count == 1 => 0,
            None => {
                return Err(usage(format!(
                    "{count} files are {count} scans: give the time between them with --every, or the time of each with \
                     --times-from PATTERN or --times-file CSV"
                )));
            }
        };
        if let Some(notice) = numbered::notice(files) {
            status_line(&notice);
        }
        let time = |index: i64| every.checked_mul(index).and_then(|after| at.checked_add(after)).map(FileTime::Utc);
        let times = (0..).take(count).map(time).collect::<Option<Vec<FileTime>>>();
        times.ok_or_else(|| usage("--at and --every lead past the year 2262"))
    }
}

impl FileTimes {
    /// The files with their times, in nanoseconds UTC, and the files whose time does not exist in the zone, with the
    /// reason. Files that state themselves when they were made are put in the order of their times. `zone`: the map's
    /// time zone, by name.
    ///
    /// # Errors
    /// The zone is unknown.
    pub(super) fn resolve<T>(self, zone: &str, files: Vec<(PathBuf, T)>) -> anyhow::Result<TimedAndRefused<T>> {
        let zone = if self.is_utc { "UTC" } else { zone };
        let clocks = TimeZoneDatabase::bundled().get(zone).with_context(|| format!("time zone {zone}"))?;
        let mut timed: Vec<(PathBuf, T, i64)> = Vec::with_capacity(files.len());
        let mut refused = Vec::new();
        let (mut before, mut twice) = (i64::MIN, 0);
        for ((file, kind), time) in files.into_iter().zip(self.times) {
            let time = match time {
                FileTime::Utc(nanos) => nanos,
                FileTime::Clock(clock) => match of_clock(&clocks, clock, before) {
                    Ok((nanos, is_twice)) => {
                        twice += u64::from(is_twice);
                        nanos
                    }
                    Err(why) => {
                        refused.push((file, why));
                        continue;
                    }
                },
            };
            before = time;
            timed.push((file, kind, time));
        }
        if twice > 0 {
            let text = "in the hour that the clocks of the zone show twice: read as the first time, or as the second where \
                        the file before would be later";
            status_line(&format!("{twice} of the files were made {text}"));
        }
        if self.are_own {
            timed.sort_by_key(|(_, _, time)| *time);
        }
        Ok((timed, refused))
    }
}

/// The time at which the clocks of a zone showed this, in nanoseconds UTC, and whether they showed it twice. If there
/// are two such times, the second is taken if the first is not after `before`.
fn of_clock(zone: &TimeZone, clock: DateTime, before: i64) -> Result<(i64, bool), String> {
    let nanos = |offset: jiff::tz::Offset| {
        let time = offset.to_timestamp(clock).map_err(|error| format!("{clock}: {error}"))?;
        nanos_of(time.as_nanosecond()).ok_or_else(|| format!("{clock} is not between the years 1970 and 2262"))
    };
    match zone.to_ambiguous_timestamp(clock).offset() {
        AmbiguousOffset::Unambiguous { offset } => Ok((nanos(offset)?, false)),
        AmbiguousOffset::Fold { before: first, after: second } => {
            let first = nanos(first)?;
            Ok((if first > before { first } else { nanos(second)? }, true))
        }
        AmbiguousOffset::Gap { .. } => {
            let zone = zone.iana_name().unwrap_or("the map");
            Err(format!("{clock} does not exist in {zone}: the clocks were put forward then"))
        }
    }
}

/// Nanoseconds that are a valid time.
fn nanos_of(nanos: i128) -> Option<i64> {
    i64::try_from(nanos).ok().filter(|nanos| *nanos >= 0)
}

/// The name of a file without its folders.
fn name_of(file: &Path) -> String {
    file.file_name().map(|name| name.to_string_lossy().into_owned()).unwrap_or_default()
}

/// The times that a list has for the files, by their names as given, or without folders.
fn listed(text: &str, files: &[PathBuf]) -> anyhow::Result<Vec<FileTime>> {
    let text = text.strip_prefix('\u{feff}').unwrap_or(text);
    let mut lines = (1..).zip(text.lines()).filter(|(_, line)| !line.trim().is_empty());
    let right = "the first line has to be the header file,time";
    let (_, header) = lines.next().with_context(|| format!("it is empty: {right}"))?;
    let header = split_row(header).map_err(|why| anyhow::anyhow!("line 1: {why}"))?;
    let column = |name: &str| header.iter().position(|column| column == name).with_context(|| right.to_owned());
    let (file_at, time_at) = (column("file")?, column("time")?);
    let mut known: HashMap<String, (FileTime, bool)> = HashMap::new();
    for (number, line) in lines {
        let row = || format!("line {number}");
        let fields = split_row(line).map_err(|why| anyhow::anyhow!("line {number}: {why}"))?;
        let field = |at: usize| fields.get(at).map(ToString::to_string).unwrap_or_default();
        let time = listed_time(field(time_at).trim()).with_context(row)?;
        let name = field(file_at);
        if known.insert(name.clone(), (time, false)).is_some_and(|(other, _)| other != time) {
            anyhow::bail!("line {number}: {name:?} has another time than before");
        }
    }
    let mut times = Vec::with_capacity(files.len());
    for file in files {
        let given = file.display().to_string();
        let name = if known.contains_key(&given) { given } else { name_of(file) };
        let (time, is_used) = known.get_mut(&name).with_context(|| format!("it has no time for {name:?}"))?;
        *is_used = true;
        times.push(*time);
    }
    let unused: Vec<&String> = known.iter().filter(|(_, (_, is_used))| !is_used).map(|(name, _)| name).collect();
    if let Some(first) = unused.iter().min() {
        status_line(&format!(
            "{} of the list's {} files are not among those given: {first}",
            unused.len(),
            known.len()
        ));
    }
    Ok(times)
}

fn listed_time(text: &str) -> Result<FileTime, InvalidTime> {
    match parse_time(text) {
        Ok(nanos) => Ok(FileTime::Utc(nanos)),
        Err(InvalidTime::NoOffset(shown)) => {
            text.parse().map(FileTime::Clock).map_err(|_| InvalidTime::Malformed(shown))
        }
        Err(wrong) => Err(wrong),
    }
}

#[cfg(test)]
mod tests;
