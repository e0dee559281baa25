//! `GET /api/v1/maps/NAME/topology.geojson`: nodes and edges with their predictions at a time.
//!
//! Invariant: coordinates are metres in the map's frame, which the document states in the member `tidemap`. A node
//! without a position has the geometry null, as RFC 7946 section 3.2 allows; so do the edges of the node.

use std::collections::{BTreeMap, HashMap};

use axum::{
    extract::{Path, Request, State},
    http::HeaderMap,
    response::Response,
};
use serde_json::{Value, json};
use tidemap_map::{
    name::{EdgeName, StateName},
    topology::{Node, Topology},
};
use tidemap_model::time::format_rfc3339;
use tidemap_proto::convert::route::EdgePrediction;
use tonic::Code;

use super::{
    super::{
        Gateway,
        calls::{Calls, REPLY_BYTES},
    },
    Failure, Parameter, Visitor, in_turn,
    parameters::Given,
    time,
};

/// The parameters of the address.
pub(in super::super) const PARAMETERS: &[Parameter] = &[
    Parameter {
        name: "at",
        description: "When a robot would enter the edges: RFC 3339, Unix seconds or `now`. Default: now.",
        example: "2025-03-18T10:00:00Z",
    },
    Parameter {
        name: "object",
        description: "Object whose presence at the nodes is shown: the states `node/N/OBJECT`. Default: the states N.",
        example: "",
    },
];

/// A topological map with its predictions at a time.
struct PredictedNetwork {
    topology: Topology,
    predicted: Vec<EdgePrediction>,
    /// The predicted presence, by the name of the node.
    presence: HashMap<String, f64>,
}

impl PredictedNetwork {
    fn features(&self) -> Vec<Value> {
        let (mut features, predicted) = (Vec::new(), self.predicted.iter().map(|edge| (&edge.edge, edge)));
        let predicted: BTreeMap<&EdgeName, &EdgePrediction> = predicted.collect();
        let place = |node: &Node| node.pose.map(|pose| [pose.x_m, pose.y_m]);
        features.extend(self.topology.nodes().map(|node| {
            json!({
                "type": "Feature",
                "id": format!("node/{}", node.id.0),
                "geometry": place(node).map(|place| json!({ "type": "Point", "coordinates": place })),
                "properties": {
                    "kind": "node",
                    "name": node.name.as_str(),
                    "yaw_rad": node.pose.map(|pose| pose.yaw_rad),
                    "dwell_secs": node.dwell_secs,
                    "presence": self.presence.get(node.name.as_str()),
                },
            })
        }));
        features.extend(self.topology.edges().filter_map(|edge| {
            let [from, to] = [edge.from, edge.to].map(|end| self.topology.node(end));
            let (from, to) = (from.ok()?, to.ok()?);
            let line = place(from).zip(place(to));
            let name = EdgeName { from: from.name.clone(), to: to.name.clone(), action: edge.action.clone() };
            let forecast = predicted.get(&name);
            Some(json!({
                "type": "Feature",
                "id": format!("edge/{}", edge.id.0),
                "geometry": line.map(|(from, to)| json!({ "type": "LineString", "coordinates": [from, to] })),
                "properties": {
                    "kind": "edge",
                    "from": name.from.as_str(),
                    "to": name.to.as_str(),
                    "action": name.action.as_ref().map(StateName::as_str),
                    "length_m": edge.extent.length_m,
                    "nominal_secs": edge.extent.nominal_secs,
                    "success": forecast.map(|forecast| forecast.success),
                    "success_lower": forecast.map(|forecast| forecast.success_interval[0]),
                    "success_upper": forecast.map(|forecast| forecast.success_interval[1]),
                    "duration_secs": forecast.map(|forecast| forecast.duration_secs),
                    "reports": forecast.map(|forecast| forecast.reports),
                },
            }))
        }));
        features
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

/// Converts an error of an RPC. A reply larger than [`REPLY_BYTES`] is an error of the transport.
fn or_too_large(status: tonic::Status) -> Failure {
    if status.code() == Code::OutOfRange {
        return Failure::TooLarge(format!("the topology has more than {REPLY_BYTES} bytes: request it over gRPC"));
    }
    status.into()
}

async fn ask(calls: &Calls<'_>, at: i64, object: &str) -> Result<PredictedNetwork, Failure> {
    let topology = calls.topology().await.map_err(or_too_large)?;
    if topology.nodes().len() == 0 {
        let map = calls.map;
        let text = format!("map {map} has no nodes: tidemap topology load {map} FILE adds them");
        return Err(Failure::Invalid(text));
    }
    let predicted = calls.edges(at).await.map_err(or_too_large)?;
    let presence = calls.presence(object, at).await.map_err(or_too_large)?;
    Ok(PredictedNetwork { topology, predicted, presence })
}

async fn answer(gateway: &Gateway, map: String, request: Request) -> Result<Response, Failure> {
    let visitor = Visitor::of(&request);
    let given = Given::of(request.uri().query(), PARAMETERS)?;
    let at = time(given.get("at").unwrap_or("now"))?;
    let forecast = ask(&visitor.calls(gateway, &map), at, given.get("object").unwrap_or("")).await?;
    let text = in_turn(gateway, move || Ok(forecast.document(&map, at).to_string().into_bytes())).await?;
    Ok(visitor.answer("application/geo+json", text, HeaderMap::new()))
}

/// The response with the document.
pub(in super::super) async fn topology_geojson(
    State(gateway): State<Gateway>,
    Path(map): Path<String>,
    request: Request,
) -> Response {
    answer(&gateway, map, request).await.unwrap_or_else(|failure| failure.response())
}

#[cfg(test)]
mod tests {
    use tidemap_proto::{
        convert::{route::predictions_from_wire, topology::topology_from_wire},
        v1,
    };

    use super::*;

    #[test]
    fn what_has_no_place_has_no_geometry() {
        let node = |name: &str, pose, id| v1::TopologyNode { name: name.to_owned(), pose, id, dwell_secs: None };
        let ends = |from: &str, to: &str| {
            Some(v1::EdgeEnds { from: from.to_owned(), to: to.to_owned(), ..v1::EdgeEnds::default() })
        };
        let edge = |from, to, id| v1::TopologyEdge {
            ends: ends(from, to),
            length_m: Some(1.5),
            id,
            ..v1::TopologyEdge::default()
        };
        let pose = |x_m| Some(v1::NodePose { x_m, ..v1::NodePose::default() });
        let network = v1::GetTopologyResponse {
            nodes: vec![node("A", pose(1.5), 0), node("B", pose(3.0), 1), node("C", None, 2)],
            edges: vec![edge("A", "B", 0), edge("B", "C", 1)],
        };
        let predicted = v1::PredictEdgesResponse {
            edges: vec![v1::PredictedEdge { edge: ends("B", "C"), success: 0.25, ..v1::PredictedEdge::default() }],
        };
        let forecast = PredictedNetwork {
            topology: topology_from_wire(&network).expect("a topology"),
            predicted: predictions_from_wire(predicted).expect("an edge"),
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
