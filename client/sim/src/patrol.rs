//! The robots' rounds: when each stops where.
//!
//! Invariant: stops are in time order and irregular: random gaps, breaks for charging, days in the workshop. A day's
//! stops depend on the seed, the robot and the date only.

use jiff::civil::Date;
use rand::{Rng, seq::IndexedRandom};

use crate::{
    SECOND_NANOS,
    draw::{Topic, draws},
    people::closed,
    place::{PLACES, Place},
};

/// How a robot works.
pub(crate) struct Robot {
    /// Its name.
    pub(crate) name: &'static str,
    /// Mean time between two stops.
    gap_secs: f64,
    /// Hours of duty since local midnight.
    hours: std::ops::Range<i64>,
    /// Whether it also patrols when the office is closed.
    always: bool,
}

/// The robots.
pub(crate) const ROBOTS: [Robot; 3] = [
    Robot { name: "robot-ada", gap_secs: 240.0, hours: 0..25, always: true },
    Robot { name: "robot-bob", gap_secs: 180.0, hours: 6..21, always: true },
    Robot { name: "robot-cleo", gap_secs: 420.0, hours: 8..18, always: false },
];

/// A stop of a robot.
#[derive(Clone, Copy, Debug)]
pub(crate) struct Stop {
    /// Elapsed time since local midnight, whole seconds.
    pub(crate) secs: i64,
    /// The rest of it in nanoseconds, below one second.
    pub(crate) nanos: i64,
    /// Where.
    pub(crate) place: Place,
}

/// The stops of a robot on a local day that lasts `day_secs`.
pub(crate) fn stops(seed: u64, robot: usize, date: Date, day_secs: i64) -> Vec<Stop> {
    let mut rng = draws(seed, Topic::Patrol, robot, date);
    let robot = &ROBOTS[robot];
    if (closed(date) && !robot.always) || rng.random_bool(0.03) {
        return Vec::new();
    }
    let end = day_secs.min(robot.hours.end * 3600) as f64;
    let mut clock = (robot.hours.start * 3600) as f64;
    let mut battery_secs: f64 = rng.random_range(600.0..4.0 * 3600.0);
    let mut stops = Vec::new();
    loop {
        // Waiting times without a memory, and never two stops at once.
        let gap = 20.0 - robot.gap_secs * rng.random_range(f64::EPSILON..1.0_f64).ln();
        clock += gap;
        battery_secs -= gap;
        if battery_secs < 0.0 {
            clock += rng.random_range(40.0..100.0) * 60.0;
            battery_secs = rng.random_range(2.0..4.0) * 3600.0;
        }
        let Some(&place) = PLACES.choose(&mut rng).filter(|_| clock < end) else { return stops };
        let nanos = (clock.fract() * 1e3) as i64 * (SECOND_NANOS / 1000);
        stops.push(Stop { secs: clock as i64, nanos, place });
    }
}
