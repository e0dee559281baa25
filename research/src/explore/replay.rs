//! One run: a strategy with a model and a seed, from the first day to the last.
//!
//! Invariant: no strategy makes more visits in a day than its budget; strategies that schedule a day in advance use the
//! whole budget.

use tidemap_model::{InformationMeasure, Predictive};
use tidemap_plan::{
    information::{Certainty, LookWorth},
    location::{error_gain, information_bits, surprise_bits},
    strategy::{self, Allowance, Budget, Gains, Strategy, StrategyError},
};

use super::{
    ExploreError,
    belief::{Belief, BeliefModel, Known, Slots},
};
use crate::place_recording::PlaceRecording;

/// A strategy that chooses the place to visit.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum VisitStrategy {
    /// All places in turn.
    RoundRobin,
    /// Any place at any time.
    Random,
    /// The visits of a day that are worth most.
    Greedy,
    /// Places are drawn in proportion to their worth.
    MonteCarlo,
    /// The schedule of Monte Carlo, but changed where the short-term memory contradicts the model.
    NoveltyDriven,
    /// At each slot the place whose visit is worth most.
    Online,
    /// At each slot the place whose predicted state is most likely wrong; ties: the most likely place.
    OnlineError,
}

impl VisitStrategy {
    /// All strategies.
    pub const ALL: [VisitStrategy; 7] = [
        VisitStrategy::RoundRobin,
        VisitStrategy::Random,
        VisitStrategy::Greedy,
        VisitStrategy::MonteCarlo,
        VisitStrategy::NoveltyDriven,
        VisitStrategy::Online,
        VisitStrategy::OnlineError,
    ];

    /// The name of the strategy in protocols.
    pub fn name(self) -> &'static str {
        match self {
            VisitStrategy::RoundRobin => "round-robin",
            VisitStrategy::Random => "random",
            VisitStrategy::Greedy => "greedy",
            VisitStrategy::MonteCarlo => "monte-carlo",
            VisitStrategy::NoveltyDriven => "novelty-driven",
            VisitStrategy::Online => "online",
            VisitStrategy::OnlineError => "online-error",
        }
    }

    /// The strategy that schedules a day in advance; none if visits are chosen slot by slot.
    fn ahead(self, visited: u64) -> Option<Strategy> {
        match self {
            VisitStrategy::RoundRobin => Some(Strategy::RoundRobin { visited }),
            VisitStrategy::Random => Some(Strategy::Random),
            VisitStrategy::Greedy => Some(Strategy::Greedy),
            VisitStrategy::MonteCarlo | VisitStrategy::NoveltyDriven => Some(Strategy::MonteCarlo),
            VisitStrategy::Online | VisitStrategy::OnlineError => None,
        }
    }
}

/// A measure of the worth of a visit.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum VisitWorth {
    /// The entropy of the prediction (RAS 2017, eq. 10).
    Entropy,
    /// A measure that a map offers.
    Information(InformationMeasure),
}

impl VisitWorth {
    /// All measures.
    pub fn all() -> impl Iterator<Item = VisitWorth> {
        std::iter::once(VisitWorth::Entropy).chain(InformationMeasure::ALL.map(VisitWorth::Information))
    }

    /// The name of the measure in protocols.
    pub fn name(self) -> &'static str {
        match self {
            VisitWorth::Entropy => "entropy",
            VisitWorth::Information(measure) => measure.name(),
        }
    }

    /// The worth of a visit, in bits.
    fn bits(self, known: Known) -> f64 {
        match self {
            VisitWorth::Entropy => information_bits([known.probability]),
            VisitWorth::Information(measure) => {
                let around = known.looks.map(|looks| Predictive::new(known.probability, looks, 0.0));
                LookWorth { certainty: Certainty::default(), measure }.bits(known.probability, around)
            }
        }
    }
}

/// The strategy of an explorer, and its state.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(super) struct Explorer {
    /// The share of slots that may be used for visits, 0 to 1.
    pub exploration: f64,
    /// The strategy.
    pub strategy: VisitStrategy,
    /// The measure of the worth of a visit.
    pub worth: VisitWorth,
    /// The model of the places.
    pub model: BeliefModel,
}

/// The result of one run.
#[derive(Clone, Debug, PartialEq)]
pub(super) struct Run {
    /// Share of wrong states, 0 to 1, by day (RAS 2017, eq. 2).
    pub errors: Vec<f64>,
    /// Number of visits.
    pub visits: u64,
}

