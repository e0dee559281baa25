//! Nodes, and the states that record whether the target is there.
//!
//! Invariant: a place is a node whose state was observed and is a probability.

use std::sync::Arc;

use tidemap_map::{
    event::StateKind,
    ids::StateId,
    topology::{NodeId, Topology},
    view::MapView,
};

use super::Routes;
use crate::status::{Problem, RouteError, RpcError};

/// Maximum number of nodes in a message.
const NODES_SHOWN: usize = 10;
/// Maximum number of unobserved nodes in a reply.
const UNOBSERVED_SHOWN: usize = 1_000;

/// Name of the state that records whether the target is at a node.
pub(super) fn state_at(node: &str, object: &str) -> String {
    if object.is_empty() { node.to_owned() } else { format!("node/{node}/{object}") }
}

/// A node, or an error that lists some existing ones.
pub(super) fn find_node(map: &str, topology: &Topology, name: &str) -> Result<NodeId, RouteError> {
    if topology.nodes().len() == 0 {
        return Err(RouteError::NoNodes(map.to_owned()));
    }
    topology.node_named(name).map(|node| node.id).map_err(|_| {
        let known: Vec<&str> = topology.nodes().take(NODES_SHOWN).map(|node| node.name.as_str()).collect();
        let more = if topology.nodes().len() > NODES_SHOWN { ", …" } else { "" };
        RouteError::UnknownNode { name: name.chars().take(80).collect(), known: known.join(", ") + more }
    })
}

/// The nodes to search with their states, and those without observations.
#[derive(Default)]
pub(super) struct NodeStates {
    pub(super) nodes: Vec<NodeId>,
    pub(super) states: Vec<StateId>,
    pub(super) unobserved: Vec<String>,
    pub(super) unobserved_nodes: u32,
}

impl NodeStates {
    fn of(view: &MapView, topology: &Topology, object: &str) -> Result<NodeStates, RpcError> {
        let mut found = NodeStates::default();
        for node in topology.nodes() {
            let state = view.find(&state_at(node.name.as_str(), object));
            match state.filter(|&id| view.live(id).observations > 0) {
                Some(id) => {
                    let kind = view.kind(id);
                    if kind != StateKind::Probability {
                        let state = state_at(node.name.as_str(), object);
                        return Err(Problem::NoPresence { state, kind }.of("object").into());
                    }
                    found.nodes.push(node.id);
                    found.states.push(id);
                }
                None => {
                    if found.unobserved.len() < UNOBSERVED_SHOWN {
                        found.unobserved.push(node.name.as_str().to_owned());
                    }
                    found.unobserved_nodes += 1;
                }
            }
        }
        Ok(found)
    }

    /// The nodes and states for the presence of `object`, which is empty for the default kind.
    ///
    /// # Errors
    /// There are none, or a state is not a probability.
    pub(super) async fn find(
        routes: &Routes,
        map: &str,
        view: &Arc<MapView>,
        object: &str,
    ) -> Result<NodeStates, RpcError> {
        let topology = view.site().topology();
        if topology.nodes().len() == 0 {
            return Err(RouteError::NoNodes(map.to_owned()).into());
        }
        let (shared_view, shared_topology, object) = (Arc::clone(view), Arc::clone(topology), object.to_owned());
        let example = topology.nodes().next().map_or_else(String::new, |node| state_at(node.name.as_str(), &object));
        let found = routes.run_blocking(move || NodeStates::of(&shared_view, &shared_topology, &object)).await??;
        if found.nodes.is_empty() {
            return Err(RouteError::NothingObserved { map: map.to_owned(), example }.into());
        }
        Ok(found)
    }
}
