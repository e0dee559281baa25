//! The cleaner's round in the evening.
//!
//! Invariant: one room at a time, each once, with its door open.

use jiff::civil::Date;

use crate::{
    draw::{DrawTopic, around, draws},
    people::closed,
    place::{OfficePlace, PLACES},
};

/// The times at which the cleaner enters each room and leaves the last one, in seconds of the day. Empty on days
/// without a round.
pub(crate) struct CleaningRound {
    enters_secs: Vec<i32>,
    leaves_secs: i32,
}

impl CleaningRound {
    /// The round of a date.
    pub(crate) fn new(seed: u64, date: Date) -> Self {
        if closed(date) {
            return Self { enters_secs: Vec::new(), leaves_secs: 0 };
        }
        let mut rng = draws(seed, DrawTopic::Cleaner, 0, date);
        let mut clock = around(&mut rng, 19 * 3600, 5 * 60);
        let enters_secs = PLACES
            .iter()
            .map(|_| {
                let enters = clock;
                clock += around(&mut rng, 14 * 60, 2 * 60);
                enters
            })
            .collect();
        Self { enters_secs, leaves_secs: clock }
    }

    /// The place of the cleaner, if in the building.
    pub(crate) fn place(&self, second: i32) -> Option<OfficePlace> {
        let room = self.enters_secs.partition_point(|&enters| enters <= second).checked_sub(1)?;
        (second < self.leaves_secs).then(|| PLACES[room])
    }
}
