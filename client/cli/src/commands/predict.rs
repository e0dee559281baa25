//! `tidemap predict`.
//!
//! Invariant: rows are in the order of the states, then of the times; each is written as soon as it arrives.

use std::{borrow::Cow, path::PathBuf, process::ExitCode};

use clap::{ArgGroup, Args};
use tidemap_client::queries::{ModelKind, ModelSelector, ORDER_MAX, PredictionRun};
use tidemap_model::Dimensions;

use super::{Session, UsageError, files::DrawingArg, times, usage};
use tidemap_formats::{
    drawing::{Curve, CurvePlot},
    table::Cell,
};

mod places;

#[derive(Debug, Args)]
#[command(group = ArgGroup::new("when").required(true).args(["at", "times", "from"]))]
pub(crate) struct PredictArgs {
    /// Name of the map
    map: String,
    /// Names of the states; a vector gives one row per axis, NAME/x and so on, an angle one row in radians; a cell of
    /// the grid is cell/X/Y/Z
    #[arg(required = true, value_name = "STATE")]
    states: Vec<String>,
    /// Times, separated by commas
    #[arg(long, value_name = "TIME,…", value_parser = times::time, value_delimiter = ',')]
    at: Option<Vec<i64>>,
    /// File of times, one a line or in a column `time`; - is stdin
    #[arg(long, value_name = "FILE")]
    times: Option<PathBuf>,
    /// First time
    #[arg(long, value_name = "TIME", value_parser = times::time, requires_all = ["to", "step"])]
    from: Option<i64>,
    /// End of the times, not included
    #[arg(long, value_name = "TIME", value_parser = times::time, requires = "from")]
    to: Option<i64>,
    /// Step between the times
    #[arg(long, value_name = "DURATION", value_parser = times::duration, requires = "from")]
    step: Option<i64>,
    /// Number of spectral components, 0 to 15 [default: what the last update chose]
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
    #[command(flatten)]
    drawing: DrawingArg,
}

fn model_help() -> String {
    format!("Model, optionally with +belief, +persistence or +memory: {}", ModelKind::forms())
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

pub(crate) async fn run(session: &Session, args: PredictArgs) -> anyhow::Result<ExitCode> {
    if args.order.is_some() && !args.model.kind.has_order() {
        return Err(usage(format!(
            "--order does not go with --model {}: only auto, spectral and uniform have one",
            args.model
        )));
    }
    let times = match (&args.at, &args.times, args.from, args.to, args.step) {
        (Some(at), ..) => at.clone(),
        (None, Some(path), ..) => times::from_file(path)?,
        (None, None, Some(from), Some(to), Some(step)) => times::steps(from, to, step)?,
        _ => return Err(usage("give the times with --at, --times, or --from with --to and --step")),
    };
    args.drawing.check()?;
    if !args.places.is_empty() {
        if args.drawing.is_wanted() {
            return Err(usage("--picture draws values over time: it does not go with --where"));
        }
        return places::run(session, args, times).await;
    }
    let model = ModelSelector { order: args.order.map(|order| order as usize), ..args.model };
    let mut predictions = session.client.predict(&args.map, args.states, times, model).with_intervals(args.interval);
    let mut table = (!args.drawing.is_in_terminal()).then(|| session.table(&COLUMNS));
    let mut drawn = Drawn { session, plot: CurvePlot::default(), order: Vec::new() };
    while let Some(run) = predictions.next().await? {
        let (states, times) = (predictions.states(), predictions.times());
        let name = match run.axis.and_then(|axis| Dimensions::Three.axes().get(axis)) {
            Some(axis) => Cow::Owned(format!("{}/{axis}", states[run.state])),
            None => Cow::Borrowed(states[run.state].as_str()),
        };
        if args.drawing.is_wanted() {
            drawn.add(&run, &name, times)?;
        }
        if let Some(table) = &mut table {
            for cells in rows(&run, &name, &times[run.first_time..]) {
                table.row(cells)?;
            }
        }
    }
    if let Some(table) = table {
        table.finish()?;
    }
    args.drawing.put(|| drawn.plot.text(), || drawn.plot.svg())?;
    Ok(ExitCode::SUCCESS)
}

/// Maximum number of states, and of values, of a drawing.
const CURVES_MAX: usize = 30;
const DRAWN_MAX: usize = 200_000;

/// Predictions that are drawn: a curve for each state.
struct Drawn<'a> {
    session: &'a Session,
    plot: CurvePlot,
    /// Places of the times in their order.
    order: Vec<usize>,
}

impl Drawn<'_> {
    fn add(&mut self, run: &PredictionRun, name: &str, times: &[i64]) -> anyhow::Result<()> {
        if self.order.is_empty() {
            self.order = (0..times.len()).collect();
            self.order.sort_by_key(|&at| times[at]);
            self.plot.labels = self.order.iter().map(|&at| self.session.times.label(times[at])).collect();
            let ends =
                [self.order.first(), self.order.last()].map(|at| at.map(|&at| self.session.times.heading(times[at])));
            if let [Some(first), Some(last)] = ends {
                self.plot.title = format!("predicted from {first} to {last}");
            }
        }
        if self.plot.curves.last().is_none_or(|curve| curve.name != name) {
            self.plot.curves.push(Curve {
                name: name.to_owned(),
                values: vec![None; times.len()],
                band: vec![None; times.len()],
                marks: Vec::new(),
            });
        }
        if self.plot.curves.len() > CURVES_MAX || self.plot.curves.len() * times.len() > DRAWN_MAX {
            return Err(usage(format!(
                "--picture draws at most {CURVES_MAX} states and {DRAWN_MAX} values: name fewer states, or a longer --step"
            )));
        }
        let mut places = vec![0; times.len()];
        self.order.iter().enumerate().for_each(|(place, &at)| places[at] = place);
        if let Some(curve) = self.plot.curves.last_mut() {
            for (i, &value) in run.probabilities.iter().enumerate() {
                let Some(&place) = places.get(run.first_time + i) else { continue };
                curve.values[place] = Some(value);
                curve.band[place] = run.lower.get(i).zip(run.upper.get(i)).map(|(&lower, &upper)| [lower, upper]);
            }
        }
        Ok(())
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

fn rows<'a>(run: &'a PredictionRun, state: &'a str, times: &'a [i64]) -> impl Iterator<Item = Vec<Cell>> + 'a {
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
            Cell::secs(run.last_nanos.map(|last| time.saturating_sub(last))),
            model_cell(run),
            run.pending.into(),
            Cell::maybe(run.masses.get(i).copied()),
        ]
    })
}

/// The model that predicted. `prior`: nothing was learned. Nothing: the daemon is too old to name it.
fn model_cell(run: &PredictionRun) -> Cell {
    match run.answered_by {
        Some(model) => Cell::Text(model.to_string()),
        None if run.pending == run.observations => "prior".into(),
        None => Cell::Empty,
    }
}
