//! `tidemap landmark`.
//!
//! Invariant: a file with an error adds nothing; sightings are sent as the rows of `tidemap observe`, each exactly
//! once.

use std::{
    collections::BTreeMap,
    path::{Path, PathBuf},
    process::ExitCode,
};

use clap::{Args, Subcommand};
use tidemap_client::{
    landmarks::{
        FoundNode, ImageFeature, KnownLandmark, Landmark, LandmarkAtTime, LandmarkKind, LandmarkSelection,
        LocaliseQuery, PartOfEdge, PlaceName,
    },
    observe::ProducerOptions,
};
use tidemap_formats::{
    observation_file::{
        Layout, RowItem, RowRules,
        landmarks::{CheckedRow, FeatureColumns, LandmarkColumns},
        sightings::SightingColumns,
    },
    table::Cell,
};

use super::{
    Session, files,
    observe::{self, FileSent, FileWords, SenderArgs, feed, refused::RefusedRows},
    times, usage,
};
use crate::progress::status_line;

/// Landmarks of one request.
const CHUNK: usize = 1_000;

#[derive(Debug, Subcommand)]
pub(crate) enum LandmarkCommand {
    /// Adds the landmarks of a file; one that exists is replaced, and keeps its learned data
    ///
    /// The file has a header and the columns place and name, in any order. Place is a node, or an edge
    /// FROM/TO[/ACTION]. Image features have u_px, v_px and descriptor (hexadecimal digits), those of edges along_m as
    /// well; markers have number,x,y,z,qx,qy,qz,qw.
    Add(AddArgs),
    /// Reports which landmarks were seen: the sightings of a file, each exactly once
    ///
    /// The file has a header and the columns time, place and seen, in any order, and optionally out_of_view, and from_m
    /// and to_m for a part of an edge. seen and out_of_view are names of landmarks, separated by `;`. A sighting counts
    /// for all landmarks of its place: 1 if it was seen, 0 if not, nothing if it was out of view.
    Observe(SightingArgs),
    /// Lists the places with landmarks, or the landmarks of a place with the share of sightings in which each was seen
    List {
        /// Name of the map
        map: String,
        /// The node, or the edge FROM/TO[/ACTION] [default: all places, with their numbers of landmarks]
        #[arg(value_parser = place_of)]
        place: Option<PlaceName>,
        /// Writes the velocity profile of the edge to this file
        #[arg(long, value_name = "FILE", requires = "place")]
        velocity_profile: Option<PathBuf>,
    },
    /// Predicts which landmarks of a place are visible at a time, the most probable first
    Predict(LandmarkPredictArgs),
    /// Finds the node at which a robot is, by the image features that it sees: the best first
    ///
    /// The file has a header and the columns u_px, v_px and descriptor (hexadecimal digits). heading_px is how far the
    /// features are to the right of where the landmarks were.
    Locate(LocateArgs),
    /// Removes landmarks; their learned data stays for one of the same name that is added again
    Remove {
        /// Name of the map
        map: String,
        /// The node, or the edge FROM/TO[/ACTION]
        #[arg(value_parser = place_of)]
        place: PlaceName,
        /// Names of the landmarks
        #[arg(required = true)]
        landmarks: Vec<String>,
    },
    /// Removes landmarks that are hardly ever seen
    Prune {
        /// Name of the map
        map: String,
        /// Removes landmarks that were seen in less than this share of the sightings, above 0, at most 1
        #[arg(long, value_name = "SHARE")]
        below: f64,
        /// Keeps landmarks that were in view in fewer sightings
        #[arg(long, value_name = "N", default_value_t = 10, value_parser = clap::value_parser!(u64).range(1..))]
        min_sightings: u64,
        /// Only landmarks of this node, or edge FROM/TO[/ACTION]
        #[arg(long, value_name = "PLACE", value_parser = place_of)]
        place: Option<PlaceName>,
        /// Shows the landmarks that would be removed, and removes none
        #[arg(long)]
        dry_run: bool,
    },
}

#[derive(Debug, Args)]
pub(crate) struct AddArgs {
    /// Name of the map
    map: String,
    /// File with the landmarks; - is stdin
    file: PathBuf,
    /// Name of the method that computes the descriptors, such as orb or grief-256; a map has descriptors of one kind
    #[arg(long, value_name = "KIND", default_value = "", hide_default_value = true)]
    descriptors: String,
    /// File with the velocity profile of the edge, up to 64 KiB, for a file of landmarks of one edge
    #[arg(long, value_name = "FILE")]
    velocity_profile: Option<PathBuf>,
}

#[derive(Debug, Args)]
pub(crate) struct SightingArgs {
    /// Name of the map
    map: String,
    /// File with the columns time, place and seen; - is stdin
    file: PathBuf,
    /// Writes the refused rows to this new file, to be corrected there and sent
    #[arg(long, value_name = "FILE")]
    refused: Option<PathBuf>,
    #[command(flatten)]
    sender: SenderArgs,
}

