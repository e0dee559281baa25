//! A checked request of a search, and the order found for it.

use tidemap_map::topology::{NodeId, Roads, ShortestTimes};

use super::{EXACT_GOALS_MAX, Effort, GOALS_MAX, Goal, SearchError, SearchOptions};

/// The order found for a search.
pub(super) struct GoalOrder {
    /// Indices of nodes in the order of visits.
    pub(super) nodes: Vec<usize>,
    pub(super) lower_bound_secs: f64,
    pub(super) complete: bool,
    pub(super) states: usize,
}

/// A checked request: reachable goals with their probabilities.
pub(super) struct SearchQuestion {
    pub(super) start: usize,
    /// Index of the node, and the probability as given.
    pub(super) goals: Vec<(usize, f64)>,
    pub(super) unreachable: Vec<Goal>,
}

impl SearchQuestion {
    pub(super) fn new(
        roads: &Roads,
        start: NodeId,
        goals: &[Goal],
        options: &SearchOptions,
    ) -> Result<SearchQuestion, SearchError> {
        if goals.is_empty() {
            return Err(SearchError::NoGoals);
        }
        if options.floor.is_nan() || options.floor <= 0.0 || options.floor > 1.0 {
            return Err(SearchError::Floor(options.floor));
        }
        options.stop.check()?;
        // The number of goals is checked before any work per goal.
        if options.effort == Effort::Exact && goals.len() > EXACT_GOALS_MAX {
            return Err(SearchError::TooManyForExact { found: goals.len() });
        }
        if goals.len() > GOALS_MAX {
            return Err(SearchError::TooMany { found: goals.len(), max: GOALS_MAX });
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
        Ok(SearchQuestion { start: start_index, goals, unreachable })
    }
}
