//! A home with forty sensors that report changes: doors, windows, lights, motion and plugs in eight rooms.
//!
//! Invariant: what a sensor shows at a time depends on the seed, the zone and that time only.

use jiff::{
    Timestamp, ToSpan,
    civil::Date,
    tz::{TimeZone, TimeZoneDatabase},
};
use rand::{Rng as _, rngs::SmallRng};

use crate::{
    draw::{DrawTopic, around, draws},
    zone::UnknownZone,
};

/// The rooms.
const ROOMS: [&str; 8] = ["hall", "kitchen", "living_room", "bedroom", "bathroom", "office", "garage", "garden"];

/// The thing that is sensed in a room.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
enum Thing {
    Door,
    Window,
    Light,
    Motion,
    Plug,
}

const THINGS: [Thing; 5] = [Thing::Door, Thing::Window, Thing::Light, Thing::Motion, Thing::Plug];
const HOUR: i32 = 3_600;
const DAY: i32 = 24 * HOUR;

/// A change of a sensor.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct SensorChange {
    /// The time, seconds since 1970 UTC.
    pub secs: i64,
    /// The wall clock of the home at that time, such as `2025-03-30 14:05:09`.
    pub local: String,
    /// Index of the sensor.
    pub sensor: usize,
    /// Whether the sensor is on, or open, from then on.
    pub is_on: bool,
}

/// A home with its sensors.
#[derive(Clone, Debug)]
pub struct Home {
    seed: u64,
    zone: TimeZone,
}

impl Home {
    /// A home in a time zone. A different `seed` gives different days, but the same routines.
    ///
    /// # Errors
    /// [`UnknownZone`] if the bundled IANA database has no zone `zone_name`.
    pub fn new(seed: u64, zone_name: &str) -> Result<Self, UnknownZone> {
        let zone = TimeZoneDatabase::bundled().get(zone_name).map_err(|_| UnknownZone(zone_name.to_owned()))?;
        Ok(Self { seed, zone })
    }

    /// Names of the sensors, as a hub gives them.
    #[must_use]
    pub fn sensors() -> Vec<String> {
        let name = |(room, thing): (&str, Thing)| match thing {
            Thing::Door => format!("binary_sensor.{room}_door"),
            Thing::Window => format!("binary_sensor.{room}_window"),
            Thing::Light => format!("light.{room}"),
            Thing::Motion => format!("binary_sensor.{room}_motion"),
            Thing::Plug => format!("switch.{room}_plug"),
        };
        ROOMS.into_iter().flat_map(|room| THINGS.map(|thing| (room, thing))).map(name).collect()
    }

    /// The changes of all sensors on some days, in order of time; at first each sensor reports its value.
    #[must_use]
    pub fn changes(&self, first: Date, days: i32) -> Vec<SensorChange> {
        let mut changes = Vec::new();
        let begin = self.secs(first, 0);
        for sensor in 0..ROOMS.len() * THINGS.len() {
            let on: Vec<(i64, i64)> =
                (0..days).flat_map(|day| self.on(sensor, first.saturating_add(day.days()))).collect();
            let mut is_on = on.first().is_some_and(|(from, _)| *from <= begin);
            changes.push(self.change(begin + sensor as i64, sensor, is_on));
            for (secs, value) in on.into_iter().flat_map(|(from, to)| [(from, true), (to, false)]) {
                if value != is_on {
                    changes.push(self.change(secs.max(begin + sensor as i64), sensor, value));
                    is_on = value;
                }
            }
        }
        changes.sort_by_key(|change| change.secs);
        changes
    }

    fn change(&self, secs: i64, sensor: usize, is_on: bool) -> SensorChange {
        let zoned = Timestamp::from_second(secs).unwrap_or(Timestamp::UNIX_EPOCH).to_zoned(self.zone.clone());
        SensorChange { secs, local: zoned.strftime("%Y-%m-%d %H:%M:%S").to_string(), sensor, is_on }
    }

    /// Seconds UTC of a second of a date on the wall clock.
    fn secs(&self, date: Date, of_day: i32) -> i64 {
        let of_day = of_day.clamp(0, DAY - 1);
        let civil = date.at((of_day / HOUR) as i8, (of_day / 60 % 60) as i8, (of_day % 60) as i8, 0);
        self.zone.to_timestamp(civil).map_or(0, |timestamp| timestamp.as_second())
    }

