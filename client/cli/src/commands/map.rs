//! `tidemap map`.
//!
//! Invariant: nothing is deleted without --yes.

pub(crate) mod grid_spec;

use std::{process::ExitCode, str::FromStr};

use clap::{Args, Subcommand, ValueEnum};
use tidemap_client::maps::{
    EnabledModels, GridSpec, Map, NewMap, NotLearned, OrderCriterion, PeriodicityDefinition, Retention,
};
use tidemap_formats::table::{Cell, Format};
use tidemap_model::time::format_duration;

use self::grid_spec::{GridArg, box_text, retention_text, spec_text};

use super::{Session, point::Point, shell_word::quoted, times, usage};

use crate::{counted::some_of, progress::status_line};

#[derive(Debug, Subcommand)]
pub(crate) enum MapCommand {
    /// Creates an empty map and shows it
    Create(Box<CreateArgs>),
    /// Lists all maps
    List,
    /// Shows a map
    Show {
        /// Name of the map
        name: String,
    },
    /// Sets the position of the robot's charger
    Set {
        /// Name of the map
        name: String,
        /// Position where the robot rests and charges, metres; `none` clears it
        #[arg(long, value_name = "X,Y|none", allow_hyphen_values = true)]
        charger: Charger,
    },
    /// Deletes a map and all its data permanently
    Delete {
        /// Name of the map
        name: String,
        /// Confirms the deletion
        #[arg(long)]
        yes: bool,
    },
}

/// Position of a charger, or none.
#[derive(Clone, Copy, Debug)]
pub(crate) struct Charger(Option<[f64; 2]>);

impl FromStr for Charger {
    type Err = String;

    fn from_str(text: &str) -> Result<Self, String> {
        if text == "none" { Ok(Self(None)) } else { text.parse().map(|Point(at)| Self(Some(at))) }
    }
}

#[derive(Debug, Args)]
pub(crate) struct CreateArgs {
    /// Name of the map: a-z 0-9 _ -, at most 63
    name: String,
    /// Time zone of the place, for example Europe/London [default: UTC]
    #[arg(long, value_name = "IANA")]
    time_zone: Option<String>,
    /// Longest candidate period; the others are this divided by 2, 3, ... [default: 7d]
    #[arg(long, value_name = "DURATION", value_parser = times::duration)]
    period_base: Option<i64>,
    /// Number of candidate periods [default: 168]
    #[arg(long, value_name = "N", value_parser = clap::value_parser!(u32).range(1..=2048))]
    period_count: Option<u32>,
    /// Candidate periods as a list, for example 24h,12h,7d
    #[arg(long, value_name = "DURATION,…", value_parser = times::duration, value_delimiter = ',',
          conflicts_with_all = ["period_base", "period_count"])]
    periods: Option<Vec<i64>>,
    /// Criterion by which the order of the spectral model is chosen
    #[arg(long, value_name = "CRITERION", default_value = "squared-error")]
    order_criterion: Criterion,
    /// Time for which the history of exact observations of named states is kept: none, forever or a duration [default:
    /// forever]
    #[arg(long, value_name = "RETENTION", value_parser = grid_spec::retention)]
    retention: Option<Retention>,
    /// An occupancy grid: resolution=M[,flat][,origin=X:Y:Z][,size=NXxNYxNZ or min=X:Y:Z,max=X:Y:Z][,frame=NAME]
    /// [,hit=P][,false-alarm=P][,prior=P]; resolution and origin in metres, the others in cells [default: none]
    #[arg(long, value_name = "SPEC")]
    grid: Option<GridArg>,
    /// Time for which the history of exact cell observations is kept: none, forever or a duration [default: none]
    #[arg(long, value_name = "RETENTION", value_parser = grid_spec::retention, requires = "grid")]
    grid_retention: Option<Retention>,
    /// Age, from the newest reading of a cell, at which its readings have half their weight, so that old routines are
    /// forgotten; in whole days [default: never]
    #[arg(long, value_name = "DURATION", value_parser = times::duration, requires = "grid")]
    grid_half_life: Option<i64>,
    /// Age at which the weight of an observation of a named state is one half, so that old routines are forgotten; for
    /// grid cells see --grid-half-life [default: never]
    #[arg(long, value_name = "DURATION", value_parser = times::duration)]
    half_life: Option<i64>,
    /// Prediction of a named state with no learned data, 0 to 1 [default: 0.5]
    #[arg(long, value_name = "P")]
    prior: Option<f64>,
    #[arg(long, value_name = "MODEL,…", value_parser = enabled_models, help = models_help())]
    models: Option<EnabledModels>,
    /// The clocks of the robots: of a map with real clocks, observations before 1990 are refused, which come from a
    /// clock that is not set or are in another unit; a simulation may begin at 0
    #[arg(long, value_name = "CLOCK", default_value = "real")]
    clock: ClockArg,
}

