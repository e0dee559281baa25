//! Searches: the walk that finds a target, a person or an object, soonest.
//!
//! The Graph Searching Problem of Krajník, Kulich, Mudrová, Ambrus, Duckett, "Where's Waldo at time t?", ICRA 2015
//! ("Waldo"): of all walks that visit every place, the one with the least expected time to find the target (eq. 1 to
//! 3), given the probability of each place. This is a minimum latency problem with weights on shortest times. A goal is
//! never scheduled before an unvisited goal that lies on the way to it, because passing a goal visits it. Invariant: a
//! plan called optimal is optimal; otherwise it has a lower bound.
//!
//! A place whose observation takes no time is visited in passing, as in the paper. A place whose observation takes
//! [`Roads::dwell_secs`] may be passed without a visit if that is better; the target is found on arrival, and the
//! observation delays the later places. The start is visited first unless that takes time.

mod changing;
mod exact;
mod iterate;
mod local;
mod machine;
mod order;
mod paths;
mod plan;
mod policy;
mod problem;
mod question;
mod stop;

pub use changing::{CHANGING_GOALS_MAX, search_changing};
pub use order::search;
pub use plan::{Passage, SearchPlan, SearchStep};
pub use policy::{JointMoment, PolicyError, anyone, next_above};
pub use stop::{Stop, StopError, StopReason};

use tidemap_map::topology::NodeId;

/// Maximum number of goals of an exact search.
pub const EXACT_GOALS_MAX: usize = 40;
/// Maximum number of goals of a search.
pub const GOALS_MAX: usize = 5_000;
/// Default minimum probability of a goal.
pub(crate) const FLOOR: f64 = 1e-6;

/// The limits of a search. Plans use [`SearchLimits::USUAL`]; tests use smaller ones.
#[derive(Clone, Copy, Debug)]
struct SearchLimits {
    /// Maximum number of states of an exact search, 40 bytes each.
    states_max: usize,
    /// Maximum number of perturbations of a heuristic search.
    rounds_max: usize,
}

impl SearchLimits {
    /// The limits of every plan.
    const USUAL: SearchLimits = SearchLimits { states_max: 4_000_000, rounds_max: 10_000 };
}

/// A place to search.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Goal {
    /// The node.
    pub node: NodeId,
    /// Probability of finding the target at the node, in `[0,1]`. The probabilities need not add up to one: there may
    /// be several targets, or none. See [`anyone`].
    pub probability: f64,
}

/// The effort to find the best order.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub enum Effort {
    /// The best order up to [`EXACT_GOALS_MAX`] goals, within the budget; a good order above.
    #[default]
    Auto,
    /// The best order, within the budget; more goals are refused.
    Exact,
    /// A good order, without proof.
    Heuristic,
}

/// Options of a search.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct SearchOptions {
    /// The effort.
    pub effort: Effort,
    /// Minimum probability of a goal, in `[0,1]`, above 0. Without it, the order of impossible goals would be
    /// arbitrary; with it impossible goals come last, the near ones first.
    pub floor: f64,
    /// Seed of the heuristic.
    pub seed: u64,
    /// The stop rule.
    pub stop: Stop,
}

impl Default for SearchOptions {
    fn default() -> SearchOptions {
        SearchOptions { effort: Effort::Auto, floor: FLOOR, seed: 0, stop: Stop::default() }
    }
}

/// The reason why a search cannot be planned.
#[derive(Clone, Debug, PartialEq, thiserror::Error)]
#[expect(missing_docs, reason = "the messages name the fields")]
pub enum SearchError {
    /// There are no goals.
    #[error("there are no goals: give at least one node with a probability")]
    NoGoals,
    /// The map has no such node.
    #[error("there is no node of number {0}")]
    UnknownNode(u32),
    /// A node is given twice.
    #[error("node number {0} is given twice")]
    DuplicateGoal(u32),
    /// A probability is out of range.
    #[error("the probability at node number {node} is {found}: expected 0 to 1")]
    Probability { node: u32, found: f64 },
    /// The floor is out of range.
    #[error("the minimum probability of a goal is {0}: expected above 0, at most 1")]
    Floor(f64),
    /// A limit of the stop rule is out of range.
    #[error(transparent)]
    Stop(#[from] StopError),
    /// Too many goals for an exact search.
    #[error("an exact search of {found} places: at most {EXACT_GOALS_MAX} are possible; use the heuristic")]
    TooManyForExact { found: usize },
    /// Too many goals.
    #[error("a search of {found} places: at most {max} are possible; omit unlikely ones")]
    TooMany { found: usize, max: usize },
    /// No goal can be reached.
    #[error("no goal can be reached from node number {start}")]
    Unreachable { start: u32 },
}

#[cfg(test)]
mod tests;
