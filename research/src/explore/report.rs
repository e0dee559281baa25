//! The output of an exploration: a row for each strategy and model, the error of every week, and a picture.
//!
//! Invariant: the table on stdout and `results.csv` are the same; errors are in percent of all states.

use std::{
    io::{self, Write},
    path::Path,
};

use super::{Exploration, PlacesProtocol, StrategyResult, WEEK_DAYS, picture};
use crate::report::file;
use tidemap_formats::table::{Cell, Format, write_rows};

/// Writes a row for each strategy and model.
///
/// Columns: exploration (if the protocol lists several), strategy, information (likewise), model, error_percent over
/// the whole world and its standard error over seeds, both also for the weeks that are scored separately, and
/// visits_per_day.
pub fn summary<W: Write>(
    protocol: &PlacesProtocol,
    outcome: &Exploration,
    format: Format,
    writer: W,
) -> io::Result<()> {
    let mut columns = names(protocol).map(str::to_owned).collect::<Vec<_>>();
    columns.extend(["error_percent", "standard_error"].map(str::to_owned));
    if let Some((first, last)) = protocol.weeks {
        columns.push(format!("weeks_{first}_{last}_percent"));
        columns.push(format!("weeks_{first}_{last}_standard_error"));
    }
    columns.push("visits_per_day".to_owned());
    let row = |result: &StrategyResult| {
        let mut cells = named(protocol, result);
        let apart = protocol.weeks.map(|(first, last)| (first - 1) * WEEK_DAYS..last * WEEK_DAYS);
        for days in std::iter::once(0..outcome.days).chain(apart) {
            let error = result.error(days);
            cells.push((100.0 * error.mean).into());
            cells.push(Cell::maybe(error.standard_error.map(|error| 100.0 * error)));
        }
        cells.push(result.visits_per_day.into());
        cells
    };
    write_rows(format, &columns, outcome.results.iter().map(row), writer)
}

/// The columns that name a result.
fn names(protocol: &PlacesProtocol) -> impl Iterator<Item = &'static str> + use<> {
    let several = (protocol.explorations.len() > 1).then_some("exploration");
    let worths = (protocol.worths.len() > 1).then_some("information");
    several.into_iter().chain(["strategy"]).chain(worths).chain(["model"])
}

/// The values of [`names`] for a result.
fn named(protocol: &PlacesProtocol, result: &StrategyResult) -> Vec<Cell> {
    let mut cells = Vec::with_capacity(4);
    cells.extend((protocol.explorations.len() > 1).then_some(Cell::Number(result.exploration)));
    cells.push(result.strategy.name().into());
    cells.extend((protocol.worths.len() > 1).then(|| Cell::from(result.worth.name())));
    cells.push(Cell::Text(result.model.name()));
    cells
}

/// Writes the files of an exploration into its folder, which exists.
pub fn write(protocol: &PlacesProtocol, outcome: &Exploration, folder: &Path) -> anyhow::Result<()> {
    file(folder, "results.csv", |writer| summary(protocol, outcome, Format::Csv, writer))?;
    file(folder, "weeks.csv", |writer| weeks(protocol, outcome, writer))?;
    file(folder, "exploration.svg", |writer| writer.write_all(picture::draw(protocol, outcome).as_bytes()))
}

/// The error of every week; the last week may be short.
fn weeks<W: Write>(protocol: &PlacesProtocol, outcome: &Exploration, writer: W) -> io::Result<()> {
    let rows = outcome.results.iter().flat_map(|result| {
        (1_u64..).zip((0..outcome.days).step_by(WEEK_DAYS)).map(|(week, from)| {
            let error = result.error(from..outcome.days.min(from + WEEK_DAYS));
            let (mean, deviation) = (100.0 * error.mean, error.standard_error.map(|error| 100.0 * error));
            let mut cells = named(protocol, result);
            cells.extend([week.into(), mean.into(), Cell::maybe(deviation)]);
            cells
        })
    });
    let columns: Vec<&str> = names(protocol).chain(["week", "error_percent", "standard_error"]).collect();
    write_rows(Format::Csv, &columns, rows, writer)
}
