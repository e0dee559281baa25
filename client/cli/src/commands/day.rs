//! `tidemap day`.
//!
//! Invariant: one row per slot of the local day, in order; a free slot has an empty location.

use std::process::ExitCode;

use anyhow::Context as _;
use clap::{Args, ValueEnum};
use tidemap_client::{
    exploration::{Budget, DayQuery, DaySlot, DayTour, Sensor, Strategy, Viewpoint},
    maps::Map,
    queries::ModelSelector,
    tasks::{KeptWork, PlannedTasks, TaskQuery, UnservedReason, UnservedTask},
};

use super::{Session, files::DrawingArg, measure::MeasureArg, times, usage};
use crate::progress::status_line;
use tidemap_formats::{
    drawing::{Curve, CurvePlot},
    table::Cell,
};

#[derive(Debug, Args)]
pub(crate) struct DayArgs {
    /// Name of the map
    map: String,
    /// Local date, such as 2016-03-21
    #[arg(long, value_name = "YYYY-MM-DD")]
    date: String,
    /// Length of a slot
    #[arg(long, value_name = "DURATION", value_parser = times::duration, default_value = "15m")]
    slot: i64,
    /// Number of slots to explore [default: a quarter of all]
    #[arg(long, value_name = "N", conflicts_with = "ratio")]
    explore: Option<u32>,
    /// Share of the slots to explore, above 0 and at most 1
    #[arg(long, value_name = "E")]
    ratio: Option<f64>,
    /// Strategy that chooses slots and locations
    #[arg(long, value_name = "STRATEGY", default_value = "monte-carlo")]
    strategy: StrategyArg,
    /// Seed of the random numbers
    #[arg(long, value_name = "N", default_value_t = 0)]
    seed: u64,
    /// Locations to choose from [default: all; where the map has none, every state is one]
    #[arg(long = "location", value_name = "LOCATION", num_args = 1..)]
    locations: Vec<String>,
    /// Model: those of predict, each optionally with +persistence or +memory
    #[arg(long, value_name = "KIND", default_value = "auto")]
    model: ModelSelector,
    /// The locations hold one person or object, which is at exactly one of them: a model of all of them predicts
    #[arg(long, conflicts_with_all = ["model", "views", "tours", "task_states"])]
    exactly_one: bool,
    /// Measure of the value of an observation
    #[arg(long, value_name = "MEASURE", default_value = "ral", conflicts_with_all = ["exactly_one", "views", "tours"])]
    information: MeasureArg,
    /// Explores the grid from viewpoints with this spacing, in metres; a location is then X,Y
    #[arg(long, value_name = "M", value_parser = spacing, conflicts_with = "locations")]
    views: Option<f64>,
    /// Values each slot by the information of a whole tour with this number of goals; the location is then `tour`
    #[arg(
        long,
        value_name = "GOALS",
        value_parser = clap::value_parser!(u32).range(1..=100),
        conflicts_with_all = ["locations", "views"]
    )]
    tours: Option<u32>,
    /// Weight between exploration (1) and benefit to a task (0)
    #[arg(long, value_name = "W", requires = "task_states")]
    exploration_weight: Option<f64>,
    /// States that the task depends on, one per location and in their order
    #[arg(long = "task-state", value_name = "STATE", num_args = 1.., requires = "exploration_weight")]
    task_states: Vec<String>,
    /// Plans the tasks of the map first; slots that are left over explore the locations
    #[arg(long)]
    tasks: bool,
    /// Node where the robot is at first [default: that nearest to the charger, or of a task of the kind charge]
    #[arg(long, value_name = "NODE", requires = "tasks")]
    start_node: Option<String>,
    /// Time from which the robot is ready [default: the beginning of the day]
    #[arg(long, value_name = "TIME", value_parser = times::time, requires = "tasks")]
    ready: Option<i64>,
    /// Keeps the plan in the map, for plan show
    #[arg(long, requires = "tasks")]
    keep: bool,
    #[command(flatten)]
    drawing: DrawingArg,
}

