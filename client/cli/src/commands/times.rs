//! Times, durations and lists of times as arguments.
//!
//! Invariant: the clock is read once for each `now`, when the command line is parsed.

use std::path::Path;

use anyhow::Context as _;
use tidemap_client::clock;
use tidemap_model::time::{InvalidDuration, InvalidTime, parse_duration, parse_time};

use super::{UsageError, files};

/// Maximum number of times of one `--from --to --step`.
const STEPS_MAX: i64 = 10_000_000;

/// A time, or `now`.
pub(crate) fn time(text: &str) -> Result<i64, InvalidTime> {
    if text == "now" { Ok(clock::now_nanos()) } else { parse_time(text) }
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
