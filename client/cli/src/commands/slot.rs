//! `tidemap slot`.
//!
//! Invariant: one row, the location to observe.

use std::process::ExitCode;

use clap::Args;
use tidemap_client::{
    exploration::{SlotChoice, SlotQuery, SlotStrategy},
    queries::ModelSelector,
};

use super::{Session, times};
use tidemap_formats::table::Cell;

#[derive(Debug, Args)]
pub(crate) struct SlotArgs {
    /// Name of the map
    map: String,
    /// Middle of the slot
    #[arg(long, value_name = "TIME", value_parser = times::time)]
    at: i64,
    /// Location of the day's plan: kept unless something unexpected was observed elsewhere lately
    #[arg(long, value_name = "LOCATION", conflicts_with = "monte_carlo")]
    planned: Option<String>,
    /// Chooses at random, in proportion to the expected information, instead of the most uncertain location
    #[arg(long)]
    monte_carlo: bool,
    /// Locations to choose from [default: all; where the map has none, every state is one]
    #[arg(long = "location", value_name = "LOCATION", num_args = 1..)]
    locations: Vec<String>,
    /// Model: those of predict [default: auto+persistence, with --planned auto]
    #[arg(long, value_name = "KIND")]
    model: Option<ModelSelector>,
    /// Seed of the random numbers
    #[arg(long, value_name = "N", default_value_t = 0)]
    seed: u64,
}

pub(crate) async fn run(session: &Session, args: SlotArgs) -> anyhow::Result<ExitCode> {
    let strategy = match (args.planned, args.monte_carlo) {
        (Some(planned), _) => SlotStrategy::Novelty { planned },
        (None, true) => SlotStrategy::MonteCarlo,
        (None, false) => SlotStrategy::Online,
    };
    let (map, at, locations, model, seed) = (args.map, args.at, args.locations, args.model, args.seed);
    let query = SlotQuery { map, time_nanos: at, strategy, locations, model, seed };
    let SlotChoice { location, information_bits, surprise_bits } = session.client.plan_slot(query).await?;
    session.print(
        &["location", "information_bits", "surprise_bits"],
        [vec![Cell::Text(location), information_bits.into(), Cell::maybe(surprise_bits)]],
    )
}
