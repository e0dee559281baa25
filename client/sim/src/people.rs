//! The people who work in the office, and where each is during a day.
//!
//! Invariant: times are seconds on the wall clock of the local day; routines never see UTC.

use jiff::civil::{Date, Weekday};
use rand::Rng;

use crate::{
    draw::{DrawTopic, around, draws},
    place::OfficePlace,
};

const MINUTE: i32 = 60;
const HOUR: i32 = 60 * MINUTE;

/// Habits of one person.
struct Worker {
    office: usize,
    arrives_secs: i32,
    leaves_secs: i32,
    /// Standard deviation of arrival and departure.
    spread_secs: i32,
    /// Afternoons spent in the lab.
    lab_days: &'static [Weekday],
}

const fn worker(office: usize, (from, to): (i32, i32), spread: i32, lab_days: &'static [Weekday]) -> Worker {
    Worker { office, arrives_secs: from * MINUTE, leaves_secs: to * MINUTE, spread_secs: spread * MINUTE, lab_days }
}

/// Everybody who works in the office; arrival, departure and spread in minutes of the day.
const PEOPLE: [Worker; 6] = [
    worker(0, (8 * 60, 16 * 60 + 30), 10, &[]),
    worker(0, (9 * 60, 17 * 60 + 30), 15, &[Weekday::Monday, Weekday::Wednesday]),
    worker(1, (9 * 60 + 15, 17 * 60 + 30), 15, &[Weekday::Monday, Weekday::Wednesday, Weekday::Friday]),
    worker(1, (8 * 60 + 45, 17 * 60), 10, &[Weekday::Wednesday]),
    worker(2, (10 * 60, 18 * 60 + 30), 25, &[Weekday::Tuesday, Weekday::Thursday]),
    worker(2, (9 * 60 + 30, 18 * 60), 20, &[Weekday::Monday]),
];

/// Start, end and place of a stay, in seconds of the day.
type Stay = (i32, i32, OfficePlace);

/// One person's working day: the time at the desk, and its interruptions, the most binding first.
pub(crate) struct Attendance {
    desk: Stay,
    elsewhere: Vec<Stay>,
}

impl Attendance {
    /// The place of the person, if in the building.
    pub(crate) fn place(&self, second: i32) -> Option<OfficePlace> {
        let holds = |&&(from, to, _): &&Stay| (from..to).contains(&second);
        Some(&self.desk).filter(holds).map(|desk| self.elsewhere.iter().find(holds).unwrap_or(desk).2)
    }

    /// Whether the person is in the building.
    pub(crate) fn present(&self, second: i32) -> bool {
        self.place(second).is_some()
    }
}

/// Nobody works at the weekend or on these days.
pub(crate) fn closed(date: Date) -> bool {
    matches!(date.weekday(), Weekday::Saturday | Weekday::Sunday)
        || matches!((date.month(), date.day()), (1, 1) | (12, 25 | 26))
}

/// The working days of all people who come in on a date.
pub(crate) fn attendances(seed: u64, date: Date) -> Vec<Attendance> {
    if closed(date) {
        return Vec::new();
    }
    let meetings = meetings(seed, date);
    PEOPLE
        .iter()
        .enumerate()
        .filter(|&(index, _)| !on_leave(seed, index, date))
        .map(|(index, person)| attendance(person, seed, index, date, &meetings))
        .collect()
}

/// Whether a person is away: sometimes for a week, sometimes for a day.
fn on_leave(seed: u64, index: usize, date: Date) -> bool {
    let monday = date.iso_week_date().first_of_week().map_or(date, |week| week.date());
    draws(seed, DrawTopic::Leave, index, monday).random_bool(0.04)
        // Sick leave.
        || draws(seed, DrawTopic::Leave, index + PEOPLE.len(), date).random_bool(0.03)
}

/// The meetings of a date, as (from, to).
fn meetings(seed: u64, date: Date) -> Vec<(i32, i32)> {
    let mut rng = draws(seed, DrawTopic::Meeting, 0, date);
    let mut meetings = Vec::new();
    let weekly = match date.weekday() {
        Weekday::Tuesday => Some((10 * HOUR, 11 * HOUR + 30 * MINUTE)),
        Weekday::Thursday => Some((14 * HOUR, 15 * HOUR + 30 * MINUTE)),
        _ => None,
    };
    if let Some((from, to)) = weekly {
        meetings.push((around(&mut rng, from, 2 * MINUTE), around(&mut rng, to, 8 * MINUTE)));
    }
    if rng.random_bool(0.25) {
        let from = rng.random_range(9 * HOUR..16 * HOUR);
        meetings.push((from, from + 40 * MINUTE));
    }
    meetings
}

fn attendance(person: &Worker, seed: u64, index: usize, date: Date, meetings: &[(i32, i32)]) -> Attendance {
    let mut rng = draws(seed, DrawTopic::Person, index, date);
    // On Fridays everybody leaves early.
    let early = if date.weekday() == Weekday::Friday { 2 * HOUR } else { 0 };
    let arrives = around(&mut rng, person.arrives_secs, person.spread_secs);
    let leaves = around(&mut rng, person.leaves_secs - early, person.spread_secs);

    let mut elsewhere = Vec::new();
    for &(from, to) in meetings {
        if rng.random_bool(0.85) {
            elsewhere.push((from, to, OfficePlace::MeetingRoom));
        }
    }
    let lunch = around(&mut rng, 12 * HOUR + 30 * MINUTE, 20 * MINUTE);
    elsewhere.push((lunch, lunch + around(&mut rng, 40 * MINUTE, 5 * MINUTE), OfficePlace::Kitchen));
    for (coffee, chance) in [(10 * HOUR + 30 * MINUTE, 0.5), (15 * HOUR + 30 * MINUTE, 0.5)] {
        if rng.random_bool(chance) {
            let from = around(&mut rng, coffee, 20 * MINUTE);
            elsewhere.push((from, from + around(&mut rng, 15 * MINUTE, 3 * MINUTE), OfficePlace::Kitchen));
        }
    }
    if person.lab_days.contains(&date.weekday()) {
        let from = around(&mut rng, 13 * HOUR + 30 * MINUTE, 10 * MINUTE);
        elsewhere.push((from, from + around(&mut rng, 3 * HOUR, 15 * MINUTE), OfficePlace::Lab));
    }
    Attendance { desk: (arrives, leaves, OfficePlace::Office(person.office)), elsewhere }
}