#[derive(Clone, Copy, Debug, PartialEq, Eq, ValueEnum)]
enum ClockArg {
    /// Clocks of robots
    Real,
    /// Time of a simulation
    Simulated,
}

fn models_help() -> String {
    let (all, usual) = (EnabledModels::all_names(), EnabledModels::default().names().collect::<Vec<_>>().join(","));
    format!(
        "Models among which the nightly update chooses for each named state: {all}, or all; spectral is always \
         included [default: {usual}]"
    )
}

/// The value of `--models`: names with commas between.
pub fn enabled_models(text: &str) -> Result<EnabledModels, String> {
    text.split(',').try_fold(EnabledModels::SPECTRAL, |models, name| {
        models.with_named(name).ok_or_else(|| {
            let names: Vec<_> = EnabledModels::ALL.names().collect();
            let names = names.join(", ");
            format!("{name:?} is not a model that the nightly update chooses among: use {names}, or all")
        })
    })
}

#[derive(Clone, Copy, Debug, ValueEnum)]
enum Criterion {
    /// Mean squared difference between value and prediction
    SquaredError,
    /// Share of values on the other side of 0.5 than their prediction
    ZeroOne,
}

const WEEK_NANOS: i64 = 7 * 86_400 * 1_000_000_000;
const USUAL_COUNT: u32 = 168;

const COLUMNS: [&str; 11] = [
    "name",
    "states",
    "observations",
    "pending",
    "time_zone",
    "periods",
    "order_criterion",
    "created",
    "updates",
    "updated_until",
    "scans",
];
/// Additional columns of a single map.
const MORE_COLUMNS: [&str; 18] = [
    "retention",
    "grid",
    "grid_retention",
    "tiles",
    "pending_scans",
    "cell_observations",
    "bounds",
    "half_life",
    "prior",
    "charger",
    "locations",
    "models",
    "grid_half_life",
    "ahead",
    "ahead_scans",
    "not_learned",
    "not_learned_scans",
    "learn_with",
];

pub(crate) async fn run(session: &Session, command: MapCommand) -> anyhow::Result<ExitCode> {
    let client = &session.client;
    let all = matches!(command, MapCommand::List);
    let mut unavailable = Vec::new();
    let maps = match command {
        MapCommand::Create(args) => {
            let wanted = new_map(*args);
            let has_grid = wanted.grid.is_some();
            let grid_fades = wanted.grid.as_ref().is_some_and(|grid| grid.half_life_nanos.is_some());
            if has_grid && wanted.half_life_nanos.is_some() && !grid_fades {
                status_line("the half-life applies to named states: grid cells forget with --grid-half-life");
            }
            vec![with_grid(client.create_map(wanted).await?, has_grid)?]
        }
        MapCommand::List => {
            let maps = client.all_maps().await?;
            unavailable = maps.1;
            maps.0
        }
        MapCommand::Show { name } => vec![client.map(&name).await?],
        MapCommand::Set { name, charger: Charger(at_m) } => {
            client.set_charger(&name, at_m).await?;
            vec![client.map(&name).await?]
        }
        MapCommand::Delete { name, yes } => {
            if !yes {
                let Map { states, observations, .. } = client.map(&name).await?;
                let lost = format!("{observations} observations of {states} states");
                return Err(usage(format!("this deletes map {name:?} with {lost} for good; add --yes to do it")));
            }
            client.delete_map(&name).await?;
            status_line(&format!("map {name:?} is deleted"));
            return Ok(ExitCode::SUCCESS);
        }
    };
    let columns = if all { [&COLUMNS[..], &["problem"]].concat() } else { [&COLUMNS[..], &MORE_COLUMNS].concat() };
    let row = |map| {
        let more = if all { vec![Cell::Empty] } else { more_cells(&map) };
        [cells(map), more].concat()
    };
    if let ([map], false) = (maps.as_slice(), all) {
        // Tables for people have one more column; the columns of programs stay.
        let clock = (session.format == Format::Table).then_some(if map.has_real_clock { "real" } else { "any" });
        let columns = columns.into_iter().chain(clock.map(|_| "clock")).collect::<Vec<_>>();
        let cells = row(map.clone()).into_iter().chain(clock.map(Cell::from)).collect();
        session.print_one(&columns, cells)?;
        if let Some(waiting) = never_learned(map).filter(|_| session.format == Format::Table) {
            let what = some_of(&[(waiting.scans, "scan"), (waiting.observations, "observation")]);
            status_line(&format!(
                "not learned yet: {what}. There are no predictions before the first update: {}",
                update_command(&map.name)
            ));
        }
        return Ok(ExitCode::SUCCESS);
    }
    let damaged = unavailable.into_iter().map(|map| {
        let mut row = vec![Cell::Empty; COLUMNS.len() + 1];
        row[0] = Cell::Text(map.name);
        row[COLUMNS.len()] = Cell::Text(map.reason);
        row
    });
    session.print(&columns, maps.into_iter().map(row).chain(damaged))
}

