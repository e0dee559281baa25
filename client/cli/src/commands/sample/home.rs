//! A home with forty sensors, as a hub exports them: rows at changes only, local times, the hub's columns and words.
//!
//! Invariant: one sensor is out of reach for a week, and its rows state this; clocks are set forward once.

use std::{fmt::Write as _, fs, path::Path};

use jiff::civil::date;
use tidemap_sim::Home;

use super::{SEED, SampleFile, ZONE};

/// Days that are exported, from 1 February 2025 on, and days after them.
const DAYS: i32 = 83;
const AFTER: i32 = 7;
/// The sensor that is out of reach, and when, in days.
const AWAY: &str = "binary_sensor.garage_door";
const AWAY_DAYS: std::ops::Range<i64> = 40..47;
const STEP_SECS: i64 = 300;
const DAY_SECS: i64 = 86_400;

const TRY: &str = r#"#!/bin/sh
# A home with forty sensors. Start a daemon first, in a terminal of its own: tidemapd --data-dir ./tidemap-data
cd "$(dirname "$0")" || exit 1
set -ex

# A map in the home's time zone, and the export of the hub as it is: changes only, local times, its own columns.
tidemap map create smart-home --time-zone Europe/London
tidemap observe smart-home export.csv --changes --local --columns time=last_changed,state=entity_id,value=state

# Learn now instead of at midnight.
tidemap update smart-home

# Every sensor for a day, and the unusual observations of the last week.
tidemap predict smart-home --date 2025-04-25 --picture
tidemap anomalies smart-home --top 10

# How good is that? Compare with the week that really came.
tidemap evaluate smart-home next-week.csv --models auto,mean --output csv | awk -F, '
  NR > 1 { n[$2] += $4; sum[$2] += $4 * $5 } END { for (m in n) print m ": mse " sum[m] / n[m] }'
"#;

pub(super) fn write(folder: &Path) -> anyhow::Result<Vec<SampleFile>> {
    let home = Home::new(SEED, ZONE)?;
    let names = Home::sensors();
    let changes = home.changes(date(2025, 2, 1), DAYS + AFTER);
    let begin = changes.first().map_or(0, |change| change.secs);
    let is_away = |name: &str, secs: i64| name == AWAY && AWAY_DAYS.contains(&((secs - begin) / DAY_SECS));
    let end = begin + i64::from(DAYS) * DAY_SECS;
    let (mut export, mut rows, mut away) = ("entity_id,state,last_changed\n".to_owned(), 0_u64, false);
    for change in changes.iter().filter(|change| change.secs < end) {
        let Some(name) = names.get(change.sensor) else { continue };
        let is_gone = is_away(name, change.secs);
        if is_gone && away {
            continue;
        }
        // The sensor was away with its last value until the first change after the week.
        away = if name == AWAY { is_gone } else { away };
        let word = match (is_gone, change.is_on) {
            (true, _) => "unavailable",
            (_, true) => "on",
            (_, false) => "off",
        };
        writeln!(export, "{name},{word},{}", change.local)?;
        rows += 1;
    }
    fs::write(folder.join("export.csv"), export)?;
    let (mut after, mut readings) = ("time,state,value\n".to_owned(), 0_u64);
    let mut value = vec![0_u8; names.len()];
    let mut left = changes.iter().peekable();
    for secs in (begin..end + i64::from(AFTER) * DAY_SECS).step_by(STEP_SECS as usize) {
        while let Some(change) = left.next_if(|change| change.secs <= secs) {
            if let Some(value) = value.get_mut(change.sensor) {
                *value = u8::from(change.is_on);
            }
        }
        for (name, value) in names.iter().zip(&value).filter(|_| secs >= end) {
            writeln!(after, "{secs},{name},{value}")?;
            readings += 1;
        }
    }
    fs::write(folder.join("next-week.csv"), after)?;
    fs::write(folder.join("try.sh"), TRY)?;
    Ok(vec![
        SampleFile { name: "export.csv", rows, what: "12 weeks of 40 sensors, as the hub exports them" },
        SampleFile { name: "next-week.csv", rows: readings, what: "the week after, read every five minutes" },
        SampleFile { name: "try.sh", rows: TRY.lines().count() as u64, what: "commands to try" },
    ])
}