#[derive(Debug, Args)]
pub(crate) struct LandmarkPredictArgs {
    /// Name of the map
    map: String,
    /// The node, or the edge FROM/TO[/ACTION]
    #[arg(value_parser = place_of)]
    place: PlaceName,
    /// The time
    #[arg(long, value_name = "TIME", value_parser = times::time)]
    at: i64,
    /// Maximum number [default: all]
    #[arg(long, value_name = "N", value_parser = clap::value_parser!(u32).range(1..))]
    count: Option<u32>,
    /// Part of the edge: where it begins, metres
    #[arg(long, value_name = "M")]
    from_m: Option<f64>,
    /// Part of the edge: where it ends, metres
    #[arg(long, value_name = "M")]
    to_m: Option<f64>,
}

#[derive(Debug, Args)]
pub(crate) struct LocateArgs {
    /// Name of the map
    map: String,
    /// File with the features of an image; - is stdin
    file: PathBuf,
    /// Time of the image
    #[arg(long, value_name = "TIME", value_parser = times::time)]
    at: i64,
    /// Number of landmarks of each node to compare, the most probable ones
    #[arg(long, value_name = "N", default_value_t = 100, value_parser = clap::value_parser!(u32).range(1..))]
    count: u32,
    /// A node at which the robot may be; may be repeated [default: all nodes with image features]
    #[arg(long, value_name = "NODE")]
    node: Vec<String>,
}

/// A place by its name.
fn place_of(text: &str) -> Result<PlaceName, String> {
    PlaceName::parse(text).map_err(|error| format!("{error}: name a node, or an edge as FROM/TO or FROM/TO/ACTION"))
}

pub(crate) async fn run(session: &Session, command: LandmarkCommand) -> anyhow::Result<ExitCode> {
    match command {
        LandmarkCommand::Add(args) => add(session, args).await,
        LandmarkCommand::Observe(args) => send(session, &args).await,
        LandmarkCommand::List { map, place: None, .. } => list_places(session, &map).await,
        LandmarkCommand::List { map, place: Some(place), velocity_profile } => {
            list(session, &map, &place, velocity_profile.as_deref()).await
        }
        LandmarkCommand::Predict(args) => predict(session, args).await,
        LandmarkCommand::Locate(args) => locate(session, args).await,
        LandmarkCommand::Remove { map, place, landmarks } => {
            remove(session, &map, LandmarkSelection::Named(place, landmarks), false).await
        }
        LandmarkCommand::Prune { map, below, min_sightings, place, dry_run } => {
            remove(session, &map, LandmarkSelection::SeldomSeen { place, below, min_sightings }, dry_run).await
        }
    }
}

/// All rows of a file.
///
/// # Errors
/// The file, the line and the fault of the first row that cannot be read.
fn rows<L, Content>(path: &Path) -> anyhow::Result<Vec<Content>>
where
    L: Layout<Item = CheckedRow<Content>>,
    Content: std::fmt::Debug,
{
    let (mut reader, _) = feed::reader::<L>(path, &RowRules::default())?;
    let mut rows = Vec::new();
    while let Some(item) = reader.next_item()? {
        let (line, content) = match item {
            RowItem::Row(CheckedRow { at, content }) => (at.line, content),
            RowItem::Torn { line, text } => (line, Err(format!("the line is cut off: {text}"))),
        };
        let shown = feed::display_name(path);
        rows.push(content.map_err(|wrong| anyhow::anyhow!("{shown}: line {line}: {wrong}"))?);
    }
    Ok(rows)
}

async fn add(session: &Session, args: AddArgs) -> anyhow::Result<ExitCode> {
    let AddArgs { map, file, descriptors, velocity_profile } = args;
    let mut by_place: BTreeMap<PlaceName, Vec<Landmark>> = BTreeMap::new();
    for (place, landmark) in rows::<LandmarkColumns, _>(&file)? {
        by_place.entry(place).or_default().push(landmark);
    }
    if by_place.is_empty() {
        return Err(usage(format!("{}: it has no landmarks", feed::display_name(&file))));
    }
    let profile = velocity_profile.as_deref().map(std::fs::read).transpose()?;
    if profile.is_some() && by_place.len() > 1 {
        return Err(usage(format!("--velocity-profile is of one edge, and the file has {} places", by_place.len())));
    }
    let mut table = Vec::with_capacity(by_place.len());
    for (place, landmarks) in by_place {
        let mut at_place = 0;
        for (number, chunk) in landmarks.chunks(CHUNK).enumerate() {
            let profile = profile.as_deref().filter(|_| number == 0);
            (at_place, _) = session.client.add_landmarks(&map, &place, &descriptors, chunk, profile).await?;
        }
        table.push(vec![Cell::Text(place.to_string()), (landmarks.len() as u64).into(), at_place.into()]);
    }
    session.print(&["place", "sent", "landmarks"], table)
}