    /// The intervals of a date in which a sensor is on, ascending and apart.
    fn on(&self, sensor: usize, date: Date) -> Vec<(i64, i64)> {
        let (room, thing) = (sensor / THINGS.len(), THINGS.get(sensor % THINGS.len()).copied().unwrap_or(Thing::Door));
        let rng = &mut draws(self.seed, DrawTopic::Sensor, sensor, date);
        let is_working_day = date.weekday().to_monday_zero_offset() < 5;
        let wanted = times(rng, room, thing, is_working_day);
        let mut on: Vec<(i64, i64)> = Vec::new();
        let mut starts: Vec<(i32, i32)> = wanted.into_iter().filter(|(from, to)| from < to).collect();
        starts.sort_unstable();
        for (from, to) in starts {
            let (from, to) = (self.secs(date, from), self.secs(date, to));
            match on.last_mut() {
                Some((_, end)) if from <= *end => *end = to.max(*end),
                _ if from < to => on.push((from, to)),
                _ => {}
            }
        }
        on
    }
}

/// The times at which a thing is on, in seconds of the day.
fn times(rng: &mut SmallRng, room: usize, thing: Thing, is_working_day: bool) -> Vec<(i32, i32)> {
    let shift = room as i32 * 7 * 60;
    let mut wanted = Vec::new();
    match thing {
        // The office is used on working days; other doors open for a moment.
        Thing::Door if room == 5 => {
            if is_working_day {
                wanted.push((around(rng, 9 * HOUR, 900), around(rng, 17 * HOUR, 1_800)));
            }
        }
        Thing::Door => {
            for hour in [7, 8, 13, 17, 19, 21] {
                if rng.random_bool(0.6) {
                    let from = around(rng, hour * HOUR + shift, 1_500);
                    wanted.push((from, from + rng.random_range(15..900)));
                }
            }
        }
        Thing::Window => {
            if rng.random_bool(0.85) {
                let from = around(rng, 7 * HOUR + shift, 900);
                wanted.push((from, from + around(rng, 2_400, 600).max(60)));
            }
        }
        Thing::Light => {
            wanted.push((around(rng, 18 * HOUR + shift, 1_200), around(rng, 22 * HOUR + shift / 2, 1_200)));
            if is_working_day {
                wanted.push((around(rng, 6 * HOUR + 1_800, 600), around(rng, 7 * HOUR + 1_800, 600)));
            }
        }
        Thing::Motion => {
            let hours = if is_working_day { [6, 7, 12, 17, 18, 19, 20, 21] } else { [8, 9, 10, 12, 15, 18, 20, 22] };
            for hour in hours {
                let from = around(rng, hour * HOUR + shift, 1_800);
                wanted.push((from, from + rng.random_range(60..1_800)));
            }
        }
        Thing::Plug => {
            let evening = if is_working_day { 20 } else { 15 };
            wanted.push((around(rng, evening * HOUR + shift / 2, 1_200), around(rng, 22 * HOUR + 1_800, 1_200)));
        }
    }
    wanted
}

#[cfg(test)]
mod tests {
    use jiff::civil::date;

    use super::*;

    #[test]
    fn sensors_report_each_change_once_on_their_wall_clock() {
        let home = Home::new(1, "Europe/London").expect("a zone");
        let changes = home.changes(date(2025, 3, 28), 5);
        assert_eq!(Home::sensors().len(), 40);
        let mut is_on = [None; 40];
        for change in &changes {
            assert_ne!(is_on[change.sensor], Some(change.is_on), "{change:?}");
            is_on[change.sensor] = Some(change.is_on);
        }
        assert!(changes.is_sorted_by_key(|change| change.secs));
        assert!(is_on.iter().all(Option::is_some));
        // Clocks are set forward on the thirtieth.
        let offset = |change: &SensorChange| {
            let civil: jiff::civil::DateTime = change.local.parse().expect("a civil time");
            civil.to_zoned(TimeZone::UTC).expect("in range").timestamp().as_second() - change.secs
        };
        assert_eq!((offset(&changes[0]), changes.last().map(offset)), (0, Some(3_600)));
        assert_eq!(home.changes(date(2025, 3, 28), 5), changes);
    }
}
