//! The output of the experiment: a row for each setting, and its scores by day, by activity and by hour.
//!
//! Invariant: the table on stdout and `results.csv` are the same.

use std::{
    io::{self, Write},
    path::Path,
};

use super::{ActivityComparison, ActivityScores, TrueActivity, course::HOURS};
use crate::report::file;
use tidemap_formats::table::{Cell, Format, write_rows};

/// The first columns of each row.
const SETTING: [&str; 3] = ["classifier", "model", "place"];

fn setting_cells(scores: &ActivityScores) -> Vec<Cell> {
    let setting = &scores.setting;
    let place = if setting.knows_place { "yes" } else { "no" };
    vec![setting.classifier.name().into(), Cell::Text(setting.model.to_string()), place.into()]
}

/// Writes a row for each setting.
///
/// Columns: classifier; model; place: whether the place is a second prior; score: the mean posterior of the true
/// activity from the seventh day on, with its standard_error over seeds; slope of the error (1 - score) over the days
/// from the second on, and its two-sided p_value.
pub fn summary<W: Write>(outcome: &ActivityComparison, format: Format, writer: W) -> io::Result<()> {
    let columns = [&SETTING[..], &["score", "standard_error", "slope", "p_value"]].concat();
    let row = |scores: &ActivityScores| {
        let (late, trend) = (scores.late(), scores.error_trend());
        let mut cells = setting_cells(scores);
        cells.extend([
            Cell::maybe(late.map(|late| late.mean)),
            Cell::maybe(late.and_then(|late| late.standard_error)),
            Cell::maybe(trend.map(|trend| trend.slope)),
            Cell::maybe(trend.map(|trend| trend.p_value)),
        ]);
        cells
    };
    write_rows(format, &columns, outcome.settings.iter().map(row), writer)
}

/// Writes the files of the experiment into its folder, which exists.
pub fn write(outcome: &ActivityComparison, folder: &Path) -> anyhow::Result<()> {
    file(folder, "results.csv", |writer| summary(outcome, Format::Csv, writer))?;
    file(folder, "days.csv", |writer| days(outcome, writer))?;
    let activity = |label: usize| Cell::Text(outcome.activities[label].clone());
    let of_activity = |scores: &ActivityScores, label: usize| scores.late_sum(|other, _| other == label);
    file(folder, "activities.csv", |writer| {
        parts(outcome, writer, "activity", outcome.activities.len(), activity, of_activity)
    })?;
    let of_hour = |scores: &ActivityScores, hour: usize| scores.late_sum(|_, other| other == hour);
    file(folder, "hours.csv", |writer| parts(outcome, writer, "hour", HOURS, |hour| (hour as u64).into(), of_hour))
}

/// A row for each setting and day, counted from 1.
fn days<W: Write>(outcome: &ActivityComparison, writer: W) -> io::Result<()> {
    let columns = [&SETTING[..], &["day", "score", "standard_error"]].concat();
    let rows = outcome.settings.iter().flat_map(|scores| {
        (0..outcome.days).map(move |day| {
            let score = scores.day(day);
            let mut cells = setting_cells(scores);
            cells.extend([
                (day as u64 + 1).into(),
                Cell::maybe(score.map(|score| score.mean)),
                Cell::maybe(score.and_then(|score| score.standard_error)),
            ]);
            cells
        })
    });
    write_rows(Format::Csv, &columns, rows, writer)
}

/// A row for each setting and activity, or hour, with its minutes from the seventh day on, of all seeds.
fn parts<W: Write>(
    outcome: &ActivityComparison,
    writer: W,
    name: &str,
    count: usize,
    cell: impl Fn(usize) -> Cell,
    sum: impl Fn(&ActivityScores, usize) -> TrueActivity,
) -> io::Result<()> {
    let columns = [&SETTING[..], &[name, "minutes", "score"]].concat();
    let rows = outcome.settings.iter().flat_map(|scores| {
        let (cell, sum) = (&cell, &sum);
        let known = (0..count).map(move |part| (part, sum(scores, part))).filter(|(_, sum)| sum.minutes > 0);
        known.map(move |(part, sum)| {
            let mut cells = setting_cells(scores);
            cells.extend([cell(part), sum.minutes.into(), Cell::maybe(sum.score())]);
            cells
        })
    });
    write_rows(Format::Csv, &columns, rows, writer)
}
