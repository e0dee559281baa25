//! A search with changing probabilities: each goal has its probability at the robot's arrival.
//!
//! This is a heuristic: the cost of a state would depend on its time, so the pruning of the exact search would not be
//! safe. The order is planned by the probabilities at the start, then replanned by those at the arrivals of the last
//! plan. The best of these orders is improved by moving, exchanging and reversing; each change is evaluated on the
//! whole walk. Invariant: with constant probabilities, the order is that of [`super::search`] or one of equal cost.

use tidemap_map::topology::{NodeId, Roads};

use super::{
    EXACT_GOALS_MAX, Effort, Goal, SearchError, SearchLimits, SearchOptions,
    order::order,
    plan::SearchPlan,
    problem::SearchProblem,
    question::{GoalOrder, SearchQuestion},
};

/// Maximum number of goals with changing probabilities: each change of the order costs as many predictions.
pub const CHANGING_GOALS_MAX: usize = 200;
/// Number of times that the order is planned again by the arrivals of the last plan.
const REPLANS: usize = 4;

/// Plans a search with probabilities predicted for the time of arrival: `probability(node, arrival_secs)`, in `[0,1]`.
///
/// Minimises the expected time until the search ends: the remaining share starts as the sum of the probabilities at the
/// start, falls at each arrival by the probability then, never below 0, and weights the times between arrivals. With
/// constant probabilities this is eq. 2. The plan is never called optimal, and its lower bound is 0; its expected time
/// is eq. 2 with the probabilities at the arrivals. The number of evaluated walks is limited.
///
/// # Errors
/// [`SearchError`], also for invalid predictions.
pub fn search_changing(
    roads: &Roads,
    start: NodeId,
    nodes: &[NodeId],
    probability: impl Fn(NodeId, f64) -> f64,
    options: &SearchOptions,
    mut until: impl FnMut() -> bool,
) -> Result<SearchPlan, SearchError> {
    if nodes.len() > CHANGING_GOALS_MAX {
        return Err(SearchError::TooMany { found: nodes.len(), max: CHANGING_GOALS_MAX });
    }
    let at_start: Vec<Goal> = nodes.iter().map(|&node| Goal { node, probability: probability(node, 0.0) }).collect();
    let mut question = SearchQuestion::new(roads, start, &at_start, options)?;
    let exact = options.effort != Effort::Heuristic && question.goals.len() <= EXACT_GOALS_MAX;

    let mut best: Option<(f64, GoalOrder)> = None;
    let goals: Vec<(usize, f64)> = question.goals.clone();
    let mut problem = SearchProblem::new(roads, question.start, &goals);
    problem.fill_missing();
    let weigh = |ordered: &GoalOrder| WeighedWalk::of(roads, &problem, &goals, ordered, options.floor, &probability);
    let mut replanned =
        SearchQuestion { goals: question.goals.clone(), unreachable: Vec::new(), start: question.start };
    for _ in 0..=REPLANS {
        let mut ordered = order(roads, &replanned, options, SearchLimits::USUAL, exact, &mut until);
        // Places on the way to other goals are visited in passing.
        let plan = SearchPlan::of(roads, &replanned, &ordered, options.floor);
        ordered.nodes = plan.steps.iter().filter_map(|step| roads.index_of(step.node)).collect();
        let weighed = weigh(&ordered)?;
        if best.as_ref().is_some_and(|(cost, _)| weighed.cost >= *cost) {
            break;
        }
        for (node, probability) in &mut replanned.goals {
            if let Some(at) = ordered.nodes.iter().position(|other| other == node) {
                *probability = weighed.probabilities[at];
            }
        }
        best = Some((weighed.cost, ordered));
        if until() {
            break;
        }
    }
    let Some((cost, mut ordered)) = best else { return Err(SearchError::NoGoals) };
    improve(&mut ordered, cost, SearchLimits::USUAL.rounds_max, |ordered| Ok(weigh(ordered)?.cost), until)?;

    let weighed = weigh(&ordered)?;
    for (node, probability) in &mut question.goals {
        if let Some(at) = ordered.nodes.iter().position(|other| other == node) {
            *probability = weighed.probabilities[at];
        }
    }
    ordered.complete = false;
    ordered.lower_bound_secs = 0.0;
    let mut plan = SearchPlan::of(roads, &question, &ordered, options.floor);
    options.stop.apply(&mut plan);
    Ok(plan)
}

/// A walk, evaluated with the probabilities at its arrivals.
struct WeighedWalk {
    cost: f64,
    probabilities: Vec<f64>,
}

impl WeighedWalk {
    fn of(
        roads: &Roads,
        problem: &SearchProblem,
        goals: &[(usize, f64)],
        ordered: &GoalOrder,
        floor: f64,
        probability: impl Fn(NodeId, f64) -> f64,
    ) -> Result<WeighedWalk, SearchError> {
        let expected: f64 = goals.iter().map(|&(_, probability)| probability.max(floor)).sum();
        let (mut at, mut now_secs, mut missing, mut cost) = (problem.count, 0.0, 1.0_f64, 0.0);
        let mut probabilities = Vec::with_capacity(goals.len());
        for &node in &ordered.nodes {
            // Goals are sorted by node.
            let Ok(goal) = goals.binary_search_by_key(&node, |&(node, _)| node) else { continue };
            now_secs += problem.secs(at, goal);
            cost += missing * problem.secs(at, goal);
            let node = roads.node(node);
            let here = probability(node, now_secs);
            if !(0.0..=1.0).contains(&here) {
                return Err(SearchError::Probability { node: node.0, found: here });
            }
            missing = (missing - here.max(floor) / expected).max(0.0);
            probabilities.push(here);
            at = goal;
        }
        Ok(WeighedWalk { cost, probabilities })
    }
}

/// Moves, exchanges and reverses while that lowers the cost, for at most the given number of walks.
fn improve(
    ordered: &mut GoalOrder,
    mut cost: f64,
    walks: usize,
    weigh: impl Fn(&GoalOrder) -> Result<f64, SearchError>,
    mut until: impl FnMut() -> bool,
) -> Result<(), SearchError> {
    let count = ordered.nodes.len();
    let mut left = walks;
    loop {
        let before = cost;
        for from in 0..count {
            for to in from + 1..count {
                for change in [Change::Reverse, Change::Later, Change::Earlier, Change::Swap] {
                    if left == 0 || until() {
                        return Ok(());
                    }
                    left -= 1;
                    change.apply(&mut ordered.nodes[from..=to]);
                    let changed = weigh(ordered)?;
                    if changed < cost * (1.0 - 1e-12) {
                        cost = changed;
                    } else {
                        change.undo(&mut ordered.nodes[from..=to]);
                    }
                }
            }
        }
        if cost >= before {
            return Ok(());
        }
    }
}

#[derive(Clone, Copy)]
enum Change {
    Reverse,
    Later,
    Earlier,
    Swap,
}

impl Change {
    fn apply(self, nodes: &mut [usize]) {
        match self {
            Change::Reverse => nodes.reverse(),
            Change::Later => nodes.rotate_left(1),
            Change::Earlier => nodes.rotate_right(1),
            Change::Swap => nodes.swap(0, nodes.len() - 1),
        }
    }

    fn undo(self, nodes: &mut [usize]) {
        match self {
            Change::Later => Change::Earlier.apply(nodes),
            Change::Earlier => Change::Later.apply(nodes),
            Change::Reverse | Change::Swap => self.apply(nodes),
        }
    }
}
