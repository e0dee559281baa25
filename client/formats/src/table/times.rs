//! Times in tables, as people read them.
//!
//! Invariant: a column shows as much of the clock as its times need, with one precision for all times, and its header
//! names their zone. A time that the clocks show twice has its offset from UTC.

use tidemap_model::{
    Zone,
    time::{format_rfc3339, format_secs},
};

use super::Cell;

const SEC: i64 = 1_000_000_000;
const DAY: i64 = 86_400 * SEC;
const LONGEST_CHANGE: i64 = 3 * 3_600 * SEC;
/// 1 January 1970 was a Thursday.
const WEEKDAYS: [&str; 7] = ["Thu", "Fri", "Sat", "Sun", "Mon", "Tue", "Wed"];

/// The style of times in an aligned table.
#[derive(Clone, Debug, Default)]
pub enum TimeStyle {
    /// Unix seconds.
    #[default]
    Unix,
    /// Nanoseconds since 1970.
    Nanos,
    /// Day and clock of a zone, down to milliseconds.
    Clock(Zone),
}

/// The part of the clock that is shown.
#[derive(Clone, Copy, PartialEq, Eq, PartialOrd, Ord)]
enum Precision {
    Minutes,
    Seconds,
    Millis,
}

fn precision(nanos: i64) -> Precision {
    match nanos {
        _ if nanos % (60 * SEC) == 0 => Precision::Minutes,
        _ if nanos % SEC == 0 => Precision::Seconds,
        _ => Precision::Millis,
    }
}

/// `Tue 2025-01-28 09:00`, in the civil time of a zone.
fn clock(zone: &Zone, nanos: i64, precision: Precision) -> String {
    let civil = nanos.saturating_add(i64::from(zone.offset_secs(nanos)) * SEC).max(0);
    let text = format_rfc3339(civil);
    let (date, time) = text.trim_end_matches('Z').split_once('T').unwrap_or((&text, ""));
    let time = match precision {
        Precision::Minutes => time.get(..5),
        Precision::Seconds => time.get(..8),
        Precision::Millis => time.get(..12).or(Some(time)),
    };
    let time = time.unwrap_or_default();
    let weekday = usize::try_from(civil / DAY % 7).ok().and_then(|day| WEEKDAYS.get(day)).unwrap_or(&"");
    let offset = if comes_twice(zone, nanos) { offset_text(zone.offset_secs(nanos)) } else { String::new() };
    format!("{weekday} {date} {time}{offset}")
}

/// Whether the clocks of the zone show this time twice, because they are put back.
fn comes_twice(zone: &Zone, nanos: i64) -> bool {
    let offset = |nanos: i64| i64::from(zone.offset_secs(nanos.max(0))) * SEC;
    let here = offset(nanos);
    // No zone puts its clocks back by more than three hours, except for a few that changed the date.
    [nanos.saturating_sub(LONGEST_CHANGE), nanos.saturating_add(LONGEST_CHANGE)].into_iter().any(|near| {
        let other = offset(near);
        // The instant that shows the same clock with the other offset.
        let twin = nanos.saturating_add(here - other);
        other != here && twin >= 0 && offset(twin) == other
    })
}

/// An offset from UTC as times have it, `+02:00`.
#[must_use]
pub fn offset_text(secs: i32) -> String {
    let (sign, minutes) = (if secs < 0 { '-' } else { '+' }, secs.unsigned_abs() / 60);
    format!("{sign}{:02}:{:02}", minutes / 60, minutes % 60)
}

impl TimeStyle {
    /// A time as a label of a drawing: weekday and clock, `Tue 09:00`.
    #[must_use]
    pub fn label(&self, nanos: i64) -> String {
        match self {
            Self::Clock(zone) => {
                let text = clock(zone, nanos, Precision::Minutes);
                let (weekday, time) = (text.get(..3).unwrap_or_default(), text.get(15..).unwrap_or_default());
                format!("{weekday} {time}")
            }
            _ => self.text(nanos, Precision::Minutes),
        }
    }

    /// A day and a time, in the form of a heading.
    #[must_use]
    pub fn heading(&self, nanos: i64) -> String {
        match self {
            Self::Clock(zone) => format!("{} ({})", clock(zone, nanos, precision(nanos)), zone.name()),
            _ => self.text(nanos, Precision::Minutes),
        }
    }

    fn text(&self, nanos: i64, precision: Precision) -> String {
        match self {
            Self::Unix => format_secs(nanos),
            Self::Nanos => nanos.to_string(),
            Self::Clock(zone) => clock(zone, nanos, precision),
        }
    }

