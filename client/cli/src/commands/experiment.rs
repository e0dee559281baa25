//! `tidemap experiment`.
//!
//! Invariant: no daemon is asked. A word after `experiment` that names no kind of experiment is a protocol's file, and a
//! protocol's file ends in .yaml or .yml, so that kinds that come later take no file's name away.

use std::{
    fs,
    io::{self, IsTerminal as _},
    path::{Path, PathBuf},
    process::ExitCode,
};

use anyhow::Context as _;
use clap::{Args, Subcommand};

use super::UsageError;
use crate::progress::{Bar, status_line};
use tidemap_experiment::{
    self, ProtocolError,
    explore::{self, ExploreProtocol, office},
    routes, search,
};
use tidemap_formats::table::Format;

#[derive(Debug, Args)]
#[command(args_conflicts_with_subcommands = true, subcommand_negates_reqs = true, subcommand_value_name = "KIND")]
pub struct ExperimentArgs {
    #[command(flatten)]
    compare: Option<CompareArgs>,
    #[command(subcommand)]
    kind: Option<ExperimentKind>,
}

#[derive(Debug, Subcommand)]
enum ExperimentKind {
    /// Compares temporal models by a protocol; the same as a protocol's file alone
    Compare(CompareArgs),
    /// Explores a recorded world of places, or a simulated office: where to look, and what is learned from it
    Explore(CompareArgs),
    /// Searches a recorded world for a person at every minute: how long it takes, by each model
    Search(CompareArgs),
    /// Sends robots around a simulated building: how often those fail that follow routes, week by week
    Routes(RoutesArgs),
}

#[derive(Debug, Args)]
struct RoutesArgs {
    /// Buildings, with another luck each
    #[arg(long, value_name = "N", default_value_t = 20, value_parser = clap::value_parser!(u64).range(1..=1_000))]
    seeds: u64,
    /// The first seed of their luck
    #[arg(long, value_name = "N", default_value_t = 0)]
    first_seed: u64,
    /// Weeks that robots drive in each
    #[arg(long, value_name = "N", default_value_t = 10, value_parser = clap::value_parser!(u64).range(2..=520))]
    weeks: u64,
    /// Tasks of each robot a day
    #[arg(long, value_name = "N", default_value_t = 24, value_parser = clap::value_parser!(u64).range(1..=500))]
    tasks: u64,
    /// Folder of the results
    #[arg(long, value_name = "DIR", default_value = "routes-results")]
    out: PathBuf,
}

#[derive(Debug, Args)]
struct CompareArgs {
    /// The protocol, ending in .yaml or .yml; deploy/experiments has examples
    #[arg(value_name = "FILE.yaml", value_parser = protocol_file)]
    protocol: PathBuf,
    /// Folder of the results, instead of the protocol's `out`
    #[arg(long, value_name = "DIR")]
    out: Option<PathBuf>,
}

fn protocol_file(text: &str) -> Result<PathBuf, String> {
    let path = PathBuf::from(text);
    match path.extension().and_then(|ending| ending.to_str()) {
        Some("yaml" | "yml") => Ok(path),
        _ => Err(
            "it is neither a protocol, a file that ends in .yaml or .yml, nor a kind of experiment: compare, explore, \
             search, routes"
                .to_owned(),
        ),
    }
}

pub fn run(args: ExperimentArgs, format: Format) -> anyhow::Result<ExitCode> {
    match (args.kind, args.compare) {
        (Some(ExperimentKind::Compare(args)), _) | (None, Some(args)) => compare(&args, format),
        (Some(ExperimentKind::Explore(args)), _) => explore(&args, format),
        (Some(ExperimentKind::Search(args)), _) => search(&args, format),
        (Some(ExperimentKind::Routes(args)), _) => routes(&args, format),
        (None, None) => Err(UsageError("name a protocol, a file that ends in .yaml or .yml".to_owned()).into()),
    }
}

