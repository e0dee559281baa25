//! The YAML of ROS topological maps: the list of the first versions, and the mapping of `tmap2` files.
//!
//! Invariant: an edge leads to a node of the file.

use std::collections::HashMap;

use saphyr_parser::{Event, Parser};
use serde::Deserialize;

use super::{EdgeEntry, NodeEntry, TopologyFile, TopologyFileError};

/// The mapping of `tmap2` files.
#[derive(Deserialize)]
struct YamlMap {
    nodes: Vec<YamlItem>,
    #[serde(default)]
    transformation: Option<YamlTransformation>,
}

/// An entry of the list: the node itself, or a node below `node`, beside `meta`.
#[derive(Deserialize)]
struct YamlItem {
    #[serde(default)]
    node: Option<YamlNode>,
    #[serde(default)]
    name: Option<String>,
    #[serde(default)]
    pose: Option<YamlPose>,
    #[serde(default)]
    edges: Vec<YamlEdge>,
}

impl YamlItem {
    fn node(self, number: usize) -> Result<YamlNode, TopologyFileError> {
        let missing = |what| TopologyFileError::Incomplete { number, what };
        match self.node {
            Some(node) => Ok(node),
            None => Ok(YamlNode {
                name: self.name.ok_or_else(|| missing("name"))?,
                pose: self.pose.ok_or_else(|| missing("pose"))?,
                edges: self.edges,
            }),
        }
    }
}

/// From the frame of the nodes to another frame.
#[derive(Deserialize)]
struct YamlTransformation {
    #[serde(default)]
    parent: String,
    #[serde(default)]
    rotation: Orientation,
    #[serde(default)]
    translation: Position,
}

impl YamlTransformation {
    fn is_identity(&self) -> bool {
        let Position { x, y, z } = self.translation;
        let Orientation { x: qx, y: qy, z: qz, .. } = self.rotation;
        [x, y, z, qx, qy, qz].iter().all(|number| *number == 0.0)
    }
}

#[derive(Deserialize)]
struct YamlNode {
    name: String,
    pose: YamlPose,
    #[serde(default)]
    edges: Vec<YamlEdge>,
}

#[derive(Deserialize)]
struct YamlPose {
    position: Position,
    #[serde(default)]
    orientation: Orientation,
}

#[derive(Clone, Copy, Default, Deserialize)]
struct Position {
    x: f64,
    y: f64,
    #[serde(default)]
    z: f64,
}

#[derive(Deserialize)]
#[serde(default)]
struct Orientation {
    x: f64,
    y: f64,
    z: f64,
    w: f64,
}

impl Default for Orientation {
    fn default() -> Self {
        Self { x: 0.0, y: 0.0, z: 0.0, w: 1.0 }
    }
}

impl Orientation {
    fn yaw_rad(&self) -> f64 {
        let Self { x, y, z, w } = self;
        (2.0 * (w * z + x * y)).atan2(1.0 - 2.0 * (y * y + z * z))
    }
}

#[derive(Deserialize)]
struct YamlEdge {
    node: String,
    #[serde(default)]
    action: String,
    /// Seconds; not part of the ROS format.
    #[serde(default)]
    duration: Option<f64>,
}

/// Reads the YAML of a ROS topological map: a list of nodes, each with `name`, `pose` and `edges`, mostly below `node`;
/// or a mapping with this list as `nodes`, as in `tmap2` files. The length of an edge is the distance of its nodes;
/// `duration` is its nominal time in seconds.
///
/// # Errors
/// [`TopologyFileError`]
pub fn read_yaml(text: &str) -> Result<TopologyFile, TopologyFileError> {
    let invalid = |error: serde_saphyr::Error| TopologyFileError::Yaml(error.to_string());
    let YamlMap { nodes, transformation } = if is_mapping(text)? {
        serde_saphyr::from_str(text).map_err(invalid)?
    } else {
        YamlMap { nodes: serde_saphyr::from_str(text).map_err(invalid)?, transformation: None }
    };
    let nodes = (1..).zip(nodes).map(|(number, item)| item.node(number)).collect::<Result<Vec<_>, _>>()?;
    let mut topology = from_nodes(&nodes)?;
    if let Some(moved) = transformation.filter(|transformation| !transformation.is_identity()) {
        topology.notes.push(format!(
            "its transformation to frame {:?} is not used: the nodes keep the coordinates of the file",
            moved.parent
        ));
    }
    Ok(topology)
}

/// Whether the document is a mapping.
fn is_mapping(text: &str) -> Result<bool, TopologyFileError> {
    for event in Parser::new_from_str(text) {
        match event.map_err(|error| TopologyFileError::Yaml(error.to_string()))?.0 {
            Event::MappingStart(..) => return Ok(true),
            Event::SequenceStart(..) | Event::Scalar(..) | Event::StreamEnd => return Ok(false),
            _ => {}
        }
    }
    Ok(false)
}

