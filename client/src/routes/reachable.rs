//! The nodes that a robot reaches from one node at one time.
//!
//! Invariant: a node of the answer has the best route of `PlanRoute`; a node without one has no route within the
//! horizon.

use tonic::Code;

use super::{Certainty, RouteQuery, RouteTime};
use crate::{connection::Client, error::Error, queries::ModelSelector};

/// A request for the reachable nodes. `None`: the daemon's default.
#[derive(Clone, Debug, PartialEq)]
pub struct ReachableQuery {
    /// Name of the map.
    pub map: String,
    /// Name of the node where the robot is.
    pub from: String,
    /// Names of the nodes to reach. Each is a search of its own, so name no more than a few hundred.
    pub nodes: Vec<String>,
    /// Departure, nanoseconds UTC.
    pub at_nanos: i64,
    /// The longest duration of a route, nanoseconds.
    pub horizon_nanos: Option<i64>,
    /// The model that predicts success.
    pub model: ModelSelector,
    /// Speed on edges without data, metres per second.
    pub speed_m_per_s: Option<f64>,
}

/// A node, with the route to it that is the least likely to fail.
#[derive(Clone, Debug, PartialEq)]
pub struct ReachableNode {
    /// Name of the node.
    pub node: String,
    /// Probability that nothing fails on the way; 0 without a route.
    pub success: f64,
    /// Lower and upper end of the interval of `success`; `None` without a route.
    pub success_interval: Option<[f64; 2]>,
    /// Expected duration, failed attempts included, seconds; `None` without a route.
    pub expected_secs: Option<f64>,
    /// Number of edges of the route; 0 without one, and at the node where the robot is.
    pub edges: usize,
    /// Whether the search reached its limit of time or memory: there may be a better route.
    pub is_cut_off: bool,
}

impl Client {
    /// The nodes with the best route to each, by falling probability of success; among equal ones the fastest first;
    /// nodes without a route come last. Each node is a request of its own: an update that ends meanwhile counts for the
    /// nodes after it.
    ///
    /// # Errors
    /// [`Error`]; the code is `NOT_FOUND` if the map or a node does not exist, `FAILED_PRECONDITION` if the
    /// map has no nodes.
    pub async fn reachable_nodes(&self, query: ReachableQuery) -> Result<Vec<ReachableNode>, Error> {
        let route_to = |node: &str| RouteQuery {
            horizon_nanos: query.horizon_nanos,
            model: query.model,
            speed_m_per_s: query.speed_m_per_s,
            ..RouteQuery::new(&query.map, &query.from, node, RouteTime::Depart(query.at_nanos))
        };
        // There is always a route to the node where the robot is: this request fails only for another reason.
        self.plan_route(route_to(&query.from)).await?;
        let mut found = Vec::with_capacity(query.nodes.len());
        for node in &query.nodes {
            let (best, certainty) = match self.plan_route(route_to(node)).await {
                Ok((routes, certainty)) => (routes.into_iter().next(), certainty),
                // No route exists, or none is short enough.
                Err(Error::Server(error)) if error.code == Code::FailedPrecondition => (None, Certainty::Proven),
                Err(error) => return Err(error),
            };
            found.push(ReachableNode {
                node: node.clone(),
                success: best.as_ref().map_or(0.0, |route| route.success),
                success_interval: best.as_ref().map(|route| route.success_interval),
                expected_secs: best.as_ref().map(|route| route.expected_secs),
                edges: best.as_ref().map_or(0, |route| route.steps.len()),
                is_cut_off: certainty == Certainty::CutOff,
            });
        }
        found.sort_by(|one, other| {
            let secs = |node: &ReachableNode| node.expected_secs.unwrap_or(f64::INFINITY);
            other.success.total_cmp(&one.success).then(secs(one).total_cmp(&secs(other)))
        });
        Ok(found)
    }
}
