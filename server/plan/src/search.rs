//! Where to look first: the walk that finds somebody, or something, soonest.
//!
//! The Graph Searching Problem of Krajník, Kulich, Mudrová, Ambrus, Duckett, "Where's Waldo at time t?", ICRA 2015
//! ("Waldo"): of all walks that visit every place, the one of the least expected time to find (eq. 1 to 3), given how likely
//! each place is. Invariant: an answer called optimal is; one that is not tells the least time that any walk could have.
//!
//! A place whose look takes no time is visited by whoever passes it, as in the paper. One whose look takes
//! [`Roads::dwell_secs`] may be passed without a look, where that is better; who is there is found on arrival, and the look's
//! time delays what comes after. Looking at the start comes first unless it takes time.

mod changing;
mod exact;
mod iterate;
mod local;
mod machine;
mod paths;
mod plan;
mod policy;
mod problem;
mod stop;

pub use changing::{CHANGING_GOALS_MAX, search_changing};
pub use plan::{Passage, Plan, Step};
pub use policy::{Joint, PolicyError, anyone, next_above};
pub use stop::{Stop, StopError, Stopped};

use tidemap_map::topology::{NodeId, Roads, ShortestTimes};

use self::{exact::Sorted, iterate::iterate, machine::Machine, problem::Passing, problem::Problem};

/// Most goals of which the best order is searched for.
pub const EXACT_GOALS_MAX: usize = 40;
/// Most goals of a search.
pub const GOALS_MAX: usize = 5_000;
/// The least probability that a goal counts with by default.
pub const FLOOR: f64 = 1e-6;

/// A place to look at.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Goal {
    /// Where.
    pub node: NodeId,
    /// How likely it is to find there who or what is looked for, in `[0,1]`. Those of all goals need not add up to one: there
    /// may be several, or none anywhere. See [`anyone`].
    pub probability: f64,
}

/// How hard to look for the best order.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub enum Effort {
    /// The best order up to [`EXACT_GOALS_MAX`] goals, as far as the budget goes; a good one of more.
    #[default]
    Auto,
    /// The best order, as far as the budget goes; more goals are refused.
    Exact,
    /// A good order, without proof.
    Heuristic,
}

/// Options of a search.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Options {
    /// How hard to look.
    pub effort: Effort,
    /// What a goal counts at least, in `[0,1]`, above 0. Without it, the order among impossible goals would be arbitrary: with
    /// it, they come last, the near ones first.
    pub floor: f64,
    /// Most states of an exact search, 40 bytes each; 4 million by default.
    pub states_max: usize,
    /// Most disturbances of a heuristic search; 10,000 by default.
    pub rounds_max: usize,
    /// Seed of the heuristic.
    pub seed: u64,
    /// When to give up.
    pub stop: Stop,
}

impl Default for Options {
    fn default() -> Options {
        let effort = Effort::Auto;
        Options { effort, floor: FLOOR, states_max: 4_000_000, rounds_max: 10_000, seed: 0, stop: Stop::default() }
    }
}

/// Why there is no plan.
#[derive(Clone, Debug, PartialEq, thiserror::Error)]
pub enum SearchError {
    /// Nothing to look at.
    #[error("there is nowhere to look: give at least one node with a probability")]
    NoGoals,
    /// The map has no such node.
    #[error("there is no node of number {0}")]
    UnknownNode(u32),
    /// A node is given twice.
    #[error("node number {0} is given twice")]
    DuplicateGoal(u32),
    /// A probability is none.
    #[error("the probability at node number {node} is {found}: expected 0 to 1")]
    Probability {
        /// The node.
        node: u32,
        /// What was given.
        found: f64,
    },
    /// The floor is no probability, or 0.
    #[error("the least probability of a goal is {0}: expected above 0, at most 1")]
    Floor(f64),
    /// A limit of the stop rule is out of range.
    #[error(transparent)]
    Stop(#[from] StopError),
    /// More goals than are searched exactly.
    #[error(
        "the best order of {found} places was asked for: at most {EXACT_GOALS_MAX} are possible; ask for a good one"
    )]
    TooManyForExact {
        /// Reachable goals.
        found: usize,
    },
    /// More goals than are searched.
    #[error("a search of {found} places: at most {most} are possible; leave out unlikely ones")]
    TooMany {
        /// Goals.
        found: usize,
        /// How many may be.
        most: usize,
    },
    /// No goal can be reached.
    #[error("none of the places can be reached from node number {start}")]
    Unreachable {
        /// Where the search begins.
        start: u32,
    },
}

/// A search with what was found of its order.
struct Ordered {
    /// Indices of nodes in the order of looking.
    nodes: Vec<usize>,
    lower_bound_secs: f64,
    complete: bool,
    states: usize,
}

/// A checked question: reachable goals with what they count.
struct Question {
    start: usize,
    /// Index of the node, probability as given.
    goals: Vec<(usize, f64)>,
    unreachable: Vec<Goal>,
}

/// Plans a search from a node. `until` is asked now and then whether to make do with what is found so far.
///
/// # Errors
/// [`SearchError`].
pub fn search(
    roads: &Roads,
    start: NodeId,
    goals: &[Goal],
    options: &Options,
    mut until: impl FnMut() -> bool,
) -> Result<Plan, SearchError> {
    let question = Question::new(roads, start, goals, options)?;
    let exact = match options.effort {
        Effort::Auto => question.goals.len() <= EXACT_GOALS_MAX,
        Effort::Exact if question.goals.len() > EXACT_GOALS_MAX => {
            return Err(SearchError::TooManyForExact { found: question.goals.len() });
        }
        Effort::Exact => true,
        Effort::Heuristic => false,
    };
    let ordered = order(roads, &question, options, exact, &mut until);
    let mut plan = Plan::of(roads, &question, &ordered, options.floor);
    options.stop.apply(&mut plan);
    Ok(plan)
}

