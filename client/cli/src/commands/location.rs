//! `tidemap location`.
//!
//! Invariant: a change is durable when the command ends; locations are listed by name.

use std::process::ExitCode;

use clap::Subcommand;
use tidemap_client::maps::{NamedLocation, StateName};

use super::{Session, point::Point};
use crate::progress::status_line;
use tidemap_formats::table::Cell;

#[derive(Debug, Subcommand)]
pub(crate) enum LocationCommand {
    /// Sets a location: states that are observed together; replaces a location of that name
    Set {
        /// Name of the map
        map: String,
        /// Name of the location
        location: String,
        /// Names of its states
        #[arg(required = true, value_name = "STATE")]
        states: Vec<String>,
        /// Position from which the robot observes them, metres
        #[arg(long, value_name = "X,Y", allow_hyphen_values = true)]
        position: Option<Point>,
    },
    /// Lists the locations of a map
    List {
        /// Name of the map
        map: String,
    },
    /// Deletes a location; its states stay
    Delete {
        /// Name of the map
        map: String,
        /// Name of the location
        location: String,
    },
}

const COLUMNS: [&str; 4] = ["location", "x", "y", "states"];

pub(crate) async fn run(session: &Session, command: LocationCommand) -> anyhow::Result<ExitCode> {
    let locations = match command {
        LocationCommand::Set { map, location, states, position } => {
            let position_m = position.map(|Point(at)| at);
            let location = NamedLocation { name: StateName::new(&location)?, members: states, position_m };
            vec![session.client.set_location(&map, location).await?]
        }
        LocationCommand::List { map } => session.client.locations(&map).await?,
        LocationCommand::Delete { map, location } => {
            session.client.delete_location(&map, &location).await?;
            status_line(&format!("location {location:?} is deleted; its states stay"));
            return Ok(ExitCode::SUCCESS);
        }
    };
    let row = |NamedLocation { name, members, position_m }| {
        let [x, y] = position_m.map_or([None; 2], |at| at.map(Some));
        vec![name.as_str().into(), Cell::maybe(x), Cell::maybe(y), Cell::texts(members)]
    };
    session.print(&COLUMNS, locations.into_iter().map(row))
}
