//! `tidemap state`.
//!
//! Invariant: states are listed in the order of their first observation, page by page; an added state is durable.

use std::{process::ExitCode, str::FromStr};

use clap::Subcommand;
use tidemap_client::maps::{Dimensions, RowKind, State, StateKind, StateSensor, StateShape};

use super::{Session, rows::stated, times, usage};
use tidemap_formats::table::Cell;

#[derive(Debug, Subcommand)]
pub(crate) enum StateCommand {
    /// Lists the states of a map, in the order of their first observation
    List {
        /// Name of the map
        map: String,
    },
    /// Adds a state before its first observation, to set its kind or its sensor
    Add {
        /// Name of the map
        map: String,
        /// Name of the state
        state: String,
        /// Kind of its values: probability (0 to 1), continuous (any number), count (0, 1, 2, …), vector,
        /// angle (radians), or categorical (one of --labels) [default: probability; count for events]
        #[arg(long, value_name = "KIND")]
        kind: Option<KindArg>,
        /// Number of coordinates of a vector, 2 or 3
        #[arg(long, value_name = "N", required_if_eq("kind", "vector"), value_parser = clap::value_parser!(u32).range(2..=3))]
        dimensions: Option<u32>,
        /// Labels of a categorical state, 2 to 64, such as sleep,eat,work; they never change
        #[arg(long, value_name = "LABEL,…", value_delimiter = ',', required_if_eq("kind", "categorical"))]
        labels: Vec<String>,
        /// Probability to read 1 where the state is 1, if you know it: above 0, up to 1 [default: 1 with --false-alarm,
        /// else updates estimate it]
        #[arg(long, value_name = "P")]
        hit: Option<f64>,
        /// Probability to read 1 where the state is 0, if you know it: 0 or more, less than --hit [default: 0 with
        /// --hit, else updates estimate it]
        #[arg(long, value_name = "P")]
        false_alarm: Option<f64>,
        /// Kind of reporting: samples (each observation is a reading), changes (a value holds until the next one), or
        /// events (each observation is a number of events, of kind count)
        #[arg(long, value_name = "HOW", default_value = "samples", value_parser = row_kind)]
        reports: RowKind,
        /// With changes or events: the longest time for which an observation is valid [default: 7d]
        #[arg(long, value_name = "DURATION", value_parser = times::duration)]
        hold_max: Option<i64>,
        /// With changes or events: the time between two readings that are learned [default: 5m, 1h for events]
        #[arg(long, value_name = "DURATION", value_parser = times::duration)]
        hold_step: Option<i64>,
    },
}

/// The reporting of a state, on the command line.
fn row_kind(text: &str) -> Result<RowKind, String> {
    let kind = RowKind::ALL.into_iter().find(|kind| kind.name() == text);
    kind.ok_or_else(|| format!("{text:?} is not a way to report: use samples, changes or events"))
}

/// A kind on the command line.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(crate) enum KindArg {
    /// Values, one a row.
    Single(StateShape),
    Vector,
    /// Labels, one a row.
    Categorical,
}

/// A text that is not the name of a kind.
#[derive(Clone, Debug, PartialEq, Eq, thiserror::Error)]
#[error("{0:?} is not a kind of states: use probability, continuous, count, vector, angle or categorical")]
pub(crate) struct InvalidKind(String);

impl KindArg {
    pub(crate) fn name(self) -> &'static str {
        match self {
            Self::Single(shape) => shape.name(),
            Self::Vector => "vector",
            Self::Categorical => "categorical",
        }
    }

    /// The shape of values; `None` for a vector and for labels.
    pub(crate) fn single(self) -> Option<StateShape> {
        match self {
            Self::Single(shape) => Some(shape),
            Self::Vector | Self::Categorical => None,
        }
    }
}

impl FromStr for KindArg {
    type Err = InvalidKind;

    fn from_str(text: &str) -> Result<Self, InvalidKind> {
        let single = StateKind::ALL.into_iter().map(StateShape::from).chain([StateShape::Angle]);
        let mut kinds = single.map(Self::Single).chain([Self::Vector, Self::Categorical]);
        kinds.find(|kind| kind.name() == text).ok_or_else(|| InvalidKind(text.to_owned()))
    }
}

const COLUMNS: [&str; 13] = [
    "state",
    "kind",
    "observations",
    "order",
    "last_time",
    "dimensions",
    "pending",
    "hit",
    "false_alarm",
    "reports",
    "hold_max_secs",
    "hold_step_secs",
    "labels",
];

fn cells(state: State) -> Vec<Cell> {
    vec![
        Cell::Text(state.name),
        match state.shape {
            StateShape::Vector(_) => KindArg::Vector.name(),
            StateShape::Categorical(_) => KindArg::Categorical.name(),
            shape => shape.name(),
        }
        .into(),
        state.observations.into(),
        state.order.into(),
        Cell::time(state.last_nanos),
        Cell::maybe(state.shape.dimensions().map(|dimensions| dimensions.count() as u64)),
        state.pending.into(),
        Cell::maybe(state.sensor.map(StateSensor::hit)),
        Cell::maybe(state.sensor.map(StateSensor::false_alarm)),
        state.reporting.kind().name().into(),
        Cell::maybe(state.reporting.max_secs().map(u64::from)),
        Cell::maybe(state.reporting.step_secs().map(u64::from)),
        if state.labels.is_empty() {
            Cell::Empty
        } else {
            Cell::List(state.labels.into_iter().map(Cell::Text).collect())
        },
    ]
}

/// The sensor of a state, if an option states a part of it; the other number is the value of a sensor that is always
/// right.
fn sensor(shape: StateShape, hit: Option<f64>, false_alarm: Option<f64>) -> anyhow::Result<Option<StateSensor>> {
    if hit.is_none() && false_alarm.is_none() {
        return Ok(None);
    }
    if !shape.may_have_sensor() {
        return Err(usage(format!("--hit and --false-alarm go with --kind probability, not {}", shape.name())));
    }
    let sensor = StateSensor::new(hit.unwrap_or(1.0), false_alarm.unwrap_or(0.0));
    sensor.map(Some).map_err(|error| usage(error.to_string()))
}

pub(crate) async fn run(session: &Session, command: StateCommand) -> anyhow::Result<ExitCode> {
    let map = match command {
        StateCommand::List { map } => map,
        StateCommand::Add { map, state, kind, dimensions, labels, hit, false_alarm, reports, hold_max, hold_step } => {
            let usual = if reports == RowKind::Events { StateKind::Count } else { StateKind::Probability };
            let kind = kind.unwrap_or(KindArg::Single(usual.into()));
            let reporting = stated(reports, hold_max, hold_step)?;
            if kind == KindArg::Categorical {
                if dimensions.is_some() || hit.is_some() || false_alarm.is_some() || reporting.is_some() {
                    return Err(usage("--kind categorical has --labels, and nothing else"));
                }
                let added = session.client.add_categorical(&map, &state, &labels).await?;
                return session.print(&COLUMNS, [cells(added)]);
            }
            if !labels.is_empty() {
                return Err(usage(format!("--labels goes with --kind categorical, not {}", kind.name())));
            }
            let shape = match (kind, dimensions.and_then(|count| Dimensions::of(count as usize))) {
                (KindArg::Vector, Some(dimensions)) => StateShape::Vector(dimensions),
                (KindArg::Single(shape), None) => shape,
                _ => return Err(usage(format!("--dimensions goes with --kind vector, not {}", kind.name()))),
            };
            let sensor = sensor(shape, hit, false_alarm)?;
            let added = session.client.add_state(&map, &state, shape, sensor, reporting).await?;
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
