//! Simulated offices for the demo, the benchmarks and the tests. [`Office`] has doors and rooms, people with daily and
//! weekly routines on local civil time, and robots that stop irregularly. [`GridOffice`] is a stream of occupancy
//! grids, [`ExploredOffice`] a small floor for exploration experiments, [`Home`] a home whose
//! sensors report changes, [`BuildingDay`] a day of a building with a floor, rooms, doors and drives,
//! [`StreamOffice`] a floor with streams of people, and [`Hall`] a hall with known walls that a robot scans.
//!
//! Invariant: pure. No I/O, no clock; the seed is an argument, and the truth at a time depends on the seed, the zone
//! and that time only, so that queries can come in any order. Draws may change with the version of this crate.
//!
//! ```
//! let office = tidemap_sim::Office::new(1, "Europe/London")?;
//! let kitchen = office.states().iter().position(|&state| state == "kitchen").expect("a kitchen");
//! // Tuesday 2025-04-15 at 03:00 in London: nobody is there.
//! assert!(office.truth(kitchen, 1_744_682_400_000_000_000) < 0.5);
//! # Ok::<(), tidemap_sim::UnknownZone>(())
//! ```

mod building;
mod civil_day;
mod cleaner;
mod day;
mod draw;
mod explored_office;
mod grid_office;
mod hall;
mod home;
mod patrol;
mod people;
mod place;
mod streams;
mod zone;

use jiff::{
    SignedDuration, Timestamp,
    civil::Date,
    tz::{TimeZone, TimeZoneDatabase},
};

pub use self::building::{
    BuildingDay, BuildingDrive, BuildingPlace, BuildingReading, FloorPlan, building_places, building_ways,
};
pub use self::explored_office::ExploredOffice;
pub use self::grid_office::{DayScans, GridOffice, GridOfficeError, GridOfficeOptions, GridScan, GridStream};
pub use self::hall::{
    CellShare, HALL_SCANNERS, Hall, HallCell, HallOptions, HallPose, HallScan, HallScanner, HallScore, HallThing,
    HallTruth, TableScore,
};
pub use self::home::{Home, SensorChange};
pub use self::streams::{DetectedWalk, StreamOffice, StreamWalk};
pub use self::zone::UnknownZone;
use crate::{
    civil_day::{CivilDay, midnight_nanos},
    day::OfficeDay,
    patrol::ROBOTS,
    place::STATES,
};

/// An office with its people and robots.
#[derive(Clone, Debug)]
pub struct Office {
    seed: u64,
    zone: TimeZone,
}

impl Office {
    /// An office in a time zone. A different `seed` gives different days, but the same routines.
    ///
    /// # Errors
    /// [`UnknownZone`] if the bundled IANA database has no zone `zone_name`.
    pub fn new(seed: u64, zone_name: &str) -> Result<Self, UnknownZone> {
        let zone = TimeZoneDatabase::bundled().get(zone_name).map_err(|_| UnknownZone(zone_name.to_owned()))?;
        Ok(Self { seed, zone })
    }

    /// Names of the states. Doors are 1 when open, rooms are 1 when a person is in them.
    pub fn states(&self) -> &'static [&'static str] {
        &STATES
    }

    /// Names of the robots.
    pub fn robots(&self) -> Vec<&'static str> {
        ROBOTS.iter().map(|robot| robot.name).collect()
    }

    /// The value of the state at index `state` at a time in nanoseconds UTC: 0 or 1.
    ///
    /// # Panics
    /// If `state` is not an index of [`Office::states`].
    pub fn truth(&self, state: usize, utc_nanos: i64) -> f64 {
        let (date, second) = self.local(utc_nanos);
        OfficeDay::new(self.seed, date).value(state, second)
    }

    /// The observations of the robot at index `robot` in `from_nanos..to_nanos` UTC: time in nanoseconds UTC, index of
    /// the state, value; ordered by time, then by state. Adjacent windows give the same as one window over both.
    ///
    /// # Panics
    /// If `robot` is not an index of [`Office::robots`].
    pub fn visits(&self, robot: usize, from_nanos: i64, to_nanos: i64) -> impl Iterator<Item = (i64, usize, f64)> + '_ {
        assert!(robot < ROBOTS.len(), "robot {robot} is out of range: there are {}", ROBOTS.len());
        let first = self.local(from_nanos).0;
        let dates = first.series(jiff::Span::new().days(1));
        dates
            .take_while(move |&date| midnight_nanos(&self.zone, CivilDay::new(date)) < to_nanos)
            .flat_map(move |date| self.visits_of_day(robot, date))
            .filter(move |&(time, ..)| (from_nanos..to_nanos).contains(&time))
    }

    fn visits_of_day(&self, robot: usize, date: Date) -> Vec<(i64, usize, f64)> {
        let day = OfficeDay::new(self.seed, date);
        let today = CivilDay::new(date);
        let (start, end) = (midnight_nanos(&self.zone, today), midnight_nanos(&self.zone, today.plus(1)));
        let mut seen = Vec::new();
        for stop in patrol::stops(self.seed, robot, date, end - start) {
            let time = start + stop.nanos;
            let (on, second) = self.local(time);
            debug_assert_eq!(on, date, "a stop lies within its local day");
            seen.extend(stop.place.states().iter().map(|&state| (time, state, day.value(state, second))));
        }
        seen
    }

    /// Local date and second of that day, as the wall clock shows them.
    fn local(&self, utc_nanos: i64) -> (Date, i32) {
        let local = self.zone.to_datetime(Timestamp::UNIX_EPOCH + SignedDuration::from_nanos(utc_nanos));
        let second = i32::from(local.hour()) * 3600 + i32::from(local.minute()) * 60 + i32::from(local.second());
        (local.date(), second)
    }
}
