//! Terminals that choose their places in different ways.
//!
//! Invariant: a terminal stands in one place in each slot. The map learns from the terminal that tidemap plans for
//! alone, and the static place is chosen by the learned data of that map.

use rand::Rng as _;
use tidemap_map::{
    event::Observations,
    ids::StateId,
    name::{MapName, ProducerKey, StateName},
    spec::MapSpec,
};
use tidemap_model::{InformationMeasure, Predictive, Sample, selector::ModelSelector};
use tidemap_plan::{
    information::LookWorth,
    strategy::{Budget, Gains, Strategy, schedule},
};

use super::{
    TerminalError,
    visitors::{HOUR_MINUTES, House, SLOT_MINUTES, SLOTS, WORKING_HOURS},
};
use crate::{
    nightly_map::NightlyMap,
    routes::{START_NANOS, WEEK_DAYS, building::draw},
};

const MINUTE_NANOS: i64 = 60_000_000_000;
const DAY_NANOS: i64 = 86_400_000_000_000;
/// Weight of the information gain of an observation, beside the probability that a visitor comes.
const EXPLORATION: f64 = 0.1;
/// Subjects of draws, apart from the draws of the house.
const UNIFORM: u64 = 11;
const TIES: u64 = 12;

/// The method by which a terminal chooses its places.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum TerminalRobotKind {
    /// A random place in each slot.
    Uniform,
    /// Always the place where people came in the greatest share of the slots that tidemap has learned.
    StaticLearned,
    /// Always the place with the greatest number of visitors in all weeks, which no robot knows beforehand.
    StaticBest,
    /// The place that tidemap plans.
    Tidemap,
    /// The place with the greatest true rate of visitors.
    Oracle,
}

impl TerminalRobotKind {
    /// All kinds.
    pub const ALL: [TerminalRobotKind; 5] = [
        TerminalRobotKind::Uniform,
        TerminalRobotKind::StaticLearned,
        TerminalRobotKind::StaticBest,
        TerminalRobotKind::Tidemap,
        TerminalRobotKind::Oracle,
    ];

    /// The name of the terminal in results.
    pub fn name(self) -> &'static str {
        match self {
            TerminalRobotKind::Uniform => "uniform",
            TerminalRobotKind::StaticLearned => "static-learned",
            TerminalRobotKind::StaticBest => "static-best",
            TerminalRobotKind::Tidemap => "tidemap",
            TerminalRobotKind::Oracle => "oracle",
        }
    }
}

/// The interactions an hour of each robot in each week.
pub(super) fn run(seed: u64, weeks: usize) -> Result<Vec<Vec<f64>>, TerminalError> {
    let house = House::new(seed);
    let places = House::places().len();
    let best = static_best(&house, weeks);
    let mut learner = TerminalLearner::new()?;
    let mut used = vec![vec![0.0; weeks]; TerminalRobotKind::ALL.len()];
    let mut stands: [Option<usize>; TerminalRobotKind::ALL.len()] = Default::default();
    for day in 0..weeks * WEEK_DAYS {
        let planned = learner.plan(seed, day)?;
        let learned = learner.static_place();
        let mut random = draw(seed, [UNIFORM, day as u64, 0]);
        let mut seen = Vec::with_capacity(SLOTS);
        for (slot, &planned) in planned.iter().enumerate() {
            let rate = |place: &usize| house.rate(*place, day, middle_hour(slot));
            for (index, kind) in TerminalRobotKind::ALL.into_iter().enumerate() {
                let place = match kind {
                    TerminalRobotKind::Uniform => random.random_range(0..places),
                    TerminalRobotKind::StaticLearned => learned,
                    TerminalRobotKind::StaticBest => best,
                    TerminalRobotKind::Tidemap => planned,
                    TerminalRobotKind::Oracle => {
                        (0..places).max_by(|one, other| rate(one).total_cmp(&rate(other))).unwrap_or(0)
                    }
                };
                let has_moved = stands[index].replace(place).is_some_and(|before| before != place);
                let interactions = house.interactions(place, day, slot, has_moved);
                used[index][day / WEEK_DAYS] += interactions as f64;
                if kind == TerminalRobotKind::Tidemap {
                    seen.push((place, interactions > 0));
                }
            }
        }
        learner.learn(day, &seen)?;
    }
    let hours = (WEEK_DAYS * SLOTS * SLOT_MINUTES) as f64 / HOUR_MINUTES as f64;
    used.iter_mut().flatten().for_each(|count| *count /= hours);
    Ok(used)
}

