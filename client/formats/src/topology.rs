//! Files of topological maps: lines of nodes and links, and the YAML of ROS topological maps.
//!
//! Invariant: an error names the invalid line or node. In files of lines, the daemon checks that the nodes of links
//! exist.

use std::collections::HashMap;

use serde::Deserialize;

/// A node of a file.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct NodeEntry {
    /// Name of the node.
    pub name: String,
    /// x, y in metres and heading in radians.
    pub pose: Option<[f64; 3]>,
}

/// An edge of a file. At least one of length and time is given.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct EdgeEntry {
    /// Name of the start node.
    pub from: String,
    /// Name of the end node.
    pub to: String,
    /// The action that traverses it; empty: the default action.
    pub action: String,
    /// Whether the file declares the reverse direction, too.
    pub both_ways: bool,
    /// Length of the edge, metres.
    pub length_m: Option<f64>,
    /// Nominal duration of the edge, seconds.
    pub nominal_secs: Option<f64>,
}

/// The nodes and edges of a file.
#[derive(Clone, Debug, Default, PartialEq)]
#[allow(missing_docs, reason = "see the type")]
pub struct TopologyFile {
    pub nodes: Vec<NodeEntry>,
    pub edges: Vec<EdgeEntry>,
}

/// Why a file of a topological map is invalid.
#[derive(Clone, Debug, PartialEq, Eq, thiserror::Error)]
#[allow(missing_docs, reason = "the message of each variant names its fields")]
pub enum TopologyFileError {
    /// An invalid line.
    #[error("line {line}: {text:?} is not understood: write `node NAME`, `link A B SECONDS` or `edge A B SECONDS`")]
    Line { line: usize, text: String },
    /// An invalid time.
    #[error("line {line}: {text:?} is no time in seconds")]
    Seconds { line: usize, text: String },
    /// Invalid YAML.
    #[error("{0}")]
    Yaml(String),
    /// An edge leads to an unknown node.
    #[error("node {from:?} has an edge to {to:?}, which the file does not have")]
    UnknownNode { from: String, to: String },
}

/// Reads lines: `node NAME`, `link A B SECONDS` (both directions), `edge A B SECONDS` (one direction); `#` starts a
/// comment.
pub fn read_lines(text: &str) -> Result<TopologyFile, TopologyFileError> {
    let mut topology = TopologyFile::default();
    for (line, text) in (1..).zip(text.trim_start_matches('\u{feff}').lines()) {
        let words: Vec<&str> = text.split_whitespace().take_while(|word| !word.starts_with('#')).collect();
        match words[..] {
            [] => {}
            ["node", name] => topology.nodes.push(NodeEntry { name: name.to_owned(), pose: None }),
            [what @ ("link" | "edge"), from, to, secs] => {
                let nominal_secs = secs.parse().map_err(|_| TopologyFileError::Seconds { line, text: shown(secs) })?;
                let (from, to) = (from.to_owned(), to.to_owned());
                let (both_ways, nominal_secs) = (what == "link", Some(nominal_secs));
                topology.edges.push(EdgeEntry { from, to, both_ways, nominal_secs, ..EdgeEntry::default() });
            }
            _ => return Err(TopologyFileError::Line { line, text: shown(text) }),
        }
    }
    Ok(topology)
}

fn shown(text: &str) -> String {
    text.chars().take(60).collect()
}

#[derive(Deserialize)]
struct YamlItem {
    node: YamlNode,
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

#[derive(Clone, Copy, Deserialize)]
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

/// Reads the YAML of a ROS topological map: a list of `node`s with `name`, `pose` and `edges`. The length of an edge is
/// the distance of its nodes; `duration` is its nominal time in seconds.
pub fn read_yaml(text: &str) -> Result<TopologyFile, TopologyFileError> {
    let written: Vec<YamlItem> =
        serde_saphyr::from_str(text).map_err(|error| TopologyFileError::Yaml(error.to_string()))?;
    let places: HashMap<&str, Position> =
        written.iter().map(|YamlItem { node }| (node.name.as_str(), node.pose.position)).collect();
    let mut topology = TopologyFile::default();
    for YamlItem { node } in &written {
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
    use super::*;

    #[test]
    fn lines_are_nodes_and_links() {
        let topology = read_lines("# a flat\nnode A\nnode B # the bath\n\nlink A   B 14.5 \nedge B A 3\r\n");
        let topology = topology.expect("right");
        assert_eq!(topology.nodes.iter().map(|node| node.name.as_str()).collect::<Vec<_>>(), ["A", "B"]);
        let ways: Vec<_> = topology.edges.iter().map(|edge| (edge.both_ways, edge.nominal_secs)).collect();
        assert_eq!(ways, [(true, Some(14.5)), (false, Some(3.0))]);
        for (wrong, words) in [
            ("node A\nlink A B", "line 2"),
            ("node", "line 1"),
            ("knot A", "\"knot A\""),
            ("link A B soon", "\"soon\" is no time"),
        ] {
            let error = read_lines(wrong).expect_err("wrong").to_string();
            assert!(error.contains(words), "{error}");
        }
    }

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
        assert!(read_yaml("- {").is_err());
    }
}
