//! `tidemap slot`.
//!
//! Invariant: one row, the location to observe; empty if the robot should rest.

use std::process::ExitCode;

use clap::Args;
use tidemap_client::{
    exploration::{Budget, SlotAllowance, SlotChoice, SlotQuery, SlotStrategy},
    queries::ModelSelector,
};

use super::{Session, measure::MeasureArg, times, usage};
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
    /// Chooses at random, in proportion to the expected information, instead of the location where an observation is
    /// worth most
    #[arg(long)]
    monte_carlo: bool,
    /// Chooses the location where most states are expected to be predicted wrongly
    #[arg(long, conflicts_with_all = ["planned", "monte_carlo"])]
    online_error: bool,
    /// Visits a day: rests if later slots of the day are predicted to be worth more
    #[arg(long, value_name = "N", conflicts_with_all = ["ratio", "planned", "monte_carlo"])]
    explore: Option<u32>,
    /// Visits a day as a share of the slots of a day, above 0 and at most 1; instead of --explore
    #[arg(long, value_name = "E", conflicts_with_all = ["planned", "monte_carlo"])]
    ratio: Option<f64>,
    /// Visits since midnight, with --explore or --ratio
    #[arg(long, value_name = "N", default_value_t = 0)]
    spent: u32,
    /// Length of a slot, with --explore, --ratio or --exactly-one
    #[arg(long, value_name = "DURATION", value_parser = times::duration, default_value = "15m")]
    slot: i64,
    /// Locations to choose from [default: all; where the map has none, every state is one]
    #[arg(long = "location", value_name = "LOCATION", num_args = 1..)]
    locations: Vec<String>,
    /// Model: those of predict [default: auto; with --planned ensemble]
    #[arg(long, value_name = "KIND", conflicts_with = "exactly_one")]
    model: Option<ModelSelector>,
    /// The locations hold one person or object, which is at exactly one of them: a model of all of them predicts
    #[arg(long)]
    exactly_one: bool,
    /// Measure of the value of an observation
    #[arg(long, value_name = "MEASURE", default_value = "ral", conflicts_with = "exactly_one")]
    information: MeasureArg,
    /// Seed of the random numbers
    #[arg(long, value_name = "N", default_value_t = 0)]
    seed: u64,
}

pub(crate) async fn run(session: &Session, args: SlotArgs) -> anyhow::Result<ExitCode> {
    let strategy = match (args.planned, args.monte_carlo, args.online_error) {
        (Some(planned), ..) => SlotStrategy::Novelty { planned },
        (None, true, _) => SlotStrategy::MonteCarlo,
        (None, false, true) => SlotStrategy::OnlineError,
        (None, false, false) => SlotStrategy::Online,
    };
    let budget = match (args.explore, args.ratio) {
        (Some(visits), _) => Some(Budget::Visits(visits as usize)),
        (None, Some(ratio)) if ratio > 0.0 && ratio <= 1.0 => Some(Budget::Ratio(ratio)),
        (None, Some(ratio)) => return Err(usage(format!("--ratio {ratio}: it has to be above 0 and at most 1"))),
        (None, None) => None,
    };
    if budget.is_none() && args.spent > 0 {
        return Err(usage("--spent needs --explore or --ratio: the visits that a day has".to_owned()));
    }
    let allowance = budget.map(|budget| SlotAllowance { budget, spent: args.spent as usize });
    let (map, at, locations, model, seed) = (args.map, args.at, args.locations, args.model, args.seed);
    let exactly_one = args.exactly_one;
    let slot_nanos = (exactly_one || allowance.is_some()).then_some(args.slot);
    let query = SlotQuery {
        map,
        time_nanos: at,
        strategy,
        locations,
        model,
        information: args.information.into(),
        exactly_one,
        seed,
        slot_nanos,
        allowance,
    };
    let SlotChoice { location, information_bits, surprise_bits } = session.client.plan_slot(query).await?;
    session.print(
        &["location", "information_bits", "surprise_bits"],
        [vec![location.map_or(Cell::Empty, Cell::Text), information_bits.into(), Cell::maybe(surprise_bits)]],
    )
}
