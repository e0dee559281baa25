//! What to do at each node at each time on the way to a target, where edges fail and their success and duration depend on time.
//!
//! A Markov decision process after the topological navigation of N. Hawes et al., "The STRANDS Project", IEEE RAM 2017: states
//! are nodes at times, in slots of equal width from the reference time; its actions are the edges that leave a node, and to wait
//! there until the next slot. An edge that is taken in a slot is forecast for the slot's middle. With its success it brings the
//! robot to its end after its duration d; otherwise the robot is where it was after d and the recovery r.
//!
//! Values are those at the beginnings of slots. A time between two beginnings counts as one of them, each as likely as the time is
//! close to it: values are straight between beginnings, and times are right on average. Several edges may be gone within one slot:
//! its values then depend on each other, and are solved for together, exactly, by policy iteration (`policy/settle.rs`).
//!
//! A [`route`](crate::route) is a plan for when all goes well; this one has an answer after a failure, too, and may wait for a
//! door. Invariant: the values are those of the best actions, to the last digits; no number is NaN.

mod settle;
mod solve;

use tidemap_map::topology::{EdgeId, NodeId};

pub use self::solve::solve_policy;
use crate::route::ForecastError;

/// Most states, nodes times slots, of a policy.
pub(crate) const POLICY_STATES_MAX: usize = 2_000_000;

/// What a policy is best at.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub enum PolicyObjective {
    /// The greatest probability to be at the target by the end of the last slot; of equal ones the least expected time until then,
    /// and of these the fewest attempts, where what differs by 1e-12 is equal.
    #[default]
    Reach,
    /// The least expected time to the target. Forecasts of the last slot stay for ever; of equal ones the fewest attempts.
    Time,
}

/// How to plan.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct PolicyOptions {
    /// What is sought; to reach the target by default.
    pub objective: PolicyObjective,
    /// Width of a slot, in seconds, 0.001 to [`NOMINAL_MAX_SECS`]; 900 by default.
    pub slot_secs: f64,
    /// How many slots, 1 or more; 96 by default, a day. Nodes times slots are at most [`POLICY_STATES_MAX`].
    pub slots: usize,
    /// What a failed attempt costs beside its time, in seconds, 0 to [`NOMINAL_MAX_SECS`]; 60 by default.
    pub recovery_secs: f64,
}

impl Default for PolicyOptions {
    fn default() -> PolicyOptions {
        PolicyOptions { objective: PolicyObjective::Reach, slot_secs: 900.0, slots: 96, recovery_secs: 60.0 }
    }
}

/// What to do.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum PolicyAction {
    /// Take this edge.
    Take(EdgeId),
    /// Stay until the next slot begins.
    Wait,
    /// Nothing: this is the target.
    Arrived,
    /// Nothing that is done here helps.
    Nothing,
}

/// A node in a slot.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct PolicyEntry {
    /// What to do.
    pub action: PolicyAction,
    /// With [`PolicyObjective::Time`]: expected seconds to the target, infinite where it is not certain to be reached at last. With
    /// [`PolicyObjective::Reach`]: expected seconds until the target or the end of the last slot, whichever comes first.
    pub expected_secs: f64,
    /// Probability to be at the target by the end of the last slot.
    pub reach: f64,
}

/// What to do at each node in each slot.
#[derive(Clone, Debug, PartialEq)]
pub struct PolicyTable {
    target: NodeId,
    slot_secs: f64,
    slots: usize,
    /// Ascending by number.
    nodes: Vec<NodeId>,
    /// Slot by slot, node by node.
    entries: Vec<PolicyEntry>,
}

impl PolicyTable {
    /// Where the policy leads.
    #[must_use]
    pub fn target(&self) -> NodeId {
        self.target
    }

    /// Width of a slot, in seconds.
    #[must_use]
    pub fn slot_secs(&self) -> f64 {
        self.slot_secs
    }

    /// Number of slots.
    #[must_use]
    pub fn slots(&self) -> usize {
        self.slots
    }

    /// All nodes, ascending by number.
    #[must_use]
    pub fn nodes(&self) -> &[NodeId] {
        &self.nodes
    }

    /// A node in a slot; `None` where the map has no such node or the policy no such slot.
    #[must_use]
    pub fn entry(&self, node: NodeId, slot: usize) -> Option<PolicyEntry> {
        let index = self.nodes.binary_search(&node).ok()?;
        Some(self.slot(slot)?[index])
    }

    /// All nodes in a slot, in the order of [`PolicyTable::nodes`].
    #[must_use]
    pub fn slot(&self, slot: usize) -> Option<&[PolicyEntry]> {
        let count = self.nodes.len();
        (slot < self.slots).then(|| &self.entries[slot * count..(slot + 1) * count])
    }
}

/// Why there is no policy.
#[derive(Clone, Debug, PartialEq, thiserror::Error)]
#[expect(missing_docs, reason = "the messages name the fields")]
pub enum PolicyError {
    /// The map has no such node.
    #[error("there is no node of number {0}")]
    UnknownNode(u32),
    /// A number of the question is out of range.
    #[error("{what} is {found}: expected {expected}")]
    Range { what: &'static str, found: f64, expected: String },
    /// More states than are solved for.
    #[error("{nodes} nodes in {slots} slots: at most {POLICY_STATES_MAX} of both together; take fewer, wider slots")]
    TooManyStates { nodes: usize, slots: usize },
    /// It was told to stop.
    #[error("the policy was stopped with {left} of {slots} slots left; allow it more, or take fewer slots")]
    Stopped { left: usize, slots: usize },
    /// A forecast is out of range.
    #[error(transparent)]
    Forecast(#[from] ForecastError),
}

#[cfg(test)]
mod tests;
