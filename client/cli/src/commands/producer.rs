//! `tidemap producer`.
//!
//! Invariant: a row per producer and label; nothing changes.

use std::process::ExitCode;

use clap::Subcommand;
use tidemap_client::updates::KnownProducer;
use tidemap_formats::table::Cell;

use super::Session;

#[derive(Debug, Subcommand)]
pub(crate) enum ProducerCommand {
    /// Lists those who have sent observations to a map, with their last
    List {
        /// Name of the map
        map: String,
    },
}

pub(crate) async fn run(session: &Session, command: &ProducerCommand) -> anyhow::Result<ExitCode> {
    let ProducerCommand::List { map } = command;
    let producers = session.client.producers(map).await?;
    let cells = |known: KnownProducer| {
        vec![
            Cell::Text(known.producer),
            Cell::Text(known.label),
            known.durable_sequence.into(),
            if known.is_connected { "yes" } else { "no" }.into(),
            Cell::time(known.received_nanos),
        ]
    };
    session.print(&["producer", "label", "observations", "connected", "received"], producers.into_iter().map(cells))
}
