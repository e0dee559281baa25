//! The robots' patrols: when and where each robot stops.
//!
//! Invariant: stops are in time order and irregular: random gaps, breaks for charging, days in the workshop. A day's
//! stops depend on the seed, the robot and the date only.

use jiff::civil::Date;
use rand::{Rng, seq::IndexedRandom};

use crate::{
    draw::{DrawTopic, draws},
    people::closed,
    place::{OfficePlace, PLACES},
};

const SECOND_NANOS: i64 = 1_000_000_000;

/// A robot and its working habits.
pub(crate) struct PatrolRobot {
    pub(crate) name: &'static str,
    /// Mean time between two stops.
    gap_secs: f64,
    /// Hours of duty since local midnight.
    hours: std::ops::Range<i64>,
    /// Whether the robot also patrols when the office is closed.
    always: bool,
}

pub(crate) const ROBOTS: [PatrolRobot; 3] = [
    PatrolRobot { name: "robot-ada", gap_secs: 240.0, hours: 0..25, always: true },
    PatrolRobot { name: "robot-bob", gap_secs: 180.0, hours: 6..21, always: true },
    PatrolRobot { name: "robot-cleo", gap_secs: 420.0, hours: 8..18, always: false },
];

/// A stop of a robot.
#[derive(Clone, Copy, Debug)]
pub(crate) struct Stop {
    /// Elapsed time since local midnight.
    pub(crate) nanos: i64,
    pub(crate) place: OfficePlace,
}

/// The stops of a robot on a local day that lasts `day_nanos`.
pub(crate) fn stops(seed: u64, robot: usize, date: Date, day_nanos: i64) -> Vec<Stop> {
    let mut rng = draws(seed, DrawTopic::Patrol, robot, date);
    let robot = &ROBOTS[robot];
    if (closed(date) && !robot.always) || rng.random_bool(0.03) {
        return Vec::new();
    }
    let end = (day_nanos / SECOND_NANOS).min(robot.hours.end * 3600) as f64;
    let mut clock = (robot.hours.start * 3600) as f64;
    let mut battery_secs: f64 = rng.random_range(600.0..4.0 * 3600.0);
    let mut stops = Vec::new();
    loop {
        // Exponential waiting times, and at least 20 s between two stops.
        let gap = 20.0 - robot.gap_secs * rng.random_range(f64::EPSILON..1.0_f64).ln();
        clock += gap;
        battery_secs -= gap;
        if battery_secs < 0.0 {
            clock += rng.random_range(40.0..100.0) * 60.0;
            battery_secs = rng.random_range(2.0..4.0) * 3600.0;
        }
        let Some(&place) = PLACES.choose(&mut rng).filter(|_| clock < end) else { return stops };
        let millis = clock as i64 * 1000 + (clock.fract() * 1e3) as i64;
        stops.push(Stop { nanos: millis * (SECOND_NANOS / 1000), place });
    }
}
