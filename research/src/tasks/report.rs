//! The output of the experiment: a row for each robot, and a row for each of its weeks.
//!
//! Invariant: the table on stdout and `results.csv` are the same.

use std::{
    io::{self, Write},
    path::Path,
};

use super::{TaskComparison, TaskCourse, TaskFigures};
use crate::{report::file, seed_mean::SeedMean};
use tidemap_formats::table::{Cell, Format, write_rows};

/// Writes a row for each robot, with means over seeds.
///
/// Columns: robot; failed traversals a week, and the failures divided by the failures of the first robot; the number of
/// seeds in which they are at most half of that robot's failures; failed traversals a task; tasks done and missed a
/// week; mean seconds by which a task was late; A %, and the longest lifetime of the system in days.
pub fn summary<W: Write>(outcome: &TaskComparison, format: Format, writer: W) -> io::Result<()> {
    let columns = [
        "robot",
        "failures",
        "of_first_come",
        "seeds_halved",
        "failures_per_task",
        "done",
        "missed",
        "late_secs",
        "autonomy_percent",
        "lifetime_days",
    ];
    let row = |course: &TaskCourse| {
        let all = 0..outcome.weeks;
        vec![
            course.kind.name().into(),
            course.weekly(all.clone(), |week| week.failures as f64).mean.into(),
            outcome.of_first_come(course).into(),
            (outcome.seeds_halved(course) as u64).into(),
            course.per_task(all.clone(), |week| week.failures as f64).mean.into(),
            course.weekly(all.clone(), |week| week.done as f64).mean.into(),
            course.weekly(all.clone(), |week| week.missed as f64).mean.into(),
            course.per_task(all.clone(), |week| week.late_secs).mean.into(),
            course.weekly(all.clone(), |week| week.autonomy_percent).mean.into(),
            course.lifetime_days(all).mean.into(),
        ]
    };
    write_rows(format, &columns, outcome.courses.iter().map(row), writer)
}

/// Writes the files of the experiment into its folder, which exists.
pub fn write(outcome: &TaskComparison, folder: &Path) -> anyhow::Result<()> {
    file(folder, "results.csv", |writer| summary(outcome, Format::Csv, writer))?;
    file(folder, "weeks.csv", |writer| weeks(outcome, writer))
}

/// A row for each robot and week, mean over seeds.
fn weeks<W: Write>(outcome: &TaskComparison, writer: W) -> io::Result<()> {
    let columns = [
        "robot",
        "week",
        "failures",
        "standard_error",
        "done",
        "missed",
        "late_secs",
        "autonomy_percent",
        "interventions",
        "lifetime_days",
    ];
    let rows = outcome.courses.iter().flat_map(|course| {
        (0..outcome.weeks).map(|index| {
            let week = index..index + 1;
            let mean = |figure: fn(&TaskFigures) -> f64| course.weekly(week.clone(), figure).mean;
            let failures: SeedMean = course.weekly(week.clone(), |week| week.failures as f64);
            vec![
                course.kind.name().into(),
                (index as u64 + 1).into(),
                failures.mean.into(),
                Cell::maybe(failures.standard_error),
                mean(|week| week.done as f64).into(),
                mean(|week| week.missed as f64).into(),
                course.per_task(week.clone(), |week| week.late_secs).mean.into(),
                mean(|week| week.autonomy_percent).into(),
                mean(|week| week.interventions as f64).into(),
                course.lifetime_days(week).mean.into(),
            ]
        })
    });
    write_rows(Format::Csv, &columns, rows, writer)
}
