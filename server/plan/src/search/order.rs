//! Plans a search: the order of its goals, and the walk along it.

use tidemap_map::topology::{NodeId, Roads};

use super::{
    EXACT_GOALS_MAX, Effort, Goal, SearchError, SearchLimits, SearchOptions,
    exact::{self, SortedProblem},
    iterate::iterate,
    machine::Machine,
    plan::SearchPlan,
    problem::{Passing, SearchProblem},
    question::{GoalOrder, SearchQuestion},
};

/// Plans a search from a node. `until` is called at intervals; `true` ends the search with the best result so far.
///
/// # Errors
/// [`SearchError`].
pub fn search(
    roads: &Roads,
    start: NodeId,
    goals: &[Goal],
    options: &SearchOptions,
    until: impl FnMut() -> bool,
) -> Result<SearchPlan, SearchError> {
    search_with(SearchLimits::USUAL, roads, start, goals, options, until)
}

/// Does the same as [`search`], with other limits.
pub(super) fn search_with(
    limits: SearchLimits,
    roads: &Roads,
    start: NodeId,
    goals: &[Goal],
    options: &SearchOptions,
    mut until: impl FnMut() -> bool,
) -> Result<SearchPlan, SearchError> {
    let question = SearchQuestion::new(roads, start, goals, options)?;
    let exact = match options.effort {
        Effort::Auto => question.goals.len() <= EXACT_GOALS_MAX,
        Effort::Exact if question.goals.len() > EXACT_GOALS_MAX => {
            return Err(SearchError::TooManyForExact { found: question.goals.len() });
        }
        Effort::Exact => true,
        Effort::Heuristic => false,
    };
    let ordered = order(roads, &question, options, limits, exact, &mut until);
    let mut plan = SearchPlan::of(roads, &question, &ordered, options.floor);
    options.stop.apply(&mut plan);
    Ok(plan)
}

/// Finds an order of the goals.
pub(super) fn order(
    roads: &Roads,
    question: &SearchQuestion,
    options: &SearchOptions,
    limits: SearchLimits,
    exact: bool,
    mut until: impl FnMut() -> bool,
) -> GoalOrder {
    let start = question.start;
    let count_of = |probability: f64| probability.max(options.floor);
    let sum: f64 = question.goals.iter().map(|&(_, probability)| count_of(probability)).sum();
    let weighted = question.goals.iter().map(|&(node, probability)| (node, count_of(probability) / sum));
    // The start comes first if its observation takes no time.
    let at_once = |node: usize| node == start && roads.dwell_secs(node) == 0.0;
    let goals: Vec<(usize, f64)> = weighted.clone().filter(|&(node, _)| !at_once(node)).collect();
    let first = weighted.filter(|&(node, _)| at_once(node)).map(|(node, _)| node);
    let mut problem = SearchProblem::new(roads, start, &goals);
    let has_traps = problem.fill_missing();

    let (count, rounds) = (problem.count, if exact { first_rounds(problem.count) } else { limits.rounds_max });
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
        let sorted = SortedProblem { problem: &sorted, passing: &passing, machine: &sorted_machine };
        let mut proven = sorted.prove_quickly(known, limits.states_max, &mut until);
        if !proven.complete {
            // A better known walk prunes more.
            let better = iterate(&problem, EXACT_ROUNDS * count, options.seed, &mut until);
            let cost = problem.expected_secs(&better);
            if cost < known {
                (found, known) = (better, cost);
            }
            proven = sorted.prove(known, &proven, limits.states_max, &mut until);
        }
        if let Some(better) = proven.order {
            found = better.into_iter().map(|goal| machine.order[goal]).collect();
        }
        (lower_bound_secs, complete, states) = (proven.lower_bound, proven.complete, proven.states);
    } else if count >= 2 {
        lower_bound_secs = Machine::new(&problem, None).root;
    }
    if has_traps {
        // Unreachable goals have an artificial cost, so the bound is void.
        (lower_bound_secs, complete) = (0.0, false);
    }
    let nodes = first.chain(found.iter().map(|&goal| goals[goal].0)).collect();
    GoalOrder { nodes, lower_bound_secs, complete, states }
}

/// Perturbations per goal before a longer exact search.
const EXACT_ROUNDS: usize = 4;

/// Perturbations before the first attempt of an exact search.
fn first_rounds(count: usize) -> usize {
    if count <= exact::TABLE_GOALS_MAX { 0 } else { count }
}
