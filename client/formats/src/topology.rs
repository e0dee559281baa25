//! Files of topological maps: lines of nodes and links, and the YAML of ROS topological maps.
//!
//! Invariant: the content decides the kind of a file, not its name. An error names the invalid line or node. In files
//! of lines, the daemon checks that the nodes of links exist.

mod yaml;

pub use yaml::read_yaml;

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
    /// The parts of the file that are not used, in words.
    pub notes: Vec<String>,
}

/// Why a file of a topological map is invalid.
#[derive(Clone, Debug, PartialEq, Eq, thiserror::Error)]
#[allow(missing_docs, reason = "the message of each variant names its fields")]
pub enum TopologyFileError {
    /// An invalid line.
    #[error(
        "line {line}: {text:?} is not understood: write `node NAME`, `link A B SECONDS` or `edge A B SECONDS`, or give a \
         ROS topological map in YAML"
    )]
    Line { line: usize, text: String },
    /// An invalid time.
    #[error("line {line}: {text:?} is no time in seconds")]
    Seconds { line: usize, text: String },
    /// Invalid YAML.
    #[error("{0}")]
    Yaml(String),
    /// A node without a name or a pose.
    #[error("node number {number} has no {what}: a node of a topological map has name, pose and edges")]
    Incomplete { number: usize, what: &'static str },
    /// An edge leads to an unknown node.
    #[error("node {from:?} has an edge to {to:?}, which the file does not have")]
    UnknownNode { from: String, to: String },
}

/// Reads a file of either kind: lines, or YAML.
///
/// # Errors
/// [`TopologyFileError`]
pub fn read(text: &str) -> Result<TopologyFile, TopologyFileError> {
    if is_yaml(text) { read_yaml(text) } else { read_lines(text) }
}

/// Whether a text is YAML (JSON is YAML, too): a list, or a mapping. Lines of this format begin with a word that no
/// colon follows.
fn is_yaml(text: &str) -> bool {
    let lines = text.trim_start_matches('\u{feff}').lines().map(str::trim_start);
    let first =
        lines.filter(|line| !line.is_empty() && !line.starts_with('#')).map(|line| line.split_whitespace().next());
    first.flatten().next().is_some_and(|word| word.starts_with(['-', '[', '{', '%']) || word.contains(':'))
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

    #[test]
    fn the_content_decides_which_kind_of_file_it_is() {
        for yaml in [
            "- node: {}",
            "# saved by hand\n---\n- meta:",
            "\u{feff}meta:\n  last_updated: 2022\nnodes: []\n",
            "{\"nodes\": []}",
            "[]",
            "%YAML 1.1\n---\n",
            "nodes: []",
        ] {
            assert!(is_yaml(yaml), "{yaml}");
        }
        for lines in ["node A\nlink A B: 3", "# a - b\n\n  link A B 3", "", "<xml>"] {
            assert!(!is_yaml(lines), "{lines}");
        }
        assert!(read("<launch>").expect_err("wrong").to_string().contains("ROS topological map in YAML"));
    }
}
