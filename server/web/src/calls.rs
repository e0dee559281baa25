//! Calls of RPCs that answer a link. They use the caller's token, and the same guard and bounds as calls of any client.
//!
//! Invariant: the types of the wire are used only in this module.

use std::collections::HashMap;

use axum::{
    extract::Request,
    http::{Extensions, HeaderMap, HeaderValue, header},
};
use tidemap_base::connections::Remote;
use tidemap_map::topology::Topology;
use tidemap_proto::{
    convert::{
        route::{EdgePrediction, predictions_from_wire},
        search::presence_of_nodes,
        time::timestamp,
        topology::topology_from_wire,
    },
    v1::{
        self, map_service_client::MapServiceClient, route_service_client::RouteServiceClient,
        search_service_client::SearchServiceClient, topology_service_client::TopologyServiceClient,
    },
};
use tidemap_rpc::serve::GuardedServices;
use tonic::{Code, Status};

/// Maximum size of one reply of an RPC.
pub(super) const REPLY_BYTES: usize = 8 << 20;

/// The caller: requests to the RPCs carry the caller's token, and count for the caller's connection.
pub(super) struct Caller {
    token: Option<HeaderValue>,
    remote: Option<Remote>,
}

impl Caller {
    /// The caller of a request.
    pub(super) fn of(request: &Request) -> Self {
        Self::of_head(request.headers(), request.extensions())
    }

    /// The caller of a request with this head.
    pub(super) fn of_head(headers: &HeaderMap, extensions: &Extensions) -> Self {
        Self { token: headers.get(header::AUTHORIZATION).cloned(), remote: extensions.get().cloned() }
    }

    /// Makes a request of this caller.
    pub(super) fn request<T>(&self, message: T) -> tonic::Request<T> {
        let mut request = tonic::Request::new(message);
        if let Some(token) = &self.token
            && let Ok(token) = tonic::metadata::MetadataValue::try_from(token.as_bytes())
        {
            request.metadata_mut().insert("authorization", token);
        }
        if let Some(remote) = &self.remote {
            request.extensions_mut().insert(remote.clone());
        }
        request
    }
}

/// The services, called for a caller about a map.
pub(super) struct Calls<'a> {
    pub services: &'a GuardedServices,
    pub caller: &'a Caller,
    pub map: &'a str,
}

/// The error of an invalid reply: the daemon itself sent it, so this is a defect of the daemon.
fn senseless(error: impl std::fmt::Display) -> Status {
    Status::internal(error.to_string())
}

/// Converts a reply in a blocking thread, because it may be large.
async fn converted<T: Send + 'static, E: std::fmt::Display + Send + 'static>(
    convert: impl FnOnce() -> Result<T, E> + Send + 'static,
) -> Result<T, Status> {
    let done = tidemap_base::task::blocking(convert).await.map_err(|_| Status::internal("the work was not done"))?;
    done.map_err(senseless)
}

impl Calls<'_> {
    /// The nodes and edges.
    ///
    /// # Errors
    /// The RPC refused or failed.
    pub(super) async fn topology(&self) -> Result<Topology, Status> {
        let mut client = TopologyServiceClient::new(self.services.clone()).max_decoding_message_size(REPLY_BYTES);
        let question = v1::GetTopologyRequest { map: self.map.to_owned() };
        let reply = client.get_topology(self.caller.request(question)).await?.into_inner();
        converted(move || topology_from_wire(&reply)).await
    }

    /// Whether the clocks of the producers of the map are real.
    ///
    /// # Errors
    /// The RPC refused or failed.
    pub(super) async fn has_real_clock(&self) -> Result<bool, Status> {
        let mut client = MapServiceClient::new(self.services.clone()).max_decoding_message_size(REPLY_BYTES);
        let question = v1::GetMapRequest { name: self.map.to_owned() };
        let reply = client.get_map(self.caller.request(question)).await?.into_inner();
        Ok(reply.map.is_some_and(|map| map.real_clock))
    }

    /// The predictions for the edges, for a robot that enters them at a time, nanoseconds UTC.
    ///
    /// # Errors
    /// The RPC refused or failed.
    pub(super) async fn edges(&self, at_nanos: i64) -> Result<Vec<EdgePrediction>, Status> {
        let mut client = RouteServiceClient::new(self.services.clone()).max_decoding_message_size(REPLY_BYTES);
        let question = v1::PredictEdgesRequest {
            map: self.map.to_owned(),
            time: Some(timestamp(at_nanos)),
            ..v1::PredictEdgesRequest::default()
        };
        let reply = client.predict_edges(self.caller.request(question)).await?.into_inner();
        converted(move || predictions_from_wire(reply)).await
    }

    /// The probability that an object is there, by the name of the node. It is empty for the default kind if no
    /// presence was observed.
    ///
    /// # Errors
    /// The RPC refused or failed.
    pub(super) async fn presence(&self, object: &str, at_nanos: i64) -> Result<HashMap<String, f64>, Status> {
        let mut client = SearchServiceClient::new(self.services.clone()).max_decoding_message_size(REPLY_BYTES);
        let question = v1::PredictPresenceRequest {
            map: self.map.to_owned(),
            object: object.to_owned(),
            times_nanos: vec![at_nanos],
            ..v1::PredictPresenceRequest::default()
        };
        match client.predict_presence(self.caller.request(question)).await {
            Ok(reply) => Ok(presence_of_nodes(reply.into_inner()).collect()),
            // No presence was observed, or the states of nodes are not about presence.
            Err(status) if object.is_empty() && status.code() == Code::FailedPrecondition => Ok(HashMap::new()),
            Err(status) => Err(status),
        }
    }
}
