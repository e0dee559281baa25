//! `tidemap sample`: data to try tidemap with, and the commands to try.
//!
//! Invariant: the same version writes the same files. An existing folder is never written into.

mod building;
mod clouds;
mod door;
mod grid;
mod home;
mod office;
mod recording;

use std::{
    fs,
    path::{Path, PathBuf},
    process::ExitCode,
};

use anyhow::Context as _;
use clap::{Args, ValueEnum};
use tidemap_formats::table::{Cell, Format, write_rows};
use tidemap_sim::Office;

use crate::{commands::UsageError, output::stdout, progress::status_line};

/// Time zone of the simulated people.
const ZONE: &str = "Europe/London";
const SEED: u64 = 1;
const SEC: i64 = 1_000_000_000;
const DAY_SECS: i64 = 86_400;
/// Monday, 6 January 2025, midnight in London.
const START_SECS: i64 = 1_736_121_600;

#[derive(Clone, Debug, Args)]
pub(crate) struct SampleArgs {
    /// The sample; without it, all samples are listed
    name: Option<Sample>,
    /// Folder to write, which must not exist [default: sample-NAME]
    folder: Option<PathBuf>,
    #[command(flatten)]
    building: BuildingArgs,
    #[command(flatten)]
    clouds: CloudArgs,
}

/// Other sizes of the building, for tests.
#[derive(Clone, Copy, Debug, Args)]
struct BuildingArgs {
    /// Size of a cell, metres
    #[arg(long, hide = true, default_value_t = 0.1)]
    cell: f64,
    /// Days
    #[arg(long, hide = true, default_value_t = 14, value_parser = clap::value_parser!(u16).range(1..=365))]
    days: u16,
    /// Maps a day
    #[arg(long, hide = true, default_value_t = 24, value_parser = clap::value_parser!(u16).range(1..=1_440))]
    scans_per_day: u16,
}

#[derive(Clone, Copy, Debug, PartialEq, Eq, ValueEnum)]
enum Sample {
    /// Three weeks of one door
    Door,
    /// Six weeks of an office: doors and rooms seen by three robots, its topological map, and their traversals
    Office,
    /// Two weeks of a building: maps of its floor by the hour, rooms, its topological map, and a robot's traversals
    Building,
    /// Twelve weeks of forty sensors of a home, as a hub exports them: changes only, local times, its own columns
    Home,
    /// Two weeks of scans of an office of real size, 213,000 cells of 0.1 m
    Grid,
    /// Two weeks of a robot in a corridor with two doors, as ROS 2 records it: scans, transforms, doors
    Recording,
    /// A minute of a robot with a 3-D scanner: ten point clouds of 100,000 points a second, as ROS 2 records them
    Clouds,
}

/// Options of the sample of point clouds.
#[derive(Clone, Copy, Debug, Args)]
pub(crate) struct CloudArgs {
    /// For `clouds`: seconds of the recording, 12 MB each
    #[arg(long, value_name = "N", default_value_t = 60, value_parser = clap::value_parser!(u32).range(1..=36_000))]
    seconds: u32,
}

/// A file of a sample.
struct SampleFile {
    name: &'static str,
    rows: u64,
    what: &'static str,
}

impl Sample {
    fn name(self) -> &'static str {
        match self {
            Self::Door => "door",
            Self::Office => "office",
            Self::Building => "building",
            Self::Home => "home",
            Self::Grid => "grid",
            Self::Recording => "recording",
            Self::Clouds => "clouds",
        }
    }

    fn what(self) -> &'static str {
        match self {
            Self::Door => "three weeks of one door",
            Self::Office => "six weeks of an office: states, topological map, traversals, and the week after",
            Self::Building => "two weeks of a building: a Nav2 map for each hour, rooms, topological map, traversals",
            Self::Home => "twelve weeks of forty sensors of a home that report changes, and the week after",
            Self::Grid => "two weeks of scans of an office of real size, 213,000 cells of 0.1 m",
            Self::Clouds => "a minute of a robot with a 3-D scanner: point clouds of 100,000 points",
            Self::Recording => "two weeks of a robot in a corridor with two doors, as ROS 2 records it",
        }
    }

    fn write(self, folder: &Path, building: &BuildingArgs, clouds: &CloudArgs) -> anyhow::Result<Vec<SampleFile>> {
        match self {
            Self::Door => door::write(folder),
            Self::Office => office::write(folder),
            Self::Building => building::write(folder, building),
            Self::Home => home::write(folder),
            Self::Grid => grid::write(folder),
            Self::Recording => recording::write(folder),
            Self::Clouds => clouds::write(folder, clouds),
        }
    }
}

/// The observations of a robot of the simulated office in some days as rows, and their number.
fn observed(office: &Office, robot: usize, days: i64, keep: impl Fn(&str) -> bool) -> (String, u64) {
    let (mut text, mut rows) = ("time,state,value\n".to_owned(), 0);
    for (time, state, value) in office.visits(robot, START_SECS * SEC, (START_SECS + days * DAY_SECS) * SEC) {
        let state = office.states()[state];
        if keep(state) {
            text += &format!("{},{state},{value}\n", time / SEC);
            rows += 1;
        }
    }
    (text, rows)
}

/// Writes a sample, or lists all.
pub(crate) fn run(args: &SampleArgs, format: Format) -> anyhow::Result<ExitCode> {
    let Some(sample) = args.name else {
        let row = |sample: &Sample| {
            vec![sample.name().into(), sample.what().into(), Cell::Text(format!("tidemap sample {}", sample.name()))]
        };
        write_rows(format, &["sample", "content", "command"], Sample::value_variants().iter().map(row), stdout())?;
        return Ok(ExitCode::SUCCESS);
    };
    let folder = args.folder.clone().unwrap_or_else(|| PathBuf::from(format!("sample-{}", sample.name())));
    let shown = folder.display();
    if folder.exists() {
        return Err(UsageError(format!("{shown} exists: name another folder, or remove it")).into());
    }
    fs::create_dir_all(&folder).with_context(|| shown.to_string())?;
    let files = sample.write(&folder, &args.building, &args.clouds).with_context(|| shown.to_string())?;
    let row = |file: &SampleFile| vec![file.name.into(), file.rows.into(), file.what.into()];
    write_rows(format, &["file", "rows", "content"], files.iter().map(row), stdout())?;
    status_line(&format!("with a daemon running, try it: sh {shown}/try.sh, or its commands one by one"));
    Ok(ExitCode::SUCCESS)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn samples_are_the_same_each_time() -> anyhow::Result<()> {
        let folder = tempfile::tempdir()?;
        let small = BuildingArgs { cell: 0.4, days: 1, scans_per_day: 2 };
        for sample in [Sample::Door, Sample::Office, Sample::Home, Sample::Building] {
            let mut contents = Vec::new();
            for name in ["a", "b"] {
                let folder = folder.path().join(sample.name().to_owned() + name);
                fs::create_dir(&folder)?;
                let mut files = sample.write(&folder, &small, &CloudArgs { seconds: 1 })?;
                files.retain(|file| file.name != "maps");
                let read = |file: &SampleFile| fs::read_to_string(folder.join(file.name));
                contents.push(files.iter().map(read).collect::<Result<Vec<_>, _>>()?);
                for (file, text) in files.iter().zip(&contents[0]).filter(|(file, _)| file.name.ends_with(".csv")) {
                    assert_eq!(text.lines().count() as u64, file.rows + 1, "{}", file.name);
                }
                assert!(files.iter().any(|file| file.name == "try.sh"));
            }
            assert_eq!(contents[0], contents[1]);
        }
        Ok(())
    }
}