/// Checks that a new map has its grid: a daemon that does not support grids ignores the field.
pub fn with_grid(made: Map, wanted: bool) -> anyhow::Result<Map> {
    anyhow::ensure!(
        made.grid.is_some() || !wanted,
        "map {0:?} was created without its grid: the daemon is too old for grids. Delete the map, with tidemap map \
         delete {0} --yes, and create it with a newer daemon",
        made.name
    );
    Ok(made)
}

fn new_map(args: CreateArgs) -> NewMap {
    let periodicities = match (args.periods, args.period_base, args.period_count) {
        (Some(periods), ..) => Some(PeriodicityDefinition::List { period_nanos: periods }),
        (None, None, None) => None,
        (None, base, count) => Some(PeriodicityDefinition::Harmonics {
            base_nanos: base.unwrap_or(WEEK_NANOS),
            count: count.unwrap_or(USUAL_COUNT),
        }),
    };
    let order_criterion = match args.order_criterion {
        Criterion::SquaredError => OrderCriterion::SquaredError,
        Criterion::ZeroOne => OrderCriterion::ZeroOne,
    };
    let grid = args.grid.map(|GridArg(grid)| GridSpec {
        retention: args.grid_retention.unwrap_or(grid.retention),
        half_life_nanos: args.grid_half_life,
        ..grid
    });
    NewMap {
        name: args.name,
        time_zone: args.time_zone,
        periodicities,
        order_criterion,
        retention: args.retention,
        grid,
        half_life_nanos: args.half_life,
        prior: args.prior,
        models: args.models,
        has_real_clock: args.clock == ClockArg::Real,
    }
}

fn cells(map: Map) -> Vec<Cell> {
    let periods = match map.periodicities {
        PeriodicityDefinition::Harmonics { base_nanos, count } => {
            vec![format!("{}/1..{count}", format_duration(base_nanos))]
        }
        PeriodicityDefinition::List { period_nanos } => period_nanos.into_iter().map(format_duration).collect(),
    };
    let criterion = match map.order_criterion {
        OrderCriterion::SquaredError => "squared-error",
        OrderCriterion::ZeroOne => "zero-one",
    };
    vec![
        Cell::Text(map.name),
        map.states.into(),
        map.observations.into(),
        map.pending_observations.into(),
        Cell::Text(map.time_zone),
        Cell::texts(periods),
        criterion.into(),
        Cell::time(map.created_nanos),
        map.last_update.generation.into(),
        Cell::time(map.last_update.cut_nanos),
        Cell::maybe(map.grid_summary.map(|summary| summary.scans)),
    ]
}

/// The data that waits for the first update of a map; `None`: an update has learned something, or there is no data.
fn never_learned(map: &Map) -> Option<NotLearned> {
    map.not_learned.filter(|waiting| waiting.is_all)
}

fn update_command(map: &str) -> String {
    format!("tidemap update {}", quoted(map))
}

fn more_cells(map: &Map) -> Vec<Cell> {
    let text = |text: Option<String>| text.map_or(Cell::Empty, Cell::Text);
    let (grid, summary) = (map.grid.as_ref(), map.grid_summary.as_ref());
    vec![
        text(Some(retention_text(map.retention))),
        text(grid.map(spec_text)),
        text(grid.map(|grid| retention_text(grid.retention))),
        Cell::maybe(summary.map(|summary| summary.tiles)),
        Cell::maybe(summary.map(|summary| summary.pending_scans)),
        Cell::maybe(summary.map(|summary| summary.cell_observations)),
        text(summary.and_then(|summary| summary.bounds.as_ref()).map(box_text)),
        text(map.half_life_nanos.map(format_duration)),
        map.prior.into(),
        text(map.charger_m.map(|[x, y]| format!("{x},{y}"))),
        map.locations.into(),
        Cell::texts(map.models.names()),
        text(grid.and_then(|grid| grid.half_life_nanos).map(format_duration)),
        map.ahead_observations.into(),
        Cell::maybe(summary.map(|summary| summary.ahead_scans)),
        map.not_learned.map_or(0, |waiting| waiting.observations).into(),
        Cell::maybe(summary.map(|_| map.not_learned.map_or(0, |waiting| waiting.scans))),
        text(never_learned(map).map(|_| update_command(&map.name))),
    ]
}
