//! `tidemap model`.
//!
//! Invariant: values are shown as the daemon sends them; only the table adds explanations.

use std::{io, process::ExitCode};

use anyhow::Context as _;
use clap::Subcommand;
use tidemap_client::{
    maps::StateKind,
    queries::{ModelDescription, ModelSelector, SpectralComponent},
};

use super::{Session, files::DrawingArg};
use crate::output::{self, stdout};
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
        /// Name of the state; of a categorical state, a row for each label is shown; a cell of the grid is cell/X/Y/Z
        state: String,
        #[command(flatten)]
        drawing: DrawingArg,
    },
}

pub(crate) async fn run(session: &Session, command: &ModelCommand) -> anyhow::Result<ExitCode> {
    let ModelCommand::Show { map, state, drawing } = command;
    drawing.check()?;
    let model = match session.client.describe_model(map, state).await {
        Ok(model) => model,
        Err(error) => {
            // A categorical state has no model of its own.
            let labels = labels_of(session, map, state).await?;
            if labels.is_empty() {
                return Err(error.into());
            }
            return of_labels(session, map, state, &labels).await;
        }
    };
    let shown = ShownModel { answers: answering(session, map, &model).await?, model };
    if drawing.is_wanted() {
        let week = week(session, map, state, &shown).await?;
        drawing.put(|| week.text() + &amplitudes(&shown.model), || week.svg())?;
    }
    if drawing.is_in_terminal() {
        return Ok(ExitCode::SUCCESS);
    }
    match session.format {
        Format::Table => table(&shown)?,
        Format::Json => json(&shown)?,
        Format::Csv => csv(&shown)?,
    }
    Ok(ExitCode::SUCCESS)
}

/// The labels of a categorical state; none for others.
async fn labels_of(session: &Session, map: &str, state: &str) -> anyhow::Result<Vec<String>> {
    let mut token = Some(String::new());
    // A name with a slash is not a categorical state.
    while let Some(page) = token.filter(|_| !state.contains('/')) {
        let (states, next) = session.client.states(map, &page).await?;
        if let Some(found) = states.into_iter().find(|known| known.name == state) {
            return Ok(found.labels);
        }
        token = next;
    }
    Ok(Vec::new())
}

/// A row for each label of a categorical state; `model show` of a label shows more.
async fn of_labels(session: &Session, map: &str, state: &str, labels: &[String]) -> anyhow::Result<ExitCode> {
    let mut rows = Vec::with_capacity(labels.len());
    for label in labels {
        let model = session.client.describe_model(map, &format!("{state}/{label}")).await?;
        let answers = answering(session, map, &model).await?;
        rows.push(vec![
            Cell::Text(model.state.clone()),
            model.mean.into(),
            model.learned_observations.into(),
            model.order.into(),
            Cell::Text(model.chosen.to_string()),
            Cell::Text(answers),
        ]);
    }
    session.print(&["state", "mean", "n", "order", "model", "auto"], rows)
}

/// The models of a state, and the name of the model with which `auto` answers: the selected one, or the ensemble of
/// several.
struct ShownModel {
    model: ModelDescription,
    answers: String,
}

impl ShownModel {
    /// Whether `auto` answers with the selected model alone.
    fn is_alone(&self) -> bool {
        self.answers == self.model.chosen.to_string()
    }
}

/// The name of the model with which `auto` answers. Before anything is learned it is the selected one.
async fn answering(session: &Session, map: &str, model: &ModelDescription) -> anyhow::Result<String> {
    let (selected, auto) = (model.chosen.to_string(), ModelSelector::default());
    let Some(last) = model.last_nanos else { return Ok(selected) };
    let mut predicted = session.client.predict(map, vec![model.state.clone()], vec![last], auto);
    let answered_by = predicted.next().await?.and_then(|run| run.answered_by);
    let is_selected = answered_by.is_none_or(|answered| answered.kind == model.chosen.kind);
    Ok(answered_by.filter(|_| !is_selected).map_or(selected, |answered| answered.to_string()))
}

const HOUR_NANOS: i64 = 3_600_000_000_000;

