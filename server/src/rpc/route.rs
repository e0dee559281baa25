//! `TopologyService`, `RouteService` and `SearchService`: the topological map, and plans over it.
//!
//! Invariant: a change is durable and shown when it is answered. A plan is made from one view, off the async threads, with
//! turns of its own, and ends at its deadline or when nobody waits for it any more.

use std::sync::Arc;

use tidemap_map::{
    site::SiteEdit,
    topology::{RoadsError, TopologyEdit, TopologyError},
};
use tidemap_plan::{policy::PolicyError, route::RouteError as CannotRoute, search::SearchError};
use tidemap_proto::{
    convert::{
        route::POLICY_CELLS_MAX,
        topology::{edit_from_wire, load_from_wire, topology_to_wire},
        traversals::{failure_to_wire, is_of},
    },
    v1::{
        self, route_service_server::RouteService, search_service_server::SearchService,
        topology_service_server::TopologyService,
    },
};
use tonic::{Code, Request, Response, Status};

use super::{
    map::{edit_site, find_map},
    query::{
        Queries,
        fitting::Fitting,
        replies::{Turns, processors},
    },
    series::Means,
    status::RpcError,
};
use crate::catalog::Catalog;

mod edges;
mod places;
mod plan;
mod presence;
mod search;

/// Why there is no walk.
#[derive(Clone, Debug, PartialEq, thiserror::Error)]
pub enum RouteError {
    /// The map has no nodes.
    #[error("map {0:?} has no nodes: load a topological map, with `tidemap topology load`")]
    NoNodes(String),
    /// A node is not known.
    #[error("there is no node {name:?}; nodes here: {known}")]
    UnknownNode {
        /// The name, shortened.
        name: String,
        /// Some that there are.
        known: String,
    },
    /// Nothing is known of any node.
    #[error(
        "nothing was observed at any node of map {map:?}: observe states like {example:?}, 1 where somebody is, else 0"
    )]
    NothingObserved {
        /// The map.
        map: String,
        /// Name of a state that would be asked.
        example: String,
    },
    /// Nobody is expected.
    #[error("nobody is to be found: each of the {0} nodes that were observed has a probability of 0 at that time")]
    Nobody(usize),
    /// No way leads to anybody.
    #[error("from node {start:?} no way leads to any of the {goals} nodes that were observed")]
    Unreachable {
        /// Where the search begins.
        start: String,
        /// How many places there are.
        goals: usize,
    },
    /// No way leads there.
    #[error("no way leads from node {from:?} to node {to:?}")]
    NoWay {
        /// Where the route begins.
        from: String,
        /// Where it would end.
        to: String,
    },
    /// All ways take too long.
    #[error("no way from node {from:?} to node {to:?} takes at most {horizon_secs} s: raise the horizon")]
    TooLong {
        /// Where the route begins.
        from: String,
        /// Where it would end.
        to: String,
        /// The longest that was allowed.
        horizon_secs: f64,
    },
    /// No departure is early enough.
    #[error(
        "no departure from node {from:?} is expected to arrive at node {to:?} by {by_nanos} ns: arrive later, or raise the \
         horizon"
    )]
    TooLate {
        /// Where the route begins.
        from: String,
        /// Where it would end.
        to: String,
        /// The latest arrival, nanoseconds UTC.
        by_nanos: i64,
    },
    /// A route that is none.
    #[error(transparent)]
    Plan(CannotRoute),
    /// A policy that is none.
    #[error(transparent)]
    Policy(#[from] PolicyError),
    /// A policy would be too large for an answer.
    #[error("{nodes} nodes in {slots} slots: at most {POLICY_CELLS_MAX} of both together; take fewer, wider slots")]
    PolicyTooLarge {
        /// Nodes of the map.
        nodes: usize,
        /// Slots.
        slots: usize,
    },
    /// Too many edges for an answer.
    #[error("the map has {found} edges: at most {most} are told of at once")]
    TooManyEdges {
        /// How many there are.
        found: usize,
        /// How many may be.
        most: usize,
    },
    /// The edges have no times.
    #[error(transparent)]
    Roads(#[from] RoadsError),
    /// The search is none, or too large.
    #[error(transparent)]
    Search(#[from] SearchError),
}

impl RouteError {
    pub(super) fn code_and_reason(&self) -> (Code, &'static str) {
        match self {
            Self::NoNodes(_) => (Code::FailedPrecondition, "NO_TOPOLOGY"),
            Self::UnknownNode { .. } => (Code::NotFound, "UNKNOWN_NODE"),
            Self::NothingObserved { .. } => (Code::FailedPrecondition, "NOTHING_OBSERVED"),
            Self::Nobody(_) => (Code::FailedPrecondition, "NOBODY"),
            Self::Unreachable { .. } | Self::Search(SearchError::Unreachable { .. }) => {
                (Code::FailedPrecondition, "UNREACHABLE")
            }
            Self::NoWay { .. } | Self::TooLong { .. } | Self::TooLate { .. } => {
                (Code::FailedPrecondition, "UNREACHABLE")
            }
            Self::Plan(CannotRoute::CutOff { .. }) => (Code::DeadlineExceeded, "CUT_OFF"),
            Self::Plan(CannotRoute::TooManyDepartures { .. })
            | Self::Policy(PolicyError::TooManyStates { .. })
            | Self::PolicyTooLarge { .. }
            | Self::TooManyEdges { .. }
            | Self::Search(SearchError::TooManyForExact { .. } | SearchError::TooMany { .. })
            | Self::Roads(RoadsError::TooManyPairs { .. }) => (Code::ResourceExhausted, "LIMIT"),
            Self::Search(_) | Self::Roads(_) | Self::Plan(_) | Self::Policy(_) => {
                (Code::InvalidArgument, "INVALID_FIELD")
            }
        }
    }
}

/// Code and reason of an edit that is refused.
pub(super) fn refusal_of(error: &TopologyError) -> (Code, &'static str) {
    match error {
        TopologyError::UnknownNode(_) | TopologyError::UnknownNodeId(_) => (Code::NotFound, "UNKNOWN_NODE"),
        TopologyError::UnknownEdge(_) | TopologyError::UnknownEdgeId(_) => (Code::NotFound, "UNKNOWN_EDGE"),
        TopologyError::DuplicateNode(_) => (Code::AlreadyExists, "NODE_EXISTS"),
        TopologyError::DuplicateEdge(_) => (Code::AlreadyExists, "EDGE_EXISTS"),
        TopologyError::TooManyNodes | TopologyError::TooManyEdges | TopologyError::NumbersUsedUp => {
            (Code::ResourceExhausted, "LIMIT")
        }
        _ => (Code::InvalidArgument, "INVALID_FIELD"),
    }
}

/// The service.
#[derive(Debug)]
pub struct Routes {
    catalog: Arc<Catalog>,
    /// Most predictions of one request.
    predictions: u64,
    fitting: Arc<Fitting>,
    turns: Turns,
}

impl Routes {
    /// Plans with so many predictions at most; models are fitted where questions have theirs fitted.
    #[must_use]
    pub fn new(catalog: Arc<Catalog>, queries: &Queries, predictions: u64) -> Self {
        Self { catalog, predictions, fitting: queries.fitting(), turns: Turns::new(processors().max(2)) }
    }

    fn means(&self) -> Means<'_> {
        Means { fitting: &self.fitting, turns: &self.turns, predictions: self.predictions }
    }

    /// Does what may take long off the async threads, with a turn.
    async fn off_threads<T: Send + 'static>(&self, work: impl FnOnce() -> T + Send + 'static) -> Result<T, RpcError> {
        let turn = self.turns.take().await?;
        let work = move || {
            let _turn = turn;
            work()
        };
        tokio::task::spawn_blocking(work).await.map_err(|_| RpcError::Stopping)
    }

    /// Changes a map's topological map. Numbers of nodes and edges that it has then.
    async fn edit(&self, map: &str, edit: TopologyEdit) -> Result<(u32, u32), RpcError> {
        let handle = find_map(&self.catalog, map)?;
        edit_site(&handle, SiteEdit::Topology(edit)).await?;
        let view = handle.view();
        let topology = view.site().topology();
        let count = |length: usize| u32::try_from(length).unwrap_or(u32::MAX);
        Ok((count(topology.nodes().len()), count(topology.edges().len())))
    }
}

