//! Navigation policies: the best action at each node at each time on the way to a target, where edges may fail and
//! their success and duration depend on time.
//!
//! A Markov decision process after the topological navigation of N. Hawes et al., "The STRANDS Project", IEEE RAM 2017:
//! states are nodes at times, in slots of equal width from the reference time; actions are the edges that leave a node,
//! and waiting until the next slot. An edge taken in a slot has the forecast of the slot's middle. With its success
//! probability the robot reaches the end of the edge after the duration d; otherwise it is back at the start after d
//! and the recovery r.
//!
//! Values are those at the beginnings of slots, and linear in between. Several short edges can be traversed within one
//! slot: the values of a slot then depend on each other, and are solved for together, exactly, by policy iteration
//! (`policy/settle.rs`). Slots are solved from the last to the first. Ties: the fewest attempts, so that a robot waits
//! at a closed door instead of moving back and forth.
//!
//! A [`route`](crate::route) is a plan without failures; a policy also covers failures, and may wait for a door.
//! Invariant: the values are those of the best actions, up to rounding; no number is NaN.

mod settle;
mod solve;

use tidemap_map::topology::{EdgeId, NodeId};

pub use self::solve::solve_policy;
use crate::route::ForecastError;

/// Maximum number of states of a policy, nodes times slots.
pub(crate) const POLICY_STATES_MAX: usize = 2_000_000;

/// The objective of a policy.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub enum PolicyObjective {
    /// The greatest probability of being at the target by the end of the last slot. Ties (within 1e-12): the least
    /// expected time, then the fewest attempts.
    #[default]
    Reach,
    /// The least expected time to the target. Forecasts of the last slot hold for ever. Ties: the fewest attempts.
    Time,
}

/// The options of a policy.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct PolicyOptions {
    /// The objective; [`PolicyObjective::Reach`] by default.
    pub objective: PolicyObjective,
    /// Width of a slot, in seconds, 0.001 to [`NOMINAL_MAX_SECS`]; 900 by default.
    pub slot_secs: f64,
    /// Number of slots, at least 1; 96 by default, a day. Nodes times slots are at most [`POLICY_STATES_MAX`].
    pub slots: usize,
    /// The additional time of a failed attempt, in seconds, 0 to [`NOMINAL_MAX_SECS`]; 60 by default.
    pub recovery_secs: f64,
}

impl Default for PolicyOptions {
    fn default() -> PolicyOptions {
        PolicyOptions { objective: PolicyObjective::Reach, slot_secs: 900.0, slots: 96, recovery_secs: 60.0 }
    }
}

/// The action at a node in a slot. The planner identifies edges by number, users by name.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum PolicyAction<E = EdgeId> {
    /// Take this edge.
    Take(E),
    /// Stay until the next slot begins.
    Wait,
    /// No action: this is the target.
    Arrived,
    /// No action helps.
    Nothing,
}

/// The policy at a node in a slot.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct PolicyEntry<E = EdgeId> {
    /// The action.
    pub action: PolicyAction<E>,
    /// With [`PolicyObjective::Time`]: expected seconds to the target, infinite if the target is not reached with
    /// certainty. With [`PolicyObjective::Reach`]: expected seconds until the target or the end of the last slot,
    /// whichever comes first.
    pub expected_secs: f64,
    /// Probability of being at the target by the end of the last slot.
    pub reach: f64,
}

/// The policy at each node in each slot.
#[derive(Clone, Debug, PartialEq)]
pub struct PolicyTable {
    target: NodeId,
    slot_secs: f64,
    slots: usize,
    /// The nodes, ascending by number.
    nodes: Vec<NodeId>,
    /// The entries, slot by slot and node by node.
    entries: Vec<PolicyEntry>,
}

impl PolicyTable {
    /// The target.
    pub fn target(&self) -> NodeId {
        self.target
    }

    /// Width of a slot, in seconds.
    pub fn slot_secs(&self) -> f64 {
        self.slot_secs
    }

    /// Number of slots.
    pub fn slots(&self) -> usize {
        self.slots
    }

    /// All nodes, ascending by number.
    pub fn nodes(&self) -> &[NodeId] {
        &self.nodes
    }

    /// A node in a slot; `None` if there is no such node or slot.
    pub fn entry(&self, node: NodeId, slot: usize) -> Option<PolicyEntry> {
        let index = self.nodes.binary_search(&node).ok()?;
        Some(self.slot(slot)?[index])
    }

    /// All nodes in a slot, in the order of [`PolicyTable::nodes`].
    pub fn slot(&self, slot: usize) -> Option<&[PolicyEntry]> {
        let count = self.nodes.len();
        (slot < self.slots).then(|| &self.entries[slot * count..(slot + 1) * count])
    }
}

/// The reason why policy planning failed.
#[derive(Clone, Debug, PartialEq, thiserror::Error)]
#[expect(missing_docs, reason = "the messages name the fields")]
pub enum PolicyError {
    /// The map has no such node.
    #[error("there is no node of number {0}")]
    UnknownNode(u32),
    /// A number in the request is out of range.
    #[error("{what} is {found}: expected {expected}")]
    Range { what: &'static str, found: f64, expected: String },
    /// Too many states.
    #[error("{nodes} nodes in {slots} slots: at most {POLICY_STATES_MAX} of both together; use fewer, wider slots")]
    TooManyStates { nodes: usize, slots: usize },
    /// The caller stopped the planning.
    #[error("the policy was stopped with {left} of {slots} slots left; raise the time limit, or use fewer slots")]
    Stopped { left: usize, slots: usize },
    /// A forecast is out of range.
    #[error(transparent)]
    Forecast(#[from] ForecastError),
}

#[cfg(test)]
mod tests;