fn compare(args: &CompareArgs, format: Format) -> anyhow::Result<ExitCode> {
    let shown = args.protocol.display();
    let protocol = tidemap_experiment::read(&args.protocol).map_err(|error| refused(&args.protocol, &error))?;
    let out = args.out.as_ref().unwrap_or(&protocol.out);
    // Before the work, so that it is not done in vain.
    fs::create_dir_all(out).with_context(|| format!("folder of the results {}", out.display()))?;
    let bar = Bar::count("fits");
    let outcome = tidemap_experiment::run(&protocol, &|done, total| bar.set_of(done, total));
    bar.clear();
    let outcome = outcome.with_context(|| shown.to_string())?;
    tidemap_experiment::write(&protocol, &outcome, out)?;
    tidemap_experiment::summary(&protocol, &outcome, format, io::stdout().lock())?;
    let undecided =
        |model: &tidemap_experiment::ModelResult| model.difference.is_some_and(|difference| difference.test.is_none());
    if outcome.models.iter().any(undecided) {
        status_line("the test sets have too few days for a test: intervals and p-values are left out");
    }
    if io::stderr().is_terminal() {
        status_line(&format!("results are in {}", out.display()));
    }
    Ok(ExitCode::SUCCESS)
}

fn explore(args: &CompareArgs, format: Format) -> anyhow::Result<ExitCode> {
    let shown = args.protocol.display();
    let wanted = explore::read(&args.protocol).map_err(|error| refused(&args.protocol, &error))?;
    let own = match &wanted {
        ExploreProtocol::Places(protocol) => &protocol.out,
        ExploreProtocol::Office(protocol) => &protocol.out,
    };
    let out = args.out.as_ref().unwrap_or(own);
    fs::create_dir_all(out).with_context(|| format!("folder of the results {}", out.display()))?;
    match &wanted {
        ExploreProtocol::Places(protocol) => {
            let bar = Bar::count("runs");
            let outcome = explore::run(protocol, &|done, total| bar.set_of(done, total));
            bar.clear();
            let outcome = outcome.with_context(|| shown.to_string())?;
            explore::write(protocol, &outcome, out)?;
            explore::summary(protocol, &outcome, format, io::stdout().lock())?;
        }
        ExploreProtocol::Office(protocol) => {
            let bar = Bar::count("days");
            let outcome = office::run(protocol, &|done, total| bar.set_of(done, total));
            bar.clear();
            let outcome = outcome.with_context(|| shown.to_string())?;
            office::write(protocol, &outcome, out)?;
            office::summary(protocol, &outcome, format, io::stdout().lock())?;
        }
    }
    if io::stderr().is_terminal() {
        status_line(&format!("results are in {}", out.display()));
    }
    Ok(ExitCode::SUCCESS)
}

fn search(args: &CompareArgs, format: Format) -> anyhow::Result<ExitCode> {
    let shown = args.protocol.display();
    let protocol = search::read(&args.protocol).map_err(|error| refused(&args.protocol, &error))?;
    let out = args.out.as_ref().unwrap_or(&protocol.out);
    fs::create_dir_all(out).with_context(|| format!("folder of the results {}", out.display()))?;
    let bar = Bar::count("rounds");
    let outcome = search::run(&protocol, &|done, total| bar.set_of(done, total));
    bar.clear();
    let outcome = outcome.with_context(|| shown.to_string())?;
    search::write(&protocol, &outcome, out)?;
    search::summary(&outcome, format, io::stdout().lock())?;
    if io::stderr().is_terminal() {
        status_line(&format!("results are in {}", out.display()));
    }
    Ok(ExitCode::SUCCESS)
}

/// What a protocol says wrongly is wrong usage, as if it stood on the command line.
fn refused(path: &Path, error: &ProtocolError) -> anyhow::Error {
    let misuse = error.is_misuse();
    let message = format!("{}: {error}", path.display());
    if misuse { UsageError(message).into() } else { anyhow::anyhow!(message) }
}

fn routes(args: &RoutesArgs, format: Format) -> anyhow::Result<ExitCode> {
    let RoutesArgs { seeds, first_seed, weeks, tasks, out } = args;
    let protocol = routes::RoutesProtocol {
        seeds: *seeds,
        first_seed: *first_seed,
        weeks: *weeks as usize,
        tasks: *tasks as usize,
    };
    fs::create_dir_all(out).with_context(|| format!("folder of the results {}", out.display()))?;
    let bar = Bar::count("runs");
    let outcome = routes::run(&protocol, &|done, total| bar.set_of(done, total));
    bar.clear();
    let outcome = outcome?;
    routes::write(&outcome, out)?;
    routes::summary(&outcome, format, io::stdout().lock())?;
    if io::stderr().is_terminal() {
        status_line(&format!("results are in {}", out.display()));
    }
    Ok(ExitCode::SUCCESS)
}
