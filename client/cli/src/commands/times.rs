//! Times, durations and lists of times as arguments.
//!
//! Invariant: the clock is read once for each `now`, when the command line is parsed.

use std::path::Path;

use anyhow::Context as _;
use tidemap_client::clock;
use tidemap_model::{
    LocalDay, LocalInstant, Zone,
    time::{InvalidDuration, InvalidTime, format_rfc3339, parse_duration, parse_time},
};

use super::{UsageError, files};
use crate::progress::status_line;
use tidemap_formats::table::offset_text;

mod requested;

pub(crate) use requested::RequestedTimesArgs;

/// Maximum number of times of one `--from --to --step`.
const STEPS_MAX: i64 = 10_000_000;
const SEC_NANOS: i64 = 1_000_000_000;
const DAY_NANOS: i64 = 86_400 * SEC_NANOS;

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
    /// A clock alone, such as 10:00, which needs a day.
    Clock(String),
}

/// A time, `now`, a civil time such as 2026-11-26T09:00, which needs a zone, or a clock such as 09:00, which needs a
/// day.
pub(crate) fn when(text: &str) -> Result<When, InvalidTime> {
    match time(text) {
        Err(InvalidTime::NoOffset(_)) => Ok(When::Civil(text.to_owned())),
        Err(_) if is_clock(text) => Ok(When::Clock(text.to_owned())),
        known => known.map(When::At),
    }
}

fn is_clock(text: &str) -> bool {
    matches!(text.split(':').count(), 2 | 3) && Zone::utc().local_instant(&format!("2000-01-01T{text}")).is_some()
}

impl When {
    /// The time; a civil time is read in this zone. If it exists twice, the first is taken, and this is reported.
    /// `None`: civil times are refused.
    pub(crate) fn resolve(&self, zone: Option<&Zone>) -> Result<i64, UsageError> {
        let text = match self {
            Self::At(nanos) => return Ok(*nanos),
            Self::Civil(text) => text,
            Self::Clock(text) => {
                return Err(UsageError(format!(
                    "{text:?} has no date: name the day with --date, as in --date today --at {text}, or write the whole \
                     time, 2026-11-26T{text} with --local"
                )));
            }
        };
        let Some(zone) = zone else {
            let error = InvalidTime::NoOffset(text.clone());
            return Err(UsageError(format!("{error}, or --local to read it in the map's zone")));
        };
        civil_time(text, zone)
    }

    /// The time, which has to be on a day of the zone; a clock alone is of this day.
    pub(crate) fn resolve_on(&self, day: LocalDay, local: Option<&Zone>, zone: &Zone) -> Result<i64, UsageError> {
        match self {
            Self::Clock(text) => {
                let midnight = format_rfc3339(i64::from(day.0).saturating_mul(DAY_NANOS));
                civil_time(&format!("{}T{text}", midnight.get(..10).unwrap_or_default()), zone)
            }
            other => {
                let nanos = other.resolve(local)?;
                match zone.day_of(nanos) == day {
                    true => Ok(nanos),
                    false => Err(UsageError(format!(
                        "--at {}: this is not on the day of --date; give a clock such as 10:00, or leave --date out",
                        format_rfc3339(nanos)
                    ))),
                }
            }
        }
    }
}

/// The time of the clocks of a zone. If it exists twice, the first is taken, and this is reported.
fn civil_time(text: &str, zone: &Zone) -> Result<i64, UsageError> {
    match zone.local_instant(text) {
        Some(LocalInstant::Once(nanos)) => Ok(nanos),
        Some(LocalInstant::Twice(first, second)) => {
            let [first_offset, second_offset] = [first, second].map(|nanos| offset_text(zone.offset_secs(nanos)));
            status_line(&format!(
                "{text} comes twice in {}, because the clocks are put back: this is the first, {text}{first_offset}. The \
                 second is {text}{second_offset}",
                zone.name()
            ));
            Ok(first)
        }
        Some(LocalInstant::Never) => {
            let zone = zone.name();
            Err(UsageError(format!("{text:?} does not exist in {zone}: clocks were set forward over it")))
        }
        None => Err(UsageError(format!("{text:?} is before 1970 or after 2262"))),
    }
}

/// A local day: today, tomorrow, yesterday, or a date such as 2026-11-26.
fn named_day(text: &str, zone: &Zone) -> Result<LocalDay, UsageError> {
    let today = zone.day_of(clock::now_nanos()).0;
    Ok(match text {
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
    })
}

/// A local day by its name: its first instant, and the first instant of the next day.
pub(crate) fn day(text: &str, zone: &Zone) -> Result<(i64, i64), UsageError> {
    Ok(ends(named_day(text, zone)?, zone))
}

/// The first instant of a day, and of the next day.
fn ends(day: LocalDay, zone: &Zone) -> (i64, i64) {
    (zone.midnight_nanos(day), zone.midnight_nanos(LocalDay(day.0.saturating_add(1))))
}

