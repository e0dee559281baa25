//! `tidemap grid`: scans of an occupancy grid in, maps of any time out.
//!
//! Invariant: the ending of a file's name determines its format; the content is never guessed.

pub(super) mod cell_masks;
mod changed;
mod compare;
pub(super) mod ever_occupied;
mod file_times;
mod observe;
pub(super) mod place;
pub(crate) mod predict;
mod scans;
pub(super) mod sensor;

use std::process::ExitCode;

use clap::Subcommand;
use tidemap_client::maps::{GridSpec, Map};

use super::Session;

#[derive(Debug, Subcommand)]
pub(crate) enum GridCommand {
    /// Sends scans from files, each exactly once
    ///
    /// The ending gives the format: .tms is a file of scans with their own times (see the guide); .pcd and .ply are
    /// point clouds, each one scan, ray-cast from --pose; .bt and .ot (OctoMap) and .yaml or .pgm (Nav2) are maps,
    /// whose known cells count as observed at that time. The same producer and label continue where they stopped; scans
    /// that differ from those sent before are refused.
    Observe(observe::GridObserveArgs),
    /// Writes the map at any time, past or future, to a file
    ///
    /// The ending of --out gives the format: .pgm (with a .yaml beside it, for Nav2), .png, .csv, .ply or .bt
    /// (OctoMap).
    Predict(predict::GridPredictArgs),
    /// Lists the cells whose routine seems to have changed: since when, their mean and their newest value
    ///
    /// A cell is listed while its change alarm is active: its predictions have been worse than before, day after day.
    /// See model show for one cell.
    Changed(changed::GridChangedArgs),
    /// Compares the map at a time with a map of a ROS map server, cell by cell
    ///
    /// Counts the occupied cells of each that are occupied in the other, within a cell: cells of different sizes are
    /// compared in metres. A cell of the map is occupied from a probability of 0.65 on, and free up to 0.25. A file
    /// that is turned (the yaw of its origin is not 0) is refused.
    Compare(compare::GridCompareArgs),
}

pub(crate) async fn run(session: &Session, command: GridCommand) -> anyhow::Result<ExitCode> {
    match command {
        GridCommand::Observe(args) => observe::run(session, args).await,
        GridCommand::Predict(args) => predict::run(session, args).await,
        GridCommand::Changed(args) => changed::run(session, args).await,
        GridCommand::Compare(args) => compare::run(session, args).await,
    }
}

/// The grid of a map, and the number of its cell observations.
async fn grid_of(session: &Session, map: &str) -> anyhow::Result<(GridSpec, u64)> {
    grid_of_map(session.client.map(map).await?)
}

fn grid_of_map(map: Map) -> anyhow::Result<(GridSpec, u64)> {
    let cells = map.grid_summary.map_or(0, |summary| summary.cell_observations);
    match map.grid {
        Some(grid) => Ok((grid, cells)),
        None => {
            anyhow::bail!("map {:?} has no grid: create a map with one, for example --grid resolution=0.1", map.name)
        }
    }
}
