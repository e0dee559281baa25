//! The output of the experiment: a row for each robot, and a row for each of its weeks.
//!
//! Invariant: the table on stdout and `results.csv` are the same.

use std::{
    io::{self, Write},
    path::Path,
};

use super::{TerminalComparison, TerminalCourse, TerminalRobotKind};
use crate::report::file;
use tidemap_formats::table::{Cell, Format, write_rows};

/// Writes a row for each robot, with means over seeds.
///
/// Columns: robot; interactions an hour in all weeks, in the first and in the last; the interactions of all weeks
/// divided by those of the robot of random places, of the learned static place and of the best static place; and the
/// number of seeds in which they are more than those of the best static place.
pub fn summary<W: Write>(outcome: &TerminalComparison, format: Format, writer: W) -> io::Result<()> {
    let last = format!("week_{}", outcome.weeks);
    let columns =
        ["robot", "per_hour", "week_1", &last, "of_uniform", "of_static_learned", "of_static_best", "seeds_above_best"];
    let row = |course: &TerminalCourse| {
        let mean = |weeks| course.per_hour(weeks).mean;
        let against = |kind| outcome.against(course, kind);
        let (of_best, above) = against(TerminalRobotKind::StaticBest);
        vec![
            course.kind.name().into(),
            mean(0..outcome.weeks).into(),
            mean(0..1).into(),
            mean(outcome.weeks - 1..outcome.weeks).into(),
            against(TerminalRobotKind::Uniform).0.into(),
            against(TerminalRobotKind::StaticLearned).0.into(),
            of_best.into(),
            (above as u64).into(),
        ]
    };
    write_rows(format, &columns, outcome.courses.iter().map(row), writer)
}

/// Writes the files of the experiment into its folder, which exists.
pub fn write(outcome: &TerminalComparison, folder: &Path) -> anyhow::Result<()> {
    file(folder, "results.csv", |writer| summary(outcome, Format::Csv, writer))?;
    file(folder, "weeks.csv", |writer| weeks(outcome, writer))
}

/// A row for each robot and week, mean over seeds.
fn weeks<W: Write>(outcome: &TerminalComparison, writer: W) -> io::Result<()> {
    let rows = outcome.courses.iter().flat_map(|course| {
        (0..outcome.weeks).map(|week| {
            let per_hour = course.per_hour(week..week + 1);
            vec![
                course.kind.name().into(),
                (week as u64 + 1).into(),
                per_hour.mean.into(),
                Cell::maybe(per_hour.standard_error),
            ]
        })
    });
    write_rows(Format::Csv, &["robot", "week", "per_hour", "standard_error"], rows, writer)
}
