//! Names of places where landmarks are seen, and of the landmarks' states.
//!
//! Invariant: each part of such a name is a plain name, without `/`, so that the number of parts distinguishes a node
//! from an edge, and a state's name identifies place and landmark.

use std::fmt;

use super::{EdgeName, InvalidName, NAME_CHARS_MAX, StateName, shown};

/// First part of the names of landmarks' states.
const PREFIX: &str = "landmark";

/// Maximum number of characters of the name of a landmark's state: `landmark/A/B/ACTION/ID`, with four plain names.
pub const LANDMARK_STATE_CHARS_MAX: usize = 4 * NAME_CHARS_MAX + "landmark////".len();

/// The place from which landmarks are seen: a node, or the way along an edge. The place need not exist.
#[derive(Clone, Debug, PartialEq, Eq, Hash, PartialOrd, Ord)]
pub enum PlaceName {
    /// From a node.
    Node(StateName),
    /// Along an edge.
    Edge(EdgeName),
}

impl PlaceName {
    /// Checks a whole name: `N` for a node, `A/B` or `A/B/ACTION` for an edge.
    ///
    /// # Errors
    /// [`InvalidName`], with what is wrong.
    pub fn parse(name: &str) -> Result<PlaceName, InvalidName> {
        if name.contains('/') { EdgeName::parse(name).map(Self::Edge) } else { StateName::new(name).map(Self::Node) }
    }

    /// The name of the state of a landmark that is seen here: `landmark/N/ID`, `landmark/A/B/ID` or
    /// `landmark/A/B/ACTION/ID`.
    #[must_use]
    pub fn landmark(&self, id: &StateName) -> StateName {
        StateName(format!("{}{id}", self.landmark_prefix()).into())
    }

    /// The common beginning of the names of the states of all landmarks here.
    #[must_use]
    pub fn landmark_prefix(&self) -> String {
        format!("{PREFIX}/{self}/")
    }

    /// This place after a node is renamed; `None` if the node is not part of it.
    fn with_node_renamed(&self, from: &str, to: &StateName) -> Option<PlaceName> {
        match self {
            Self::Node(node) => (node.as_str() == from).then(|| Self::Node(to.clone())),
            Self::Edge(edge) => edge.with_node_renamed(from, to).map(Self::Edge),
        }
    }
}

impl fmt::Display for PlaceName {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        match self {
            Self::Node(node) => node.fmt(f),
            Self::Edge(edge) => edge.fmt(f),
        }
    }
}

/// Splits the name of a landmark's state into place and landmark; `None` for the name of another state.
pub(super) fn split(name: &str) -> Option<Result<(PlaceName, StateName), InvalidName>> {
    let (prefix, rest) = name.split_once('/')?;
    let (place, id) = rest.rsplit_once('/').filter(|_| prefix == PREFIX)?;
    let parts = || Ok((PlaceName::parse(place)?, StateName::new(id)?));
    if place.is_empty() { Some(Err(InvalidName::Slash(shown(name)))) } else { Some(parts()) }
}

/// The name of a landmark's state after a node is renamed, in the same way as [`StateName::with_node_renamed`].
pub(super) fn with_node_renamed(name: &StateName, from: &str, to: &StateName) -> Option<StateName> {
    let (place, id) = split(name.as_str())?.ok()?;
    place.with_node_renamed(from, to).map(|place| place.landmark(&id))
}

#[cfg(test)]
mod tests;
