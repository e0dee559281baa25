//! `tidemap model`.
//!
//! Invariant: values are shown as the daemon sends them; only the table adds explanations.

use std::{
    io::{self, Write as _},
    process::ExitCode,
};

use anyhow::Context as _;
use clap::Subcommand;
use tidemap_client::{
    maps::StateKind,
    queries::{ModelDescription, ModelSelector, SpectralComponent},
};

use super::{Session, files::DrawingArg};
use crate::output::stdout;
use tidemap_formats::{
    drawing::HeatMap,
    table::{Cell, Format, TimeStyle, numbers::period, object, write_rows},
};
use tidemap_model::{LocalDay, Zone};

#[derive(Debug, Subcommand)]
pub(crate) enum ModelCommand {
    /// Shows the models of a state: its mean, and its periodic components with the strongest first
    Show {
        /// Name of the map
        map: String,
        /// Name of the state; a cell of the grid is cell/X/Y/Z
        state: String,
        #[command(flatten)]
        drawing: DrawingArg,
    },
}

pub(crate) async fn run(session: &Session, command: &ModelCommand) -> anyhow::Result<ExitCode> {
    let ModelCommand::Show { map, state, drawing } = command;
    drawing.check()?;
    let model = session.client.describe_model(map, state).await?;
    if drawing.is_wanted() {
        let week = week(session, map, state, &model).await?;
        drawing.put(|| week.text() + &amplitudes(&model), || week.svg())?;
    }
    if drawing.is_in_terminal() {
        return Ok(ExitCode::SUCCESS);
    }
    match session.format {
        Format::Table => table(&model)?,
        Format::Json => json(&model)?,
        Format::Csv => csv(&model)?,
    }
    Ok(ExitCode::SUCCESS)
}

const HOUR_NANOS: i64 = 3_600_000_000_000;

/// The week after the newest observation, hour by hour, as the model predicts it: a row for each local day.
async fn week(session: &Session, map: &str, state: &str, model: &ModelDescription) -> anyhow::Result<HeatMap> {
    let zone = Zone::named(&session.client.map(map).await?.time_zone).unwrap_or_else(|_| Zone::utc());
    let last = model.last_nanos.context("nothing was observed yet: there is nothing to draw")?;
    let first = zone.day_of(last).0 + 1;
    let hour =
        |day: i32, hour: i64| zone.midnight_nanos(LocalDay(day)).saturating_add(hour * HOUR_NANOS + HOUR_NANOS / 2);
    let times: Vec<i64> =
        (first..first + 7).flat_map(|day| (0..24).map(move |at| (day, at))).map(|(day, at)| hour(day, at)).collect();
    let style = TimeStyle::Clock(zone.clone());
    let rows = times.chunks(24).map(|day| style.heading(day[0]).chars().take(14).collect()).collect();
    let mut predicted = session.client.predict(map, vec![state.to_owned()], times, ModelSelector::default());
    let mut values = Vec::new();
    // A vector is drawn by its first axis.
    while let Some(run) = predicted.next().await? {
        if run.axis.is_none_or(|axis| axis == 0) {
            values.extend(run.probabilities.into_iter().map(Some));
        }
    }
    let all = || values.iter().flatten().copied();
    let (low, high) = (all().fold(0.0, f64::min), all().fold(0.0, f64::max));
    let is_probability = model.kind == StateKind::Probability;
    Ok(HeatMap {
        title: format!("{state}: a week as {} predicts it, hour by hour ({})", model.chosen, zone.name()),
        rows,
        columns: (0..24).map(|hour| format!("{hour:02}")).collect(),
        values: values.chunks(24).map(<[Option<f64>]>::to_vec).collect(),
        range: if is_probability { [0.0, 1.0] } else { [low, high] },
        unit: if is_probability { "probability" } else { "expected value" }.to_owned(),
        cell_m: None,
    })
}

/// Bars of the amplitudes of the rhythms, for a terminal.
fn amplitudes(model: &ModelDescription) -> String {
    let strongest = model.components.iter().map(|component| component.amplitude).fold(0.0, f64::max);
    let mut text = String::new();
    if strongest > 0.0 {
        text += "rhythms of the spectral model, the used ones with █\n";
    }
    for (index, component) in model.components.iter().enumerate() {
        let length = (component.amplitude / strongest * 40.0).round().max(1.0) as usize;
        let bar = if used(model, index) { "█" } else { "░" }.repeat(length);
        text += &format!("  {:>8} │{bar} {:.3}\n", period(component.period_secs), component.amplitude);
    }
    text
}

fn used(model: &ModelDescription, index: usize) -> bool {
    index < model.order as usize
}