#[tonic::async_trait]
impl TopologyService for Routes {
    async fn load_topology(
        &self,
        request: Request<v1::LoadTopologyRequest>,
    ) -> Result<Response<v1::LoadTopologyResponse>, Status> {
        let request = request.into_inner();
        let map = request.map.clone();
        find_map(&self.catalog, &map)?;
        let edit = self.off_threads(move || load_from_wire(&request)).await?.map_err(RpcError::from)?;
        let (nodes, edges) = self.edit(&map, edit).await?;
        Ok(Response::new(v1::LoadTopologyResponse { nodes, edges }))
    }

    async fn edit_topology(
        &self,
        request: Request<v1::EditTopologyRequest>,
    ) -> Result<Response<v1::EditTopologyResponse>, Status> {
        let v1::EditTopologyRequest { map, edit } = request.into_inner();
        let edit = edit_from_wire(edit.as_ref()).map_err(RpcError::from)?;
        let (nodes, edges) = self.edit(&map, edit).await?;
        Ok(Response::new(v1::EditTopologyResponse { nodes, edges }))
    }

    async fn get_topology(
        &self,
        request: Request<v1::GetTopologyRequest>,
    ) -> Result<Response<v1::GetTopologyResponse>, Status> {
        let view = find_map(&self.catalog, &request.get_ref().map)?.view();
        Ok(Response::new(self.off_threads(move || topology_to_wire(view.site().topology())).await?))
    }

