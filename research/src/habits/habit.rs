//! The habits: when a simulated state is 1, when a robot reads it, and which days are predicted.
//!
//! Invariant: a habit is the probability of 1 at each step of local time. The draws for a day depend on the seed, the
//! habit and the days before.

use jiff::civil::{Date, date};
use rand::{Rng as _, rngs::SmallRng};

use super::calendar::HabitDay;

/// A part of a local day, from one hour until another, at which the state is 1 with a probability.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(super) struct Span {
    /// The hour at which it begins.
    pub(super) from: f64,
    /// The hour at which it ends; above 24 on the next day.
    pub(super) until: f64,
    /// The probability of 1.
    pub(super) probability: f64,
}

/// The times at which a robot reads the state.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) enum LookPlan {
    /// Every half-hour, day and night.
    HalfHourly,
    /// Every half-hour, but not from one date until before another.
    HalfHourlyExcept(Date, Date),
    /// On three days a week, once, at any time from 7 to 21 h.
    ThreeAWeek,
    /// Once a second for an hour a day, which begins at any time from 7 to 20 h.
    Bursts,
}

/// A habit of a state.
#[derive(Clone, Copy, Debug)]
pub struct Habit {
    /// The name of the habit in results.
    pub name: &'static str,
    /// The spans of a day; later ones win.
    pub(super) spans: fn(&HabitDay, &mut SmallRng) -> Vec<Span>,
    /// The probability of 1 at all other times.
    pub(super) base: f64,
    /// The state keeps its value with a time constant of this many minutes, above 0, while its probability is the same.
    pub(super) keeps_minutes: f64,
    /// The times at which a robot reads the state.
    pub(super) looks: LookPlan,
    /// The first and the last day that are predicted.
    pub(super) test: (Date, Date),
}

/// A state that does not keep its value.
const NO_MINUTES: f64 = 0.01;
const AUTUMN: (Date, Date) = (date(2025, 10, 13), date(2025, 12, 14));
const FIRST_WEEKS: (Date, Date) = (date(2025, 9, 2), date(2025, 9, 14));
const OFFICE: Habit =
    Habit { name: "office", spans: office, base: 0.02, keeps_minutes: 40.0, looks: LookPlan::HalfHourly, test: AUTUMN };
const BAR: Habit = Habit { name: "bar", spans: bar, base: 0.01, keeps_minutes: 10.0, ..OFFICE };
const NOISE: Habit = Habit { name: "noise", spans: working_hours, base: 0.1, keeps_minutes: NO_MINUTES, ..OFFICE };

/// All habits, in the order of results.
pub static HABITS: [Habit; 18] = [
    Habit { name: "semester", spans: semester, test: (date(2025, 12, 1), date(2026, 2, 15)), ..OFFICE },
    Habit { name: "shifts", spans: shifts, base: 0.03, test: (date(2025, 12, 1), date(2026, 1, 31)), ..OFFICE },
    Habit { name: "daylight", spans: daylight, base: 0.03, test: (date(2026, 2, 1), date(2026, 5, 31)), ..OFFICE },
    Habit { name: "ramadan", spans: ramadan, test: (date(2026, 2, 11), date(2026, 4, 15)), ..OFFICE },
    Habit {
        name: "first-mondays",
        spans: first_mondays,
        base: 0.01,
        keeps_minutes: 1.0,
        test: (date(2025, 12, 1), date(2026, 4, 30)),
        ..OFFICE
    },
    NOISE,
    Habit { name: "three-looks", looks: LookPlan::ThreeAWeek, test: (date(2025, 12, 1), date(2026, 3, 31)), ..OFFICE },
    Habit { name: "bursts", looks: LookPlan::Bursts, test: (date(2025, 11, 3), date(2025, 12, 28)), ..OFFICE },
    Habit {
        name: "clocks",
        spans: clocks,
        base: 0.01,
        keeps_minutes: 10.0,
        test: (date(2026, 3, 23), date(2026, 4, 12)),
        ..OFFICE
    },
    Habit { name: "change", spans: change, test: (date(2025, 11, 24), date(2026, 1, 11)), ..OFFICE },
    Habit {
        name: "gap",
        looks: LookPlan::HalfHourlyExcept(date(2025, 11, 3), date(2026, 1, 19)),
        test: (date(2026, 1, 19), date(2026, 2, 8)),
        ..OFFICE
    },
    Habit { name: "rare", spans: never, base: 0.004, keeps_minutes: NO_MINUTES, ..OFFICE },
    Habit { name: "classes", spans: classes, keeps_minutes: 10.0, ..OFFICE },
    BAR,
    OFFICE,
    Habit { name: "new-office", test: FIRST_WEEKS, ..OFFICE },
    Habit { name: "new-bar", test: FIRST_WEEKS, ..BAR },
    Habit { name: "new-noise", test: FIRST_WEEKS, ..NOISE },
];

impl Habit {
    /// The habit of this name.
    pub fn named(name: &str) -> Option<&'static Habit> {
        HABITS.iter().find(|habit| habit.name == name)
    }
}

fn span(from: f64, until: f64, probability: f64) -> Span {
    Span { from, until, probability }
}

/// A draw from the normal distribution with mean 0 (Box and Muller 1958).
fn normal(random: &mut SmallRng, deviation: f64) -> f64 {
    let (radius, turn): (f64, f64) = (random.random(), random.random());
    deviation * (-2.0 * (1.0 - radius).ln()).sqrt() * (std::f64::consts::TAU * turn).cos()
}

