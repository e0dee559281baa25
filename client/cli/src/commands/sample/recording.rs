//! A recording of a robot in a corridor with two doors.
//!
//! Invariant: the ranges follow from the doors at that time.

use std::{
    f64::consts::TAU,
    fs::{self, File},
    io::BufWriter,
    path::Path,
};

use tidemap_formats::robot_recording::{RingScan, RobotRecording};
use tidemap_model::Zone;

use super::{START_SECS, SampleFile, ZONE};

const DAYS: i64 = 14;
const STEP_SECS: i64 = 600;
const SEC_NANOS: i64 = 1_000_000_000;
const RAYS: u32 = 360;
/// Half the length and half the width of the corridor, metres.
const HALF_LENGTH: f64 = 6.0;
const HALF_WIDTH: f64 = 1.0;
/// The depth of the rooms behind the doors, metres.
const DEPTH: f64 = 4.0;

/// A door in a long wall: from where to where along the corridor, and whether in the wall on the left.
struct Door {
    name: &'static str,
    from: f64,
    to: f64,
    is_left: bool,
}

const DOORS: [Door; 2] = [
    Door { name: "left", from: 1.5, to: 2.5, is_left: true },
    Door { name: "right", from: -2.5, to: -1.5, is_left: false },
];

const TRY: &str = r#"#!/bin/sh
# Two weeks of a robot in a corridor. Start a daemon first, in a terminal of its own: tidemapd --data-dir ./tidemap-data
cd "$(dirname "$0")" || exit 1
set -ex

# The contents of the recording, and the observations that would be made of it.
tidemap import corridor robot.mcap --list

# The map. With --nightly it learns as if the two weeks happened now.
tidemap import corridor robot.mcap --nightly --time-zone Europe/London

# Will the doors be open?
tidemap predict corridor left right --date 2025-01-21 --picture

# The page, with a slider for the time: tidemap open corridor
"#;

pub(super) fn write(folder: &Path) -> anyhow::Result<Vec<SampleFile>> {
    let mut recording = RobotRecording::new(BufWriter::new(File::create(folder.join("robot.mcap"))?))?;
    let zone = Zone::named(ZONE)?;
    let mut messages = 1;
    recording.transform(("/tf_static", START_SECS * SEC_NANOS), ("base_link", "laser"), [0.1, 0.0, 0.3], 0.0)?;
    for step in 0..DAYS * 86_400 / STEP_SECS {
        let time = (START_SECS + step * STEP_SECS) * SEC_NANOS;
        let open = is_open(&zone, time);
        let (x, yaw) = (0.2 * (step % 5) as f64, 0.02 * (step % 7) as f64);
        recording.transform(("/tf", time), ("map", "odom"), [0.0; 3], 0.0)?;
        recording.transform(("/tf", time), ("odom", "base_link"), [x, 0.0, 0.0], yaw)?;
        let at = [x + 0.1 * yaw.cos(), 0.1 * yaw.sin()];
        let ranges: Vec<f32> =
            (0..RAYS).map(|ray| range(at, yaw + TAU * f64::from(ray) / f64::from(RAYS), open) as f32).collect();
        recording.scan(("/scan", time), &RingScan { frame: "laser", limits_m: [0.1, 30.0], ranges_m: &ranges })?;
        for (door, open) in DOORS.iter().zip(open) {
            recording.door(("/door_states", time), door.name, open)?;
        }
        messages += 5;
    }
    recording.finish()?;
    fs::write(folder.join("try.sh"), TRY)?;
    Ok(vec![
        SampleFile {
            name: "robot.mcap",
            rows: messages,
            what: "two weeks of a robot in a corridor: scans, transforms, doors",
        },
        SampleFile { name: "try.sh", rows: TRY.lines().count() as u64, what: "commands to try" },
    ])
}

/// Whether each door is open: the left one from 8 to 18 o'clock from Monday to Friday, the right one from 12 to 14.
fn is_open(zone: &Zone, time_nanos: i64) -> [bool; 2] {
    let weekday = zone.day_of(time_nanos).weekday();
    let hour = (time_nanos / SEC_NANOS + i64::from(zone.offset_secs(time_nanos))).rem_euclid(86_400) / 3600;
    [weekday < 5 && (8..18).contains(&hour), (12..14).contains(&hour)]
}

/// The range from a place in the corridor to the next wall, metres.
fn range([x, y]: [f64; 2], angle: f64, open: [bool; 2]) -> f64 {
    let (cos, sin) = (angle.cos(), angle.sin());
    let to = |at: f64, direction: f64, wall: f64| {
        let range = (wall - at) / direction;
        if direction.abs() > 1e-9 && range > 0.0 { range } else { f64::INFINITY }
    };
    let end = to(x, cos, HALF_LENGTH).min(to(x, cos, -HALF_LENGTH));
    let (left, right) = (to(y, sin, HALF_WIDTH), to(y, sin, -HALF_WIDTH));
    let side = left.min(right);
    if end < side {
        return end;
    }
    let along = x + side * cos;
    let passes =
        |(door, open): (&Door, bool)| open && door.is_left == (left < right) && (door.from..door.to).contains(&along);
    if DOORS.iter().zip(open).any(passes) {
        // The room behind the door is as wide as the corridor is long.
        let back = to(y, sin, HALF_WIDTH + DEPTH).min(to(y, sin, -HALF_WIDTH - DEPTH));
        return back.min(end);
    }
    side
}
