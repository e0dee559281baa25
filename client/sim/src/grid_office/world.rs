//! Everything that changes in the grid office, at every moment: the routines of things, and the flicker of cells.
//!
//! Invariant: the changes of a cell on a day depend on the seed, the cell and the date only; two changes of a cell are
//! at least [`APART_MILLIS`] apart, except where clocks change.

use jiff::{civil::date, tz::TimeZone};

use super::{
    dice::{Dice, DiceTopic},
    options::GridOfficeError,
    routine::{Routine, routine},
    staff::person_day,
    things::{ChangingCell, Inventory},
};
use crate::civil_day::{CivilDay, ClockDay, clock_day, day_at};

/// The shortest time between two changes of a cell.
const APART_MILLIS: i32 = 6_000;
/// The longest time for which a cell flickers.
const FLICKER_MILLIS: i32 = 14_000;

/// Cells and days on which the flicker rate is calibrated.
const SAMPLE_CELLS: usize = 400;
const SAMPLE_DAYS: i32 = 28;

/// The things of the office and the flicker rate of their cells.
#[derive(Clone, Debug)]
pub(crate) struct World {
    seed: u64,
    zone: TimeZone,
    pub(crate) inventory: Inventory,
    /// Mean number of times that a cell flickers in a day.
    flicker_rate: f64,
}

/// A day of the world.
#[derive(Clone, Debug)]
pub(crate) struct WorldDay {
    pub(crate) clock: ClockDay,
    /// Indexed like the things of the inventory.
    routines: Vec<Routine>,
}

impl World {
    /// Calibrates the flicker so that a cell changes `changes_per_day` times on the average day.
    pub(crate) fn new(
        seed: u64,
        zone: TimeZone,
        inventory: Inventory,
        changes_per_day: f64,
    ) -> Result<Self, GridOfficeError> {
        let mut world = Self { seed, zone, inventory, flicker_rate: 0.0 };
        let sample = world.sample();
        let least = world.mean_changes(&sample, 0.0);
        if changes_per_day < least {
            return Err(GridOfficeError::TooQuiet { requested: changes_per_day, least });
        }
        // A flicker makes two changes, or fewer where it overlaps another flicker or a routine.
        let mut rate = (changes_per_day - least) / 2.0;
        for _ in 0..3 {
            let made = world.mean_changes(&sample, rate) - least;
            rate *= (changes_per_day - least) / made.max(1e-9);
        }
        world.flicker_rate = rate;
        Ok(world)
    }

    /// The routines of all things on a day.
    pub(crate) fn day(&self, day: CivilDay) -> WorldDay {
        WorldDay { clock: clock_day(&self.zone, day), routines: self.routines(day) }
    }

    /// The day that an instant falls into.
    pub(crate) fn day_at(&self, utc_nanos: i64) -> CivilDay {
        day_at(&self.zone, utc_nanos)
    }

    fn routines(&self, day: CivilDay) -> Vec<Routine> {
        let staff: Vec<_> = (0..self.inventory.people).map(|person| person_day(self.seed, person, day)).collect();
        let things = (0..).zip(&self.inventory.things);
        things.map(|(index, thing)| routine(self.seed, index, thing, day, &staff)).collect()
    }

    /// Whether a cell is filled at the start of a day; `changes` becomes the times of its changes on that day in
    /// milliseconds after midnight, in order.
    pub(crate) fn changes(&self, cell: &ChangingCell, day: &WorldDay, changes: &mut Vec<i32>) -> bool {
        let routine = &day.routines[cell.thing as usize];
        self.changes_of(cell, routine, day.clock.day, self.flicker_rate, changes)
    }

    fn changes_of(
        &self,
        cell: &ChangingCell,
        routine: &Routine,
        day: CivilDay,
        flicker_rate: f64,
        changes: &mut Vec<i32>,
    ) -> bool {
        changes.clear();
        let filled = |pose: u8| cell.poses >> pose & 1 == 1;
        let start = filled(routine.start);
        let mut now = start;
        for &(time, pose) in &routine.turns {
            if filled(pose) != now {
                now = !now;
                changes.push(time);
            }
        }
        if let Some((from, to, liveliness)) = routine.lively {
            let weight = 0.4 + 1.2 * Dice::new(self.seed, DiceTopic::CellWeight, cell.address, 0).unit();
            let mut dice = Dice::new(self.seed, DiceTopic::Flicker, cell.address, day.number);
            let mean = flicker_rate * liveliness * weight * (0.5 + dice.unit());
            for _ in 0..(mean + dice.unit()) as u32 {
                let time = dice.between(from, to - FLICKER_MILLIS);
                changes.extend([time, time + dice.between(APART_MILLIS, FLICKER_MILLIS)]);
            }
            changes.sort_unstable();
        }
        keep_apart(changes);
        start
    }

    /// A sample of cells spread evenly over all changing cells.
    fn sample(&self) -> Vec<ChangingCell> {
        let cells = &self.inventory.cells;
        cells.iter().step_by((cells.len() / SAMPLE_CELLS).max(1)).copied().collect()
    }

    /// Mean number of changes of a cell in a day, over weeks without holidays.
    fn mean_changes(&self, sample: &[ChangingCell], flicker_rate: f64) -> f64 {
        let first = CivilDay::new(date(2024, 6, 3));
        let mut changes = Vec::new();
        let mut total = 0;
        for day in (0..SAMPLE_DAYS).map(|days| first.plus(days)) {
            let routines = self.routines(day);
            for cell in sample {
                self.changes_of(cell, &routines[cell.thing as usize], day, flicker_rate, &mut changes);
                total += changes.len();
            }
        }
        total as f64 / (sample.len() as f64 * f64::from(SAMPLE_DAYS))
    }

    /// Whether a cell is filled at a time in nanoseconds UTC that falls into the day.
    pub(crate) fn filled(&self, cell: &ChangingCell, day: &WorldDay, utc_nanos: i64) -> bool {
        let mut changes = Vec::new();
        let start = self.changes(cell, day, &mut changes);
        let before = changes.partition_point(|&time| day.clock.utc_nanos(time) <= utc_nanos);
        start ^ (before % 2 == 1)
    }
}

/// Removes pairs of changes that are too close together; the value before and after such a pair is unchanged.
fn keep_apart(changes: &mut Vec<i32>) {
    let mut kept = 0;
    for index in 0..changes.len() {
        if kept > 0 && changes[index] - changes[kept - 1] < APART_MILLIS {
            kept -= 1;
        } else {
            changes[kept] = changes[index];
            kept += 1;
        }
    }
    changes.truncate(kept);
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn changes_too_close_vanish_in_pairs() {
        for (mut changes, kept) in [
            (vec![0, 6_000, 11_999], vec![0]),
            (vec![0, 1, 2], vec![2]),
            (vec![0, 5_000, 20_000, 26_000], vec![20_000, 26_000]),
            (vec![], vec![]),
        ] {
            keep_apart(&mut changes);
            assert_eq!(changes, kept);
        }
    }
}
