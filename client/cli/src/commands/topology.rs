//! `tidemap topology`.
//!
//! Invariant: a file is loaded completely or not at all; a change is durable when the command ends.

use std::{
    cmp::Reverse,
    collections::{BTreeMap, BTreeSet},
    path::{Path, PathBuf},
    process::ExitCode,
};

use anyhow::Context as _;
use clap::{Args, Subcommand, ValueEnum};
use tidemap_client::queries::ModelSelector;
use tidemap_client::routes::{
    Edge, EdgeEnds, EdgeFailure, EdgeName, EdgePrediction, Extent, NewEdge, NewNode, Node, NodePose, StateName,
    Topology, TopologyEdit, TopologySize,
};

use super::{
    Session, files,
    point::Point,
    times,
    topology_picture::{self, Overlay},
    topology_reachable::{self, ReachableArgs},
    usage,
};
use crate::progress::status_line;
use tidemap_formats::{
    table::Cell,
    topology::{self, EdgeEntry, NodeEntry, TopologyFile},
};

#[derive(Debug, Subcommand)]
pub(crate) enum TopologyCommand {
    /// Replaces the nodes and edges with those of a file; those with the same names keep their numbers
    ///
    /// The content decides the format of a file, whatever its name: a ROS topological map in YAML (.yaml, .tmap, .tplg,
    /// .tmap2), or lines `node A`, `link A B SECONDS` (both ways) and `edge A B SECONDS` (one way); - is stdin.
    Load {
        /// Name of the map
        map: String,
        /// File to load
        file: PathBuf,
        /// Adds to the existing nodes and edges
        #[arg(long)]
        add: bool,
    },
    /// Shows the nodes or the edges
    Show {
        /// Name of the map
        map: String,
        /// Shows the edges, one row per direction
        #[arg(long)]
        edges: bool,
    },
    /// Lists failed traversals, the newest first; the map keeps 1,000
    Failures {
        /// Name of the map
        map: String,
        /// Maximum number [default: all that are kept]
        #[arg(long, value_name = "N", value_parser = clap::value_parser!(u32).range(1..))]
        limit: Option<u32>,
        /// Failures of this edge only
        #[arg(long, value_name = "FROM/TO[/ACTION]", value_parser = edge_of)]
        edge: Option<EdgeName>,
        /// Counts the failures by this instead of listing them
        #[arg(long, value_name = "WHAT")]
        by: Option<CountedBy>,
    },
    /// Predicts the probability of success and the duration of each edge at a time
    ///
    /// reports is the number of reports of the edge; an edge without reports gets the average of the map's edges.
    Predict(EdgeForecastArgs),
    /// Lists the nodes that a robot reaches from one node at one time, the most certain first
    ///
    /// probability is that of a way without failures, by the route that is the least likely to fail. A node without a
    /// route has the probability 0.
    Reachable(ReachableArgs),
    /// Changes one node or edge
    #[command(subcommand)]
    Edit(EditCommand),
}

#[derive(Debug, Args)]
pub(crate) struct EdgeForecastArgs {
    /// Name of the map
    map: String,
    /// Time of the prediction
    #[arg(long, value_name = "TIME", value_parser = times::time)]
    at: i64,
    /// Model, as in `predict`
    #[arg(long, value_name = "KIND", default_value = "auto")]
    model: ModelSelector,
    /// Speed on edges without data, metres per second [default: 0.5]
    #[arg(long, value_name = "M/S", allow_hyphen_values = true)]
    speed: Option<f64>,
    /// Draws the map with the presence at each node as SVG
    #[arg(long, value_name = "FILE")]
    picture: Option<PathBuf>,
    /// Kind of target to draw, by the states node/NODE/KIND [default: the states named like the nodes]
    #[arg(long, value_name = "KIND", default_value = "", hide_default_value = true)]
    object: String,
}

#[derive(Debug, Subcommand)]
pub(crate) enum EditCommand {
    /// Adds a node
    AddNode(NodeArgs),
    /// Sets the position of a node, and the time to observe it
    SetNode(NodeArgs),
    /// Removes a node and all its edges
    RemoveNode {
        /// Name of the map
        map: String,
        /// Name of the node
        #[arg(value_parser = StateName::new)]
        node: StateName,
    },
    /// Renames a node and its states
    RenameNode {
        /// Name of the map
        map: String,
        /// Current name
        #[arg(value_parser = StateName::new)]
        from: StateName,
        /// New name
        #[arg(value_parser = StateName::new)]
        to: StateName,
    },
    /// Adds an edge in both directions
    Link(LinkArgs),
    /// Changes the time or length of an edge in both directions
    SetLink(LinkArgs),
    /// Removes an edge in both directions
    Unlink(EndsArgs),
}

#[derive(Debug, Args)]
pub(crate) struct NodeArgs {
    /// Name of the map
    map: String,
    /// Name of the node
    #[arg(value_parser = StateName::new)]
    node: StateName,
    /// Its position, metres
    #[arg(long, value_name = "X,Y", allow_hyphen_values = true)]
    position: Option<Point>,
    /// Its heading, radians from the x axis
    #[arg(long, value_name = "RAD", allow_hyphen_values = true, default_value_t = 0.0, requires = "position")]
    yaw: f64,
    /// Time to observe it, seconds
    #[arg(long, value_name = "SECONDS", allow_hyphen_values = true)]
    dwell: Option<f64>,
}

