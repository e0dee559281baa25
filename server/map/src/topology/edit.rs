//! Edits of a topological map by the names of nodes, as requests contain them and the log keeps them.
//!
//! Invariant: an edit is applied whole or not at all, and always changes the same map in the same way. A node or edge
//! that an edit keeps has its old number after the edit.

use std::collections::BTreeMap;

use super::{Edge, EdgeId, Extent, Node, NodeId, NodePose, Topology, TopologyError, TopologyParts};
use crate::name::StateName;

/// A node to add or set.
#[derive(Clone, Debug, PartialEq)]
pub struct NewNode {
    /// The name of the node, unique within the map.
    pub name: StateName,
    /// The pose of the node, if it is known.
    pub pose: Option<NodePose>,
    /// Duration of a visit in seconds, if given.
    pub dwell_secs: Option<f64>,
}

/// The ends of an edge, by name.
#[derive(Clone, Debug, PartialEq)]
pub struct EdgeEnds {
    /// The node where the edge begins.
    pub from: StateName,
    /// The node where the edge ends.
    pub to: StateName,
    /// The action that travels the edge; `None` is the default action.
    pub action: Option<StateName>,
    /// Whether the edge back is included.
    pub both_ways: bool,
}

impl EdgeEnds {
    /// The ends of the usual edges both ways between two nodes.
    pub fn link(from: StateName, to: StateName) -> EdgeEnds {
        EdgeEnds { from, to, action: None, both_ways: true }
    }

    fn shown(&self) -> String {
        let EdgeEnds { from, to, action, .. } = self;
        action.as_ref().map_or_else(|| format!("{from}/{to}"), |action| format!("{from}/{to}/{action}"))
    }
}

/// An edge to add, or to give another extent.
#[derive(Clone, Debug, PartialEq)]
pub struct NewEdge {
    /// The ends and the action of the edge.
    pub ends: EdgeEnds,
    /// Length and nominal time.
    pub extent: Extent,
}

/// A change of a topological map.
#[derive(Clone, Debug, PartialEq)]
pub enum TopologyEdit {
    /// A whole map at once.
    Load {
        /// The nodes. Without `replaces`, none of them may exist yet.
        nodes: Vec<NewNode>,
        /// The edges, between these nodes or, without `replaces`, also existing ones.
        edges: Vec<NewEdge>,
        /// Whether everything not named is removed. Named nodes and edges keep their numbers.
        replaces: bool,
    },
    /// A node is added.
    AddNode(NewNode),
    /// Sets the pose and visit duration of the node of this name.
    SetNode(NewNode),
    /// A node is removed, with all edges at it.
    RemoveNode(StateName),
    /// A node gets another name.
    RenameNode {
        /// The name so far.
        from: StateName,
        /// The new name.
        to: StateName,
    },
    /// An edge is added; both directions, or none.
    AddEdge(NewEdge),
    /// An edge gets another length or time; with both directions, the existing ones.
    SetExtent(NewEdge),
    /// An edge is removed; with both directions, the existing ones.
    RemoveEdge(EdgeEnds),
}

impl Topology {
    /// The map after an edit.
    ///
    /// # Errors
    /// [`TopologyError`], with the node or edge that is wrong.
    pub fn edited(&self, edit: &TopologyEdit) -> Result<Topology, TopologyError> {
        if let TopologyEdit::Load { nodes, edges, replaces } = edit {
            return self.loaded(nodes, edges, *replaces);
        }
        let mut topology = self.clone();
        topology.edit(edit)?;
        Ok(topology)
    }

