//! Fades what the cells of a grid have learned, by whole local days.
//!
//! With a half-life H a reading of the day d counts 0.5^((D - d)/H), where D is the latest day on which the reading's
//! group was learned. The sums of a group, and of its changed cells, are multiplied on the days on which the group is
//! observed, so that a night costs nothing for cells that were not observed. A day that comes late counts less instead.
//!
//! Invariant: as for named states, only the ratio of weights matters, and a model keeps what it has learned of a cell
//! that is never observed again.

use tidemap_model::LocalDay;

/// How far the readings of a group have faded.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct GroupFade {
    /// Total weight of the readings, above 0 once there is one: at most the number of observations.
    pub weight: f64,
    /// The latest day that was learned, on which a reading counts 1; also in the sums of changed cells.
    pub day: LocalDay,
    /// The latest day that was learned in the group's own sums, which stop where the observation runs of its tile
    /// begin.
    pub sum_day: LocalDay,
}

impl GroupFade {
    /// A group without readings, before the readings of a day are added.
    pub(super) fn new(day: LocalDay) -> GroupFade {
        GroupFade { weight: 0.0, day, sum_day: day }
    }

    /// A group with this number of readings of equal weight, up to a local civil time.
    pub(super) fn of_equal(observations: u64, last_nanos: i64) -> GroupFade {
        GroupFade { weight: observations as f64, ..GroupFade::new(LocalDay::of_civil_nanos(last_nanos)) }
    }
}

/// The half-life of the cells of a grid.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(crate) struct HalfLife {
    days: f64,
}

/// The factors that a day applies to the weights of the earlier readings, and to its own readings; one of the two is 1.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(super) struct DayFactors {
    pub(super) known: f64,
    pub(super) of_day: f64,
}

impl DayFactors {
    /// The factors without a half-life.
    pub(super) const EQUAL: DayFactors = DayFactors { known: 1.0, of_day: 1.0 };

    /// The factors as bits, which can be hashed.
    pub(super) fn to_bits(self) -> [u64; 2] {
        [self.known.to_bits(), self.of_day.to_bits()]
    }
}

impl HalfLife {
    pub(crate) fn of_nanos(nanos: i64) -> HalfLife {
        HalfLife { days: nanos as f64 / (86_400.0 * 1e9) }
    }

    /// The weight of a reading of a day on another day that is not earlier.
    pub(super) fn factor(self, from: LocalDay, to: LocalDay) -> f64 {
        libm::exp2(-(i64::from(to.0) - i64::from(from.0)).max(0) as f64 / self.days)
    }

    /// The factors that a day applies to the weights of a group that was last learned on another day.
    pub(super) fn factors(self, learned: LocalDay, day: LocalDay) -> DayFactors {
        DayFactors { known: self.factor(learned, day), of_day: self.factor(day, learned) }
    }
}
