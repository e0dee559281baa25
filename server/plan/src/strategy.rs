//! Strategies of exploration: which slots of a day are used to look, and where (RAS 2017, section 5).
//!
//! RAS 2017 is Santos et al., "Spatio-temporal exploration strategies for long-term autonomy of mobile robots", Robotics and
//! Autonomous Systems 88. Invariant: a schedule has an entry for each slot; the same gains, budget and seed give the
//! same schedule; where a number of visits is asked for, the schedule has exactly so many.

use rand::{Rng as _, SeedableRng as _, rngs::SmallRng};
use tidemap_model::{INFORMATION_CERTAINTY, entropy_bits};

mod allowance;
mod draw;
mod gains;

#[cfg(test)]
mod tests;

pub use allowance::Allowance;
pub use gains::{GAIN_MAX, GAINS_MAX, Gains};

/// What every place is worth at least when places are drawn: ι of RAS 2017, eq. 11, which is 0.02 nats, in bits. So places
/// are visited even when the model is certain of them.
pub const IOTA_BITS: f64 = 0.02 * std::f64::consts::LOG2_E;

/// A visit is changed for another where that would tell at least so many times what the model expects of it: "I' ≫ I" of
/// RAS 2017, section 5.1. With a model that is sure (p = 0.05) it takes a short-term expectation above 0.25; one that
/// is at 0.2 is never that surprised.
pub const NOVELTY_FACTOR: f64 = 4.0;