    /// Edits a copy: an error may leave it half edited.
    fn edit(&mut self, edit: &TopologyEdit) -> Result<(), TopologyError> {
        match edit {
            // The caller applies this edit.
            TopologyEdit::Load { .. } => Ok(()),
            TopologyEdit::AddNode(NewNode { name, pose, dwell_secs }) => {
                self.add_node(name.clone(), *pose, *dwell_secs).map(drop)
            }
            TopologyEdit::SetNode(NewNode { name, pose, dwell_secs }) => {
                let id = self.node_named(name.as_str())?.id;
                self.set_node(id, *pose, *dwell_secs)
            }
            TopologyEdit::RemoveNode(name) => {
                let id = self.node_named(name.as_str())?.id;
                self.remove_node(id).map(drop)
            }
            TopologyEdit::RenameNode { from, to } => {
                let id = self.node_named(from.as_str())?.id;
                self.rename_node(id, to.clone())
            }
            TopologyEdit::AddEdge(NewEdge { ends, extent }) => {
                let (from, to) = self.ends(ends)?;
                self.add_edge(from, to, ends.action.clone(), *extent)?;
                if ends.both_ways {
                    self.add_edge(to, from, ends.action.clone(), *extent)?;
                }
                Ok(())
            }
            TopologyEdit::SetExtent(NewEdge { ends, extent }) => {
                self.found(ends)?.into_iter().try_for_each(|edge| self.set_extent(edge, *extent))
            }
            TopologyEdit::RemoveEdge(ends) => {
                self.found(ends)?.into_iter().try_for_each(|edge| self.remove_edge(edge).map(drop))
            }
        }
    }

    fn ends(&self, ends: &EdgeEnds) -> Result<(NodeId, NodeId), TopologyError> {
        Ok((self.node_named(ends.from.as_str())?.id, self.node_named(ends.to.as_str())?.id))
    }

    /// The edges with these ends; at least one.
    fn found(&self, ends: &EdgeEnds) -> Result<Vec<EdgeId>, TopologyError> {
        let (from, to) = self.ends(ends)?;
        let there = self.edge_between(from, to, ends.action.as_ref());
        let back = if ends.both_ways { self.edge_between(to, from, ends.action.as_ref()) } else { None };
        let found: Vec<EdgeId> = there.into_iter().chain(back).map(|edge| edge.id).collect();
        if found.is_empty() { Err(TopologyError::UnknownEdge(ends.shown())) } else { Ok(found) }
    }

    fn loaded(&self, nodes: &[NewNode], edges: &[NewEdge], replaces: bool) -> Result<Topology, TopologyError> {
        let mut parts = if replaces {
            TopologyParts { next_node: self.next_node, next_edge: self.next_edge, ..TopologyParts::default() }
        } else {
            self.to_parts()
        };
        let mut numbers: BTreeMap<&str, NodeId> = BTreeMap::new();
        if !replaces {
            numbers.extend(self.by_name.iter().map(|(name, &id)| (name.as_str(), id)));
        }
        for NewNode { name, pose, dwell_secs } in nodes {
            let known = self.by_name.get(name).filter(|_| replaces);
            let id = match known {
                Some(&id) => id,
                None => NodeId(take(&mut parts.next_node)?),
            };
            if numbers.insert(name.as_str(), id).is_some() {
                return Err(TopologyError::DuplicateNode(name.to_string()));
            }
            parts.nodes.push(Node { id, name: name.clone(), pose: *pose, dwell_secs: *dwell_secs });
        }
        let number = |name: &StateName| {
            let unknown = || TopologyError::UnknownNode(name.as_str().chars().take(40).collect());
            numbers.get(name.as_str()).copied().ok_or_else(unknown)
        };
        for NewEdge { ends, extent } in edges {
            let (from, to) = (number(&ends.from)?, number(&ends.to)?);
            let ways = [(from, to), (to, from)];
            for (from, to) in ways.into_iter().take(if ends.both_ways { 2 } else { 1 }) {
                let action = ends.action.clone();
                let known = if replaces { self.edge_between(from, to, action.as_ref()) } else { None };
                let id = match known {
                    Some(edge) => edge.id,
                    None => EdgeId(take(&mut parts.next_edge)?),
                };
                parts.edges.push(Edge { id, from, to, action, extent: *extent });
            }
        }
        parts.nodes.sort_by_key(|node| node.id);
        // A duplicate edge has a duplicate number, so that the two are neighbours after sorting.
        parts.edges.sort_by_key(|edge| edge.id);
        if let Some(pair) = parts.edges.windows(2).find(|pair| pair[0].id == pair[1].id) {
            return Err(TopologyError::DuplicateEdge(self.edge_name(&pair[0])));
        }
        Topology::from_parts(parts)
    }
}

fn take(next: &mut u32) -> Result<u32, TopologyError> {
    let number = *next;
    *next = next.checked_add(1).ok_or(TopologyError::NumbersUsedUp)?;
    Ok(number)
}

#[cfg(test)]
mod tests;
