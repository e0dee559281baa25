//! `tidemap evaluate`.
//!
//! Invariant: invalid rows are left out and reported; the map learns nothing from the file.

use std::{collections::HashMap, path::PathBuf, process::ExitCode, str::FromStr};

use anyhow::Context as _;
use clap::Args;
use tidemap_client::queries::{
    Comparison, EvaluateOptions, InvalidModel, ModelKind, ModelSelector, ORDER_MAX, StateEvaluation, Unavailable,
};

use super::{
    Session,
    observe::{
        feed::{self, Feed, RefusalReport},
        kinds::Kinds,
    },
    predict::names,
    rows::{FileArgs, RowKindArgs},
};
use crate::progress::{Bar, status_line};
use tidemap_formats::{
    observation_file::{ObservationColumns, ObservationRow, RowError},
    table::Cell,
};

#[derive(Debug, Args)]
pub(crate) struct EvaluateArgs {
    /// Name of the map
    map: String,
    /// File with the columns time,state,value; - is stdin
    file: PathBuf,
    /// Maximum order of the spectral model, 0 to 15 [default: 15]
    #[arg(long, value_name = "N", value_parser = clap::value_parser!(u32).range(0..=ORDER_MAX as i64))]
    max_order: Option<u32>,
    #[arg(long, value_name = "KIND,…", value_delimiter = ',', default_value = "spectral", help = models_help())]
    models: Vec<ModelArg>,
    #[command(flatten)]
    rows: RowKindArgs,
    #[command(flatten)]
    written: FileArgs,
}

fn models_help() -> String {
    let forms = ModelKind::forms();
    format!("Models, each optionally with +persistence or +memory: {forms}; or all, for every kind without a suffix")
}

/// A model, or all models.
#[derive(Clone, Debug)]
enum ModelArg {
    All,
    One(ModelSelector),
}

impl FromStr for ModelArg {
    type Err = InvalidModel;

    fn from_str(text: &str) -> Result<Self, InvalidModel> {
        if text == "all" { Ok(Self::All) } else { text.parse().map(Self::One) }
    }
}

fn selected(choices: &[ModelArg]) -> Vec<ModelSelector> {
    let mut models = Vec::new();
    for choice in choices {
        let chosen = match choice {
            ModelArg::All => ModelKind::ALL.map(|kind| ModelSelector { kind, ..ModelSelector::default() }).to_vec(),
            ModelArg::One(model) => vec![*model],
        };
        // A model that is named twice is evaluated once.
        models.extend(chosen.into_iter().filter(|model| !models.contains(model)).collect::<Vec<_>>());
    }
    models
}

/// Whether the user named this model, not only `all`.
fn is_named(choices: &[ModelArg], model: ModelSelector) -> bool {
    choices.iter().any(|choice| match choice {
        ModelArg::All => false,
        // The daemon fills in omitted parameters.
        ModelArg::One(named) => ModelSelector { order: model.order, ..*named } == model,
    })
}

/// The message about a model that is left out.
fn missing(unavailable: &Unavailable) -> String {
    const SHOWN: usize = 5;
    let Unavailable { model, reason, states } = unavailable;
    let more = states.len().saturating_sub(SHOWN);
    let and_more = if more > 0 { format!(" and {more} more") } else { String::new() };
    format!("{model} is left out of {}{and_more}: {reason}", states[..states.len() - more].join(", "))
}

/// Why a row is left out whose state has not its label.
fn unknown_label(row: &ObservationRow, labels: &HashMap<String, Vec<String>>) -> Option<String> {
    let (label, known) = (row.label.as_ref()?, labels.get(&row.state)?);
    let text = || format!("state {:?} has no label {label:?}: its labels are {}", row.state, known.join(", "));
    (!known.contains(label)).then(text)
}

