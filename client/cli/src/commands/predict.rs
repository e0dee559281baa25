//! `tidemap predict`.
//!
//! Invariant: rows are in the order of the states, then of the times; each is written as soon as it arrives.

use std::{borrow::Cow, process::ExitCode};

use clap::Args;
use tidemap_client::queries::{ModelKind, ModelSelector, ORDER_MAX, PredictionRun};
use tidemap_model::Dimensions;

use super::{Session, UsageError, files::DrawingArg, times::RequestedTimesArgs, usage};
use crate::progress::status_line;
use picture::Drawn;
use tidemap_formats::table::{Cell, Format};

pub(super) mod names;
mod picture;
mod places;

#[derive(Debug, Args)]
pub(crate) struct PredictArgs {
    /// Name of the map
    map: String,
    /// Names of states, or patterns such as 'door-*'; none for all states. A vector gives one row per axis, NAME/x and
    /// so on, a categorical state one per label, an angle one in radians; a cell of the grid is cell/X/Y/Z
    #[arg(value_name = "STATE")]
    states: Vec<String>,
    #[command(flatten)]
    times: RequestedTimesArgs,
    /// Number of spectral components, 0 to 15 [default: the number that the last update chose]
    #[arg(long, value_name = "N", value_parser = clap::value_parser!(u32).range(0..=ORDER_MAX as i64))]
    order: Option<u32>,
    #[arg(long, value_name = "KIND", default_value = "auto", help = model_help())]
    model: ModelSelector,
    /// Confidence of the interval from lower to upper for the mean over the hour around the time: 0 (no interval) or
    /// more, and below 1. Column mass: the probability that the interval holds, which can be more
    #[arg(long, value_name = "P", default_value_t = 0.9)]
    interval: f64,
    /// Predict one state at a place, by where a vector was when the state was observed: VECTOR=X,Y[,Z] in metres; may
    /// be repeated. The model is then hypertime-em or hypertime-km, and an interval contains an observation
    #[arg(long = "where", value_name = "VECTOR=X,Y[,Z]", value_parser = places::place)]
    places: Vec<places::Place>,
    /// With --where: values whose probability density to show
    #[arg(long, value_name = "VALUE,…", value_delimiter = ',', requires = "places", allow_hyphen_values = true)]
    density: Vec<f64>,
    /// Shows a row for each time and a column for each state, with the predictions alone
    #[arg(long, conflicts_with_all = ["places", "picture"])]
    wide: bool,
    /// Shows all columns in a table, as CSV and JSON have them
    #[arg(long, conflicts_with_all = ["places", "picture", "wide"])]
    full: bool,
    #[command(flatten)]
    drawing: DrawingArg,
}

fn model_help() -> String {
    format!("Model, optionally with +persistence or +memory: {}", ModelKind::forms())
}

const COLUMNS: [&str; 12] = [
    "time",
    "state",
    "probability",
    "lower",
    "upper",
    "entropy_bits",
    "order",
    "observations",
    "age_secs",
    "model",
    "pending",
    "mass",
];

/// Columns that a table shows only if they are requested, and fewer of them if a model or an order is given.
const DETAILS: &[&str] = &["entropy_bits", "order", "model", "mass"];
const DETAILS_BESIDE_MODEL: &[&str] = &["entropy_bits", "mass"];

pub(crate) async fn run(session: &Session, args: PredictArgs) -> anyhow::Result<ExitCode> {
    if args.order.is_some() && !args.model.kind.has_order() {
        return Err(usage(format!(
            "--order does not go with --model {}: only auto, spectral and uniform have one",
            args.model
        )));
    }
    args.drawing.check()?;
    let times = args.times.resolve(session, &args.map).await?;
    if !args.places.is_empty() {
        if args.drawing.is_wanted() {
            return Err(usage("--picture draws values over time: it does not go with --where"));
        }
        return places::run(session, args, times).await;
    }
    let model = ModelSelector { order: args.order.map(|order| order as usize), ..args.model };
    let states = names::meant(session, &args.map, args.states).await?;
    // Neither shows intervals.
    let interval = if args.wide { 0.0 } else { args.interval };
    let mut predictions = session.client.predict(&args.map, states, times, model).with_intervals(interval);
    let is_chosen = args.order.is_some() || args.model != ModelSelector::default();
    let hidden = match (args.full, is_chosen) {
        (true, _) => &[],
        (false, true) => DETAILS_BESIDE_MODEL,
        (false, false) => DETAILS,
    };
    let mut table = (!args.drawing.is_in_terminal() && !args.wide).then(|| session.table(&COLUMNS).hiding(hidden));
    let mut drawn = Drawn::new(session);
    let mut unlearned: Vec<String> = Vec::new();
    let mut wide = Wide::default();
    while let Some(run) = predictions.next().await? {
        let (states, times) = (predictions.states(), predictions.times());
        let axis = run.axis.and_then(|axis| Dimensions::Three.axes().get(axis)).copied();
        let name = match run.label.as_deref().or(axis) {
            Some(part) => Cow::Owned(format!("{}/{part}", states[run.state])),
            None => Cow::Borrowed(states[run.state].as_str()),
        };
        if args.drawing.is_wanted() {
            drawn.add(&run, &name, times)?;
        }
        if args.wide {
            wide.add(&run, &name, times);
        }
        if let Some(table) = &mut table {
            // Tables for people show how many observations wait, if any do.
            let shows_pending = session.format != Format::Table || args.full || run.pending > 0;
            for cells in rows(&run, &name, &times[run.first_time..], shows_pending) {
                table.row(cells)?;
            }
        }
        if is_prior(&run) && unlearned.last().is_none_or(|last| *last != name) {
            unlearned.push(name.into_owned());
        }
    }
    if let Some(first) = unlearned.first().filter(|_| session.format == Format::Table) {
        let more = if unlearned.len() > 1 { format!(" and of {} more", unlearned.len() - 1) } else { String::new() };
        status_line(&format!(
            "nothing is learned yet of {first}{more}: this is the map's prior of any state; tidemap update {} learns",
            args.map
        ));
    }
    if let Some(table) = table {
        table.finish()?;
    }
    if args.wide {
        return wide.print(session);
    }
    args.drawing.put(|| drawn.text(), || drawn.svg())?;
    Ok(ExitCode::SUCCESS)
}

