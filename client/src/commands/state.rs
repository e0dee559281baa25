//! `tidemap state`.
//!
//! Invariant: states come in the order in which they were first seen, page by page.

use std::process::ExitCode;

use clap::Subcommand;

use super::Session;
use crate::output::{Cell, Sheet};

#[derive(Debug, Subcommand)]
pub enum StateCommand {
    /// Lists the states of a map, in the order in which they were first seen
    List {
        /// Name of the map
        map: String,
    },
}

pub async fn run(session: &Session, command: StateCommand) -> anyhow::Result<ExitCode> {
    let StateCommand::List { map } = command;
    let mut page = session.client.states(&map, "").await?;
    let mut sheet = Sheet::stdout(session.format, &["state", "kind", "observations", "order", "last_time"]);
    loop {
        let (states, next) = page;
        for state in states {
            sheet.row(vec![
                Cell::Text(state.name),
                state.kind.name().into(),
                state.observations.into(),
                state.order.into(),
                Cell::time(state.last_nanos),
            ])?;
        }
        let Some(token) = next else { break };
        page = session.client.states(&map, &token).await?;
    }
    sheet.finish()?;
    Ok(ExitCode::SUCCESS)
}
