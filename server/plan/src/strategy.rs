//! Strategies of exploration: which slots of a day are used to look, and where (RAS 2017, section 5).
//!
//! RAS 2017 is Santos et al., "Spatio-temporal exploration strategies for long-term autonomy of mobile robots", Robotics and
//! Autonomous Systems 88. Invariant: a schedule has an entry for each slot; the same gains, budget and seed give the
//! same schedule; where a number of visits is asked for, the schedule has exactly so many.

mod allowance;
mod draw;
mod gains;
mod schedule;

#[cfg(test)]
mod tests;

pub use allowance::Allowance;
pub use gains::Gains;
pub use schedule::{best, choose, novel, schedule};

/// The most slots times places of one plan.
pub(crate) const GAINS_MAX: usize = 4_000_000;
/// The largest gain of one visit, in bits.
pub(crate) const GAIN_MAX: f64 = 1e12;
/// What every place is worth at least when places are drawn: ι of RAS 2017, eq. 11, which is 0.02 nats, in bits. So places
/// are visited even when the model is certain of them.
pub(crate) const IOTA_BITS: f64 = 0.02 * std::f64::consts::LOG2_E;

/// A visit is changed for another where that would tell at least so many times what the model expects of it: "I' ≫ I" of
/// RAS 2017, section 5.1. With a model that is sure (p = 0.05) it takes a short-term expectation above 0.25; one that
/// is at 0.2 is never that surprised.
pub(crate) const NOVELTY_FACTOR: f64 = 4.0;

/// How visits are scheduled for a day ahead.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub enum Strategy {
    /// All places in turn, evenly spaced over the day.
    RoundRobin {
        /// Visits made before: the turn goes on from there.
        visited: u64,
    },
    /// Slots and places alike by chance.
    Random,
    /// The slots whose best place has the highest gains; ties are broken by chance.
    Greedy,
    /// Slots and places by chance, in proportion to gain plus [`IOTA_BITS`] (eq. 11).
    #[default]
    MonteCarlo,
}

/// How much is explored.
#[derive(Clone, Copy, Debug, PartialEq)]
pub enum Budget {
    /// The exploration ratio e, from 0 to 1: Monte Carlo and random strategies keep it on average, drawing each slot by
    /// itself; the others use the nearest whole number of slots.
    Ratio(f64),
    /// Exactly so many visits, at most as many as there are slots.
    Visits(usize),
}

/// Why no schedule can be made.
#[derive(Clone, Debug, PartialEq, thiserror::Error)]
#[expect(missing_docs, reason = "the messages name the fields")]
pub enum StrategyError {
    /// Nothing to schedule.
    #[error("there are no slots: a schedule needs at least one")]
    NoSlots,
    /// Nowhere to go.
    #[error("there are no places to visit: name at least one")]
    NoPlaces,
    /// More than is worked out at once.
    #[error("{slots} slots times {places} places is more than {GAINS_MAX}: use longer slots or fewer places")]
    TooMany { slots: usize, places: usize },
    /// A gain that is none.
    #[error("the gain of place {place} in slot {slot} is {found}, expected a number from 0 to {GAIN_MAX:e}")]
    Gain { slot: usize, place: usize, found: f64 },
    /// A ratio outside its range.
    #[error("the exploration ratio is {found}, expected a number from 0 to 1")]
    Ratio { found: f64 },
    /// More visits than slots.
    #[error("{visits} visits do not fit into {slots} slots: ask for at most {slots}")]
    Budget { visits: usize, slots: usize },
    /// A weight outside its range.
    #[error("the weight of exploration is {found}, expected a number from 0 to 1")]
    Weight { found: f64 },
    /// Two matrices that do not belong together.
    #[error("gains have {} slots and {} places, the task's {} and {}", expected.0, expected.1, found.0, found.1)]
    Sizes { expected: (usize, usize), found: (usize, usize) },
}

impl Budget {
    /// The whole number of visits nearest to it.
    ///
    /// # Errors
    /// [`StrategyError`] where the ratio is outside `[0,1]` or there are more visits than slots.
    pub fn visits(self, slots: usize) -> Result<usize, StrategyError> {
        match self {
            // At most `slots`.
            Budget::Ratio(ratio) if (0.0..=1.0).contains(&ratio) => Ok((ratio * slots as f64).round() as usize),
            Budget::Ratio(found) => Err(StrategyError::Ratio { found }),
            Budget::Visits(visits) if visits <= slots => Ok(visits),
            Budget::Visits(visits) => Err(StrategyError::Budget { visits, slots }),
        }
    }
}