/// The place where a terminal that never moves is used the greatest number of times.
fn static_best(house: &House, weeks: usize) -> usize {
    let total = |place: &usize| -> u64 {
        let slots = (0..weeks * WEEK_DAYS).flat_map(|day| (0..SLOTS).map(move |slot| (day, slot)));
        slots.map(|(day, slot)| house.interactions(*place, day, slot, false)).sum()
    };
    (0..House::places().len()).max_by_key(total).unwrap_or(0)
}

/// The map of a terminal, with a state for each place: somebody comes in a slot.
#[derive(Debug)]
struct TerminalLearner {
    map: NightlyMap,
    states: Vec<StateId>,
    /// By place: slots in which the terminal stood there, and those in which somebody came.
    seen: Vec<(u64, u64)>,
}

impl TerminalLearner {
    fn new() -> Result<Self, TerminalError> {
        let name = MapName::new("house").map_err(TerminalError::setting)?;
        let producer = ProducerKey::new("terminal", "").map_err(TerminalError::setting)?;
        let spec = MapSpec { created_nanos: START_NANOS, ..MapSpec::new(name) };
        let mut map = NightlyMap::new(spec, producer);
        let add = |place: &str| {
            let name = StateName::new(&format!("people.{place}")).map_err(TerminalError::setting)?;
            Ok(map.add_probability(name)?)
        };
        let states: Vec<StateId> = House::places().map(add).collect::<Result<_, TerminalError>>()?;
        let seen = vec![(0, 0); states.len()];
        Ok(Self { map, states, seen })
    }

    /// The place of each slot of a day.
    fn plan(&mut self, seed: u64, day: usize) -> Result<Vec<usize>, TerminalError> {
        let view = self.map.view();
        let middles: Vec<i64> = (0..SLOTS).map(|slot| middle_nanos(day, slot)).collect();
        let times = view.prepare(&middles);
        let worth = LookWorth { measure: InformationMeasure::Learn, ..LookWorth::default() };
        let (mut chances, mut bits) = (Vec::new(), Vec::new());
        for (&state, (looks, _)) in self.states.iter().zip(&self.seen) {
            let mut values = vec![0.0; SLOTS];
            view.predict_into(state, &times, ModelSelector::default(), &mut values);
            let known = if *looks == 0 {
                Some(values.iter().map(|&value| Predictive::new(value, 0.0, 0.0)).collect())
            } else {
                view.model(state).predictive_around(times.moments(), &values)
            };
            let worth_at = |slot: usize| worth.bits(values[slot], known.as_ref().map(|known: &Vec<_>| known[slot]));
            bits.push((0..SLOTS).map(worth_at).collect::<Vec<f64>>());
            chances.push(values);
        }
        let places = self.states.len();
        let information = Gains::of(SLOTS, places, |slot, place| bits[place][slot])?;
        let people = Gains::of(SLOTS, places, |slot, place| chances[place][slot].clamp(0.0, 1.0))?;
        let gains = information.weighed(&people, EXPLORATION)?;
        let ties = draw(seed, [TIES, day as u64, 0]).random();
        let planned = schedule(Strategy::Greedy, &gains, Budget::Visits(SLOTS), ties)?;
        Ok(planned.into_iter().map(Option::unwrap_or_default).collect())
    }

    /// The place where people came in the greatest share of the slots; half a person more where little is known.
    fn static_place(&self) -> usize {
        let share = |place: &usize| {
            let (looks, came) = self.seen[*place];
            (came as f64 + 0.5) / (looks as f64 + 1.0)
        };
        (0..self.seen.len()).max_by(|one, other| share(one).total_cmp(&share(other))).unwrap_or(0)
    }

    /// Learns the slots of a day: where the terminal stood, and whether somebody came.
    fn learn(&mut self, day: usize, seen: &[(usize, bool)]) -> Result<(), TerminalError> {
        let midnight_nanos = START_NANOS + (day as i64 + 1) * DAY_NANOS;
        let mut observed = Observations::default();
        for (slot, &(place, came)) in seen.iter().enumerate() {
            let value = f64::from(u8::from(came));
            observed.push(self.states[place], Sample { utc_nanos: middle_nanos(day, slot), offset_secs: 0, value });
            let (looks, with_people) = &mut self.seen[place];
            *looks += 1;
            *with_people += u64::from(came);
        }
        self.map.observe(observed, seen.len() as u64, midnight_nanos)?;
        self.map.update(midnight_nanos)
    }
}

fn middle_hour(slot: usize) -> f64 {
    WORKING_HOURS.start as f64 + (slot as f64 + 0.5) * SLOT_MINUTES as f64 / HOUR_MINUTES as f64
}

fn middle_nanos(day: usize, slot: usize) -> i64 {
    let minute = middle_hour(slot) * HOUR_MINUTES as f64;
    START_NANOS + day as i64 * DAY_NANOS + (minute * MINUTE_NANOS as f64) as i64
}