fn from_nodes(nodes: &[YamlNode]) -> Result<TopologyFile, TopologyFileError> {
    let places: HashMap<&str, Position> = nodes.iter().map(|node| (node.name.as_str(), node.pose.position)).collect();
    let mut topology = TopologyFile::default();
    for node in nodes {
        let at = node.pose.position;
        let pose = Some([at.x, at.y, node.pose.orientation.yaw_rad()]);
        topology.nodes.push(NodeEntry { name: node.name.clone(), pose });
        for edge in &node.edges {
            let unknown = || TopologyFileError::UnknownNode { from: node.name.clone(), to: edge.node.clone() };
            let to = places.get(edge.node.as_str()).ok_or_else(unknown)?;
            let length_m = (to.x - at.x).hypot(to.y - at.y).hypot(to.z - at.z);
            let (from, to, action) = (node.name.clone(), edge.node.clone(), edge.action.clone());
            // An edge between nodes at the same place has no length if it has a duration.
            let length_m = Some(length_m).filter(|&length_m| length_m != 0.0 || edge.duration.is_none());
            let nominal_secs = edge.duration;
            topology.edges.push(EdgeEntry { from, to, action, both_ways: false, length_m, nominal_secs });
        }
    }
    Ok(topology)
}

#[cfg(test)]
mod tests {
    use super::{super::read, *};

    const YAML: &str = "
- meta: {map: flat, node: Hall, pointset: flat}
  node:
    edges:
    - {action: move_base, edge_id: Hall_Bath, node: Bath, top_vel: 0.55}
    name: Hall
    pose:
      orientation: {w: 0.7071067811865476, x: 0.0, y: 0.0, z: 0.7071067811865476}
      position: {x: 1.0, y: 2.0, z: 0.0}
    verts: [{x: 1.0, y: 0.5}]
- meta: {map: flat}
  node:
    edges:
    - {action: doorPassing, edge_id: Bath_Hall, node: Hall, duration: 12}
    name: Bath
    pose: {position: {x: 4.0, y: 6.0, z: 0.0}}
";

    #[test]
    fn edges_of_yaml_are_as_long_as_their_ends_are_apart() {
        let topology = read_yaml(YAML).expect("right");
        let [x, y, yaw] = topology.nodes[0].pose.expect("a pose");
        assert!((x, y) == (1.0, 2.0) && (yaw - std::f64::consts::FRAC_PI_2).abs() < 1e-9);
        assert_eq!((topology.edges[0].length_m, topology.edges[0].nominal_secs), (Some(5.0), None));
        assert_eq!((topology.edges[0].action.as_str(), topology.edges[0].both_ways), ("move_base", false));
        assert_eq!(topology.edges[1].nominal_secs, Some(12.0));
        let error = read_yaml(&YAML.replace("node: Bath,", "node: Attic,")).expect_err("wrong").to_string();
        assert!(error.contains("\"Hall\"") && error.contains("\"Attic\""), "{error}");
        assert!(read_yaml("- node: {name: A}").expect_err("wrong").to_string().contains("pose"));
        let error = read_yaml("- {name: A}").expect_err("wrong").to_string();
        assert!(error.contains("node number 1 has no pose"), "{error}");
        assert!(read_yaml("- {").is_err());
    }

    const TMAP2: &str = "
meta:
  last_updated: 2022-03-02_10-07-31
metric_map: hall
name: halls
nodes:
- meta: {map: hall, node: A, pointset: halls}
  node:
    edges:
    - action: NavigateToPose
      action_type: nav2_msgs/NavigateToPose
      config: &id001 []
      edge_id: A_B
      fail_policy: fail
      fluid_navigation: true
      goal: {target_pose: {header: {frame_id: $node.parent_frame}, pose: $node.pose}}
      node: B
      restrictions_planning: 'True'
    localise_by_topic: ''
    name: A
    parent_frame: map
    pose: {orientation: {w: 1.0, x: 0.0, y: 0.0, z: 0.0}, position: {x: 0.0, y: 0.0, z: 0.0}}
    properties: {xy_goal_tolerance: 0.3}
    verts: [{x: 0.69, y: 0.28}]
- meta: {map: hall, node: B, pointset: halls}
  node:
    edges:
    - {action: NavigateToPose, config: *id001, node: A}
    name: B
    pose: {orientation: {w: 1.0, x: 0.0, y: 0.0, z: 0.0}, position: {x: 3.0, y: 4.0, z: 0.0}}
pointset: halls
transformation:
  child: topo_map
  parent: map
  rotation: {w: 1.0, x: 0.0, y: 0.0, z: 0.0}
  translation: {x: 0.0, y: 0.0, z: 0.0}
";

    #[test]
    fn a_mapping_has_the_nodes_of_the_list_in_it() {
        let topology = read(TMAP2).expect("right");
        assert_eq!(topology.nodes.iter().map(|node| node.name.as_str()).collect::<Vec<_>>(), ["A", "B"]);
        assert_eq!(topology.edges.iter().map(|edge| edge.length_m).collect::<Vec<_>>(), [Some(5.0), Some(5.0)]);
        assert_eq!((topology.edges[0].action.as_str(), topology.edges[1].to.as_str()), ("NavigateToPose", "A"));
        assert!(topology.notes.is_empty(), "{:?}", topology.notes);
        let moved = read(&TMAP2.replace("translation: {x: 0.0", "translation: {x: 7.0")).expect("right");
        assert!(moved.notes[0].contains("transformation to frame \"map\" is not used"), "{:?}", moved.notes);
        let json = "{\"nodes\": [{\"name\": \"A\", \"pose\": {\"position\": {\"x\": 1, \"y\": 2}}}]}";
        assert_eq!(read(json).expect("right").nodes[0].pose, Some([1.0, 2.0, 0.0]), "a node without meta");
        let error = read("meta: {}\nedges: []\n").expect_err("wrong").to_string();
        assert!(error.contains("nodes"), "{error}");
    }
}
