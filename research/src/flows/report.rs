//! The output of a comparison of flows: a row for each model, and a row for each way to cross the floor.
//!
//! Invariant: the table on stdout and `results.csv` are the same.

use std::{
    io::{self, Write},
    path::Path,
};

use tidemap_formats::table::{Cell, Format, write_rows};

use super::{ComparedFlow, Crossing, FlowComparison};
use crate::report::file;

/// Writes a row for each way to cross the floor, the shortest first.
///
/// Columns: robot; squared error of the number of detections in a cell and ten minutes by its model, divided by the
/// error of the mean, with the two-sided p_value over days; log-likelihood of a detected direction by its model in
/// nats, with the p_value against the timeless histogram; seconds near people, people near, and metres, each for a
/// trip; the seconds near people and the metres of the shortest way being 1.
pub fn summary<W: Write>(outcome: &FlowComparison, format: Format, writer: W) -> io::Result<()> {
    let columns = [
        "robot",
        "of_mean_error",
        "error_p_value",
        "direction_nats",
        "direction_p_value",
        "near_secs",
        "people",
        "metres",
        "of_shortest_near",
        "of_shortest_metres",
    ];
    let mean = outcome.scores.first().map_or(f64::NAN, |score| score.squared_error);
    let shortest = outcome.trips.first().copied().unwrap_or_default();
    let rows = Crossing::ALL.iter().zip(&outcome.trips).map(|(crossing, trips)| {
        let model = crossing.model();
        let score = model.and_then(|model| outcome.scores.get(usize::from(model == ComparedFlow::Spectral)));
        let is_tested = model == Some(ComparedFlow::Spectral);
        vec![
            crossing.name().into(),
            Cell::maybe(score.map(|score| score.squared_error / mean)),
            Cell::maybe(outcome.count_p_value.filter(|_| is_tested)),
            Cell::maybe(score.map(|score| score.direction_nats)),
            Cell::maybe(outcome.direction_p_value.filter(|_| is_tested)),
            trips.per_trip(trips.near_secs).into(),
            trips.per_trip(trips.people as f64).into(),
            trips.per_trip(trips.metres).into(),
            (trips.per_trip(trips.near_secs) / shortest.per_trip(shortest.near_secs)).into(),
            (trips.per_trip(trips.metres) / shortest.per_trip(shortest.metres)).into(),
        ]
    });
    write_rows(format, &columns, rows, writer)
}

/// Writes the files of the experiment into its folder, which exists.
pub fn write(outcome: &FlowComparison, folder: &Path) -> anyhow::Result<()> {
    file(folder, "results.csv", |writer| summary(outcome, Format::Csv, writer))
}