#[derive(Debug, Args)]
pub(crate) struct EndsArgs {
    /// Name of the map
    map: String,
    /// Name of the node where it begins
    #[arg(value_parser = StateName::new)]
    from: StateName,
    /// Name of the node where it ends
    #[arg(value_parser = StateName::new)]
    to: StateName,
    /// Action of the robot on the edge [default: none]
    #[arg(long, value_parser = StateName::new)]
    action: Option<StateName>,
    /// Only from the first node to the second
    #[arg(long)]
    one_way: bool,
}

#[derive(Debug, Args)]
pub(crate) struct LinkArgs {
    #[command(flatten)]
    ends: EndsArgs,
    /// Its nominal time, seconds
    #[arg(allow_hyphen_values = true, required_unless_present = "length")]
    seconds: Option<f64>,
    /// Its length, metres
    #[arg(long, value_name = "M", allow_hyphen_values = true)]
    length: Option<f64>,
}

impl NodeArgs {
    fn node(self) -> (String, NewNode) {
        let pose = self.position.map(|Point([x_m, y_m])| NodePose { x_m, y_m, yaw_rad: self.yaw });
        (self.map, NewNode { name: self.node, pose, dwell_secs: self.dwell })
    }
}

impl EndsArgs {
    fn ends(self) -> (String, EdgeEnds) {
        let EndsArgs { map, from, to, action, one_way } = self;
        (map, EdgeEnds { from, to, action, both_ways: !one_way })
    }
}

impl LinkArgs {
    fn edge(self) -> (String, NewEdge) {
        let (map, ends) = self.ends.ends();
        (map, NewEdge { ends, extent: Extent { length_m: self.length, nominal_secs: self.seconds } })
    }
}

impl EditCommand {
    fn edit(self) -> (String, TopologyEdit) {
        fn with_map<T>((map, what): (String, T), edit: impl FnOnce(T) -> TopologyEdit) -> (String, TopologyEdit) {
            (map, edit(what))
        }
        match self {
            EditCommand::AddNode(args) => with_map(args.node(), TopologyEdit::AddNode),
            EditCommand::SetNode(args) => with_map(args.node(), TopologyEdit::SetNode),
            EditCommand::RemoveNode { map, node } => (map, TopologyEdit::RemoveNode(node)),
            EditCommand::RenameNode { map, from, to } => (map, TopologyEdit::RenameNode { from, to }),
            EditCommand::Link(args) => with_map(args.edge(), TopologyEdit::AddEdge),
            EditCommand::SetLink(args) => with_map(args.edge(), TopologyEdit::SetExtent),
            EditCommand::Unlink(args) => with_map(args.ends(), TopologyEdit::RemoveEdge),
        }
    }
}

/// An edge by its name.
fn edge_of(text: &str) -> Result<EdgeName, String> {
    EdgeName::parse(text).map_err(|_| format!("{text:?} is not an edge: use FROM/TO or FROM/TO/ACTION"))
}

/// Reads a file; reports which parts of it are not used.
fn read(path: &Path) -> anyhow::Result<(Vec<NewNode>, Vec<NewEdge>)> {
    let text = files::read_text(path)?;
    let shown = || path.display().to_string();
    let topology = topology::read(&text).with_context(shown)?;
    topology.notes.iter().for_each(|note| status_line(&format!("{}: {note}", shown())));
    from_file(topology).with_context(shown)
}

/// The nodes and edges that a file describes.
pub fn from_file(file: TopologyFile) -> anyhow::Result<(Vec<NewNode>, Vec<NewEdge>)> {
    let node = |NodeEntry { name, pose }| {
        let pose = pose.map(|[x_m, y_m, yaw_rad]| NodePose { x_m, y_m, yaw_rad });
        Ok(NewNode { name: StateName::new(&name)?, pose, dwell_secs: None })
    };
    let edge = |EdgeEntry { from, to, action, both_ways, length_m, nominal_secs }| {
        let EdgeName { from, to, action } = EdgeName::new(&from, &to, &action)?;
        Ok(NewEdge { ends: EdgeEnds { from, to, action, both_ways }, extent: Extent { length_m, nominal_secs } })
    };
    let nodes = file.nodes.into_iter().map(node).collect::<anyhow::Result<_>>()?;
    Ok((nodes, file.edges.into_iter().map(edge).collect::<anyhow::Result<_>>()?))
}

