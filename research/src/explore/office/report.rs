//! The output of an exploration of an office: a row for each day and explorer, the error in every slot, and a picture.
//!
//! Invariant: the table on stdout and `results.csv` are the same; errors are in percent of the cells seen so far.

use std::{
    io::{self, Write},
    path::Path,
};

use super::{DayFigures, OfficeExploration, OfficeProtocol, picture};
use crate::report::file;
use tidemap_formats::table::{Cell, Format, write_rows};

/// Writes a row for each day and explorer.
///
/// Columns: day, explorer, error_percent (mean over slots and seeds), difference_percent to the first explorer, its
/// p_value (the median over seeds of a paired test over the day's slots), seeds_better and seeds_worse (with p below
/// 0.05), changes_per_tour and changes (cells seen changed), discovered (cells seen for the first time), tours,
/// tours_8_to_18.
pub fn summary<W: Write>(
    protocol: &OfficeProtocol,
    outcome: &OfficeExploration,
    format: Format,
    writer: W,
) -> io::Result<()> {
    let columns = [
        "day",
        "explorer",
        "error_percent",
        "difference_percent",
        "p_value",
        "seeds_better",
        "seeds_worse",
        "changes_per_tour",
        "changes",
        "discovered",
        "tours",
        "tours_8_to_18",
    ];
    let row = |day: DayFigures| {
        let p_value = median(&day.p_values);
        let tested = |count: usize| Cell::maybe(p_value.map(|_| count as u64));
        vec![
            (day.day as u64).into(),
            day.kind.name().into(),
            (100.0 * day.error).into(),
            Cell::maybe(p_value.map(|_| 100.0 * day.difference)),
            Cell::maybe(p_value),
            tested(day.better),
            tested(day.worse),
            day.changes_per_tour.into(),
            day.changes.into(),
            day.discovered.into(),
            day.tours.into(),
            day.tours_by_day.into(),
        ]
    };
    write_rows(format, &columns, outcome.days(protocol).into_iter().map(row), writer)
}

/// The median; for an even count, the upper of the two middle values.
fn median(numbers: &[f64]) -> Option<f64> {
    let mut sorted = numbers.to_vec();
    sorted.sort_by(f64::total_cmp);
    sorted.get(sorted.len() / 2).copied()
}

/// Writes the files of an exploration into its folder, which exists.
pub fn write(protocol: &OfficeProtocol, outcome: &OfficeExploration, folder: &Path) -> anyhow::Result<()> {
    file(folder, "results.csv", |writer| summary(protocol, outcome, Format::Csv, writer))?;
    file(folder, "slots.csv", |writer| slots(protocol, outcome, writer))?;
    file(folder, "exploration.svg", |writer| writer.write_all(picture::draw(protocol, outcome).as_bytes()))
}

/// The error of every explorer in every slot, mean over seeds.
fn slots<W: Write>(protocol: &OfficeProtocol, outcome: &OfficeExploration, writer: W) -> io::Result<()> {
    let per_day = protocol.slots();
    let rows = protocol.explorers.iter().enumerate().flat_map(|(index, kind)| {
        (0..protocol.days * per_day).map(move |slot| {
            let (day, of_day) = (slot as u64 / per_day as u64 + 1, slot as u64 % per_day as u64);
            let error = outcome.error_at(index, slot).map(|error| 100.0 * error);
            vec![kind.name().into(), day.into(), of_day.into(), Cell::maybe(error)]
        })
    });
    write_rows(Format::Csv, &["explorer", "day", "slot", "error_percent"], rows, writer)
}
