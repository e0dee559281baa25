//! `tidemap no-go`.
//!
//! Invariant: a change is durable when the command ends; areas are listed by name.

use std::process::ExitCode;

use clap::Subcommand;
use tidemap_client::maps::{NoGoArea, StateName};
use tidemap_formats::table::Cell;

use super::{Session, point::Point};
use crate::progress::status_line;

#[derive(Debug, Subcommand)]
pub(crate) enum NoGoCommand {
    /// Adds an area, a polygon; replaces the area of that name
    ///
    /// An edge of the topological map is closed where the straight line between its nodes touches an area. Tours drive
    /// around areas.
    Add {
        /// Name of the map
        map: String,
        /// Name of the area
        area: String,
        /// Corners in their order, at least three, metres
        #[arg(value_name = "X,Y:X,Y:X,Y…", allow_hyphen_values = true, value_parser = corners)]
        corners: Corners,
    },
    /// Lists the areas of a map
    List {
        /// Name of the map
        map: String,
    },
    /// Removes an area
    Remove {
        /// Name of the map
        map: String,
        /// Name of the area
        area: String,
    },
}

/// The corners of an area, metres.
#[derive(Clone, Debug)]
pub(crate) struct Corners(Vec<[f64; 2]>);

fn corners(text: &str) -> Result<Corners, String> {
    let corners: Vec<[f64; 2]> =
        text.split(':').map(|corner| corner.parse().map(|Point(at)| at)).collect::<Result<_, String>>()?;
    if corners.len() < 3 { Err("an area has at least three corners".to_owned()) } else { Ok(Corners(corners)) }
}

pub(crate) async fn run(session: &Session, command: NoGoCommand) -> anyhow::Result<ExitCode> {
    let areas = match command {
        NoGoCommand::Add { map, area, corners } => {
            let area = NoGoArea { name: StateName::new(&area)?, corners_m: corners.0 };
            session.client.set_no_go(&map, &area).await?;
            vec![area]
        }
        NoGoCommand::List { map } => session.client.no_go(&map).await?,
        NoGoCommand::Remove { map, area } => {
            session.client.delete_no_go(&map, &area).await?;
            status_line(&format!("area {area:?} is removed"));
            return Ok(ExitCode::SUCCESS);
        }
    };
    let row = |NoGoArea { name, corners_m }| {
        let corners = corners_m.iter().map(|[x, y]| format!("{x},{y}"));
        vec![name.as_str().into(), Cell::texts(corners)]
    };
    session.print(&["area", "corners"], areas.into_iter().map(row))
}
