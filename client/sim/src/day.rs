//! One local day of the office: the value of every state at every second of the day.
//!
//! Invariant: depends on the seed and the date only.

use jiff::civil::Date;
use rand::Rng;

use crate::{
    cleaner::CleaningRound,
    draw::{DrawTopic, draws},
    people::{Attendance, attendances},
    place::{OfficePlace, PLACES},
};

/// Time between two possible changes of the storage door.
const STORAGE_HOLD_SECS: i32 = 30 * 60;

/// A day with the whereabouts of all people.
pub(crate) struct OfficeDay {
    people: Vec<Attendance>,
    cleaner: CleaningRound,
    /// Open or shut for each half hour, at random: only the mean can be learned.
    storage_door: Vec<bool>,
}

impl OfficeDay {
    /// The day at `date`.
    pub(crate) fn new(seed: u64, date: Date) -> Self {
        let mut coin = draws(seed, DrawTopic::StorageDoor, 0, date);
        Self {
            people: attendances(seed, date),
            cleaner: CleaningRound::new(seed, date),
            storage_door: (0..24 * 3600 / STORAGE_HOLD_SECS).map(|_| coin.random_bool(0.4)).collect(),
        }
    }

    /// Value of the state with this index at a second of the wall clock.
    pub(crate) fn value(&self, state: usize, second: i32) -> f64 {
        let on = match state {
            0 => self.people.iter().any(|person| person.present(second)) || self.cleaner.place(second).is_some(),
            7 => self.storage_door[(second / STORAGE_HOLD_SECS).unsigned_abs() as usize],
            8 => true,
            room => self.anybody_in(PLACES[room], second),
        };
        f64::from(u8::from(on))
    }

    fn anybody_in(&self, place: OfficePlace, second: i32) -> bool {
        self.cleaner.place(second) == Some(place)
            || self.people.iter().any(|person| person.place(second) == Some(place))
    }
}
