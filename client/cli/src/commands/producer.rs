//! `tidemap producer`.
//!
//! Invariant: a row per producer and label. The observations of a forgotten producer stay.

use std::process::ExitCode;

use clap::Subcommand;
use tidemap_client::updates::KnownProducer;
use tidemap_formats::table::Cell;

use super::Session;

#[derive(Debug, Subcommand)]
pub(crate) enum ProducerCommand {
    /// Lists the producers that have sent observations to a map, with their last
    List {
        /// Name of the map
        map: String,
    },
    /// Frees the places of a producer that will not come back; its observations stay
    Forget {
        /// Name of the map
        map: String,
        /// Name of the producer
        producer: String,
        /// Only its sequence with this label
        #[arg(long)]
        label: Option<String>,
    },
}

pub(crate) async fn run(session: &Session, command: &ProducerCommand) -> anyhow::Result<ExitCode> {
    match command {
        ProducerCommand::List { map } => list(session, map).await,
        ProducerCommand::Forget { map, producer, label } => {
            let forgotten = session.client.forget_producer(map, producer, label.as_deref()).await?;
            session.print(
                &["producer", "forgotten"],
                std::iter::once(vec![Cell::Text(producer.clone()), forgotten.into()]),
            )
        }
    }
}

async fn list(session: &Session, map: &str) -> anyhow::Result<ExitCode> {
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
    session.print(
        &["producer", "label", "observations", "connected", "received"],
        producers.into_iter().filter(|known| !known.is_forgotten).map(cells),
    )
}