/// Predictions as a table with a column for each state.
#[derive(Debug, Default)]
struct Wide {
    times: Vec<i64>,
    columns: Vec<(String, Vec<Option<f64>>)>,
}

impl Wide {
    fn add(&mut self, run: &PredictionRun, name: &str, times: &[i64]) {
        if self.times.is_empty() {
            self.times = times.to_vec();
        }
        if self.columns.last().is_none_or(|(known, _)| known != name) {
            self.columns.push((name.to_owned(), vec![None; times.len()]));
        }
        let Some((_, values)) = self.columns.last_mut() else { return };
        for (place, &value) in values.iter_mut().skip(run.first_time).zip(&run.probabilities) {
            *place = Some(value);
        }
    }

    fn print(&self, session: &Session) -> anyhow::Result<ExitCode> {
        let names: Vec<&str> = ["time"].into_iter().chain(self.columns.iter().map(|(name, _)| name.as_str())).collect();
        let row = |(at, &time): (usize, &i64)| {
            let values = self.columns.iter().map(|(_, values)| Cell::maybe(values.get(at).copied().flatten()));
            [Cell::Time(time)].into_iter().chain(values).collect()
        };
        session.print(&names, self.times.iter().enumerate().map(row))
    }
}

/// Refuses a model that all cells of a grid at once do not support.
pub(super) fn check_for_cells(model: ModelSelector) -> Result<(), UsageError> {
    if model.kind.is_for_cells() {
        return Ok(());
    }
    let others = if model.kind.needs_readings() { "cells by name" } else { "named states" };
    Err(UsageError(format!(
        "all cells at once do not support model {model}: use auto, mean, latest or spectral; {others} support it"
    )))
}

fn rows<'a>(
    run: &'a PredictionRun,
    state: &'a str,
    times: &'a [i64],
    shows_pending: bool,
) -> impl Iterator<Item = Vec<Cell>> + 'a {
    times.iter().zip(&run.probabilities).enumerate().map(move |(i, (&time, &probability))| {
        vec![
            Cell::Time(time),
            state.into(),
            probability.into(),
            Cell::maybe(run.lower.get(i).copied()),
            Cell::maybe(run.upper.get(i).copied()),
            Cell::maybe(run.entropies_bits.get(i).copied()),
            run.order.into(),
            run.observations.into(),
            Cell::secs(run.age_nanos(time)),
            model_cell(run),
            Cell::maybe(shows_pending.then_some(run.pending)),
            Cell::maybe(run.masses.get(i).copied()),
        ]
    })
}

/// Whether no update has learned anything of the state.
fn is_prior(run: &PredictionRun) -> bool {
    run.answered_by.is_none() && run.pending == run.observations
}

/// The model that predicted. `prior`: nothing was learned. Nothing: the daemon is too old to name it.
fn model_cell(run: &PredictionRun) -> Cell {
    match run.answered_by {
        Some(model) => Cell::Text(model.to_string()),
        None if is_prior(run) => "prior".into(),
        None => Cell::Empty,
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_age_is_never_below_0() {
        let run = PredictionRun {
            state: 0,
            axis: None,
            label: None,
            first_time: 0,
            probabilities: vec![0.5; 3],
            lower: Vec::new(),
            upper: Vec::new(),
            masses: Vec::new(),
            entropies_bits: Vec::new(),
            order: 0,
            observations: 1,
            last_nanos: Some(5_000_000_000),
            pending: 0,
            answered_by: None,
        };
        let age = COLUMNS.iter().position(|column| *column == "age_secs").expect("a column");
        let times = [2_000_000_000, 5_000_000_000, 6_500_000_000];
        let ages: Vec<String> = rows(&run, "door", &times, false).map(|row| row[age].json()).collect();
        assert_eq!(ages, ["0", "0", "1.5"], "before, at and after the newest observation");
    }
}
