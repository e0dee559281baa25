//! `tidemap day`.
//!
//! Invariant: a row per slot of the local day, in order; an empty location is a slot to rest.

use std::process::ExitCode;

use clap::{Args, ValueEnum};
use tidemap::{
    exploration::{Budget, DayQuery, DaySlot, Strategy},
    queries::ModelSelector,
};

use super::{Misused, Session, times};
use crate::output::{Cell, Sheet};

#[derive(Debug, Args)]
pub struct DayArgs {
    /// Name of the map
    map: String,
    /// The local date, as 2016-03-21
    #[arg(long, value_name = "YYYY-MM-DD")]
    date: String,
    /// Length of a slot
    #[arg(long, value_name = "DURATION", value_parser = times::duration, default_value = "15m")]
    slot: i64,
    /// So many slots to explore [default: a quarter of them]
    #[arg(long, value_name = "N", conflicts_with = "ratio")]
    explore: Option<u32>,
    /// Share of the slots to explore, above 0 and at most 1
    #[arg(long, value_name = "E")]
    ratio: Option<f64>,
    /// How slots and locations are chosen
    #[arg(long, value_name = "STRATEGY", default_value = "monte-carlo")]
    strategy: StrategyArg,
    /// Seed of what is random
    #[arg(long, value_name = "N", default_value_t = 0)]
    seed: u64,
    /// Locations to choose from [default: all; where the map has none, every state is one]
    #[arg(long = "location", value_name = "LOCATION", num_args = 1..)]
    locations: Vec<String>,
    /// Model: those of predict, each optionally with +persistence
    #[arg(long, value_name = "KIND", default_value = "auto")]
    model: ModelSelector,
    /// Between exploring (1) and doing what a task profits from (0)
    #[arg(long, value_name = "W", requires = "task_states")]
    exploration_weight: Option<f64>,
    /// States that the task profits from, one per location and in their order
    #[arg(long = "task-state", value_name = "STATE", num_args = 1.., requires = "exploration_weight")]
    task_states: Vec<String>,
}

#[derive(Clone, Copy, Debug, ValueEnum)]
enum StrategyArg {
    /// At random, in proportion to the information expected
    MonteCarlo,
    /// The slots and locations with the most information
    Greedy,
    /// All locations in turn
    RoundRobin,
    /// All locations alike, at random
    Random,
}

const COLUMNS: [&str; 4] = ["slot", "start", "location", "information_bits"];

pub async fn run(session: &Session, args: DayArgs) -> anyhow::Result<ExitCode> {
    let budget = match (args.explore, args.ratio) {
        (Some(slots), _) => Budget::Slots(slots),
        (None, Some(ratio)) if ratio > 0.0 && ratio <= 1.0 => Budget::Ratio(ratio),
        (None, Some(ratio)) => return Err(Misused(format!("--ratio {ratio}: it is above 0 and at most 1")).into()),
        (None, None) => Budget::Usual,
    };
    let query = DayQuery {
        map: args.map,
        date: args.date,
        slot_nanos: Some(args.slot),
        budget,
        strategy: match args.strategy {
            StrategyArg::MonteCarlo => Strategy::MonteCarlo,
            StrategyArg::Greedy => Strategy::Greedy,
            StrategyArg::RoundRobin => Strategy::RoundRobin,
            StrategyArg::Random => Strategy::Random,
        },
        seed: args.seed,
        locations: args.locations,
        model: args.model,
        exploration_weight: args.exploration_weight,
        task_states: args.task_states,
    };
    let slots = session.client.plan_day(query).await?;
    let mut sheet = Sheet::stdout(session.format, &COLUMNS);
    for (slot, DaySlot { start_nanos, location, information_bits }) in (0_u64..).zip(slots) {
        let location = location.map_or(Cell::Empty, Cell::Text);
        sheet.row(vec![Cell::Count(slot), Cell::Secs(start_nanos), location, information_bits.into()])?;
    }
    sheet.finish()?;
    Ok(ExitCode::SUCCESS)
}
