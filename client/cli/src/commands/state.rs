//! `tidemap state`.
//!
//! Invariant: states are listed in the order of their first observation, page by page; an added state is durable.

use std::process::ExitCode;

use clap::Subcommand;
use tidemap_client::maps::{State, StateKind};

use super::{Session, usage};
use tidemap_formats::table::Cell;

#[derive(Debug, Subcommand)]
pub(crate) enum StateCommand {
    /// Lists the states of a map, in the order of their first observation
    List {
        /// Name of the map
        map: String,
    },
    /// Adds a state before its first observation, to set its kind
    Add {
        /// Name of the map
        map: String,
        /// Name of the state
        state: String,
        /// Kind of its values: probability (0 to 1), continuous (any number), count (0, 1, 2, …), vector, or angle (radians)
        #[arg(long, value_name = "KIND", default_value = "probability")]
        kind: StateKind,
        /// Number of coordinates of a vector, 2 or 3
        #[arg(long, value_name = "N", required_if_eq("kind", "vector"), value_parser = clap::value_parser!(u32).range(2..=3))]
        dimensions: Option<u32>,
    },
}

const COLUMNS: [&str; 6] = ["state", "kind", "observations", "order", "last_time", "dimensions"];

fn cells(state: State) -> Vec<Cell> {
    vec![
        Cell::Text(state.name),
        state.kind.name().into(),
        state.observations.into(),
        state.order.into(),
        Cell::time(state.last_nanos),
        Cell::maybe(Some(u64::from(state.dimensions)).filter(|&dimensions| dimensions > 0)),
    ]
}

pub(crate) async fn run(session: &Session, command: StateCommand) -> anyhow::Result<ExitCode> {
    let map = match command {
        StateCommand::List { map } => map,
        StateCommand::Add { map, state, kind, dimensions } => {
            let added = match (kind, dimensions) {
                (StateKind::Vector, Some(dimensions)) => session.client.add_vector(&map, &state, dimensions).await?,
                (_, Some(_)) => {
                    return Err(usage(format!("--dimensions goes with --kind vector, not {}", kind.name())));
                }
                (_, None) => session.client.add_state(&map, &state, kind).await?,
            };
            return session.print(&COLUMNS, [cells(added)]);
        }
    };
    let mut page = session.client.states(&map, "").await?;
    let mut table = session.table(&COLUMNS);
    loop {
        let (states, next) = page;
        for state in states {
            table.row(cells(state))?;
        }
        let Some(token) = next else { break };
        page = session.client.states(&map, &token).await?;
    }
    table.finish()?;
    Ok(ExitCode::SUCCESS)
}
