//! A simulated office, for the demo, the benchmarks and the tests: doors and rooms, people with daily and weekly
//! routines on local civil time, and robots that pass by irregularly. [`GridOffice`] is another one, as a stream of
//! occupancy grids, [`ExploredOffice`] a small floor to be explored.
//!
//! Invariant: pure. No I/O, no clock; the seed is an argument, and the truth at a time depends on the seed, the zone
//! and that time only, so that it can be asked for in any order. Draws hold for one version of this crate.
//!
//! ```
//! let office = tidemap_sim::Office::new(1, "Europe/London")?;
//! let kitchen = office.states().iter().position(|&state| state == "kitchen").expect("it has one");
//! // Tuesday 2025-04-15 at 03:00 in London: nobody is there.
//! assert!(office.truth(kitchen, 1_744_682_400_000_000_000) < 0.5);
//! # Ok::<(), tidemap_sim::UnknownZone>(())
//! ```

mod cleaner;
mod day;
mod draw;
mod explored_office;
mod grid_office;
mod patrol;
mod people;
mod place;

use jiff::{
    Timestamp,
    civil::Date,
    tz::{TimeZone, TimeZoneDatabase},
};

pub use self::explored_office::ExploredOffice;
pub use self::grid_office::{DayScans, GridOffice, GridOfficeError, GridOfficeOptions, GridScan, GridStream};
use crate::{day::Day, patrol::ROBOTS, place::STATES};

/// Nanoseconds in a second.
const SECOND_NANOS: i64 = 1_000_000_000;

/// The time zone database has no zone of this name.
#[derive(Clone, Debug, PartialEq, Eq, thiserror::Error)]
#[error("time zone {0:?} is not known: use a name of the IANA database, for example \"Europe/London\"")]
pub struct UnknownZone(pub String);

/// An office with its people and robots.
#[derive(Clone, Debug)]
pub struct Office {
    seed: u64,
    zone: TimeZone,
}

impl Office {
    /// An office by whose wall clocks the people live. Another `seed` gives other people's days, not other routines.
    ///
    /// # Errors
    /// [`UnknownZone`], where the bundled IANA database has no zone `zone_name`.
    pub fn new(seed: u64, zone_name: &str) -> Result<Self, UnknownZone> {
        let zone = TimeZoneDatabase::bundled().get(zone_name).map_err(|_| UnknownZone(zone_name.to_owned()))?;
        Ok(Self { seed, zone })
    }

    /// Names of the states. Doors are 1 when open, rooms when somebody is in them.
    #[must_use]
    pub fn states(&self) -> &'static [&'static str] {
        &STATES
    }

    /// Names of the robots.
    #[must_use]
    pub fn robots(&self) -> Vec<&'static str> {
        ROBOTS.iter().map(|robot| robot.name).collect()
    }

    /// The value of the state at index `state` at a time in nanoseconds UTC: 0 or 1.
    ///
    /// # Panics
    /// If `state` is not an index of [`Office::states`].
    #[must_use]
    pub fn truth(&self, state: usize, utc_nanos: i64) -> f64 {
        let (date, second) = self.local(utc_nanos);
        Day::new(self.seed, date).value(state, second)
    }

    /// What the robot at index `robot` sees in `from_nanos..to_nanos` UTC: time in nanoseconds UTC, index of the state,
    /// value; by time, and within one time by state. Windows that touch give what one window over both gives.
    ///
    /// # Panics
    /// If `robot` is not an index of [`Office::robots`].
    pub fn visits(&self, robot: usize, from_nanos: i64, to_nanos: i64) -> impl Iterator<Item = (i64, usize, f64)> + '_ {
        assert!(robot < ROBOTS.len(), "robot {robot} is not one of the {} there are", ROBOTS.len());
        let first = self.local(from_nanos).0;
        let dates = first.series(jiff::Span::new().days(1));
        dates
            .take_while(move |&date| self.midnight_nanos(date) < to_nanos)
            .flat_map(move |date| self.visits_of_day(robot, date))
            .filter(move |&(time, ..)| (from_nanos..to_nanos).contains(&time))
    }

    fn visits_of_day(&self, robot: usize, date: Date) -> Vec<(i64, usize, f64)> {
        let day = Day::new(self.seed, date);
        let tomorrow = date.tomorrow().expect("a date before the year 9999");
        let (start, end) = (self.midnight_nanos(date), self.midnight_nanos(tomorrow));
        let mut seen = Vec::new();
        for stop in patrol::stops(self.seed, robot, date, (end - start) / SECOND_NANOS) {
            let time = start + stop.secs * SECOND_NANOS + stop.nanos;
            let (on, second) = self.local(time);
            debug_assert_eq!(on, date, "a stop lies within its local day");
            seen.extend(stop.place.states().iter().map(|&state| (time, state, day.value(state, second))));
        }
        seen
    }

    /// Local date, and the second of it that the wall clock shows.
    fn local(&self, utc_nanos: i64) -> (Date, i32) {
        let timestamp =
            Timestamp::from_nanosecond(i128::from(utc_nanos)).expect("every i64 of nanoseconds is in range");
        let local = self.zone.to_datetime(timestamp);
        let second = i32::from(local.hour()) * 3600 + i32::from(local.minute()) * 60 + i32::from(local.second());
        (local.date(), second)
    }

    /// First instant of a local date in nanoseconds UTC.
    fn midnight_nanos(&self, date: Date) -> i64 {
        let start = date.to_zoned(self.zone.clone()).expect("a date before the year 9999");
        i64::try_from(start.timestamp().as_nanosecond()).unwrap_or(i64::MAX)
    }
}
