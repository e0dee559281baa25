//! A simulated hall with known walls, and a robot that patrols it with two planar scanners.
//!
//! The hall has what makes a learned grid wrong: a corridor whose walls beams graze, shelves that the upper scanner
//! does not see, boards that the lower one does not see, dark and shiny walls from which few beams return, and a table
//! that stands there from 9 to 12 on working days. The robot's reported pose drifts. On working days it patrols in each
//! half hour from 8 to 18, otherwise once an hour.
//!
//! Invariant: pure. The scans of a day depend on the options and the number of the day only, and the truth depends on
//! the scans that it notes.

mod options;
mod plan;
mod robot;
mod score;
mod solid;
mod truth;

use jiff::{
    ToSpan as _,
    civil::Date,
    tz::{TimeZone, TimeZoneDatabase},
};
use rand::Rng as _;

use self::plan::{HallPlan, TABLE_HOURS};
pub use self::{
    options::HallOptions,
    plan::HallThing,
    robot::{HALL_SCANNERS, HallPose, HallScan, HallScanner},
    score::{CellShare, HallScore, TableScore},
    truth::{HallCell, HallTruth},
};
use crate::{
    civil_day::{CivilDay, clock_day},
    draw::{DrawTopic, draws},
    people::closed,
    zone::UnknownZone,
};

const MINUTE_MILLIS: i32 = 60_000;
const HOUR_MILLIS: i32 = 60 * MINUTE_MILLIS;
/// The hours of a working day with a patrol in each half hour.
const BUSY_HOURS: std::ops::Range<i32> = 8..18;

/// A hall and its robot.
///
/// ```
/// use tidemap_sim::{Hall, HallOptions};
///
/// let hall = Hall::new(HallOptions { stops: 4, ..HallOptions::default() })?;
/// let mut truth = hall.truth();
/// for scan in hall.patrol(0, 12) {
///     truth.note(&scan);
/// }
/// let first = truth.cells().iter().find(|cell| cell.ends > 0).expect("a wall that was seen");
/// assert!(first.thing.is_some());
/// # Ok::<(), tidemap_sim::UnknownZone>(())
/// ```
#[derive(Clone, Debug)]
pub struct Hall {
    options: HallOptions,
    zone: TimeZone,
    plan: HallPlan,
}

impl Hall {
    /// A hall with these options.
    ///
    /// # Errors
    /// [`UnknownZone`] if the bundled IANA database has no such zone.
    pub fn new(options: HallOptions) -> Result<Self, UnknownZone> {
        let zone = TimeZoneDatabase::bundled().get(&options.zone).map_err(|_| UnknownZone(options.zone.clone()))?;
        Ok(Self { options, zone, plan: HallPlan::new() })
    }

    /// The cells, of which none was seen yet.
    pub fn truth(&self) -> HallTruth {
        HallTruth::new(&self.plan)
    }

    /// Whether people work on a day; day 0 is the first.
    pub fn is_working_day(&self, day: u32) -> bool {
        !closed(self.date(day))
    }

    /// The time at which the hall's clock shows a minute of a day, nanoseconds UTC.
    pub fn utc_nanos(&self, day: u32, minute: i32) -> i64 {
        clock_day(&self.zone, CivilDay::new(self.date(day))).utc_nanos(minute * MINUTE_MILLIS)
    }

    /// Number of patrols of a day.
    pub fn patrols(&self, day: u32) -> u32 {
        self.starts(day).count() as u32
    }

    /// The scans of a patrol of a day, in order of time.
    ///
    /// # Panics
    /// If the day does not have so many patrols.
    pub fn patrol(&self, day: u32, patrol: u32) -> Vec<HallScan> {
        let date = self.date(day);
        let clock = clock_day(&self.zone, CivilDay::new(date));
        let Some((start_millis, spare_millis)) = self.starts(day).nth(patrol as usize) else {
            panic!("day {day} has no patrol {patrol}: it has {}", self.patrols(day));
        };
        let mut rng = draws(self.options.seed, DrawTopic::HallPatrol, patrol as usize, date);
        let start_nanos = clock.utc_nanos(start_millis + rng.random_range(0..spare_millis));
        let [from, to] = [TABLE_HOURS.start, TABLE_HOURS.end].map(|hour| clock.utc_nanos(hour * HOUR_MILLIS));
        let has_table = |nanos| !closed(date) && (from..to).contains(&nanos);
        robot::patrol(&self.plan, &self.options, start_nanos, has_table, &mut rng)
    }

    fn date(&self, day: u32) -> Date {
        self.options.first_day.saturating_add(i64::from(day).days())
    }

    /// The beginning of the time in which each patrol of a day starts, and the length of that time, milliseconds.
    fn starts(&self, day: u32) -> impl Iterator<Item = (i32, i32)> {
        let is_open = self.is_working_day(day);
        (0..48).filter_map(move |half_hour| {
            let is_busy = is_open && BUSY_HOURS.contains(&(half_hour / 2));
            let spare_millis = if is_busy { 20 * MINUTE_MILLIS } else { 50 * MINUTE_MILLIS };
            (is_busy || half_hour % 2 == 0).then_some((half_hour * HOUR_MILLIS / 2, spare_millis))
        })
    }
}