/// Explores a world once.
pub(super) fn replay(world: &PlaceRecording, explorer: Explorer, seed: u64) -> Result<Run, ExploreError> {
    let Explorer { exploration, strategy, worth, model } = explorer;
    let cannot_train = |refused| ExploreError::CannotTrain { model: model.name(), refused };
    let cannot_plan = |refused: StrategyError| ExploreError::Strategy { strategy: strategy.name(), refused };
    let (places, per_day) = (world.places.len(), world.slots());
    let slots = Slots { per_day, nanos: world.slot_minutes as i64 * 60_000_000_000 };
    let mut belief =
        Belief::new(model, places, slots, strategy == VisitStrategy::NoveltyDriven).map_err(cannot_train)?;
    let allowed = Budget::Ratio(exploration).visits(per_day).map_err(cannot_plan)?;
    let mut allowance = Allowance::new(per_day, allowed).map_err(cannot_plan)?;
    let mut run = Run { errors: Vec::with_capacity(world.days()), visits: 0 };
    for day in 0..world.days() {
        let first = day * per_day;
        belief.midnight(first).map_err(cannot_train)?;
        let schedule = match strategy.ahead(run.visits) {
            Some(ahead_by) => {
                let ahead = belief.ahead(first);
                let gain = |slot: usize, place: usize| worth.bits(ahead[slot][place]);
                let gains = Gains::of(per_day, places, gain).map_err(cannot_plan)?;
                let budget = Budget::Visits(allowed);
                strategy::schedule(ahead_by, &gains, budget, mixed(seed, first)).map_err(cannot_plan)?
            }
            None => vec![None; per_day],
        };
        let mut wrong = 0_u64;
        for (slot, planned) in (first..).zip(schedule) {
            belief.enter(slot);
            let known = belief.now();
            let visit = visit((strategy, worth), planned, &known, &belief, &mut allowance, mixed(seed, slot));
            wrong += errors(world.slot(slot), &known, visit);
            if let Some(place) = visit {
                run.visits += 1;
                belief.observe(place, world.seen(slot) == place);
            }
        }
        run.errors.push(wrong as f64 / (per_day * world.slot_minutes * places) as f64);
    }
    Ok(run)
}

/// The place to visit in the current slot; `planned` is the place scheduled in advance.
fn visit(
    (strategy, worth): (VisitStrategy, VisitWorth),
    planned: Option<usize>,
    known: &[Known],
    belief: &Belief,
    allowance: &mut Allowance,
    seed: u64,
) -> Option<usize> {
    match strategy {
        VisitStrategy::RoundRobin | VisitStrategy::Random | VisitStrategy::Greedy | VisitStrategy::MonteCarlo => {
            planned
        }
        VisitStrategy::NoveltyDriven => {
            let expected = belief.expected();
            let bits = |(&expected, known): (&f64, &Known)| {
                (surprise_bits([(expected, known.probability)]), information_bits([known.probability]))
            };
            planned.map(|planned| strategy::novel(expected.iter().zip(known).map(bits)).unwrap_or(planned))
        }
        VisitStrategy::Online | VisitStrategy::OnlineError => {
            let gain = |&known: &Known| match strategy {
                VisitStrategy::Online => worth.bits(known),
                _ => error_gain([known.probability]),
            };
            let gains: Vec<f64> = known.iter().map(gain).collect();
            let (place, gain) = strategy::best(&gains, seed)?;
            allowance.grant(gain).then_some(place)
        }
    }
}

/// Number of wrong states over the minutes of a slot (RAS 2017, eq. 1 and 2). An unknown state, p = 0.5, counts as off:
/// one person is in one of ten rooms.
fn errors(minutes: &[u8], known: &[Known], visit: Option<usize>) -> u64 {
    let mut wrong = 0;
    for &there in minutes {
        for (place, known) in known.iter().enumerate() {
            let is_wrong = (known.probability > 0.5) != (usize::from(there) == place);
            wrong += u64::from(is_wrong && visit != Some(place));
        }
    }
    wrong
}

/// A different seed for each slot (the finaliser of splitmix64; G. Steele et al., OOPSLA 2014).
fn mixed(seed: u64, slot: usize) -> u64 {
    let mut mixed = seed.wrapping_mul(0x9e37_79b9_7f4a_7c15).wrapping_add(slot as u64).wrapping_add(1);
    mixed = (mixed ^ (mixed >> 30)).wrapping_mul(0xbf58_476d_1ce4_e5b9);
    mixed = (mixed ^ (mixed >> 27)).wrapping_mul(0x94d0_49bb_1331_11eb);
    mixed ^ (mixed >> 31)
}
