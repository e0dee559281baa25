//! `tidemap evaluate`.
//!
//! Invariant: rows that cannot be read are left out and said so; nothing of the file is learned.

use std::{path::PathBuf, process::ExitCode, str::FromStr};

use anyhow::Context as _;
use clap::Args;
use tidemap::queries::{EvaluateOptions, InvalidModel, ModelKind, ModelSelector, ORDER_MAX};

use super::{
    Session,
    observe::feed::{self, Feed, Told},
};
use crate::{
    output::{Cell, Sheet},
    progress::Bar,
};

#[derive(Debug, Args)]
pub struct EvaluateArgs {
    /// Name of the map
    map: String,
    /// File with the columns time,state,value; - is stdin
    file: PathBuf,
    /// Greatest order of the spectral model, 0 to 15 [default: 15]
    #[arg(long, value_name = "N", value_parser = clap::value_parser!(u32).range(0..=i64::from(ORDER_MAX)))]
    max_order: Option<u32>,
    /// Models: auto, mean, latest, spectral, each optionally with +persistence; or all, for the four without it
    #[arg(long, value_name = "KIND,…", value_delimiter = ',', default_value = "spectral")]
    models: Vec<Choice>,
}

/// A model, or all of them.
#[derive(Clone, Debug)]
enum Choice {
    All,
    One(ModelSelector),
}

impl FromStr for Choice {
    type Err = InvalidModel;

    fn from_str(text: &str) -> Result<Self, InvalidModel> {
        if text == "all" { Ok(Self::All) } else { text.parse().map(Self::One) }
    }
}

fn selected(choices: Vec<Choice>) -> Vec<ModelSelector> {
    let mut models = Vec::new();
    for choice in choices {
        let chosen = match choice {
            Choice::All => ModelKind::ALL.map(|kind| ModelSelector { kind, ..ModelSelector::default() }).to_vec(),
            Choice::One(model) => vec![model],
        };
        // Naming a model twice asks for it once.
        models.extend(chosen.into_iter().filter(|model| !models.contains(model)).collect::<Vec<_>>());
    }
    models
}

pub async fn run(session: &Session, args: EvaluateArgs) -> anyhow::Result<ExitCode> {
    let shown = feed::shown(&args.file);
    let Feed { mut rows, total_bytes } = feed::open(&args.file)?;
    let options = EvaluateOptions { map: args.map, models: selected(args.models), max_order: args.max_order };
    let mut evaluator = session.client.evaluate(options);
    let bar = Bar::bytes(total_bytes);
    let mut told = Told::new(bar.clone(), "is left out");
    'file: while let Some(chunk) = rows.recv().await {
        let chunk = chunk.with_context(|| shown.clone())?;
        bar.set(chunk.bytes);
        for row in &chunk.rows {
            if let Some(wrong) = &row.wrong {
                told.refused(row.number, Some(row.line), wrong);
            } else if !evaluator.add(&row.state, row.time_nanos, row.value).await {
                break 'file;
            }
        }
        told.last_line(&chunk);
    }
    let evaluations = evaluator.finish().await?;
    bar.clear();
    let mut sheet = Sheet::stdout(session.format, &["state", "model", "order", "n", "mse", "error_rate"]);
    for evaluation in evaluations {
        sheet.row(vec![
            Cell::Text(evaluation.state),
            Cell::Text(evaluation.model.to_string()),
            Cell::maybe(evaluation.model.order),
            evaluation.observations.into(),
            evaluation.mean_squared_error.into(),
            evaluation.error_rate.into(),
        ])?;
    }
    sheet.finish()?;
    Ok(if told.all_well() { ExitCode::SUCCESS } else { ExitCode::FAILURE })
}
