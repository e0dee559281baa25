//! The output of searches: a row for each model, and every trial of the tuning.
//!
//! Invariant: the table on stdout and `results.csv` are the same.

use std::{
    io::{self, Write},
    path::Path,
};

use super::{SearchComparison, SearchProtocol, SearchResult, TuningCriterion};
use crate::report::file;
use tidemap_formats::table::{Cell, Format, write_rows};

/// Writes a row for each model.
///
/// Columns: model, parameters, number of searches, then the time until the person is found: mean, median, quartiles and
/// 90th percentile.
pub fn summary<W: Write>(outcome: &SearchComparison, format: Format, writer: W) -> io::Result<()> {
    let columns = [
        "model",
        "parameters",
        "searches",
        "mean_secs",
        "median_secs",
        "quarter_secs",
        "three_quarters_secs",
        "p90_secs",
    ];
    let row = |row: &SearchResult| {
        let mut cells = vec![
            Cell::Text(row.label.clone()),
            Cell::Text(row.parameters.clone()),
            (row.times.count() as u64).into(),
            row.times.mean_secs().into(),
        ];
        cells.extend([0.5, 0.25, 0.75, 0.9].map(|share| Cell::from(row.times.quantile_secs(share))));
        cells
    };
    write_rows(format, &columns, outcome.rows.iter().map(row), writer)
}

/// Writes the files of an experiment into its folder, which exists.
pub fn write(protocol: &SearchProtocol, outcome: &SearchComparison, folder: &Path) -> anyhow::Result<()> {
    file(folder, "results.csv", |writer| summary(outcome, Format::Csv, writer))?;
    if outcome.trials.is_empty() {
        return Ok(());
    }
    file(folder, "folds.csv", |writer| trials(protocol, outcome, writer))
}

/// Every parameter set on every fold.
fn trials<W: Write>(protocol: &SearchProtocol, outcome: &SearchComparison, writer: W) -> io::Result<()> {
    let [error, mean] = match protocol.criterion {
        TuningCriterion::Seconds => ["mean_secs", "mean_of_folds_secs"],
        TuningCriterion::LogLoss => ["log_loss", "mean_of_folds_log_loss"],
    };
    let columns = ["model", "parameters", "fold", error, mean, "chosen"];
    let rows = outcome.trials.iter().flat_map(|trial| {
        let model = &protocol.models[trial.model];
        (1_u64..).zip(&trial.folds).map(move |(number, &error)| {
            vec![
                Cell::Text(model.label.clone()),
                model.sets[trial.set].shown().into(),
                number.into(),
                error.into(),
                trial.error.into(),
                Cell::Flag(trial.is_chosen),
            ]
        })
    });
    write_rows(Format::Csv, &columns, rows, writer)
}
