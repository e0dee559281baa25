//! The output of the experiment: a row for each model and number of landmarks.
//!
//! Invariant: the table on stdout and `results.csv` are the same.

use std::{
    io::{self, Write},
    path::Path,
};

use super::{COUNTS, LocaliseComparison};
use crate::report::file;
use tidemap_formats::table::{Cell, Format, write_rows};

/// Writes a row for each model and number of landmarks of a place.
///
/// Columns: model; landmarks; `found`: places that were found, and their share; median error of the heading of these,
/// pixels, and the share of all pictures whose heading is off by more than 35 px; share of the landmarks of the true
/// place that were seen again; mean of the negative logarithm of the probability of the true place, nats; mean squared
/// error of all landmarks of the true place (Brier score), which does not depend on their number.
pub fn summary<W: Write>(outcome: &LocaliseComparison, format: Format, writer: W) -> io::Result<()> {
    let columns =
        ["model", "landmarks", "found", "share", "heading_px", "heading_wrong", "seen_again", "log_loss", "mse"];
    let pictures = outcome.pictures.max(1) as f64;
    let rows = outcome.models.iter().flat_map(|(model, scores)| {
        scores.places.iter().zip(COUNTS).map(|(places, count)| {
            vec![
                model.name().into(),
                Cell::Count(count as u64),
                Cell::Count(places.found as u64),
                (places.found as f64 / pictures).into(),
                Cell::maybe(places.heading_px()),
                (places.heading_wrong as f64 / pictures).into(),
                (places.seen_again / pictures).into(),
                (places.log_loss / pictures).into(),
                scores.mse().into(),
            ]
        })
    });
    write_rows(format, &columns, rows, writer)
}

/// Writes the files of the experiment into its folder, which exists.
pub fn write(outcome: &LocaliseComparison, folder: &Path) -> anyhow::Result<()> {
    file(folder, "results.csv", |writer| summary(outcome, Format::Csv, writer))
}