    async fn list_failures(
        &self,
        request: Request<v1::ListFailuresRequest>,
    ) -> Result<Response<v1::ListFailuresResponse>, Status> {
        let v1::ListFailuresRequest { map, limit, edge } = request.into_inner();
        let view = find_map(&self.catalog, &map)?.view();
        let most = if limit == 0 { usize::MAX } else { usize::try_from(limit).unwrap_or(usize::MAX) };
        let asked = view.site().failures().newest_first();
        let asked = asked.filter(|failure| edge.as_ref().is_none_or(|edge| is_of(failure, edge)));
        let failures = asked.take(most).map(failure_to_wire).collect();
        Ok(Response::new(v1::ListFailuresResponse { failures }))
    }
}

#[tonic::async_trait]
impl SearchService for Routes {
    async fn plan_search(
        &self,
        request: Request<v1::PlanSearchRequest>,
    ) -> Result<Response<v1::PlanSearchResponse>, Status> {
        Ok(Response::new(search::plan_search(self, request.into_inner()).await?))
    }

    async fn predict_presence(
        &self,
        request: Request<v1::PredictPresenceRequest>,
    ) -> Result<Response<v1::PredictPresenceResponse>, Status> {
        Ok(Response::new(presence::predict_presence(self, request.into_inner()).await?))
    }

    async fn next_joint(
        &self,
        request: Request<v1::NextJointRequest>,
    ) -> Result<Response<v1::NextJointResponse>, Status> {
        Ok(Response::new(presence::next_joint(self, request.into_inner()).await?))
    }
}

#[tonic::async_trait]
impl RouteService for Routes {
    async fn plan_route(
        &self,
        request: Request<v1::PlanRouteRequest>,
    ) -> Result<Response<v1::PlanRouteResponse>, Status> {
        Ok(Response::new(plan::plan_route(self, request.into_inner()).await?))
    }

    async fn plan_policy(
        &self,
        request: Request<v1::PlanPolicyRequest>,
    ) -> Result<Response<v1::PlanPolicyResponse>, Status> {
        Ok(Response::new(plan::plan_policy(self, request.into_inner()).await?))
    }

    async fn predict_edges(
        &self,
        request: Request<v1::PredictEdgesRequest>,
    ) -> Result<Response<v1::PredictEdgesResponse>, Status> {
        Ok(Response::new(plan::predict_edges(self, request.into_inner()).await?))
    }
}