/// The week after the newest observation, hour by hour, as the model predicts it: a row for each local day.
async fn week(session: &Session, map: &str, state: &str, shown: &ShownModel) -> anyhow::Result<HeatMap> {
    let model = &shown.model;
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
        title: format!("{state}: a week as {} predicts it, hour by hour ({})", shown.answers, zone.name()),
        rows,
        columns: (0..24).map(|hour| format!("{hour:02}")).collect(),
        values: values.chunks(24).map(<[Option<f64>]>::to_vec).collect(),
        range: if is_probability { [0.0, 1.0] } else { [low, high] },
        unit: if is_probability { "probability" } else { "expected value" }.to_owned(),
        ..HeatMap::default()
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

fn summary(ShownModel { model, answers }: &ShownModel) -> [(&'static str, Cell); 11] {
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
        ("auto", Cell::Text(answers.clone())),
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
fn table(shown: &ShownModel) -> io::Result<()> {
    let model = &shown.model;
    let print = |columns: &[&str], rows: Vec<Vec<Cell>>| write_rows(Format::Table, columns, rows, stdout());
    let names = [model.chosen.to_string(), shown.answers.clone()].map(Cell::Text);
    let row =
        [Cell::Text(model.state.clone()), model.mean.into(), model.learned_observations.into(), model.order.into()]
            .into_iter()
            .chain(names)
            .collect();
    print(&["state", "mean", "n", "order", "model", "auto"], vec![row])?;
    if let Some(date) = &model.change_date {
        output::print(&format!(
            "\nThe routine seems to have changed: predictions have been worse since about {date}.\n"
        ))?;
    }
    if !model.model_errors.is_empty() {
        output::print("\n")?;
        let row = |(tried, error): &(ModelSelector, f64)| {
            let order = Cell::maybe(tried.order.map(|order| order as u64));
            vec![Cell::Text(tried.to_string()), order, (*error).into(), Cell::Flag(tried.kind == model.chosen.kind)]
        };
        let column = if shown.is_alone() { "used" } else { "best" };
        print(&["model", "order", "recent_error", column], model.model_errors.iter().map(row).collect())?;
    }
    if model.components.is_empty() {
        return output::print(
            "\nNo periodic component was found: this takes observed changes over at least one period, and an update.\n",
        );
    }
    output::print("\n")?;
    let row = |(index, component): (usize, &SpectralComponent)| {
        let cells = component_cells(component, used(model, index)).map(|(_, cell)| cell);
        [vec![Cell::Text(period(component.period_secs))], cells.to_vec()].concat()
    };
    let rows = model.components.iter().enumerate().map(row).collect();
    print(&["period", "period_secs", "amplitude", "phase_rad", "used"], rows)
}

/// One table for programs, a row per component. The columns of the state are repeated in each row; a state without
/// components has one row. The selected model, the recent errors of all models, and the model with which `auto` answers
/// are the last columns.
fn csv(shown: &ShownModel) -> io::Result<()> {
    let (model, summary) = (&shown.model, summary(shown));
    let columns = ["period_secs", "amplitude", "phase_rad", "used", "model", "recent_errors", "auto"];
    let columns: Vec<&'static str> = summary[..3].iter().map(|(name, _)| *name).chain(columns).collect();
    let errors = model.model_errors.iter().map(|(tried, error)| format!("{tried}={error}"));
    let tried = [model.chosen.to_string(), errors.collect::<Vec<_>>().join(" "), shown.answers.clone()].map(Cell::Text);
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

fn json(shown: &ShownModel) -> io::Result<()> {
    let model = &shown.model;
    let component = |(index, component)| {
        object(component_cells(component, used(model, index)).iter().map(|(name, cell)| (*name, cell.json())))
    };
    let components: Vec<String> = model.components.iter().enumerate().map(component).collect();
    let summary = summary(shown).map(|(name, cell)| (name, cell.json()));
    let state = ("state", Cell::Text(model.state.clone()).json());
    let components = ("components", format!("[{}]", components.join(",")));
    let error = |(model, error): &(ModelSelector, f64)| {
        let (name, order) = (Cell::Text(model.to_string()), Cell::maybe(model.order.map(|order| order as u64)));
        let error: Cell = (*error).into();
        object([("model", name.json()), ("order", order.json()), ("recent_error", error.json())].into_iter())
    };
    let errors: Vec<String> = model.model_errors.iter().map(error).collect();
    let errors = ("model_errors", format!("[{}]", errors.join(",")));
    output::print(&(object([state].into_iter().chain(summary).chain([components, errors])) + "\n"))
}
