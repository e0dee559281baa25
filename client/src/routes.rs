//! Topological maps, searches and presence.
//!
//! Invariant: a load or edit is durable when the call returns; a load is accepted completely or not at all.

use tidemap_proto::{
    convert::{
        query::selector_to_wire,
        search::{effort_to_wire, stop_from_wire},
        time::{duration, timestamp},
        topology::{edge_name_to_wire, edit_to_wire, new_edge_to_wire, node_to_wire, topology_from_wire},
        traversals::failure_from_wire,
    },
    v1::{
        self, route_service_client::RouteServiceClient, search_service_client::SearchServiceClient,
        topology_service_client::TopologyServiceClient,
    },
};

mod path;
mod presence;
mod reachable;

pub use path::{NamedRoute, NamedRouteStep, Policy, PolicyQuery, RouteQuery, RouteTime};
pub use presence::{Joint, JointQuery, PresenceAt, PresenceForecast, PresenceQuery};
pub use reachable::{ReachableNode, ReachableQuery};
pub use tidemap_map::{
    name::{EdgeName, StateName},
    topology::{Edge, EdgeEnds, Extent, NewEdge, NewNode, Node, NodePose, Topology, TopologyEdit},
    traversal::EdgeFailure,
};
pub use tidemap_plan::{
    policy::{PolicyAction, PolicyEntry},
    route::{Certainty, Objective, expected_secs},
    search::{Effort, SearchStep, StopReason},
};
pub use tidemap_proto::convert::route::EdgePrediction;

use crate::{
    connection::{Client, Connection},
    error::Error,
    queries::ModelSelector,
};

/// Maximum size of a topological map, bytes: a million edges with names of usual length.
const TOPOLOGY_BYTES: usize = 256 << 20;
/// Maximum size of a reply with a plan, bytes: the policy of all nodes, or all edges of a map.
const PLAN_BYTES: usize = 64 << 20;

/// Number of nodes and edges.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct TopologySize {
    /// Number of nodes.
    pub nodes: u32,
    /// Number of edges; each direction counts as one.
    pub edges: u32,
}

/// A request for a search. `None`: the daemon's default.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct SearchQuery {
    /// Name of the map.
    pub map: String,
    /// Name of the node where the robot is.
    pub start: String,
    /// Start, nanoseconds UTC.
    pub time_nanos: i64,
    /// Name of the target: the states `node/N/OBJECT`; empty: the states with the names of the nodes.
    pub object: String,
    /// Time limit of the walk, nanoseconds.
    pub budget_nanos: Option<i64>,
    /// The effort of the search for the best order.
    pub effort: Effort,
    /// Time limit of planning, nanoseconds.
    pub plan_within_nanos: Option<i64>,
    /// End once less than this share of the probability remains.
    pub remains_below: Option<f64>,
    /// Cost of a second of search, relative to the value of finding the target.
    pub cost_per_sec: Option<f64>,
    /// Predict each place for the robot's arrival there.
    pub for_arrival: bool,
    /// The model that predicts.
    pub model: ModelSelector,
    /// Minimum probability of a place.
    pub floor: Option<f64>,
    /// Speed on edges without nominal duration, metres per second.
    pub speed_m_per_s: Option<f64>,
    /// Seed of the random choices.
    pub seed: u64,
    /// Use forecast durations of edges instead of nominal ones.
    pub as_travelled: bool,
}

/// A planned search.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct Search {
    /// The places to search, by the names of their nodes, in this order.
    pub steps: Vec<SearchStep<String>>,
    /// All nodes of the walk with the arrival in seconds; the start first.
    pub walk: Vec<(String, f64)>,
    /// Expected time to find the target.
    pub expected_secs: f64,
    /// Lower bound of the expected time of any walk to all places.
    pub lower_bound_secs: f64,
    /// Whether the order is proven to be the best.
    pub optimal: bool,
    /// Probability of all places that are not steps, divided by the probability of all places.
    pub remains: f64,
    /// Why the walk ends early, if it does.
    pub stop: Option<StopReason>,
    /// Nodes that cannot be reached.
    pub unreachable: Vec<String>,
    /// Nodes that were never observed, the first thousand.
    pub unobserved: Vec<String>,
    /// Number of nodes that were never observed.
    pub unobserved_nodes: u32,
}

impl Client {
    fn topology_service(&self) -> TopologyServiceClient<Connection> {
        TopologyServiceClient::new(self.requests()).max_decoding_message_size(TOPOLOGY_BYTES)
    }

    fn route_service(&self) -> RouteServiceClient<Connection> {
        RouteServiceClient::new(self.requests()).max_decoding_message_size(PLAN_BYTES)
    }

    fn search_service(&self) -> SearchServiceClient<Connection> {
        SearchServiceClient::new(self.requests()).max_decoding_message_size(PLAN_BYTES)
    }