#[derive(Clone, Copy, Debug, ValueEnum)]
enum StrategyArg {
    /// At random, in proportion to the expected information
    MonteCarlo,
    /// The slots and locations with the most information
    Greedy,
    /// All locations in turn
    RoundRobin,
    /// At random, all locations alike
    Random,
}

/// Maximum number of viewpoints; a request for more is refused before it is sent.
const VIEWS_MAX: f64 = 100_000.0;

fn spacing(text: &str) -> Result<f64, String> {
    let number = text.parse().ok().filter(|metres: &f64| *metres > 0.0 && metres.is_finite());
    number.ok_or_else(|| format!("{text:?} is not a distance: use metres above 0, such as 1.5"))
}

/// Viewpoints all over a map's grid, `apart_m` metres apart.
async fn viewpoints(session: &Session, map: &str, apart_m: f64) -> anyhow::Result<Vec<Viewpoint>> {
    let Map { grid, grid_summary, .. } = session.client.map(map).await?;
    let grid = grid.with_context(|| format!("map {map:?} has no grid"))?;
    let bounds = grid_summary.and_then(|summary| summary.bounds);
    let bounds = bounds.with_context(|| format!("the grid of map {map:?} has no observations yet"))?;
    let (size, min) = (bounds.size(), <[i32; 3]>::from(bounds.min));
    let cells = |axis: usize| size[axis] as f64;
    let count = |axis: usize| (cells(axis) * grid.resolution_m / apart_m).floor().max(1.0);
    if count(0) * count(1) > VIEWS_MAX {
        let text =
            format!("--views {apart_m} makes {:.0} viewpoints: at most {VIEWS_MAX} are allowed", count(0) * count(1));
        return Err(usage(text));
    }
    let along = |axis: usize, number: u32| {
        let spare = cells(axis) * grid.resolution_m - count(axis) * apart_m;
        let low = grid.origin_m[axis] + f64::from(min[axis]) * grid.resolution_m;
        low + spare / 2.0 + (f64::from(number) + 0.5) * apart_m
    };
    let rounded = |metres: f64| (metres * 1e3).round() / 1e3;
    let at =
        |x: u32, y: u32| Viewpoint { x_m: rounded(along(0, x)), y_m: rounded(along(1, y)), ..Viewpoint::default() };
    let (columns, rows) = (count(0) as u32, count(1) as u32);
    Ok((0..rows).flat_map(|y| (0..columns).map(move |x| (x, y))).map(|(x, y)| at(x, y)).collect())
}

/// The last only with --tasks.
const COLUMNS: [&str; 5] = ["slot", "start", "location", "information_bits", "task"];