pub(crate) async fn run(session: &Session, command: TopologyCommand) -> anyhow::Result<ExitCode> {
    let size = match command {
        TopologyCommand::Load { map, file, add } => {
            let (nodes, edges) = read(&file)?;
            if nodes.is_empty() && !add {
                return Err(usage(format!("{}: it has no nodes", file.display())));
            }
            session.client.load_topology(&map, &nodes, &edges, add).await?
        }
        TopologyCommand::Show { map, edges } => {
            let topology = session.client.topology(&map).await?;
            return if edges { show_edges(session, &topology) } else { show_nodes(session, &topology) };
        }
        TopologyCommand::Predict(args) => return predict(session, args).await,
        TopologyCommand::Reachable(args) => return topology_reachable::run(session, args).await,
        TopologyCommand::Failures { map, limit, edge, by } => {
            let failures = session.client.failures(&map, limit.unwrap_or_default(), edge.as_ref()).await?;
            return match by {
                Some(CountedBy::Reason) => count_failures(session, failures),
                None => show_failures(session, failures),
            };
        }
        TopologyCommand::Edit(edit) => {
            let (map, edit) = edit.edit();
            session.client.edit_topology(&map, &edit).await?
        }
    };
    let TopologySize { nodes, edges } = size;
    session.print(&["nodes", "edges"], [vec![nodes.into(), edges.into()]])
}

async fn predict(session: &Session, args: EdgeForecastArgs) -> anyhow::Result<ExitCode> {
    let EdgeForecastArgs { map, at, model, speed, picture, object } = args;
    files::check_picture(picture.as_deref())?;
    let columns = ["from", "to", "action", "probability", "lower", "upper", "duration_secs", "reports"];
    let forecasts = session.client.predict_edges(&map, at, model, speed).await?;
    let row = |EdgePrediction { edge, success, success_interval: [lower, upper], duration_secs, reports }| {
        let [from, to, action] = edge_cells(&edge);
        let [success, lower, upper, duration] = [success, lower, upper, duration_secs].map(Cell::from);
        vec![from, to, action, success, lower, upper, duration, reports.into()]
    };
    session.print(&columns, forecasts.into_iter().map(row))?;
    if let Some(path) = &picture {
        let drawn = topology_picture::draw(session, &map, at, model, speed, &object, Overlay::default()).await?;
        files::write(path, drawn)?;
    }
    Ok(ExitCode::SUCCESS)
}

fn show_nodes(session: &Session, topology: &Topology) -> anyhow::Result<ExitCode> {
    let row = |node: &Node| {
        let pose = node.pose.map_or([None; 3], |pose| [pose.x_m, pose.y_m, pose.yaw_rad].map(Some));
        let ([x, y, yaw], dwell) = (pose.map(Cell::maybe), Cell::maybe(node.dwell_secs));
        vec![node.name.as_str().into(), node.id.0.into(), x, y, yaw, dwell]
    };
    session.print(&["node", "id", "x", "y", "yaw_rad", "dwell_secs"], topology.nodes().map(row))
}

fn show_edges(session: &Session, topology: &Topology) -> anyhow::Result<ExitCode> {
    let row = |edge: &Edge| {
        let [from, to, action] = edge_cells(&topology.edge_in_words(edge)?);
        let Extent { length_m, nominal_secs } = edge.extent;
        Ok(vec![from, to, action, edge.id.0.into(), Cell::maybe(nominal_secs), Cell::maybe(length_m)])
    };
    let rows = topology.edges().map(row).collect::<anyhow::Result<Vec<_>>>()?;
    session.print(&["from", "to", "action", "id", "duration_secs", "length_m"], rows)
}

/// The columns from, to and action.
fn edge_cells(EdgeName { from, to, action }: &EdgeName) -> [Cell; 3] {
    [from.as_str(), to.as_str(), action.as_ref().map_or("", StateName::as_str)].map(Cell::from)
}

/// The property by which failures are counted.
#[derive(Clone, Copy, Debug, ValueEnum)]
pub(crate) enum CountedBy {
    /// The reason that the robot gave
    Reason,
}

/// The failures of each reason, the usual one first.
fn count_failures(session: &Session, failures: Vec<EdgeFailure>) -> anyhow::Result<ExitCode> {
    let mut counted: BTreeMap<String, (u64, BTreeSet<String>, i64)> = BTreeMap::new();
    for EdgeFailure { edge, start_nanos, reason, .. } in failures {
        let (count, edges, newest) = counted.entry(reason).or_insert((0, BTreeSet::new(), start_nanos));
        *count += 1;
        edges.insert(edge.to_string());
        *newest = start_nanos.max(*newest);
    }
    let mut counted: Vec<_> = counted.into_iter().collect();
    // Equal counts stay in the order of their reasons.
    counted.sort_by_key(|(_, (count, ..))| Reverse(*count));
    let row = |(reason, (count, edges, newest)): (String, (u64, BTreeSet<String>, i64))| {
        vec![Cell::Text(reason), count.into(), (edges.len() as u64).into(), Cell::Time(newest)]
    };
    session.print(&["reason", "failures", "edges", "newest"], counted.into_iter().map(row))
}

fn show_failures(session: &Session, failures: Vec<EdgeFailure>) -> anyhow::Result<ExitCode> {
    let row = |EdgeFailure { edge, start_nanos, end_nanos, reason }| {
        let [start, end] = [start_nanos, end_nanos].map(|nanos| Cell::time(Some(nanos)));
        vec![Cell::Text(edge.to_string()), start, end, Cell::Text(reason)]
    };
    session.print(&["edge", "start", "end", "reason"], failures.into_iter().map(row))
}
