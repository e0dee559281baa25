//! A plan for a local day: the day in slots, and the visit of each slot.
//!
//! Invariant: slots follow one another without gaps from the first instant of the local date to the first of the next,
//! also when the clocks change; a plan has one row per slot.

use tidemap_model::{LocalDay, Zone};

use crate::strategy::{self, Budget, Gains, Strategy, StrategyError};

#[cfg(test)]
mod tests;

/// Slots of a plan by default: 15 minutes, of which an ordinary day has 96 (RA-L 2016, section IV.A).
pub const SLOT_NANOS: i64 = 15 * MINUTE_NANOS;

const MINUTE_NANOS: i64 = 60 * 1_000_000_000;

/// The reason why a day cannot be planned.
#[derive(Clone, Debug, PartialEq, thiserror::Error)]
#[expect(missing_docs, reason = "the messages name the fields")]
pub enum DayError {
    /// The slot length is invalid.
    #[error(
        "slots of {} s do not fit a day of {} h: use 60 s up to the length of the day",
        secs(*slot_nanos), secs(*day_nanos) / 3600.0
    )]
    Slot { slot_nanos: i64, day_nanos: i64 },
    /// The zone skipped this date, or it is out of range.
    #[error("{day} has no hours in this time zone")]
    NoSuchDay { day: LocalDay },
    /// There is no valid schedule.
    #[error(transparent)]
    Strategy(#[from] StrategyError),
}

fn secs(nanos: i64) -> f64 {
    nanos as f64 / 1e9
}

/// A local day in slots.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct DaySlots {
    from_nanos: i64,
    until_nanos: i64,
    slot_nanos: i64,
}

impl DaySlots {
    /// The local date in slots of the given length, in nanoseconds of elapsed time: a day of 23 hours has 92 slots of a
    /// quarter of an hour, one of 25 hours 100. Where the length does not divide the day, the last slot is shorter.
    ///
    /// # Errors
    /// [`DayError`] where slots are shorter than a minute or longer than the day, or the zone skipped the date.
    pub fn of(zone: &Zone, day: LocalDay, slot_nanos: i64) -> Result<DaySlots, DayError> {
        let from_nanos = zone.midnight_nanos(day);
        let until_nanos = zone.midnight_nanos(LocalDay(day.0.saturating_add(1)));
        let day_nanos = until_nanos.saturating_sub(from_nanos);
        if day_nanos <= 0 {
            return Err(DayError::NoSuchDay { day });
        }
        if !(MINUTE_NANOS..=day_nanos).contains(&slot_nanos) {
            return Err(DayError::Slot { slot_nanos, day_nanos });
        }
        let slots = DaySlots { from_nanos, until_nanos, slot_nanos };
        debug_assert_eq!(slots.start_nanos(slots.count()), until_nanos, "slots reach the end of the day");
        Ok(slots)
    }

    /// Number of slots, at least 1.
    pub fn count(&self) -> usize {
        let day_nanos = (self.until_nanos - self.from_nanos) as u64;
        // Slots last at least a minute, so there are at most about 1,500.
        day_nanos.div_ceil(self.slot_nanos.unsigned_abs()) as usize
    }

    /// First instant of a slot, UTC in nanoseconds since 1970; beyond the last slot the end of the day.
    pub fn start_nanos(&self, slot: usize) -> i64 {
        let offset_nanos = i64::try_from(slot).ok().and_then(|slot| slot.checked_mul(self.slot_nanos));
        offset_nanos
            .and_then(|offset| self.from_nanos.checked_add(offset))
            .map_or(self.until_nanos, |start| start.min(self.until_nanos))
    }

    /// The middle of a slot, UTC in nanoseconds since 1970: predictions for a slot are for this moment.
    pub fn middle_nanos(&self, slot: usize) -> i64 {
        let start_nanos = self.start_nanos(slot);
        start_nanos + (self.start_nanos(slot.saturating_add(1)) - start_nanos) / 2
    }

    /// The slot in which a moment lies; `None` outside the day.
    pub fn slot_at(&self, utc_nanos: i64) -> Option<usize> {
        let is_inside = (self.from_nanos..self.until_nanos).contains(&utc_nanos);
        // The result is at least 0, and at most the count.
        is_inside.then(|| ((utc_nanos - self.from_nanos) / self.slot_nanos) as usize)
    }
}

/// The plan of one slot.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct DayRow {
    /// Number of the slot, from 0.
    pub slot: usize,
    /// First instant of the slot: UTC, nanoseconds since 1970.
    pub start_nanos: i64,
    /// Index of the place to visit; `None`: no exploration in this slot.
    pub location: Option<usize>,
    /// Expected information of the visit, in bits; 0 without a visit.
    pub information_bits: f64,
}

/// Plans a day. `gain` returns the expected information of a visit, in bits, for a moment (the middle of a slot, UTC
/// nanoseconds since 1970) and a place.
///
/// With [`Strategy::MonteCarlo`] and a number of visits as budget, slots are chosen as in RA-L 2016, section III.F: in
/// proportion to their gains, and exactly this number.
///
/// # Errors
/// [`DayError`] where the budget does not suit the day, there are no places or too many, or a gain is negative or NaN.
pub fn plan_day(
    slots: &DaySlots,
    places: usize,
    mut gain: impl FnMut(i64, usize) -> f64,
    strategy: Strategy,
    budget: Budget,
    seed: u64,
) -> Result<Vec<DayRow>, DayError> {
    // The budget is checked before any gain is computed, because gains may be costly.
    budget.visits(slots.count())?;
    let gains = Gains::of(slots.count(), places, |slot, place| gain(slots.middle_nanos(slot), place))?;
    let plan = strategy::schedule(strategy, &gains, budget, seed)?;
    let row = |(slot, location): (usize, Option<usize>)| DayRow {
        slot,
        start_nanos: slots.start_nanos(slot),
        location,
        information_bits: location.map_or(0.0, |place| gains.at(slot, place)),
    };
    Ok(plan.into_iter().enumerate().map(row).collect())
}
