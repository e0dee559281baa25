//! `GET /api/v1/maps/NAME/topology.geojson`: nodes and edges with what is predicted of them at a time.
//!
//! Invariant: coordinates are metres in the map's frame, which the document says in the member `tidemap`. A node
//! without a position has the geometry null, as RFC 7946 section 3.2 allows; so do its edges.

use std::collections::HashMap;

use axum::{
    extract::{Path, Request, State},
    http::HeaderMap,
    response::Response,
};
use serde_json::{Value, json};
use tidemap_model::time::format_rfc3339;
use tidemap_proto::{
    convert::time::timestamp,
    v1::{
        self, route_service_client::RouteServiceClient, search_service_client::SearchServiceClient,
        topology_service_client::TopologyServiceClient,
    },
};
use tonic::Code;

use super::{super::Gateway, Caller, Failure, Parameter, in_turn, parameters::Given, time};

/// Maximum size of one reply of an RPC.
const REPLY_BYTES: usize = 8 << 20;

/// The parameters of the address.
pub(in super::super) const PARAMETERS: &[Parameter] = &[
    Parameter {
        name: "at",
        description: "When a robot would enter the edges: RFC 3339, Unix seconds or `now`. Default: now.",
        example: "2025-03-18T10:00:00Z",
    },
    Parameter {
        name: "object",
        description: "Whose presence at the nodes: the states `node/N/OBJECT`. Default: the states N.",
        example: "",
    },
];

/// What is known of a topological map at a time.
struct PredictedNetwork {
    nodes: Vec<v1::TopologyNode>,
    edges: Vec<v1::TopologyEdge>,
    predicted: Vec<v1::PredictedEdge>,
    /// Presence by the name of the node.
    presence: HashMap<String, f64>,
}

type EdgeKey<'a> = (&'a str, &'a str, &'a str);

fn key(ends: Option<&v1::EdgeEnds>) -> EdgeKey<'_> {
    ends.map_or(("", "", ""), |ends| (&ends.from, &ends.to, &ends.action))
}

impl PredictedNetwork {
    fn features(&self) -> Vec<Value> {
        let places: HashMap<&str, [f64; 2]> = self
            .nodes
            .iter()
            .filter_map(|node| Some((node.name.as_str(), node.pose.map(|pose| [pose.x_m, pose.y_m])?)))
            .collect();
        let nodes = self.nodes.iter().map(|node| {
            let place = places.get(node.name.as_str());
            json!({
                "type": "Feature",
                "id": format!("node/{}", node.id),
                "geometry": place.map(|place| json!({ "type": "Point", "coordinates": place })),
                "properties": {
                    "kind": "node",
                    "name": node.name,
                    "yaw_rad": node.pose.map(|pose| pose.yaw_rad),
                    "dwell_secs": node.dwell_secs,
                    "presence": self.presence.get(&node.name),
                },
            })
        });
        let predicted: HashMap<EdgeKey<'_>, &v1::PredictedEdge> =
            self.predicted.iter().map(|edge| (key(edge.edge.as_ref()), edge)).collect();
        let edges = self.edges.iter().map(|edge| {
            let (from, to, action) = key(edge.ends.as_ref());
            let line = places.get(from).zip(places.get(to));
            let forecast = predicted.get(&(from, to, action));
            json!({
                "type": "Feature",
                "id": format!("edge/{}", edge.id),
                "geometry": line.map(|(from, to)| json!({ "type": "LineString", "coordinates": [from, to] })),
                "properties": {
                    "kind": "edge",
                    "from": from,
                    "to": to,
                    "action": (!action.is_empty()).then_some(action),
                    "length_m": edge.length_m,
                    "nominal_secs": edge.nominal_secs,
                    "success": forecast.map(|forecast| forecast.success),
                    "success_lower": forecast.map(|forecast| forecast.success_lower),
                    "success_upper": forecast.map(|forecast| forecast.success_upper),
                    "duration_secs": forecast.map(|forecast| forecast.duration_secs),
                    "reports": forecast.map(|forecast| forecast.reports),
                },
            })
        });
        nodes.chain(edges).collect()
    }

    fn document(&self, map: &str, at: i64) -> Value {
        json!({
            "type": "FeatureCollection",
            "tidemap": {
                "map": map,
                "time": format_rfc3339(at),
                "coordinates": "metres in the frame of the map, x and y; not longitude and latitude",
            },
            "features": self.features(),
        })
    }
}

/// A reply beyond [`REPLY_BYTES`] is an error of the transport.
fn or_too_large(status: tonic::Status) -> Failure {
    if status.code() == Code::OutOfRange {
        return Failure::TooLarge(format!("the topology has more than {REPLY_BYTES} bytes: ask for it over gRPC"));
    }
    status.into()
}

