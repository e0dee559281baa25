//! The output of a comparison of robots: a row for each robot, a row for each of its weeks, and a picture.
//!
//! Invariant: the table on stdout and `results.csv` are the same.

use std::{
    io::{self, Write},
    path::Path,
};

use super::{RobotCourse, RouteComparison, picture};
use crate::report::file;
use tidemap_formats::table::{Cell, Format, write_rows};

/// Writes a row for each robot.
///
/// Columns: robot; failures a week in the first week, in the last, and on average over the later half of the weeks; the
/// failures of the later half divided by the failures of the shortest paths; slope of the failures over the weeks, its
/// two-sided p_value over seeds, and the number of seeds with a negative slope; slope and p_value without the first
/// week; failures and seconds a task in the later half.
pub fn summary<W: Write>(outcome: &RouteComparison, format: Format, writer: W) -> io::Result<()> {
    let late = outcome.late();
    let columns = [
        "robot",
        "week_1",
        &format!("week_{}", outcome.weeks),
        &format!("weeks_{}_{}", late.start + 1, late.end),
        "of_shortest",
        "slope",
        "p_value",
        "seeds_falling",
        "slope_from_2",
        "p_value_from_2",
        "failures_per_task",
        "secs_per_task",
    ];
    let row = |course: &RobotCourse| {
        let trend = outcome.trend(course, 0..outcome.weeks);
        let later = outcome.trend(course, 1..outcome.weeks);
        vec![
            course.kind.name().into(),
            course.failures(0..1).mean.into(),
            course.failures(outcome.weeks - 1..outcome.weeks).mean.into(),
            course.failures(late.clone()).mean.into(),
            outcome.of_shortest(course).into(),
            trend.slope.into(),
            Cell::maybe(trend.p_value),
            (trend.falling as u64).into(),
            later.slope.into(),
            Cell::maybe(later.p_value),
            course.failures_per_task(late.clone()).mean.into(),
            course.secs_per_task(late.clone()).mean.into(),
        ]
    };
    write_rows(format, &columns, outcome.courses.iter().map(row), writer)
}

/// Writes the files of the experiment into its folder, which exists.
pub fn write(outcome: &RouteComparison, folder: &Path) -> anyhow::Result<()> {
    file(folder, "results.csv", |writer| summary(outcome, Format::Csv, writer))?;
    file(folder, "weeks.csv", |writer| weeks(outcome, writer))?;
    file(folder, "routes.svg", |writer| writer.write_all(picture::draw(outcome).as_bytes()))
}

/// A row for each robot and week, mean over seeds.
fn weeks<W: Write>(outcome: &RouteComparison, writer: W) -> io::Result<()> {
    let columns = ["robot", "week", "failures", "standard_error", "failures_per_task", "secs_per_task"];
    let rows = outcome.courses.iter().flat_map(|course| {
        (0..outcome.weeks).map(|week| {
            let failures = course.failures(week..week + 1);
            vec![
                course.kind.name().into(),
                (week as u64 + 1).into(),
                failures.mean.into(),
                Cell::maybe(failures.standard_error),
                course.failures_per_task(week..week + 1).mean.into(),
                course.secs_per_task(week..week + 1).mean.into(),
            ]
        })
    });
    write_rows(Format::Csv, &columns, rows, writer)
}
