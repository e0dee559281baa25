//! Names of edges, and of the states that learn from their traversals.
//!
//! Invariant: each part of such a name is a plain name, without `/`, so that a state's name identifies its edge: each
//! state of each edge has one name, and no other state has it.

use std::fmt;

use tidemap_model::StateKind;

use super::{InvalidName, NAME_CHARS_MAX, StateName, shown};

/// Maximum number of characters of the name of an edge's state: `speed/A/B/ACTION`, with three plain names.
pub const EDGE_STATE_CHARS_MAX: usize = 3 * NAME_CHARS_MAX + "speed///".len();

/// The quantity that is learned of an edge.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Hash, PartialOrd, Ord)]
pub enum EdgeState {
    /// Whether a traversal succeeds: 1 or 0, at the start of the traversal. A probability.
    Success,
    /// Speed of a successful traversal in metres per second, for an edge with a length. Continuous.
    Speed,
    /// Nominal time over the time taken by a successful traversal, for an edge with a nominal time only: 1 is nominal,
    /// 0.5 takes twice as long. Continuous.
    Pace,
}

impl EdgeState {
    const ALL: [EdgeState; 3] = [EdgeState::Success, EdgeState::Speed, EdgeState::Pace];

    /// First part of the states' names: `edge`, `speed` or `pace`.
    pub fn prefix(self) -> &'static str {
        match self {
            EdgeState::Success => "edge",
            EdgeState::Speed => "speed",
            EdgeState::Pace => "pace",
        }
    }

    /// Kind of the states.
    pub fn kind(self) -> StateKind {
        match self {
            EdgeState::Success => StateKind::Probability,
            EdgeState::Speed | EdgeState::Pace => StateKind::Continuous,
        }
    }
}

/// The name of an edge, by the names of its nodes. The edge need not exist.
#[derive(Clone, Debug, PartialEq, Eq, Hash, PartialOrd, Ord)]
pub struct EdgeName {
    /// The node where the edge begins.
    pub from: StateName,
    /// The node where the edge ends.
    pub to: StateName,
    /// The action that travels the edge; `None` is the default action.
    pub action: Option<StateName>,
}

impl EdgeName {
    /// Checks the names of the nodes and of the action; an empty action is the default action.
    ///
    /// # Errors
    /// [`InvalidName`], with what is wrong.
    pub fn new(from: &str, to: &str, action: &str) -> Result<Self, InvalidName> {
        let action = if action.is_empty() { None } else { Some(StateName::new(action)?) };
        Ok(Self { from: StateName::new(from)?, to: StateName::new(to)?, action })
    }

    /// Checks a whole name, which is `A/B` or `A/B/ACTION`.
    ///
    /// # Errors
    /// [`InvalidName`]; [`InvalidName::Slash`] where there are fewer or more parts.
    pub fn parse(name: &str) -> Result<Self, InvalidName> {
        let mut parts = name.split('/');
        match (parts.next(), parts.next(), parts.next(), parts.next()) {
            (Some(from), Some(to), None, None) => Self::new(from, to, ""),
            (Some(from), Some(to), Some(action), None) if !action.is_empty() => Self::new(from, to, action),
            _ => Err(InvalidName::Slash(shown(name))),
        }
    }

    /// This edge after a node is renamed; `None` if the node is not one of its ends.
    pub(super) fn with_node_renamed(&self, from: &str, to: &StateName) -> Option<EdgeName> {
        let mut edge = self.clone();
        let ends = [&mut edge.from, &mut edge.to].into_iter().filter(|end| end.as_str() == from);
        let renamed = ends.map(|end| *end = to.clone()).count();
        (renamed > 0).then_some(edge)
    }

    /// Name of one of the edge's states: `edge/A/B`, `speed/A/B` or `pace/A/B`, with `/ACTION` unless the action is the
    /// default.
    pub fn state(&self, what: EdgeState) -> StateName {
        StateName(format!("{}/{self}", what.prefix()).into())
    }
}

impl fmt::Display for EdgeName {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        write!(f, "{}/{}", self.from, self.to)?;
        self.action.as_ref().map_or(Ok(()), |action| write!(f, "/{action}"))
    }
}

impl StateName {
    /// The success state of an edge, `edge/A/B[/ACTION]`.
    pub fn edge(edge: &EdgeName) -> Self {
        edge.state(EdgeState::Success)
    }

    /// The speed state of an edge, `speed/A/B[/ACTION]`.
    pub fn speed(edge: &EdgeName) -> Self {
        edge.state(EdgeState::Speed)
    }

    /// The pace state of an edge, relative to its nominal time, `pace/A/B[/ACTION]`.
    pub fn pace(edge: &EdgeName) -> Self {
        edge.state(EdgeState::Pace)
    }

    /// Whether this is the name of the success state of an edge.
    pub(crate) fn is_edge_success(&self) -> bool {
        split_edge(&self.0).is_some_and(|(what, _)| what == EdgeState::Success)
    }

    /// Splits the name of an edge's state into quantity and edge.
    pub(crate) fn as_edge(&self) -> Option<(EdgeState, EdgeName)> {
        let (what, edge) = split_edge(&self.0)?;
        EdgeName::parse(edge).ok().map(|edge| (what, edge))
    }
}

/// Splits a name that starts like that of an edge's state into quantity and rest. An axis of a vector, such as
/// `speed/x`, does not.
pub(super) fn split_edge(name: &str) -> Option<(EdgeState, &str)> {
    let (prefix, edge) = name.split_once('/')?;
    let what = EdgeState::ALL.into_iter().find(|what| what.prefix() == prefix)?;
    edge.contains('/').then_some((what, edge))
}

#[cfg(test)]
mod tests;