    /// Loads nodes and edges, all or none: instead of the existing ones or, with `adds`, in addition.
    ///
    /// # Errors
    /// [`Error`]; the message names the invalid node or edge.
    pub async fn load_topology(
        &self,
        map: &str,
        nodes: &[NewNode],
        edges: &[NewEdge],
        adds: bool,
    ) -> Result<TopologySize, Error> {
        let request = v1::LoadTopologyRequest {
            map: map.to_owned(),
            nodes: nodes.iter().map(node_to_wire).collect(),
            edges: edges.iter().map(new_edge_to_wire).collect(),
            adds,
        };
        let answer = self.topology_service().load_topology(request).await.map_err(|status| self.error(&status))?;
        let v1::LoadTopologyResponse { nodes, edges } = answer.into_inner();
        Ok(TopologySize { nodes, edges })
    }

    /// Changes one node or edge; [`TopologyEdit::Load`] is refused: use [`Client::load_topology`].
    ///
    /// # Errors
    /// [`Error`]; the code is `NOT_FOUND` if the node or edge does not exist.
    pub async fn edit_topology(&self, map: &str, edit: &TopologyEdit) -> Result<TopologySize, Error> {
        let request = v1::EditTopologyRequest { map: map.to_owned(), edit: edit_to_wire(edit) };
        let answer = self.topology_service().edit_topology(request).await.map_err(|status| self.error(&status))?;
        let v1::EditTopologyResponse { nodes, edges } = answer.into_inner();
        Ok(TopologySize { nodes, edges })
    }

    /// All nodes and edges of a map.
    ///
    /// # Errors
    /// [`Error`]; the code is `NOT_FOUND` if the map does not exist.
    pub async fn topology(&self, map: &str) -> Result<Topology, Error> {
        let request = v1::GetTopologyRequest { map: map.to_owned() };
        let answer = self.topology_service().get_topology(request).await.map_err(|status| self.error(&status))?;
        topology_from_wire(answer.get_ref()).map_err(|_| Error::Protocol("an invalid topological map"))
    }

    /// Failed traversals of one edge or of all edges, newest first; at most `limit`, or all that are kept if it is 0.
    ///
    /// # Errors
    /// [`Error`]; the code is `NOT_FOUND` if the map does not exist.
    pub async fn failures(&self, map: &str, limit: u32, edge: Option<&EdgeName>) -> Result<Vec<EdgeFailure>, Error> {
        let request = v1::ListFailuresRequest { map: map.to_owned(), limit, edge: edge.map(edge_name_to_wire) };
        let answer = self.topology_service().list_failures(request).await.map_err(|status| self.error(&status))?;
        let failures = answer.into_inner().failures.into_iter().map(failure_from_wire);
        failures.collect::<Result<_, _>>().map_err(|_| Error::Protocol("a failure has no valid edge"))
    }

    /// Plans the walk that finds the target soonest.
    ///
    /// # Errors
    /// [`Error`]; the code is `NOT_FOUND` if the map or node does not exist, `FAILED_PRECONDITION` if the target can be
    /// at no node or no node can be reached, `RESOURCE_EXHAUSTED` if there are too many nodes.
    pub async fn plan_search(&self, query: SearchQuery) -> Result<Search, Error> {
        let request = v1::PlanSearchRequest {
            map: query.map,
            start: query.start,
            start_time: Some(timestamp(query.time_nanos)),
            object: query.object,
            budget: query.budget_nanos.map(duration),
            effort: effort_to_wire(query.effort).into(),
            plan_within: query.plan_within_nanos.map(duration),
            remains_below: query.remains_below,
            cost_per_sec: query.cost_per_sec,
            for_arrival: query.for_arrival,
            model: Some(selector_to_wire(query.model)),
            floor: query.floor,
            speed_m_per_s: query.speed_m_per_s.unwrap_or_default(),
            seed: query.seed,
            as_travelled: query.as_travelled,
        };
        let answer = self.search_service().plan_search(request).await.map_err(|status| self.error(&status))?;
        let reply = answer.into_inner();
        let stop = stop_from_wire(reply.stop());
        let step = |step: v1::SearchStep| {
            let v1::SearchStep { node, arrival_secs, probability } = step;
            SearchStep { node, arrival_secs, probability }
        };
        Ok(Search {
            steps: reply.steps.into_iter().map(step).collect(),
            walk: reply.walk.into_iter().map(|at| (at.node, at.arrival_secs)).collect(),
            expected_secs: reply.expected_secs,
            lower_bound_secs: reply.lower_bound_secs,
            optimal: reply.optimal,
            remains: reply.remains,
            stop,
            unreachable: reply.unreachable,
            unobserved: reply.unobserved,
            unobserved_nodes: reply.unobserved_nodes,
        })
    }
}
