//! The output of searches: a row for each model, and every trial of the tuning.
//!
//! Invariant: the table on stdout and `results.csv` are the same.

use std::{
    io::{self, Write},
    path::Path,
};

use super::{SearchComparison, SearchProtocol};
use crate::report::file;
use tidemap_formats::table::{Cell, Format, TableWriter};

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
    let mut table = TableWriter::new(format, &columns, writer);
    for row in &outcome.rows {
        let mut cells = vec![
            Cell::Text(row.label.clone()),
            Cell::Text(row.parameters.clone()),
            (row.times.count() as u64).into(),
            row.times.mean_secs().into(),
        ];
        cells.extend([0.5, 0.25, 0.75, 0.9].map(|share| Cell::from(row.times.quantile_secs(share))));
        table.row(cells)?;
    }
    table.finish()
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
    let columns = ["model", "parameters", "fold", "mean_secs", "mean_of_folds_secs", "chosen"];
    let mut table = TableWriter::new(Format::Csv, &columns, writer);
    for trial in &outcome.trials {
        let model = &protocol.models[trial.model];
        for (number, &mean_secs) in (1_u64..).zip(&trial.folds) {
            table.row(vec![
                Cell::Text(model.label.clone()),
                model.sets[trial.set].shown().into(),
                number.into(),
                mean_secs.into(),
                trial.error.into(),
                Cell::Flag(trial.is_chosen),
            ])?;
        }
    }
    table.finish()
}
