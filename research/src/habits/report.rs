//! The output of the experiment: a row for each habit, and the errors of the baselines.
//!
//! Invariant: the table on stdout and `results.csv` are the same.

use std::{
    io::{self, Write},
    path::Path,
};

use super::{BASELINES, Errors, HabitScores, HabitsComparison, HourClaims, LEVELS, SURE_WITHIN, Scores, Sure};
use crate::report::file;
use tidemap_formats::table::{Cell, Format, write_rows};

/// Writes a row for each habit, and one row of their means.
///
/// Columns: habit; mean squared error and log loss (nats) of the hidden state, and by which share they are above the
/// errors of the best baseline; `coverage_50`: the share of uncertain hours of which the mean lay in the interval of 50
/// %, and `mass_50`: the mean probability that the intervals stated; the same for other levels; `sure_99`: the share of
/// predictions below 0.01 or above 0.99, and `wrong_99`: the share of these that were wrong; `sure_999` and `wrong_999`
/// with 0.001 and 0.999. A value that does not exist is empty, and has no part in the mean.
pub fn summary<W: Write>(outcome: &HabitsComparison, format: Format, writer: W) -> io::Result<()> {
    let mut columns = ["habit", "mse", "mse_of_best", "log_loss", "log_loss_of_best"].map(str::to_owned).to_vec();
    let percent = |level: f64| (100.0 * level).round();
    columns
        .extend(LEVELS.iter().flat_map(|&level| ["coverage", "mass"].map(|word| format!("{word}_{}", percent(level)))));
    let nines = SURE_WITHIN.map(|within| (1.0 / within).round() as u64 - 1);
    columns.extend(nines.iter().flat_map(|nines| ["sure", "wrong"].map(|word| format!("{word}_{nines}"))));
    let figures: Vec<Vec<Option<f64>>> = outcome.habits.iter().map(|row| figures(&row.scores)).collect();
    let means = (0..columns.len() - 1).map(|column| mean(figures.iter().filter_map(|row| row[column])));
    let cells = |name: &str, figures: &[Option<f64>]| {
        std::iter::once(Cell::from(name)).chain(figures.iter().copied().map(Cell::maybe)).collect::<Vec<Cell>>()
    };
    let rows = outcome.habits.iter().zip(&figures).map(|(row, figures)| cells(row.habit.name, figures));
    write_rows(format, &columns, rows.chain([cells("all", &means.collect::<Vec<_>>())]), writer)
}

fn figures(scores: &Scores) -> Vec<Option<f64>> {
    let errors = [scores.auto.mse(), scores.mse_of_best(), scores.auto.log_loss(), scores.log_loss_of_best()];
    let held = scores.held.iter().flat_map(|held: &HourClaims| [held.held(), held.claimed()]);
    let sure = scores.sure.iter().flat_map(|sure: &Sure| [Some(sure.share()), sure.wrong()]);
    errors.into_iter().map(Some).chain(held).chain(sure).collect()
}

fn mean(values: impl Iterator<Item = f64>) -> Option<f64> {
    let (sum, count) = values.fold((0.0, 0_u32), |(sum, count), value| (sum + value, count + 1));
    (count > 0).then(|| sum / f64::from(count))
}

/// Writes the files of the experiment into its folder, which exists.
pub fn write(outcome: &HabitsComparison, folder: &Path) -> anyhow::Result<()> {
    file(folder, "results.csv", |writer| summary(outcome, Format::Csv, writer))?;
    file(folder, "errors.csv", |writer| errors(outcome, writer))
}

/// A row for each habit and each way to predict: `auto`, the baselines, and the true probability.
fn errors<W: Write>(outcome: &HabitsComparison, writer: W) -> io::Result<()> {
    let rows = outcome.habits.iter().flat_map(|HabitScores { habit, scores }| {
        let named = |name: &'static str, errors: &Errors| {
            vec![habit.name.into(), name.into(), errors.mse().into(), errors.log_loss().into()]
        };
        let baselines = BASELINES.into_iter().zip(&scores.baselines);
        let all = [("auto", &scores.auto)].into_iter().chain(baselines).chain([("truth", &scores.truth)]);
        all.map(|(name, errors)| named(name, errors)).collect::<Vec<_>>()
    });
    write_rows(Format::Csv, &["habit", "prediction", "mse", "log_loss"], rows, writer)
}
