//! `tidemap grid`: scans of an occupancy grid in, maps of any time out.
//!
//! Invariant: what a file is, its ending says; nothing is guessed from its content.

mod cell_masks;
mod observe;
mod place;
pub(crate) mod predict;
mod scans;
mod sensor;

use std::process::ExitCode;

use clap::Subcommand;
use tidemap_client::maps::Grid;

use super::Session;

#[derive(Debug, Subcommand)]
pub(crate) enum GridCommand {
    /// Sends scans from files, each exactly once
    ///
    /// By ending: .tms is a file of scans (see the README), which has its own times; .pcd and .ply are point clouds, each a
    /// scan, ray-cast from --pose; .bt and .ot (OctoMap) and .yaml or .pgm (Nav2) are maps, whose known cells count as
    /// observed at that time. The same producer and label again continue where they were; scans that differ from what was
    /// sent are refused.
    Observe(observe::GridObserveArgs),
    /// Writes the map at any time, past or future, to a file
    ///
    /// By ending of --out: .pgm (with a .yaml beside it, for Nav2), .png, .csv or .ply.
    Predict(predict::GridPredictArgs),
}

pub(crate) async fn run(session: &Session, command: GridCommand) -> anyhow::Result<ExitCode> {
    match command {
        GridCommand::Observe(args) => observe::run(session, args).await,
        GridCommand::Predict(args) => predict::run(session, args).await,
    }
}

/// The grid of a map, and the observations of single cells that it holds.
async fn grid_of(session: &Session, map: &str) -> anyhow::Result<(Grid, u64)> {
    let map = session.client.map(map).await?;
    let cells = map.grid_summary.map_or(0, |summary| summary.cell_observations);
    match map.grid {
        Some(grid) => Ok((grid, cells)),
        None => anyhow::bail!(
            "map {:?} has no grid: a map gets one when it is created, as with --grid resolution=0.1",
            map.name
        ),
    }
}
