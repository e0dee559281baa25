//! The output of the experiment: a row for each recording, lead time and way to predict.
//!
//! Invariant: the table on stdout and `results.csv` are the same.

use std::{
    io::{self, Write},
    path::Path,
};

use super::{FieldComparison, FieldRow};
use crate::report::file;
use tidemap_formats::table::{Cell, Format, write_rows};

const COLUMNS: [&str; 10] =
    ["recording", "states", "thinned", "lead", "model", "n", "mse", "loss", "coverage_80", "vs_best"];

/// Writes a row for each recording, unit of states, lead time and way to predict.
///
/// Columns: `thinned`: whether 5 % of the readings were learned; `n`: the number of predicted readings; `mse`: mean
/// squared error; `loss`: mean log loss (nats) of probabilities, mean CRPS of other values in their unit;
/// `coverage_80`: the share of intervals of 80 % that contained the mean of their hour; `vs_best`: by how many percent
/// the loss is above that of the best baseline. A value that does not exist is empty.
pub fn summary<W: Write>(outcome: &FieldComparison, format: Format, writer: W) -> io::Result<()> {
    write_rows(format, &COLUMNS, outcome.rows.iter().map(cells), writer)
}

fn cells(row: &FieldRow) -> Vec<Cell> {
    vec![
        row.recording.into(),
        row.states.as_str().into(),
        Cell::Flag(row.is_thinned),
        row.lead.name().into(),
        row.model.into(),
        row.errors.predictions.into(),
        row.errors.mse().into(),
        row.errors.loss().into(),
        Cell::maybe(row.errors.coverage()),
        Cell::maybe(row.above_best),
    ]
}

/// Writes the files of the experiment into its folder, which exists.
pub fn write(outcome: &FieldComparison, folder: &Path) -> anyhow::Result<()> {
    file(folder, "results.csv", |writer| summary(outcome, Format::Csv, writer))?;
    file(folder, "seconds.csv", |writer| seconds(outcome, writer))
}

/// A row for each run: how long it learned and asked.
fn seconds<W: Write>(outcome: &FieldComparison, writer: W) -> io::Result<()> {
    let rows = outcome
        .seconds
        .iter()
        .map(|run| vec![run.recording.into(), Cell::Flag(run.is_thinned), run.learning.into(), run.asking.into()]);
    write_rows(Format::Csv, &["recording", "thinned", "learning_secs", "asking_secs"], rows, writer)
}