    /// A cell of a live table.
    pub(super) fn line(&self, cell: &Cell) -> String {
        match cell {
            Cell::Time(nanos) => self.text(*nanos, Precision::Millis),
            _ => cell.rounded(),
        }
    }

    /// The texts of a column of times, whose header gets the unit; `None` for another column, and for Unix seconds,
    /// which are numbers.
    pub(super) fn column(&self, header: &mut String, cells: &[&Cell]) -> Option<Vec<String>> {
        let times = || cells.iter().filter_map(|cell| if let Cell::Time(nanos) = cell { Some(*nanos) } else { None });
        let finest = times().map(precision).max()?;
        match self {
            Self::Unix => return None,
            Self::Nanos => *header += " (ns)",
            Self::Clock(zone) => *header += &format!(" ({})", zone.name()),
        }
        let text = |cell: &&Cell| match cell {
            Cell::Time(nanos) => self.text(*nanos, finest),
            cell => cell.rounded(),
        };
        Some(cells.iter().map(text).collect())
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    /// Sunday, 30 March 2025, 00:30 UTC, half an hour before the clocks of Europe go forward.
    const SPRING: i64 = 1_743_294_600 * SEC;

    fn column(style: &TimeStyle, times: &[i64]) -> (String, Vec<String>) {
        let cells: Vec<Cell> = times.iter().map(|&time| Cell::Time(time)).collect();
        let mut header = "time".to_owned();
        let texts = style.column(&mut header, &cells.iter().collect::<Vec<_>>());
        (header, texts.unwrap_or_default())
    }

    #[test]
    fn times_are_those_of_the_clocks_there() {
        let berlin = TimeStyle::Clock(Zone::named("Europe/Berlin").expect("a zone"));
        let (header, texts) = column(&berlin, &[SPRING, SPRING + 3_600 * SEC]);
        assert_eq!(header, "time (Europe/Berlin)");
        assert_eq!(texts, ["Sun 2025-03-30 01:30", "Sun 2025-03-30 03:30"]);
        assert_eq!((berlin.label(SPRING), TimeStyle::Nanos.label(5)), ("Sun 01:30".to_owned(), "5".to_owned()));
        assert_eq!(berlin.heading(SPRING), "Sun 2025-03-30 01:30 (Europe/Berlin)");
        let (header, texts) = column(&TimeStyle::Clock(Zone::utc()), &[SPRING, SPRING + 5 * SEC, 0]);
        assert_eq!(header, "time (UTC)");
        assert_eq!(texts, ["Sun 2025-03-30 00:30:00", "Sun 2025-03-30 00:30:05", "Thu 1970-01-01 00:00:00"]);
        assert_eq!(column(&TimeStyle::Clock(Zone::utc()), &[SPRING + 1_999]).1, ["Sun 2025-03-30 00:30:00.000"]);
        let west = TimeStyle::Clock(Zone::named("America/New_York").expect("a zone"));
        assert_eq!(column(&west, &[0, i64::MAX]).1.len(), 2);
    }

    #[test]
    fn other_styles_are_numbers() {
        assert_eq!(column(&TimeStyle::Nanos, &[SPRING]), ("time (ns)".to_owned(), vec![SPRING.to_string()]));
        assert_eq!(column(&TimeStyle::Unix, &[SPRING]).0, "time");
    }

    #[test]
    fn the_hour_that_comes_twice_has_its_offset() {
        let berlin = TimeStyle::Clock(Zone::named("Europe/Berlin").expect("a zone"));
        // 2025-10-26T00:00:00Z, 02:00 in Berlin for the first time.
        let first = 1_761_436_800 * SEC;
        let texts = column(&berlin, &[-1, 0, 1, 2].map(|hours| first + hours * 3_600 * SEC)).1;
        let clocks: Vec<&str> = texts.iter().filter_map(|text| text.get(15..)).collect();
        assert_eq!(clocks, ["01:00", "02:00+02:00", "02:00+01:00", "03:00"]);
        let last = column(&berlin, &[first - SEC, first + 7_199 * SEC, first + 7_200 * SEC]).1;
        let clocks: Vec<&str> = last.iter().filter_map(|text| text.get(15..)).collect();
        assert_eq!(clocks, ["01:59:59", "02:59:59+01:00", "03:00:00"]);
        assert_eq!(column(&berlin, &[SPRING, SPRING + 3_600 * SEC]).1.concat().matches('+').count(), 0);
        assert_eq!(["+05:30", "-03:30"].map(str::to_owned), [19_800, -12_600].map(offset_text));
    }
}