async fn send(session: &Session, args: &SightingArgs) -> anyhow::Result<ExitCode> {
    let SightingArgs { map, file, refused, sender } = args;
    let refused = refused.as_deref().map(|target| RefusedRows::new(file, target)).transpose()?;
    let options: ProducerOptions = sender.options(map, &observe::base_name(file))?;
    let feed = feed::open::<SightingColumns>(file, &RowRules::default())?;
    let shown = feed::display_name(file);
    let sent = FileSent { shown: &shown, command: "landmark observe", words: FileWords::default(), refused };
    observe::send(session, options, feed, sent).await
}

async fn list_places(session: &Session, map: &str) -> anyhow::Result<ExitCode> {
    let (places, descriptors) = session.client.landmark_places(map).await?;
    if places.is_empty() {
        status_line(&format!("the map has no landmarks: tidemap landmark add {map} FILE gives it some"));
    } else if !descriptors.is_empty() {
        status_line(&format!("descriptors: {descriptors}"));
    }
    let row = |(place, landmarks): (PlaceName, u32)| vec![Cell::Text(place.to_string()), landmarks.into()];
    session.print(&["place", "landmarks"], places.into_iter().map(row))
}

/// The appearance and place of a landmark: kind, u, v, number and position along the edge.
fn looks(landmark: &Landmark) -> [Cell; 5] {
    let feature = landmark.kind.feature();
    let (kind, number) = match &landmark.kind {
        LandmarkKind::Image(_) => ("image", None),
        LandmarkKind::Marker { number, .. } => ("marker", Some(number.to_string())),
        LandmarkKind::Path { .. } => ("path", None),
    };
    [
        kind.into(),
        Cell::maybe(feature.map(|feature| feature.u_px)),
        Cell::maybe(feature.map(|feature| feature.v_px)),
        number.map_or(Cell::Empty, Cell::Text),
        Cell::maybe(landmark.kind.along_m()),
    ]
}

async fn list(session: &Session, map: &str, place: &PlaceName, profile: Option<&Path>) -> anyhow::Result<ExitCode> {
    let (landmarks, velocity_profile) = session.client.landmarks(map, place, PartOfEdge::WHOLE).await?;
    if let Some(path) = profile {
        files::write(path, velocity_profile)?;
    }
    let row = |KnownLandmark { landmark, seen_share, sightings }| {
        let [kind, u, v, number, along] = looks(&landmark);
        vec![landmark.name.as_str().into(), kind, u, v, number, along, seen_share.into(), sightings.into()]
    };
    let columns = ["landmark", "kind", "u_px", "v_px", "number", "along_m", "seen_share", "sightings"];
    session.print(&columns, landmarks.into_iter().map(row))
}

async fn predict(session: &Session, args: LandmarkPredictArgs) -> anyhow::Result<ExitCode> {
    let LandmarkPredictArgs { map, place, at, count, from_m, to_m } = args;
    let whole = PartOfEdge::WHOLE;
    let part = PartOfEdge { from_m: from_m.unwrap_or(whole.from_m), to_m: to_m.unwrap_or(whole.to_m) };
    part.check(&place).map_err(|error| usage(error.to_string()))?;
    let reply = session.client.predict_landmarks(&map, (&place, part), at, count.unwrap_or_default());
    let (landmarks, known) = reply.await?;
    if known == 0 {
        status_line(&format!("{place} has no landmarks there: tidemap landmark add {map} FILE gives it some"));
    }
    let row = |LandmarkAtTime { landmark, probability, sightings }| {
        let [kind, u, v, number, along] = looks(&landmark);
        vec![landmark.name.as_str().into(), kind, u, v, number, along, probability.into(), sightings.into()]
    };
    let columns = ["landmark", "kind", "u_px", "v_px", "number", "along_m", "probability", "sightings"];
    session.print(&columns, landmarks.into_iter().map(row))
}

async fn locate(session: &Session, args: LocateArgs) -> anyhow::Result<ExitCode> {
    let LocateArgs { map, file, at, count, node } = args;
    let features: Vec<ImageFeature> = rows::<FeatureColumns, _>(&file)?;
    let query = LocaliseQuery { map, time_nanos: at, features, landmarks_per_node: count, nodes: node };
    let found = session.client.localise(query).await?;
    let row = |FoundNode { node, landmarks, matches, votes, heading_px, probability }| {
        let counts = [landmarks, matches, votes].map(Cell::from);
        let cells = [Cell::Text(node)].into_iter().chain(counts);
        cells.chain([Cell::maybe(heading_px), probability.into()]).collect()
    };
    session.print(&["node", "landmarks", "matches", "votes", "heading_px", "probability"], found.into_iter().map(row))
}

async fn remove(
    session: &Session,
    map: &str,
    selection: LandmarkSelection,
    is_dry_run: bool,
) -> anyhow::Result<ExitCode> {
    let removed = session.client.remove_landmarks(map, selection, is_dry_run).await?;
    if is_dry_run {
        status_line("nothing is removed: these landmarks would be removed");
    }
    let of_place = |(place, names): (PlaceName, Vec<String>)| {
        names.into_iter().map(move |name| vec![Cell::Text(place.to_string()), Cell::Text(name)])
    };
    session.print(&["place", "landmark"], removed.into_iter().flat_map(of_place))
}