pub(crate) async fn run(session: &Session, args: EvaluateArgs) -> anyhow::Result<ExitCode> {
    let shown = feed::display_name(&args.file);
    // The daemon knows how a state holds its values.
    let mut rules = args.written.rules(session, &args.map, args.rows.kind()).await?;
    let known = names::states(session, &args.map).await?.into_iter().filter(|state| !state.labels.is_empty());
    let labels: HashMap<String, Vec<String>> = known.map(|state| (state.name, state.labels)).collect();
    rules.labelled = labels.keys().map(|name| (name.chars().collect(), true)).collect();
    let Feed { mut rows, total_bytes, layout } = feed::open::<ObservationColumns>(&args.file, &rules)?;
    if layout.has_positions() {
        return Err(anyhow::Error::new(RowError::Positions).context(feed::display_name(&args.file)));
    }
    let options = EvaluateOptions { map: args.map, models: selected(&args.models), max_order: args.max_order };
    let mut kinds = Kinds::new(session.client.clone(), options.map.clone(), None);
    let mut evaluator = session.client.evaluate(options);
    let bar = Bar::bytes(total_bytes);
    let mut report = RefusalReport::new(bar.clone(), "row", "is left out");
    'file: while let Some(chunk) = rows.recv().await {
        let chunk = chunk.with_context(|| shown.clone())?;
        bar.set(chunk.bytes);
        for row in &chunk.rows {
            let wrong = match unknown_label(row, &labels) {
                None => kinds.wrong(row).await,
                unknown => unknown,
            };
            if let Some(wrong) = wrong {
                report.refused(row.number, Some(row.line), &wrong);
                continue;
            }
            let is_open = match &row.label {
                Some(label) => evaluator.add_label(&row.state, row.time_nanos, label).await,
                None => evaluator.add(&row.state, row.time_nanos, row.value).await,
            };
            if !is_open {
                break 'file;
            }
        }
        report.last_line(&chunk);
    }
    let Comparison { evaluations, unavailable } = evaluator.finish().await?;
    bar.clear();
    // Scripts rely on the columns of other states.
    let has_labels = evaluations.iter().any(|evaluation| evaluation.log_loss_bits.is_some());
    let row = |evaluation: StateEvaluation| {
        let log_loss = has_labels.then(|| Cell::maybe(evaluation.log_loss_bits));
        let cells = [
            Cell::Text(evaluation.state),
            Cell::Text(evaluation.model.to_string()),
            Cell::maybe(evaluation.model.order.map(|order| order as u64)),
            evaluation.observations.into(),
            evaluation.mean_squared_error.into(),
            Cell::maybe(evaluation.error_rate),
        ];
        cells.into_iter().chain(log_loss).collect::<Vec<Cell>>()
    };
    let columns = ["state", "model", "order", "n", "mse", "error_rate", "log_loss_bits"];
    let shown = if has_labels { &columns[..] } else { &columns[..6] };
    session.print(shown, evaluations.into_iter().map(row))?;
    unavailable.iter().for_each(|unavailable| status_line(&missing(unavailable)));
    let all_there = !unavailable.iter().any(|unavailable| is_named(&args.models, unavailable.model));
    Ok(if report.is_clean() && all_there { ExitCode::SUCCESS } else { ExitCode::FAILURE })
}

#[cfg(test)]
mod tests {
    use super::*;

    fn choices(texts: &[&str]) -> Vec<ModelArg> {
        texts.iter().map(|text| text.parse().expect(text)).collect()
    }

    #[test]
    fn all_means_every_kind_and_a_name_twice_means_one() {
        assert_eq!(selected(&choices(&["all"])).len(), ModelKind::ALL.len());
        assert_eq!(selected(&choices(&["mean", "all", "mean"])).len(), ModelKind::ALL.len());
        assert_eq!(selected(&choices(&["pergam:3", "pergam:4"])).len(), 2);
    }

    #[test]
    fn named_models_are_distinguished_from_those_of_all() {
        let model: ModelSelector = "pergam:3".parse().expect("a model");
        for (texts, named) in [
            (["all"], false),
            (["pergam"], true),
            (["pergam:3"], true),
            (["pergam:4"], false),
            (["pergam+persistence"], false),
            (["mean"], false),
        ] {
            assert_eq!(is_named(&choices(&texts), model), named, "{texts:?}");
        }
        let weekly = "histogram:week:168".parse().expect("a model");
        assert!(is_named(&choices(&["histogram:week"]), weekly) && !is_named(&choices(&["histogram"]), weekly));
    }

    #[test]
    fn a_missing_model_names_some_of_its_states() {
        let states = |count: usize| (0..count).map(|i| format!("s{i}")).collect();
        let model = "pergam:3".parse().expect("a model");
        let unavailable = |count| Unavailable { model, reason: "it is so".to_owned(), states: states(count) };
        assert_eq!(missing(&unavailable(1)), "pergam:3 is left out of s0: it is so");
        assert_eq!(missing(&unavailable(7)), "pergam:3 is left out of s0, s1, s2, s3, s4 and 2 more: it is so");
    }
}
