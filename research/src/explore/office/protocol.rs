//! The protocol of an exploration of a simulated office.
//!
//! Invariant: a protocol that was read can be run.

use std::{ops::RangeInclusive, path::PathBuf};

use serde::Deserialize;
use tidemap_model::time::parse_duration;
use tidemap_plan::tour::GOALS_MAX;
use tidemap_sim::ExploredOffice;

use super::{ExplorerKind, space::DAY_NANOS};
use crate::{
    ProtocolError,
    protocol::{
        keys::{parsed, whole},
        raw::Word,
    },
};

/// Maximum number of days.
const DAYS_MAX: usize = 60;
/// Default length of a slot (RA-L 2016, section IV.A).
const SLOT_NANOS: i64 = tidemap_plan::day::SLOT_NANOS;
/// Minimum length of a slot: two goals fit.
const SLOT_MIN_NANOS: i64 = 300_000_000_000;

/// The protocol of an exploration of a simulated office.
#[derive(Clone, Debug, PartialEq)]
pub struct OfficeProtocol {
    /// Name of the experiment.
    pub name: String,
    /// Days of exploration, at least 1.
    pub days: usize,
    /// Tours of each explorer in a day, at most one for each slot.
    pub tours: usize,
    /// Goals of a tour.
    pub goals: usize,
    /// Rooms on each side of the corridor.
    pub rooms: usize,
    /// Length of a slot, which divides the day.
    pub slot_nanos: i64,
    /// Number of runs, with seeds from 0 on.
    pub seeds: u64,
    /// The explorers; the first is the baseline.
    pub explorers: Vec<ExplorerKind>,
    /// Folder of the results.
    pub out: PathBuf,
}

impl OfficeProtocol {
    /// Slots of a day.
    pub fn slots(&self) -> usize {
        (DAY_NANOS / self.slot_nanos) as usize
    }
}

/// The section `office`.
#[derive(Debug, Deserialize)]
#[serde(deny_unknown_fields)]
pub(crate) struct RawOffice {
    days: Option<Word>,
    tours: Option<Word>,
    goals: Option<Word>,
    rooms: Option<Word>,
    slot: Option<Word>,
}

impl RawOffice {
    /// The protocol, with defaults for missing keys.
    pub(crate) fn parse(self, name: String, seeds: u64, out: PathBuf) -> Result<OfficeProtocol, ProtocolError> {
        let slot_nanos = self.slot.map_or(Ok(SLOT_NANOS), |word| {
            parsed(&word, "slot", "at least 5m, and a divisor of the day, such as 15m", |text| {
                let divides = |nanos: &i64| *nanos >= SLOT_MIN_NANOS && DAY_NANOS % nanos == 0;
                parse_duration(text).ok().filter(divides)
            })
        })?;
        let slots = (DAY_NANOS / slot_nanos) as usize;
        let goals_max = GOALS_MAX.min((slot_nanos / 120_000_000_000) as usize);
        Ok(OfficeProtocol {
            name,
            days: number("days", self.days, 5, 1..=DAYS_MAX)?,
            tours: number("tours", self.tours, 24.min(slots), 1..=slots)?,
            goals: number("goals", self.goals, 6.min(goals_max), 1..=goals_max)?,
            rooms: number("rooms", self.rooms, 4, 2..=ExploredOffice::ROOMS_MAX)?,
            slot_nanos,
            seeds,
            explorers: ExplorerKind::ALL.to_vec(),
            out,
        })
    }
}

fn number(
    key: &'static str,
    word: Option<Word>,
    default: usize,
    range: RangeInclusive<usize>,
) -> Result<usize, ProtocolError> {
    word.map_or(Ok(default), |word| whole(&word, key, range))
}