impl Question {
    fn new(roads: &Roads, start: NodeId, goals: &[Goal], options: &Options) -> Result<Question, SearchError> {
        if goals.is_empty() {
            return Err(SearchError::NoGoals);
        }
        if options.floor.is_nan() || options.floor <= 0.0 || options.floor > 1.0 {
            return Err(SearchError::Floor(options.floor));
        }
        options.stop.check()?;
        // Before anything is computed for each of them.
        if options.effort == Effort::Exact && goals.len() > EXACT_GOALS_MAX {
            return Err(SearchError::TooManyForExact { found: goals.len() });
        }
        if goals.len() > GOALS_MAX {
            return Err(SearchError::TooMany { found: goals.len(), most: GOALS_MAX });
        }
        let index = |node: NodeId| roads.index_of(node).ok_or(SearchError::UnknownNode(node.0));
        let start_index = index(start)?;
        let mut given = Vec::with_capacity(goals.len());
        for goal in goals {
            if !(0.0..=1.0).contains(&goal.probability) {
                return Err(SearchError::Probability { node: goal.node.0, found: goal.probability });
            }
            given.push((index(goal.node)?, goal.probability));
        }
        given.sort_by_key(|&(node, _)| node);
        if let Some(pair) = given.windows(2).find(|pair| pair[0].0 == pair[1].0) {
            return Err(SearchError::DuplicateGoal(roads.node(pair[0].0).0));
        }
        let mut shortest = ShortestTimes::default();
        shortest.from(roads, start_index);
        let (goals, unreachable): (Vec<_>, Vec<_>) =
            given.into_iter().partition(|&(node, _)| shortest.secs()[node].is_finite());
        if goals.is_empty() {
            return Err(SearchError::Unreachable { start: start.0 });
        }
        let unreachable =
            unreachable.into_iter().map(|(node, probability)| Goal { node: roads.node(node), probability }).collect();
        Ok(Question { start: start_index, goals, unreachable })
    }
}

/// Finds an order of a question's goals.
fn order(
    roads: &Roads,
    question: &Question,
    options: &Options,
    exact: bool,
    mut until: impl FnMut() -> bool,
) -> Ordered {
    let start = question.start;
    let count_of = |probability: f64| probability.max(options.floor);
    let sum: f64 = question.goals.iter().map(|&(_, probability)| count_of(probability)).sum();
    let weighted = question.goals.iter().map(|&(node, probability)| (node, count_of(probability) / sum));
    // Who looks at the start without losing time does so first.
    let at_once = |node: usize| node == start && roads.dwell_secs(node) == 0.0;
    let goals: Vec<(usize, f64)> = weighted.clone().filter(|&(node, _)| !at_once(node)).collect();
    let first = weighted.filter(|&(node, _)| at_once(node)).map(|(node, _)| node);
    let mut problem = Problem::new(roads, start, &goals);
    let has_traps = problem.fill_missing();

    let (count, rounds) = (problem.count, if exact { first_rounds(problem.count) } else { options.rounds_max });
    let mut found = iterate(&problem, rounds, options.seed, &mut until);
    let mut known = problem.expected_secs(&found);
    let (mut lower_bound_secs, mut complete, mut states) = (known, count < 2, 0);
    if exact && count >= 2 {
        let mut passing = Passing::new(&problem);
        if count > exact::TABLE_GOALS_MAX {
            passing.find_before(&problem, roads, start, &goals);
        }
        let machine = Machine::new(&problem, Some(&passing));
        let sorted = problem.reordered(&machine.order);
        let passing = passing.reordered(&machine.order);
        let sorted_machine = machine.sorted();
        let sorted = Sorted { problem: &sorted, passing: &passing, machine: &sorted_machine };
        let mut proven = sorted.prove_quickly(known, options.states_max, &mut until);
        if !proven.complete {
            // The better the known walk, the less is looked at.
            let better = iterate(&problem, EXACT_ROUNDS * count, options.seed, &mut until);
            let cost = problem.expected_secs(&better);
            if cost < known {
                (found, known) = (better, cost);
            }
            proven = sorted.prove(known, &proven, options.states_max, &mut until);
        }
        if let Some(better) = proven.order {
            found = better.into_iter().map(|goal| machine.order[goal]).collect();
        }
        (lower_bound_secs, complete, states) = (proven.lower_bound, proven.complete, proven.states);
    } else if count >= 2 {
        lower_bound_secs = Machine::new(&problem, None).root;
    }
    if has_traps {
        // What cannot be reached any more costs something made up, and so does the bound.
        (lower_bound_secs, complete) = (0.0, false);
    }
    let nodes = first.chain(found.iter().map(|&goal| goals[goal].0)).collect();
    Ordered { nodes, lower_bound_secs, complete, states }
}

/// Disturbances, for each goal, before an exact search that takes longer.
const EXACT_ROUNDS: usize = 4;

/// Disturbances before an exact search of which it is not known whether it takes long.
fn first_rounds(count: usize) -> usize {
    if count <= exact::TABLE_GOALS_MAX { 0 } else { count }
}

#[cfg(test)]
mod tests;
