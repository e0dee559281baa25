//! Strategies of exploration: which slots of a day are used for a visit, and where to go (RAS 2017, section 5).
//!
//! RAS 2017 is Santos et al., "Spatio-temporal exploration strategies for long-term autonomy of mobile robots",
//! Robotics and Autonomous Systems 88. Invariant: a schedule has an entry for each slot; the same gains, budget and
//! seed give the same schedule; with a number of visits as budget, the schedule has exactly this number. The module
//! does not use a grid or a map: the caller supplies the gain of each place in each slot. Ties are broken by seed: if
//! the first place of a list were always taken, the first day would visit only that place.

mod allowance;
mod draw;
mod gains;
mod schedule;

#[cfg(test)]
mod tests;

pub use allowance::{Allowance, is_worth_a_visit};
pub use gains::Gains;
pub use schedule::{best, choose, novel, schedule};

/// Maximum of slots times places of one plan.
pub(crate) const GAINS_MAX: usize = 4_000_000;
/// The largest gain of one visit, in bits.
pub(crate) const GAIN_MAX: f64 = 1e12;
/// The least gain of every place in random draws: ι of RAS 2017, eq. 11, 0.02 nats in bits. So places are visited even
/// if the model is certain of them.
pub(crate) const IOTA_BITS: f64 = 0.02 * std::f64::consts::LOG2_E;

/// A visit is replaced by another whose information is at least this multiple of the model's expectation: "I' ≫ I" of
/// RAS 2017, section 5.1. With a certain model (p = 0.05) this needs a short-term expectation above 0.25; with p = 0.2
/// it never happens.
pub(crate) const NOVELTY_FACTOR: f64 = 4.0;

/// The schedule of the visits of a day.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub enum Strategy {
    /// Visits all places in turn, evenly spaced over the day.
    RoundRobin {
        /// Number of earlier visits: the rotation continues from there.
        visited: u64,
    },
    /// Visits random places in random slots.
    Random,
    /// Uses the slots whose best place has the highest gain; ties are broken at random.
    Greedy,
    /// Draws slots and places at random, in proportion to gain plus [`IOTA_BITS`] (eq. 11). With a ratio as budget each
    /// slot is drawn independently, against a weight of no visit for which the expected share of visits is the ratio
    /// (with the weight of section 5.1 the share would be less where the gains of slots differ); with a number of
    /// visits exactly this number of slots is drawn.
    #[default]
    MonteCarlo,
}

/// The budget of exploration.
#[derive(Clone, Copy, Debug, PartialEq)]
pub enum Budget {
    /// The exploration ratio e, from 0 to 1: Monte Carlo and random strategies keep it on average, drawing each slot
    /// independently; the others use the nearest whole number of slots.
    Ratio(f64),
    /// Exactly this number of visits, at most the number of slots.
    Visits(usize),
}

/// The reason why a schedule is impossible.
#[derive(Clone, Debug, PartialEq, thiserror::Error)]
#[expect(missing_docs, reason = "the messages name the fields")]
pub enum StrategyError {
    /// There are no slots.
    #[error("there are no slots: a schedule needs at least one")]
    NoSlots,
    /// There are no places.
    #[error("there are no places to visit: name at least one")]
    NoPlaces,
    /// The plan is too large.
    #[error("{slots} slots times {places} places is more than {GAINS_MAX}: use longer slots or fewer places")]
    TooMany { slots: usize, places: usize },
    /// A gain is out of range.
    #[error("the gain of place {place} in slot {slot} is {found}, expected a number from 0 to {GAIN_MAX:e}")]
    Gain { slot: usize, place: usize, found: f64 },
    /// The ratio is out of range.
    #[error("the exploration ratio is {found}, expected a number from 0 to 1")]
    Ratio { found: f64 },
    /// More visits than slots.
    #[error("{visits} visits do not fit into {slots} slots: request at most {slots}")]
    Budget { visits: usize, slots: usize },
    /// The weight is out of range.
    #[error("the weight of exploration is {found}, expected a number from 0 to 1")]
    Weight { found: f64 },
    /// Two matrices have different sizes.
    #[error("gains have {} slots and {} places, the task's {} and {}", expected.0, expected.1, found.0, found.1)]
    Sizes { expected: (usize, usize), found: (usize, usize) },
}

impl Budget {
    /// The nearest whole number of visits.
    ///
    /// # Errors
    /// [`StrategyError`] where the ratio is outside `[0,1]` or there are more visits than slots.
    pub fn visits(self, slots: usize) -> Result<usize, StrategyError> {
        match self {
            // The result is at most `slots`.
            Budget::Ratio(ratio) if (0.0..=1.0).contains(&ratio) => Ok((ratio * slots as f64).round() as usize),
            Budget::Ratio(found) => Err(StrategyError::Ratio { found }),
            Budget::Visits(visits) if visits <= slots => Ok(visits),
            Budget::Visits(visits) => Err(StrategyError::Budget { visits, slots }),
        }
    }
}