pub(crate) async fn run(session: &Session, args: DayArgs) -> anyhow::Result<ExitCode> {
    args.drawing.check()?;
    let title = format!("{}: plan of the exploration on {}", args.map, args.date);
    let budget = match (args.explore, args.ratio) {
        (Some(slots), _) => Some(Budget::Visits(slots as usize)),
        (None, Some(ratio)) if ratio > 0.0 && ratio <= 1.0 => Some(Budget::Ratio(ratio)),
        (None, Some(ratio)) => return Err(usage(format!("--ratio {ratio}: it has to be above 0 and at most 1"))),
        (None, None) => None,
    };
    let viewpoints = match args.views {
        Some(apart_m) => viewpoints(session, &args.map, apart_m).await?,
        None => Vec::new(),
    };
    let query = DayQuery {
        map: args.map,
        date: args.date,
        slot_nanos: Some(args.slot),
        exactly_one: args.exactly_one,
        budget,
        strategy: match args.strategy {
            StrategyArg::MonteCarlo => Strategy::MonteCarlo,
            StrategyArg::Greedy => Strategy::Greedy,
            StrategyArg::RoundRobin => Strategy::RoundRobin { visited: 0 },
            StrategyArg::Random => Strategy::Random,
        },
        seed: args.seed,
        locations: args.locations,
        model: args.model,
        information: args.information.into(),
        exploration_weight: args.exploration_weight,
        task_states: args.task_states,
        viewpoints,
        sensor: Sensor::default(),
        tour: args.tours.map(|goals| DayTour { goals, start_m: None }),
    };
    let (slots, tasks) = if args.tasks {
        let tasks = TaskQuery { start_node: args.start_node, ready_nanos: args.ready, keep: args.keep };
        let plan = session.client.plan_tasks(query, tasks).await?;
        (plan.slots, Some(plan.tasks))
    } else {
        (session.client.plan_day(query).await?, None)
    };
    if let Some(tasks) = &tasks {
        report_unserved(session, tasks);
    }
    args.drawing.put(|| text(session, &title, &slots), || plot(session, &title, &slots).svg())?;
    if args.drawing.is_in_terminal() {
        return Ok(ExitCode::SUCCESS);
    }
    let shown = &COLUMNS[..if tasks.is_some() { COLUMNS.len() } else { COLUMNS.len() - 1 }];
    let ends: Vec<i64> = slots.iter().skip(1).map(|slot| slot.start_nanos).chain([i64::MAX]).collect();
    let row = |((slot, DaySlot { start_nanos, location, information_bits }), end_nanos): ((u64, DaySlot), i64)| {
        let location = location.map_or(Cell::Empty, Cell::Text);
        let of_slot = tasks.as_ref().map(|tasks| task_within(tasks, start_nanos, end_nanos));
        let slot = [Cell::Count(slot), Cell::Time(start_nanos), location, information_bits.into()];
        slot.into_iter().chain(of_slot).collect()
    };
    session.print(shown, (0_u64..).zip(slots).zip(ends).map(row))
}

/// The tasks that a slot is spent on, or on the way to.
fn task_within(tasks: &PlannedTasks, start_nanos: i64, end_nanos: i64) -> Cell {
    let within = tasks.steps.iter().filter(|step| step.departure_nanos < end_nanos && step.end_nanos > start_nanos);
    let names = within.filter_map(|step| match &step.work {
        KeptWork::Task { name, .. } => Some(name.to_string()),
        KeptWork::Explore { .. } => None,
    });
    Some(names.collect::<Vec<_>>().join(" ")).filter(|names| !names.is_empty()).map_or(Cell::Empty, Cell::Text)
}

/// Prints on stderr which tasks are not planned, and why.
fn report_unserved(session: &Session, tasks: &PlannedTasks) {
    for UnservedTask { name, from_nanos, until_nanos, reason } in &tasks.unserved {
        let why = match reason {
            UnservedReason::NoWindow => "its window is over, or the robot cannot arrive early enough",
            UnservedReason::Unreachable => "no way leads to its node",
            UnservedReason::NoValue => "its value is 0 at that time",
            UnservedReason::NoTime => "there is no time for it beside tasks of higher value",
            UnservedReason::UnknownNode => "the topology has no such node",
            UnservedReason::UnknownState => "the map has no such state, or it is no probability",
        };
        let [from, until] = [*from_nanos, *until_nanos].map(|nanos| session.times.label(nanos));
        status_line(&format!("task {name} ({from} to {until}) is not planned: {why}"));
    }
}

/// The information of each slot; explored slots are marked.
fn plot(session: &Session, title: &str, slots: &[DaySlot]) -> CurvePlot {
    CurvePlot {
        title: title.to_owned(),
        labels: slots.iter().map(|slot| session.times.label(slot.start_nanos)).collect(),
        curves: vec![Curve {
            name: "information (bits)".to_owned(),
            values: slots.iter().map(|slot| Some(slot.information_bits)).collect(),
            band: Vec::new(),
            marks: slots.iter().map(|slot| slot.location.is_some()).collect(),
        }],
    }
}

/// The drawing for a terminal, with the list of the explored locations.
fn text(session: &Session, title: &str, slots: &[DaySlot]) -> String {
    let mut text = plot(session, title, slots).text();
    for slot in slots {
        if let Some(location) = &slot.location {
            text += &format!("  {}  {location}\n", session.times.label(slot.start_nanos));
        }
    }
    text
}