/// How visits are scheduled for a day ahead.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
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
pub enum StrategyError {
    /// Nothing to schedule.
    #[error("there are no slots: a schedule needs at least one")]
    NoSlots,
    /// Nowhere to go.
    #[error("there are no places to visit: name at least one")]
    NoPlaces,
    /// More than is worked out at once.
    #[error("{slots} slots times {places} places is more than {GAINS_MAX}: use longer slots or fewer places")]
    TooMany {
        /// Slots.
        slots: usize,
        /// Places.
        places: usize,
    },
    /// A gain that is none.
    #[error("the gain of place {place} in slot {slot} is {found}, expected a number from 0 to {GAIN_MAX:e}")]
    Gain {
        /// In which slot.
        slot: usize,
        /// Of which place.
        place: usize,
        /// Its gain; NaN where it was a probability outside 0 to 1.
        found: f64,
    },
    /// A ratio outside its range.
    #[error("the exploration ratio is {found}, expected a number from 0 to 1")]
    Ratio {
        /// What was given.
        found: f64,
    },
    /// More visits than slots.
    #[error("{visits} visits do not fit into {slots} slots: ask for at most {slots}")]
    Budget {
        /// Asked for.
        visits: usize,
        /// There are.
        slots: usize,
    },
    /// A weight outside its range.
    #[error("the weight of exploration is {found}, expected a number from 0 to 1")]
    Weight {
        /// What was given.
        found: f64,
    },
    /// Two matrices that do not belong together.
    #[error("gains have {} slots and {} places, the task's {} and {}", expected.0, expected.1, found.0, found.1)]
    Sizes {
        /// Slots and places of the gains.
        expected: (usize, usize),
        /// Of the task.
        found: (usize, usize),
    },
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

/// Which place to visit in each slot; `None` where the slot is left to other tasks.
///
/// # Errors
/// [`StrategyError`] where the budget does not suit the slots.
pub fn schedule(
    strategy: Strategy,
    gains: &Gains,
    budget: Budget,
    seed: u64,
) -> Result<Vec<Option<usize>>, StrategyError> {
    let (slots, places) = (gains.slots(), gains.places());
    let visits = budget.visits(slots)?;
    let mut random = SmallRng::seed_from_u64(seed);
    Ok(match strategy {
        Strategy::RoundRobin { visited } => {
            let mut turn = (visited % places as u64) as usize;
            let visit = |slot: usize| {
                let is_visit = (slot + 1) * visits / slots > slot * visits / slots;
                is_visit.then(|| {
                    let place = turn;
                    turn = (turn + 1) % places;
                    place
                })
            };
            (0..slots).map(visit).collect()
        }
        Strategy::Random => by_chance(
            &mut random,
            budget,
            visits,
            slots,
            |_, _| 1.0,
            places,
            |ratio| {
                if ratio > 0.0 { places as f64 * (1.0 - ratio) / ratio } else { 0.0 }
            },
        ),
        Strategy::MonteCarlo => {
            let total = gains.total();
            by_chance(
                &mut random,
                budget,
                visits,
                slots,
                |slot, place| gains.at(slot, place) + IOTA_BITS,
                places,
                |ratio| {
                    if ratio >= 1.0 {
                        0.0
                    } else if total > 0.0 {
                        total * (1.0 - ratio) / (slots as f64 * ratio) + IOTA_BITS
                    } else {
                        // Where nothing can be gained anywhere, ι alone would not keep the ratio.
                        places as f64 * IOTA_BITS * (1.0 - ratio) / ratio
                    }
                },
            )
        }
        Strategy::Greedy => greedy(&mut random, gains, visits),
    })
}

/// Draws slots and places in proportion to weights. With a ratio each slot is drawn by itself, against a weight of rest.
fn by_chance(
    random: &mut SmallRng,
    budget: Budget,
    visits: usize,
    slots: usize,
    weight: impl Fn(usize, usize) -> f64,
    places: usize,
    rest: impl Fn(f64) -> f64,
) -> Vec<Option<usize>> {
    let mut plan = vec![None; slots];
    match budget {
        Budget::Ratio(ratio) if ratio > 0.0 => {
            let rest = rest(ratio);
            for (slot, visit) in plan.iter_mut().enumerate() {
                let weights = std::iter::once(rest).chain((0..places).map(|place| weight(slot, place)));
                *visit = draw::index(random, weights).checked_sub(1);
            }
        }
        Budget::Ratio(_) => {}
        Budget::Visits(_) => {
            let of_slots: Vec<f64> =
                (0..slots).map(|slot| (0..places).map(|place| weight(slot, place)).sum()).collect();
            for slot in draw::distinct(random, &of_slots, visits) {
                if let Some(visit) = plan.get_mut(slot) {
                    *visit = Some(draw::index(random, (0..places).map(|place| weight(slot, place))));
                }
            }
        }
    }
    plan
}

fn greedy(random: &mut SmallRng, gains: &Gains, visits: usize) -> Vec<Option<usize>> {
    let best: Vec<Option<(usize, f64)>> =
        (0..gains.slots()).map(|slot| draw::largest(random, gains.slot(slot))).collect();
    let mut ranked: Vec<(f64, u64, usize)> = best
        .iter()
        .enumerate()
        .map(|(slot, best)| (best.map_or(0.0, |(_, gain)| gain), random.random(), slot))
        .collect();
    ranked.sort_by(|a, b| b.0.total_cmp(&a.0).then(a.1.cmp(&b.1)));
    let mut plan = vec![None; gains.slots()];
    for (_, _, slot) in ranked.into_iter().take(visits) {
        plan[slot] = best[slot].map(|(place, _)| place);
    }
    plan
}

/// One place, chosen again for the knowledge of now, by the gains of all places in the slot: the best, or for strategies
/// that draw, one in proportion to gain plus [`IOTA_BITS`]. Strategies that do not look at gains, and gains that are empty,
/// keep what was `planned`.
pub fn choose(strategy: Strategy, planned: usize, gains_now: &[f64], seed: u64) -> usize {
    let mut random = SmallRng::seed_from_u64(seed);
    match strategy {
        Strategy::RoundRobin { .. } | Strategy::Random => planned,
        Strategy::Greedy => draw::largest(&mut random, gains_now).map_or(planned, |(place, _)| place),
        Strategy::MonteCarlo if gains_now.is_empty() => planned,
        Strategy::MonteCarlo => {
            draw::index(&mut random, gains_now.iter().map(|gain| gain.clamp(0.0, GAIN_MAX) + IOTA_BITS))
        }
    }
}

/// Where to go instead of what was planned, because what was seen lately says that the model is wrong there: of the places
/// where [`surprise_bits`](crate::location::surprise_bits) is at least [`NOVELTY_FACTOR`] times what the model expects,
/// the one with the largest difference (RAS 2017, eq. 12). `None` where there is none. Pairs are (I', I) of each place.
pub fn novel(places: impl IntoIterator<Item = (f64, f64)>) -> Option<usize> {
    let mut best: Option<(usize, f64)> = None;
    for (place, (surprise, expected)) in places.into_iter().enumerate() {
        let more = surprise - expected;
        // Surprise counts no model as surer than the certainty, so neither does what it is compared with.
        let is_novel = surprise >= NOVELTY_FACTOR * expected.max(entropy_bits(INFORMATION_CERTAINTY));
        if is_novel && best.is_none_or(|(_, most)| more > most) {
            best = Some((place, more));
        }
    }
    best.map(|(place, _)| place)
}

/// The place with the largest gain, and that gain; ties are broken by the seed. `None` of none.
pub fn best(gains_now: &[f64], seed: u64) -> Option<(usize, f64)> {
    draw::largest(&mut SmallRng::seed_from_u64(seed), gains_now)
}