/// The times of a local day in steps of its clocks, from midnight on: with 6h always 00:00, 06:00, 12:00 and 18:00. An
/// hour that comes twice is there twice if the step is not longer than the time by which the clocks are put back.
fn local_steps(day: LocalDay, zone: &Zone, step: i64) -> Result<Vec<i64>, UsageError> {
    let (from, to) = ends(day, zone);
    let offsets = [from, to.saturating_sub(1)].map(|nanos| i64::from(zone.offset_secs(nanos)) * SEC_NANOS);
    let begins_at_midnight = (from + offsets[0]).rem_euclid(DAY_NANOS) == 0;
    if offsets[0] == offsets[1] && begins_at_midnight {
        return steps(from, to, step);
    }
    let midnight = i64::from(day.0).saturating_mul(DAY_NANOS);
    let mut times = Vec::new();
    for clock in steps(midnight, midnight.saturating_add(DAY_NANOS), step)? {
        let mut instants = offsets.map(|offset| (clock - offset, offset)).to_vec();
        instants.retain(|(nanos, offset)| {
            (from..to).contains(nanos) && i64::from(zone.offset_secs(*nanos)) * SEC_NANOS == *offset
        });
        instants.sort_unstable();
        instants.dedup();
        if step > (offsets[0] - offsets[1]).abs() {
            instants.truncate(1);
        }
        times.extend(instants.into_iter().map(|(nanos, _)| nanos));
    }
    times.sort_unstable();
    Ok(if times.is_empty() { vec![from] } else { times })
}

/// A duration.
pub fn duration(text: &str) -> Result<i64, InvalidDuration> {
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

    /// 2025-10-26T00:00 in Berlin, whose clocks go back from three to two in that night.
    const AUTUMN: i64 = 1_761_429_600 * SEC_NANOS;
    const HOUR: i64 = 3_600 * SEC_NANOS;

    fn berlin() -> Zone {
        Zone::named("Europe/Berlin").expect("a zone")
    }

    fn hours(day: &str, step: i64) -> Vec<i64> {
        hours_in(&berlin(), day, step)
    }

    fn hours_in(zone: &Zone, day: &str, step: i64) -> Vec<i64> {
        let day = named_day(day, zone).map_err(|error| error.0).expect(day);
        let midnight = zone.midnight_nanos(day);
        let times = local_steps(day, zone, step).map_err(|error| error.0).expect("times");
        times.into_iter().map(|time| (time - midnight) / HOUR).collect()
    }

    #[test]
    fn steps_of_a_day_are_those_of_its_clocks() {
        assert_eq!(hours("2025-10-25", 6 * HOUR), [0, 6, 12, 18]);
        assert_eq!(hours("2025-10-26", 6 * HOUR), [0, 7, 13, 19], "06:00 is seven hours after midnight");
        assert_eq!(hours("2025-03-30", 6 * HOUR), [0, 5, 11, 17]);
        assert_eq!(hours("2025-10-26", HOUR), (0..25).collect::<Vec<_>>(), "02:00 twice");
        assert_eq!(hours("2025-03-30", HOUR), (0..23).collect::<Vec<_>>(), "no 02:00");
        assert_eq!(hours("2025-03-30", 2 * HOUR)[..3], [0, 3, 5], "no 02:00, then 04:00");
        assert_eq!(hours("2025-10-26", 2 * HOUR)[..3], [0, 2, 5], "02:00 once");
        // Clocks are set forward at midnight: the day begins at 01:00.
        let cairo = Zone::named("Africa/Cairo").expect("a zone");
        assert_eq!(hours_in(&cairo, "2025-04-25", 6 * HOUR), [5, 11, 17], "no 00:00, then 06:00");
        assert_eq!(hours_in(&cairo, "2025-04-25", HOUR), (0..23).collect::<Vec<_>>());
    }

    #[test]
    fn a_clock_alone_is_of_the_named_day() {
        let (berlin, read) = (berlin(), |text: &str| when(text).expect(text));
        let day = berlin.day_of(AUTUMN);
        let on = |text: &str| read(text).resolve_on(day, None, &berlin).map_err(|error| error.0);
        assert_eq!(on("10:00"), Ok(AUTUMN + 11 * HOUR));
        assert_eq!(on("02:00"), Ok(AUTUMN + 2 * HOUR), "the first of two");
        assert_eq!(on("2025-10-26T09:00:00Z"), Ok(AUTUMN + 11 * HOUR));
        assert!(on("2025-10-27T09:00:00Z").is_err_and(|text| text.contains("not on the day")));
        let alone = read("10:00").resolve(Some(&berlin)).map_err(|error| error.0);
        assert!(alone.is_err_and(|text| text.contains("--date today --at 10:00")));
        let spring = named_day("2025-03-30", &berlin).map_err(|error| error.0).expect("a day");
        let never = read("02:30").resolve_on(spring, None, &berlin).map_err(|error| error.0);
        assert!(never.is_err_and(|text| text.contains("does not exist")));
        for wrong in ["25:00", "10", "10:60", "a:b", "10:00:00:00"] {
            assert!(!matches!(when(wrong), Ok(When::Clock(_))), "{wrong}");
        }
    }
}
