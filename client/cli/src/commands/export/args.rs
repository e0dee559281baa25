//! The arguments of `tidemap export`.
//!
//! Invariant: an option that does not fit the kind of file is refused, never ignored.

use std::path::PathBuf;

use clap::{Args, ValueEnum};
use tidemap_client::queries::ModelSelector;

use super::{
    super::{
        UsageError,
        grid::place::{AxisRange, Rectangle},
        times::RequestedTimesArgs,
    },
    ExportKind,
    frames::FrameOptions,
};

/// Confidence of the intervals of states.
const INTERVAL: f64 = 0.9;

#[derive(Debug, Args)]
pub(crate) struct ExportArgs {
    /// Name of the map
    pub(super) map: String,
    /// File to write: .mcap, .yaml (with a .pgm beside it) or .geojson
    pub(super) path: PathBuf,
    #[command(flatten)]
    pub(super) times: RequestedTimesArgs,
    /// With .mcap: contents to write [default: all that the map has]
    #[arg(long, value_name = "CONTENT,…", value_delimiter = ',')]
    pub(super) content: Vec<Content>,
    /// With .mcap: name or pattern of states to write, such as 'door-*'; may be repeated [default: all]
    #[arg(long = "state", value_name = "STATE")]
    pub(super) states: Vec<String>,
    /// With .mcap: confidence of the interval of each state, 0 (no interval) or more, and below 1 [default: 0.9]
    #[arg(long, value_name = "P")]
    pub(super) interval: Option<f64>,
    /// With .yaml: writes a mask for a costmap filter of Nav2 instead of the map
    #[arg(long, value_name = "MASK")]
    pub(super) mask: Option<Mask>,
    /// With --mask keepout: a cell is forbidden from this probability on that it is occupied [default: 0.65]
    #[arg(long, value_name = "P", value_parser = share)]
    pub(super) occupied: Option<f64>,
    /// With --mask speed: the lowest limit, as a share of the greatest speed [default: 0.2]
    #[arg(long, value_name = "SHARE", value_parser = share)]
    pub(super) slowest: Option<f64>,
    /// Model, as in `predict` [default: auto]
    #[arg(long, value_name = "KIND")]
    pub(super) model: Option<ModelSelector>,
    /// Only cells between these heights, metres [default: 0.1:1.8, if the grid has cells there]
    #[arg(long, value_name = "MIN:MAX", allow_hyphen_values = true)]
    pub(super) z: Option<AxisRange>,
    /// Only cells in this rectangle, metres
    #[arg(long, value_name = "X0:X1,Y0:Y1", allow_hyphen_values = true)]
    pub(super) region: Option<Rectangle>,
    /// Speed on edges without data, metres per second [default: 0.5]
    #[arg(long, value_name = "M/S")]
    pub(super) speed: Option<f64>,
    /// Time to recover from a failed attempt to pass an edge, seconds
    #[arg(long, value_name = "SECONDS", default_value_t = 60.0, value_parser = recovery)]
    pub(super) recovery: f64,
}

/// The contents that a recording may have.
#[derive(Clone, Copy, Debug, PartialEq, Eq, ValueEnum)]
pub(super) enum Content {
    /// The grid for ROS 2: nav_msgs/OccupancyGrid on /map
    Map,
    /// The grid for Foxglove: foxglove.Grid on /grid
    Grid,
    /// The topological map: foxglove.GeoJSON on /topology
    Topology,
    /// Each state on /states/NAME, as JSON
    States,
}

/// The masks of Nav2's costmap filters.
#[derive(Clone, Copy, Debug, PartialEq, Eq, ValueEnum)]
pub(super) enum Mask {
    /// Places where a robot must not go: no-go areas, and cells that are probably occupied
    Keepout,
    /// Speed limits: the more probable it is that a cell is occupied, the lower
    Speed,
}

fn share(text: &str) -> Result<f64, String> {
    let right = || format!("{text:?}: use a number of at least 0.01, at most 1");
    text.parse::<f64>().ok().filter(|share| (0.01..=1.0).contains(share)).ok_or_else(right)
}

fn recovery(text: &str) -> Result<f64, String> {
    let right = || format!("{text:?}: use a number of seconds from 0 to 1e9");
    text.parse::<f64>().ok().filter(|seconds| (0.0..=1e9).contains(seconds)).ok_or_else(right)
}

impl ExportArgs {
    /// Refuses options that do not go with the kind of file.
    pub(super) fn check(&self, kind: ExportKind) -> Result<(), UsageError> {
        let needs = |is_given: bool, option: &str, with: &str| match is_given {
            true => Err(UsageError(format!("{option} goes with {with} only"))),
            false => Ok(()),
        };
        if kind != ExportKind::Recording {
            needs(!self.content.is_empty(), "--content", "a .mcap file")?;
            needs(!self.states.is_empty(), "--state", "a .mcap file")?;
            needs(self.interval.is_some(), "--interval", "a .mcap file")?;
        }
        if kind != ExportKind::Image {
            needs(self.mask.is_some(), "--mask", "a .yaml file")?;
        }
        if kind == ExportKind::Graph {
            needs(self.z.is_some(), "--z", "a .mcap or .yaml file")?;
            needs(self.region.is_some(), "--region", "a .mcap or .yaml file")?;
        }
        needs(self.occupied.is_some() && self.mask != Some(Mask::Keepout), "--occupied", "--mask keepout")?;
        needs(self.slowest.is_some() && self.mask != Some(Mask::Speed), "--slowest", "--mask speed")?;
        needs(!self.states.is_empty() && !self.wants(Content::States), "--state", "--content states")
    }

    /// The options with which the map is requested.
    pub(super) fn options(&self) -> FrameOptions {
        FrameOptions {
            map: self.map.clone(),
            model: self.model.unwrap_or_default(),
            region: self.region,
            z: self.z,
            speed_m_per_s: self.speed,
            recovery_secs: self.recovery,
            interval: self.interval.unwrap_or(INTERVAL),
        }
    }

    /// Whether a recording is to have this, if the map has it.
    pub(super) fn wants(&self, content: Content) -> bool {
        self.content.is_empty() || self.content.contains(&content)
    }

    /// Whether the command line names this content.
    pub(super) fn names(&self, content: Content) -> bool {
        self.content.contains(&content)
    }
}
