//! One local day of the office: the value of every state at every second of it.
//!
//! Invariant: depends on the seed and the date only.

use jiff::civil::Date;
use rand::Rng;

use crate::{
    cleaner::Round,
    draw::{Topic, draws},
    people::{Presence, presences},
    place::Place,
};

/// The storage door may change every so many seconds.
const STORAGE_HOLD_SECS: i32 = 30 * 60;

/// A day with everybody's whereabouts.
pub(crate) struct Day {
    people: Vec<Presence>,
    cleaner: Round,
    /// Open or shut for each half hour, by the toss of a coin: nothing to learn but a mean.
    storage_door: Vec<bool>,
}

impl Day {
    /// The day at `date`.
    pub(crate) fn new(seed: u64, date: Date) -> Self {
        let mut coin = draws(seed, Topic::StorageDoor, 0, date);
        Self {
            people: presences(seed, date),
            cleaner: Round::new(seed, date),
            storage_door: (0..24 * 3600 / STORAGE_HOLD_SECS).map(|_| coin.random_bool(0.4)).collect(),
        }
    }

    /// Value of a state at a second of the wall clock.
    pub(crate) fn value(&self, state: usize, second: i32) -> f64 {
        let on = match state {
            0 => self.people.iter().any(|person| person.present(second)) || self.cleaner.place(second).is_some(),
            1..=3 => self.anybody_in(Place::Office(state - 1), second),
            4 => self.anybody_in(Place::Lab, second),
            5 => self.anybody_in(Place::MeetingRoom, second),
            6 => self.anybody_in(Place::Kitchen, second),
            7 => self.storage_door[(second / STORAGE_HOLD_SECS).unsigned_abs() as usize],
            8 => true,
            _ => panic!("state {state} is not one of the {} there are", crate::place::STATES.len()),
        };
        f64::from(u8::from(on))
    }

    fn anybody_in(&self, place: Place, second: i32) -> bool {
        self.cleaner.place(second) == Some(place)
            || self.people.iter().any(|person| person.place(second) == Some(place))
    }
}