fn summary(model: &ModelDescription) -> [(&'static str, Cell); 10] {
    [
        ("mean", model.mean.into()),
        ("n", model.learned_observations.into()),
        ("order", model.order.into()),
        ("observations", model.observations.into()),
        ("first_time", Cell::time(model.first_nanos)),
        ("last_time", Cell::time(model.last_nanos)),
        ("last_value", Cell::maybe(model.last_value)),
        ("persistence_tau_secs", model.persistence_tau_secs.into()),
        ("model", Cell::Text(model.chosen.to_string())),
        ("change_date", model.change_date.clone().map_or(Cell::Empty, Cell::Text)),
    ]
}

fn component_cells(component: &SpectralComponent, used: bool) -> [(&'static str, Cell); 4] {
    [
        ("period_secs", component.period_secs.into()),
        ("amplitude", component.amplitude.into()),
        ("phase_rad", component.phase_rad.into()),
        ("used", Cell::Flag(used)),
    ]
}

/// Two tables: the state, then its components.
fn table(model: &ModelDescription) -> io::Result<()> {
    let print = |columns: &[&str], rows: Vec<Vec<Cell>>| write_rows(Format::Table, columns, rows, stdout());
    let (state, chosen) = (Cell::Text(model.state.clone()), Cell::Text(model.chosen.to_string()));
    let row = vec![state, model.mean.into(), model.learned_observations.into(), model.order.into(), chosen];
    print(&["state", "mean", "n", "order", "model"], vec![row])?;
    if let Some(date) = &model.change_date {
        writeln!(io::stdout(), "\nThe routine seems to have changed: predictions have been worse since about {date}.")?;
    }
    if !model.model_errors.is_empty() {
        writeln!(io::stdout())?;
        let row = |(tried, error): &(ModelSelector, f64)| {
            let order = Cell::maybe(tried.order.map(|order| order as u64));
            vec![Cell::Text(tried.to_string()), order, (*error).into(), Cell::Flag(tried.kind == model.chosen.kind)]
        };
        print(&["model", "order", "recent_error", "used"], model.model_errors.iter().map(row).collect())?;
    }
    if model.components.is_empty() {
        return writeln!(
            io::stdout(),
            "\nNo periodic component was found: this takes observed changes over at least one period, and an update."
        );
    }
    writeln!(io::stdout())?;
    let row = |(index, component): (usize, &SpectralComponent)| {
        let cells = component_cells(component, used(model, index)).map(|(_, cell)| cell);
        [vec![Cell::Text(period(component.period_secs))], cells.to_vec()].concat()
    };
    let rows = model.components.iter().enumerate().map(row).collect();
    print(&["period", "period_secs", "amplitude", "phase_rad", "used"], rows)
}

/// One table for programs, a row per component. The columns of the state are repeated in each row; a state without
/// components has one row. The model in use and the recent errors of all models are the last columns.
fn csv(model: &ModelDescription) -> io::Result<()> {
    let summary = summary(model);
    let columns = ["period_secs", "amplitude", "phase_rad", "used", "model", "recent_errors"];
    let columns: Vec<&'static str> = summary[..3].iter().map(|(name, _)| *name).chain(columns).collect();
    let errors = model.model_errors.iter().map(|(tried, error)| format!("{tried}={error}"));
    let tried = [Cell::Text(model.chosen.to_string()), Cell::Text(errors.collect::<Vec<_>>().join(" "))];
    let row = |component: [Cell; 4]| {
        let state = summary[..3].iter().map(|(_, cell)| cell.clone());
        state.chain(component).chain(tried.clone()).collect()
    };
    let without = model.components.is_empty().then_some([const { Cell::Empty }; 4]);
    let components = model.components.iter().enumerate();
    let components =
        components.map(|(index, component)| component_cells(component, used(model, index)).map(|(_, cell)| cell));
    write_rows(Format::Csv, &columns, without.into_iter().chain(components).map(row), stdout())
}

fn json(model: &ModelDescription) -> io::Result<()> {
    let component = |(index, component)| {
        object(component_cells(component, used(model, index)).iter().map(|(name, cell)| (*name, cell.json())))
    };
    let components: Vec<String> = model.components.iter().enumerate().map(component).collect();
    let summary = summary(model).map(|(name, cell)| (name, cell.json()));
    let state = ("state", Cell::Text(model.state.clone()).json());
    let components = ("components", format!("[{}]", components.join(",")));
    let error = |(model, error): &(ModelSelector, f64)| {
        let (name, order) = (Cell::Text(model.to_string()), Cell::maybe(model.order.map(|order| order as u64)));
        let error: Cell = (*error).into();
        object([("model", name.json()), ("order", order.json()), ("recent_error", error.json())].into_iter())
    };
    let errors: Vec<String> = model.model_errors.iter().map(error).collect();
    let errors = ("model_errors", format!("[{}]", errors.join(",")));
    writeln!(io::stdout(), "{}", object([state].into_iter().chain(summary).chain([components, errors])))
}
