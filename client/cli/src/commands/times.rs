//! Times, durations and lists of times as arguments.
//!
//! Invariant: the clock is read once for each `now`, when the command line is parsed.

use std::path::Path;

use anyhow::Context as _;
use tidemap_client::clock;
use tidemap_model::{
    LocalDay, LocalInstant, Zone,
    time::{InvalidDuration, InvalidTime, parse_duration, parse_time},
};

use super::{UsageError, files};

/// Maximum number of times of one `--from --to --step`.
const STEPS_MAX: i64 = 10_000_000;

/// A time, or `now`.
pub(crate) fn time(text: &str) -> Result<i64, InvalidTime> {
    if text == "now" { Ok(clock::now_nanos()) } else { parse_time(text) }
}

/// A time of the command line, which may lack a time zone.
#[derive(Clone, Debug, PartialEq, Eq)]
pub(crate) enum When {
    /// Nanoseconds UTC.
    At(i64),
    /// A civil time.
    Civil(String),
}

/// A time, `now`, or a civil time such as 2026-11-26T09:00, which needs a zone.
pub(crate) fn when(text: &str) -> Result<When, InvalidTime> {
    match time(text) {
        Err(InvalidTime::NoOffset(_)) => Ok(When::Civil(text.to_owned())),
        known => known.map(When::At),
    }
}

impl When {
    /// The time; a civil one in this zone, the first of two. `None`: civil times are refused.
    pub(crate) fn resolve(&self, zone: Option<&Zone>) -> Result<i64, UsageError> {
        let text = match self {
            Self::At(nanos) => return Ok(*nanos),
            Self::Civil(text) => text,
        };
        let Some(zone) = zone else {
            let error = InvalidTime::NoOffset(text.clone());
            return Err(UsageError(format!("{error}, or --local to read it in the map's zone")));
        };
        match zone.local_instant(text) {
            Some(LocalInstant::Once(nanos) | LocalInstant::Twice(nanos, _)) => Ok(nanos),
            Some(LocalInstant::Never) => {
                let zone = zone.name();
                Err(UsageError(format!("{text:?} does not exist in {zone}: clocks were set forward over it")))
            }
            None => Err(UsageError(format!("{text:?} is before 1970 or after 2262"))),
        }
    }
}

/// A local day: today, tomorrow, yesterday, or a date such as 2026-11-26. Gives its first instant and that of the next.
pub(crate) fn day(text: &str, zone: &Zone) -> Result<(i64, i64), UsageError> {
    let today = zone.day_of(clock::now_nanos()).0;
    let day = match text {
        "today" => LocalDay(today),
        "tomorrow" => LocalDay(today.saturating_add(1)),
        "yesterday" => LocalDay(today.saturating_sub(1)),
        date => {
            let is_date = date.len() == 10 && zone.local_instant(date).is_some();
            let noon = if is_date { zone.local_instant(&format!("{date}T12:00")) } else { None };
            match noon {
                Some(LocalInstant::Once(nanos) | LocalInstant::Twice(nanos, _)) => zone.day_of(nanos),
                _ => {
                    let text = format!("{date:?} is not a day: use today, tomorrow, yesterday or a date, 2026-11-26");
                    return Err(UsageError(text));
                }
            }
        }
    };
    Ok((zone.midnight_nanos(day), zone.midnight_nanos(LocalDay(day.0.saturating_add(1)))))
}

/// A duration.
pub(crate) fn duration(text: &str) -> Result<i64, InvalidDuration> {
    parse_duration(text)
}

/// A duration, or `0s`.
pub(crate) fn duration_or_none(text: &str) -> Result<i64, InvalidDuration> {
    match parse_duration(text) {
        Err(InvalidDuration::Zero(_)) => Ok(0),
        duration => duration,
    }
}

/// Times from `from` to `to` in steps of `step`; `to` is not included.
pub(crate) fn steps(from: i64, to: i64, step: i64) -> Result<Vec<i64>, UsageError> {
    if from >= to {
        return Err(UsageError("--from must be before --to, which is not included".to_owned()));
    }
    if (to - from) / step >= STEPS_MAX {
        return Err(UsageError(format!(
            "--from, --to and --step make more than {STEPS_MAX} times: use a longer --step"
        )));
    }
    Ok(std::iter::successors(Some(from), |time| time.checked_add(step)).take_while(|&time| time < to).collect())
}

/// The times of a file: one per line, or the column `time` if it has a header; `-` is stdin.
pub(crate) fn from_file(path: &Path) -> anyhow::Result<Vec<i64>> {
    from_text(&files::read_text(path)?).with_context(|| path.display().to_string())
}

fn from_text(text: &str) -> anyhow::Result<Vec<i64>> {
    let text = text.strip_prefix('\u{feff}').unwrap_or(text);
    let mut lines = (1..).zip(text.lines()).filter(|(_, line)| !line.trim().is_empty()).peekable();
    let header = lines.peek().and_then(|(_, line)| line.split(',').position(|name| name.trim() == "time"));
    if header.is_some() {
        lines.next();
    }
    let column = header.unwrap_or(0);
    let mut times = Vec::new();
    for (number, line) in lines {
        let field = if header.is_some() { line.split(',').nth(column).unwrap_or("") } else { line };
        times.push(parse_time(field.trim()).with_context(|| format!("line {number}"))?);
    }
    anyhow::ensure!(!times.is_empty(), "it has no times: write one per line");
    Ok(times)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_end_is_not_included() {
        assert_eq!(steps(0, 30, 10).map_err(|error| error.0), Ok(vec![0, 10, 20]));
        assert_eq!(steps(0, 31, 10).map_err(|error| error.0), Ok(vec![0, 10, 20, 30]));
        assert_eq!(steps(i64::MAX - 5, i64::MAX, 10).map_err(|error| error.0), Ok(vec![i64::MAX - 5]));
        assert!(steps(10, 10, 1).is_err());
        assert!(steps(0, i64::MAX, 1).is_err());
    }

    #[test]
    fn times_come_one_a_line_or_in_a_column() -> anyhow::Result<()> {
        let second = 1_000_000_000;
        assert_eq!(from_text("1\n\n2\r\n")?, [second, 2 * second]);
        assert_eq!(from_text("time\n1\n")?, [second]);
        assert_eq!(from_text("state,time,value\ndoor,1,0\ndoor,2,1\n")?, [second, 2 * second]);
        assert!(from_text("\n").is_err());
        let error = from_text("1\nsoon\n").map_err(|error| format!("{error:#}"));
        assert!(error.as_ref().is_err_and(|text| text.starts_with("line 2: \"soon\" is not a time")), "{error:?}");
        Ok(())
    }
}