async fn ask(
    gateway: &Gateway,
    caller: &Caller,
    map: &str,
    at: i64,
    object: &str,
) -> Result<PredictedNetwork, Failure> {
    let services = || gateway.services.clone();
    let map = map.to_owned();
    let mut topologies = TopologyServiceClient::new(services()).max_decoding_message_size(REPLY_BYTES);
    let question = v1::GetTopologyRequest { map: map.clone() };
    let topology = topologies.get_topology(caller.request(question)).await.map_err(or_too_large)?.into_inner();
    if topology.nodes.is_empty() {
        let text = format!("map {map} has no nodes: tidemap topology load {map} FILE gives it some");
        return Err(Failure::Invalid(text));
    }
    let mut routes = RouteServiceClient::new(services()).max_decoding_message_size(REPLY_BYTES);
    let question =
        v1::PredictEdgesRequest { map: map.clone(), time: Some(timestamp(at)), ..v1::PredictEdgesRequest::default() };
    let predicted = routes.predict_edges(caller.request(question)).await.map_err(or_too_large)?.into_inner().edges;
    let mut searches = SearchServiceClient::new(services()).max_decoding_message_size(REPLY_BYTES);
    let question = v1::PredictPresenceRequest {
        map,
        object: object.to_owned(),
        times_nanos: vec![at],
        ..v1::PredictPresenceRequest::default()
    };
    let presence = match searches.predict_presence(caller.request(question)).await {
        Ok(reply) => {
            let reply = reply.into_inner();
            let probabilities = reply.times.into_iter().next().unwrap_or_default().probabilities;
            reply.nodes.into_iter().zip(probabilities).collect()
        }
        // Nobody was looked for, or the states of nodes are not about presence.
        Err(status) if object.is_empty() && status.code() == Code::FailedPrecondition => HashMap::new(),
        Err(status) => return Err(or_too_large(status)),
    };
    Ok(PredictedNetwork { nodes: topology.nodes, edges: topology.edges, predicted, presence })
}

async fn answer(gateway: &Gateway, map: String, request: Request) -> Result<Response, Failure> {
    let caller = Caller::of(&request);
    let given = Given::of(request.uri().query(), PARAMETERS)?;
    let at = time(given.get("at").unwrap_or("now"))?;
    let forecast = ask(gateway, &caller, &map, at, given.get("object").unwrap_or("")).await?;
    let text = in_turn(gateway, move || Ok(forecast.document(&map, at).to_string().into_bytes())).await?;
    Ok(caller.answer("application/geo+json", text, HeaderMap::new()))
}

/// Answers with the document.
pub(in super::super) async fn topology_geojson(
    State(gateway): State<Gateway>,
    Path(map): Path<String>,
    request: Request,
) -> Response {
    answer(&gateway, map, request).await.unwrap_or_else(|failure| failure.response())
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn what_has_no_place_has_no_geometry() {
        let node = |name: &str, pose| v1::TopologyNode { name: name.to_owned(), pose, ..v1::TopologyNode::default() };
        let ends = |from: &str, to: &str| {
            Some(v1::EdgeEnds { from: from.to_owned(), to: to.to_owned(), ..v1::EdgeEnds::default() })
        };
        let edge = |from, to| v1::TopologyEdge { ends: ends(from, to), ..v1::TopologyEdge::default() };
        let pose = |x_m| Some(v1::NodePose { x_m, ..v1::NodePose::default() });
        let forecast = PredictedNetwork {
            nodes: vec![node("A", pose(1.5)), node("B", pose(3.0)), node("C", None)],
            edges: vec![edge("A", "B"), edge("B", "C")],
            predicted: vec![v1::PredictedEdge { edge: ends("B", "C"), success: 0.25, ..v1::PredictedEdge::default() }],
            presence: HashMap::from([("C".to_owned(), 0.5)]),
        };
        let document = forecast.document("flat", 1_000_000_000);
        let features = document["features"].as_array().expect("features");
        assert_eq!(features[0]["geometry"], json!({ "type": "Point", "coordinates": [1.5, 0.0] }));
        assert_eq!((&features[2]["geometry"], &features[2]["properties"]["presence"]), (&Value::Null, &json!(0.5)));
        assert_eq!(features[3]["geometry"]["coordinates"], json!([[1.5, 0.0], [3.0, 0.0]]));
        assert_eq!(features[3]["properties"]["success"], Value::Null);
        assert_eq!((&features[4]["geometry"], &features[4]["properties"]["success"]), (&Value::Null, &json!(0.25)));
        assert_eq!(document["tidemap"]["time"], "1970-01-01T00:00:01Z");
    }
}
