//! A simulated house with eight places and its visitors.
//!
//! Invariant: who comes to a place in a minute depends on the seed, the place and that minute only. Days are counted
//! from a Monday, and hours from midnight.

use std::ops::Range;

use rand::{Rng as _, rngs::SmallRng};

use crate::routes::{WEEK_DAYS, building::draw};

/// The terminal works between these hours of every day.
pub(super) const WORKING_HOURS: Range<usize> = 8..20;
/// The terminal stands in one place for a slot of this length.
pub(super) const SLOT_MINUTES: usize = 15;
pub(super) const HOUR_MINUTES: usize = 60;
/// Slots of a day.
pub(super) const SLOTS: usize = WORKING_HOURS.end.abs_diff(WORKING_HOURS.start) * HOUR_MINUTES / SLOT_MINUTES;
/// Minutes at the beginning of a slot in which a terminal that moves serves nobody.
const MOVE_MINUTES: usize = 2;
const DAY_MINUTES: usize = 24 * HOUR_MINUTES;

/// In each house the hours of a place are earlier or later by at most this, and its visitors more or fewer.
const SHIFT_HOURS: f64 = 1.0;
const FACTOR: Range<f64> = 0.7..1.3;
/// Subjects of draws.
const HABIT: u64 = 1;
const VISIT: u64 = 2;

/// The times at which people come: the days of the week from Monday on, the hours, and visitors an hour.
type Rush = (Range<usize>, Range<f64>, f64);

/// Places: a name, visitors an hour at all times, and more at some.
const PLACES: [(&str, f64, &[Rush]); 8] = [
    ("lobby", 1.5, &[(0..5, 8.0..9.5, 8.5), (0..5, 16.5..18.0, 6.5)]),
    ("canteen", 0.5, &[(0..5, 11.5..13.5, 13.5), (5..7, 12.0..13.0, 5.5)]),
    ("cafe", 1.0, &[(0..5, 10.0..11.0, 7.0), (0..5, 15.0..16.0, 7.0), (5..7, 14.0..17.0, 5.0)]),
    ("ward", 1.0, &[(0..7, 9.0..11.5, 3.0)]),
    ("library", 0.5, &[(1..2, 14.0..17.0, 6.5), (3..4, 14.0..17.0, 6.5)]),
    ("garden", 0.2, &[(5..7, 10.0..12.0, 6.0)]),
    ("gym", 0.2, &[(0..1, 18.0..20.0, 8.0), (2..3, 18.0..20.0, 8.0), (4..5, 18.0..20.0, 8.0)]),
    ("corridor", 2.5, &[]),
];

/// A house.
#[derive(Clone, Debug)]
pub(super) struct House {
    seed: u64,
    /// By place: by how many hours it is later, and by which factor its visitors are more.
    habits: Vec<(f64, f64)>,
}

impl House {
    pub(super) fn new(seed: u64) -> House {
        let habit = |place: usize| {
            let mut random: SmallRng = draw(seed, [HABIT, place as u64, 0]);
            (random.random_range(-SHIFT_HOURS..SHIFT_HOURS), random.random_range(FACTOR))
        };
        House { seed, habits: (0..PLACES.len()).map(habit).collect() }
    }

    /// The names of its places.
    pub(super) fn places() -> impl ExactSizeIterator<Item = &'static str> {
        PLACES.iter().map(|(name, ..)| *name)
    }

    /// The expected visitors an hour of a place, at an hour of a day.
    pub(super) fn rate(&self, place: usize, day: usize, hour: f64) -> f64 {
        let ((_, always, rushes), (shift, factor)) = (&PLACES[place], self.habits[place]);
        let is_now = |(days, hours, _): &&Rush| days.contains(&(day % WEEK_DAYS)) && hours.contains(&(hour - shift));
        factor * (always + rushes.iter().filter(is_now).map(|(.., more)| more).sum::<f64>())
    }

    /// The number of people who use a terminal that stands in a place in a slot of a day. `has_moved`: it was elsewhere
    /// before.
    pub(super) fn interactions(&self, place: usize, day: usize, slot: usize, has_moved: bool) -> u64 {
        let first = WORKING_HOURS.start * HOUR_MINUTES + slot * SLOT_MINUTES;
        let arrived = if has_moved { first + MOVE_MINUTES } else { first };
        (arrived..first + SLOT_MINUTES).filter(|minute| self.is_visited(place, day, *minute)).count() as u64
    }

    /// Whether somebody comes to a place in a minute of a day.
    fn is_visited(&self, place: usize, day: usize, minute: usize) -> bool {
        let rate = self.rate(place, day, minute as f64 / HOUR_MINUTES as f64);
        let mut random = draw(self.seed, [VISIT, place as u64, (day * DAY_MINUTES + minute) as u64]);
        random.random_bool((rate / HOUR_MINUTES as f64).clamp(0.0, 1.0))
    }
}