/// Weekdays from about 8:30 to about 17:30, with half as many people at noon.
fn office(day: &HabitDay, random: &mut SmallRng) -> Vec<Span> {
    if day.is_weekend() {
        return Vec::new();
    }
    let (from, until) = (8.5 + normal(random, 0.3), 17.5 + normal(random, 0.3));
    vec![span(from, until, 0.8), span(12.0, 13.0, 0.4)]
}

/// Weekdays of three terms; a few hours with few people on the other weekdays.
fn semester(day: &HabitDay, random: &mut SmallRng) -> Vec<Span> {
    let terms = [
        (date(2025, 9, 29), date(2025, 12, 12)),
        (date(2026, 1, 12), date(2026, 3, 20)),
        (date(2026, 4, 13), date(2026, 6, 12)),
    ];
    if day.is_weekend() {
        return Vec::new();
    }
    if !terms.iter().any(|(first, last)| (*first..=*last).contains(&day.date)) {
        return vec![span(10.0, 16.0, 0.15)];
    }
    vec![span(8.5 + normal(random, 0.3), 18.0 + normal(random, 0.3), 0.85)]
}

/// Shifts of twelve hours on two or three days, then two or three days off: 14 days in all.
fn shifts(day: &HabitDay, _: &mut SmallRng) -> Vec<Span> {
    const IS_ON: [bool; 14] =
        [true, true, false, false, true, true, true, false, false, true, true, false, false, false];
    if IS_ON[day.number % IS_ON.len()] { vec![span(7.0, 19.0, 0.9)] } else { Vec::new() }
}

/// A light that is on from 6:30 until sunrise and from sunset until 23:00, at 53.2° north.
fn daylight(day: &HabitDay, random: &mut SmallRng) -> Vec<Span> {
    const LATITUDE: f64 = 53.2;
    let day_of_year = f64::from(day.date.day_of_year());
    let declination = -23.44 * (std::f64::consts::TAU * (day_of_year + 10.0) / 365.0).cos();
    let cosine = -LATITUDE.to_radians().tan() * declination.to_radians().tan();
    let half_day = cosine.clamp(-1.0, 1.0).acos().to_degrees() / 15.0;
    let noon = 12.0 + day.noon_offset_hours;
    let (sunrise, sunset) = (noon - half_day, noon + half_day);
    let mut spans = Vec::new();
    if sunrise > 6.5 {
        spans.push(span(6.5, sunrise + normal(random, 0.2), 0.93));
    }
    if sunset < 23.0 {
        spans.push(span(sunset + normal(random, 0.2), 23.0 + normal(random, 0.2), 0.93));
    }
    spans
}

/// Mornings and evenings; during Ramadan from 10 to 14 h and at night.
fn ramadan(day: &HabitDay, random: &mut SmallRng) -> Vec<Span> {
    if (date(2026, 2, 18)..=date(2026, 3, 19)).contains(&day.date) {
        return vec![span(10.0, 14.0, 0.7), span(20.5, 26.0, 0.9)];
    }
    vec![span(9.0 + normal(random, 0.2), 13.0, 0.85), span(16.0, 21.0 + normal(random, 0.2), 0.85)]
}

/// A shop that is shut on Sundays and on the first Monday of each month.
fn first_mondays(day: &HabitDay, _: &mut SmallRng) -> Vec<Span> {
    let is_shut = day.weekday == 6 || day.weekday == 0 && day.date.day() <= 7;
    if is_shut { Vec::new() } else { vec![span(9.0, 18.0, 0.97)] }
}

/// Weekdays from 9 to 17 h.
fn working_hours(day: &HabitDay, _: &mut SmallRng) -> Vec<Span> {
    if day.is_weekend() { Vec::new() } else { vec![span(9.0, 17.0, 0.9)] }
}

/// Weekdays from 8 to 17 h, also after the clocks change.
fn clocks(day: &HabitDay, _: &mut SmallRng) -> Vec<Span> {
    if day.is_weekend() { Vec::new() } else { vec![span(8.0, 17.0, 0.95)] }
}

/// Weekdays from 8 to 16 h, from 1 December on from 14 to 22 h.
fn change(day: &HabitDay, random: &mut SmallRng) -> Vec<Span> {
    let late = normal(random, 0.2);
    match day.date < date(2025, 12, 1) {
        _ if day.is_weekend() => Vec::new(),
        true => vec![span(8.0 + late, 16.0, 0.85)],
        false => vec![span(14.0, 22.0 + late, 0.85)],
    }
}

/// Never more than by chance.
fn never(_: &HabitDay, _: &mut SmallRng) -> Vec<Span> {
    Vec::new()
}

/// Tuesdays and Thursdays from 10 to 12 and from 14 to 16 h.
fn classes(day: &HabitDay, _: &mut SmallRng) -> Vec<Span> {
    let is_on = [1, 3].contains(&day.weekday);
    if is_on { vec![span(10.0, 12.0, 0.95), span(14.0, 16.0, 0.95)] } else { Vec::new() }
}

/// Fridays and Saturdays from 20 h until 2 h.
fn bar(day: &HabitDay, _: &mut SmallRng) -> Vec<Span> {
    if [4, 5].contains(&day.weekday) { vec![span(20.0, 26.0, 0.95)] } else { Vec::new() }
}
