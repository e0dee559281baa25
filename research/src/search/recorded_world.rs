//! A topological map, and the node where the person was in every minute.
//!
//! Invariant: every node is reachable from the start; a minute has no node if the recorded place is not in the
//! topology.

use std::fs;

use tidemap_formats::topology::{self, TopologyFile};
use tidemap_map::{
    name::StateName,
    topology::{Extent, NodeId, Roads, ShortestTimes, Topology},
};
use tidemap_model::{Sample, models::Moment};

use super::{ReplayError, SearchProtocol};
use crate::place_recording::{DAY_MINUTES, PlaceRecording};

/// The robot's speed on edges that have a length only: the default of the service.
const SPEED_M_PER_S: f64 = 0.5;
const MINUTE_NANOS: i64 = 60 * 1_000_000_000;

/// The recorded world of searches.
#[derive(Debug)]
pub(super) struct RecordedWorld {
    /// Names of the nodes.
    pub names: Vec<String>,
    /// Travel times along the edges.
    pub roads: Roads,
    /// The start of the robot.
    pub start: NodeId,
    /// Index of the node where the person is, by minute; none: at no node.
    rooms: Vec<Option<usize>>,
    /// The first local midnight, nanoseconds since 1970-01-01T00:00 local.
    first_nanos: i64,
}

impl RecordedWorld {
    /// Reads topology and world.
    pub(super) fn read(protocol: &SearchProtocol) -> Result<RecordedWorld, ReplayError> {
        let path = &protocol.topology;
        let wrong = |wrong: String| ReplayError::Topology(format!("{}: {wrong}", path.display()));
        let text = fs::read_to_string(path).map_err(|error| {
            wrong(format!("the topology cannot be read: {error}; paths are relative to the protocol's folder"))
        })?;
        let written = topology::read(&text).map_err(|error| wrong(error.to_string()))?;
        let world = PlaceRecording::read(&protocol.world, 1)?;
        RecordedWorld::new(&written, &world, protocol).map_err(wrong)
    }

    /// Combines topology and recording.
    pub(super) fn new(
        written: &TopologyFile,
        world: &PlaceRecording,
        protocol: &SearchProtocol,
    ) -> Result<RecordedWorld, String> {
        let topology = topology(written)?;
        let names: Vec<String> = written.nodes.iter().map(|node| node.name.clone()).collect();
        let start = topology.node_named(&protocol.start).map_err(|error| format!("start: {error}"))?.id;
        let roads = Roads::new(&topology, |edge| Some(edge.extent.secs_at(SPEED_M_PER_S)))
            .map_err(|error| error.to_string())?;
        let mut shortest = ShortestTimes::default();
        let index = roads.index_of(start).unwrap_or_default();
        shortest.from(&roads, index);
        if let Some((name, _)) = names.iter().zip(shortest.secs()).find(|(_, secs)| secs.is_infinite()) {
            return Err(format!("no way leads from {} to {name}", protocol.start));
        }
        let node_of: Vec<Option<usize>> =
            world.places.iter().map(|place| names.iter().position(|name| name == place)).collect();
        if node_of.iter().all(Option::is_none) {
            let (nodes, places) = (names.join(", "), world.places.join(", "));
            return Err(format!(
                "its nodes are {nodes}, and the places of the world {places}: none of them is the same"
            ));
        }
        let rooms = (0..world.days() * DAY_MINUTES).map(|minute| node_of[world.seen(minute)]).collect();
        Ok(RecordedWorld { names, roads, start, rooms, first_nanos: protocol.first_nanos })
    }

    /// Number of minutes.
    pub(super) fn minutes(&self) -> usize {
        self.rooms.len()
    }

    /// Index of the node where the person is in a minute.
    pub(super) fn room(&self, minute: usize) -> Option<usize> {
        self.rooms.get(minute).copied().flatten()
    }

    /// The start of a minute.
    pub(super) fn moment(&self, minute: usize) -> Moment {
        // A recording has at most ten years of minutes.
        Moment { utc_nanos: self.first_nanos + minute as i64 * MINUTE_NANOS, offset_secs: 0 }
    }

    /// Whether the person was at a node, for every minute before `until`.
    pub(super) fn samples(&self, node: usize, until: usize) -> Vec<Sample> {
        let sample = |minute: usize| Sample {
            utc_nanos: self.moment(minute).utc_nanos,
            offset_secs: 0,
            value: f64::from(u8::from(self.room(minute) == Some(node))),
        };
        (0..until).map(sample).collect()
    }
}

/// The topology of a file.
fn topology(written: &TopologyFile) -> Result<Topology, String> {
    let mut topology = Topology::new();
    let name = |text: &str| StateName::new(text).map_err(|error| format!("node {text:?}: {error}"));
    for node in &written.nodes {
        topology.add_node(name(&node.name)?, None, None).map_err(|error| error.to_string())?;
    }
    for edge in &written.edges {
        let id = |text: &str| topology.node_named(text).map(|node| node.id).map_err(|error| error.to_string());
        let (from, to) = (id(&edge.from)?, id(&edge.to)?);
        let action = Some(&edge.action).filter(|action| !action.is_empty());
        let action = action.map(|text| name(text)).transpose()?;
        let extent = Extent { length_m: edge.length_m, nominal_secs: edge.nominal_secs };
        let ways: &[(NodeId, NodeId)] = if edge.both_ways { &[(from, to), (to, from)] } else { &[(from, to)] };
        for &(from, to) in ways {
            topology.add_edge(from, to, action.clone(), extent).map_err(|error| error.to_string())?;
        }
    }
    Ok(topology)
}
