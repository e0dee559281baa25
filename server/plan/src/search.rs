//! Where to look first: the walk that finds somebody, or something, soonest.
//!
//! The Graph Searching Problem of Krajník, Kulich, Mudrová, Ambrus, Duckett, "Where's Waldo at time t?", ICRA 2015
//! ("Waldo"): of all walks that visit every place, the one of the least expected time to find (eq. 1 to 3), given how
//! likely each place is. Invariant: an answer called optimal is; one that is not tells the least time that any walk
//! could have.
//!
//! A place whose look takes no time is visited by whoever passes it, as in the paper. One whose look takes
//! [`Roads::dwell_secs`] may be passed without a look, where that is better; who is there is found on arrival, and the
//! look's time delays what comes after. Looking at the start comes first unless it takes time.

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

/// Most goals of which the best order is searched for.
pub const EXACT_GOALS_MAX: usize = 40;
/// Most goals of a search.
pub const GOALS_MAX: usize = 5_000;
/// The least probability that a goal counts with by default.
pub(crate) const FLOOR: f64 = 1e-6;

/// A place to look at.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Goal {
    /// Where.
    pub node: NodeId,
    /// How likely it is to find there who or what is looked for, in `[0,1]`. Those of all goals need not add up to one:
    /// there may be several, or none anywhere. See [`anyone`].
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
pub struct SearchOptions {
    /// How hard to look.
    pub effort: Effort,
    /// What a goal counts at least, in `[0,1]`, above 0. Without it, the order among impossible goals would be
    /// arbitrary: with it, they come last, the near ones first.
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

impl Default for SearchOptions {
    fn default() -> SearchOptions {
        let effort = Effort::Auto;
        SearchOptions {
            effort,
            floor: FLOOR,
            states_max: 4_000_000,
            rounds_max: 10_000,
            seed: 0,
            stop: Stop::default(),
        }
    }
}

/// Why there is no plan.
#[derive(Clone, Debug, PartialEq, thiserror::Error)]
#[expect(missing_docs, reason = "the messages name the fields")]
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
    Probability { node: u32, found: f64 },
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
    TooManyForExact { found: usize },
    /// More goals than are searched.
    #[error("a search of {found} places: at most {most} are possible; leave out unlikely ones")]
    TooMany { found: usize, most: usize },
    /// No goal can be reached.
    #[error("none of the places can be reached from node number {start}")]
    Unreachable { start: u32 },
}

#[cfg(test)]
mod tests;
