//! `tidemap-research`: experiments on recordings and in simulations, as papers report them.
//!
//! Invariant: no daemon is contacted. A first word that names no kind of experiment is a protocol file, and a protocol
//! file ends in .yaml or .yml, so that kinds added later cannot take a file's name. The exit status is 0 after success,
//! 1 after a failure, 2 after a usage error.

use std::{
    fs,
    io::{self, IsTerminal as _},
    path::{Path, PathBuf},
    process::ExitCode,
};

use anyhow::Context as _;
use clap::{Args, Parser, Subcommand, ValueEnum};
use tidemap_formats::table::Format;
use tidemap_research::{
    ModelResult, ProtocolError,
    activity::{self, ACTIVITY_MODELS, ActivityClassifier, ActivityModel, ActivityProtocol},
    explore::{self, ExploreProtocol, office},
    field::{self, FIELD_RECORDINGS, FieldProtocol, FieldRecording},
    flows::{self, FlowsProtocol},
    habits::{self, HABITS, Habit, HabitsProtocol},
    localise::{self, LandmarkRecording, VISIBILITY_MODELS, VisibilityModel},
    routes::{self, RoutesProtocol},
    search,
    tasks::{
        self, TasksProtocol,
        terminal::{self, TerminalProtocol},
    },
};
use tidemap_terminal::{
    failure::{UsageError, is_broken_pipe, usage},
    output::{self, default_format, format_parser},
    progress::{Bar, status_line},
};

/// Compares temporal models, explorers, routes and searches on recordings and in simulations, without a daemon
///
/// A protocol is a YAML file: training and test data, models with their parameters, the tuning of parameter lists on
/// the training data, and the baseline model. The comparison goes to stdout; tables, predictions and a picture go to
/// the folder that the protocol names.
#[derive(Debug, Parser)]
#[command(
    name = "tidemap-research",
    version,
    max_term_width = 110,
    arg_required_else_help = true,
    subcommand_negates_reqs = true,
    subcommand_value_name = "KIND"
)]
struct ResearchLine {
    /// Format of the results [default: table on a terminal, csv otherwise]
    #[arg(long, global = true, value_name = "FORMAT", value_parser = format_parser())]
    output: Option<Format>,
    #[command(flatten)]
    compare: Option<CompareArgs>,
    #[command(subcommand)]
    kind: Option<ExperimentKind>,
}

#[derive(Debug, Subcommand)]
enum ExperimentKind {
    /// Compares temporal models by a protocol; the same as a protocol file alone
    Compare(CompareArgs),
    /// Explores a recorded world of places, or a simulated office, by each strategy and model
    Explore(CompareArgs),
    /// Searches a recorded world for a person at every minute, and reports the search times of each model
    Search(CompareArgs),
    /// Sends robots around a simulated building, and reports how often their routes fail, week by week
    Routes(RoutesArgs),
    /// Gives robots in a simulated building tasks with windows, and reports failures and done tasks, week by week
    Tasks(TasksArgs),
    /// Finds the place and heading of pictures by landmarks that come and go, from a recording
    Localise(LocaliseArgs),
    /// Predicts simulated habits day by day, and reports how sure predictions are and whether they are right
    Habits(HabitsArgs),
    /// Predicts the last days of recordings by lead time, and reports the errors beside those of simple tables
    Field(FieldArgs),
    /// Predicts flows of people on a simulated floor, and sends robots across that avoid them
    Flows(FlowsArgs),
    /// Recognises the activities of a recording with the help of the time and place, and reports each model's scores
    Activity(ActivityArgs),
}

#[derive(Debug, Args)]
struct ActivityArgs {
    /// Folder of the recording
    #[arg(value_name = "FOLDER")]
    folder: PathBuf,
    /// Number of runs of each model, each with its own random seed
    #[arg(long, value_name = "N", default_value_t = 1, value_parser = clap::value_parser!(u64).range(1..=1_000))]
    seeds: u64,
    /// The first seed
    #[arg(long, value_name = "N", default_value_t = 0)]
    first_seed: u64,
    /// The classifiers, with commas between them: strong, weak, measured; all by default
    #[arg(long, value_name = "CLASSIFIER,…", value_delimiter = ',', value_parser = classifier)]
    classifier: Vec<ActivityClassifier>,
    /// The models, with commas between them: even, auto, spectral:3, pergam:2, …
    #[arg(long, value_name = "MODEL,…", value_delimiter = ',', default_values = ACTIVITY_MODELS)]
    models: Vec<ActivityModel>,
    /// The first days of the recording; all by default
    #[arg(long, value_name = "N", value_parser = clap::value_parser!(u64).range(1..=3_660))]
    days: Option<u64>,
    /// Folder of the results
    #[arg(long, value_name = "DIR", default_value = "activity-results")]
    out: PathBuf,
}

fn classifier(name: &str) -> Result<ActivityClassifier, String> {
    let names = || ActivityClassifier::ALL.map(ActivityClassifier::name).join(", ");
    ActivityClassifier::named(name).ok_or_else(|| format!("there is no such classifier; they are {}", names()))
}

#[derive(Debug, Args)]
struct LocaliseArgs {
    /// Folder of the recording: images.csv, features.csv.gz, offsets.csv and landmarks.csv.gz
    #[arg(value_name = "FOLDER")]
    recording: PathBuf,
    /// The models, with commas between them; all by default
    #[arg(long, value_name = "MODEL,…", value_delimiter = ',', value_parser = visibility_model)]
    models: Vec<VisibilityModel>,
    /// Folder of the results
    #[arg(long, value_name = "DIR", default_value = "localise-results")]
    out: PathBuf,
}

fn visibility_model(name: &str) -> Result<VisibilityModel, String> {
    let names = || VISIBILITY_MODELS.map(VisibilityModel::name).join(", ");
    VisibilityModel::named(name).ok_or_else(|| format!("there is no such model; the models are {}", names()))
}

#[derive(Debug, Args)]
struct HabitsArgs {
    /// Number of runs of each habit, each with its own random seed
    #[arg(long, value_name = "N", default_value_t = 1, value_parser = clap::value_parser!(u64).range(1..=1_000))]
    seeds: u64,
    /// The first seed
    #[arg(long, value_name = "N", default_value_t = 0)]
    first_seed: u64,
    /// The habits, with commas between them; all by default
    #[arg(long, value_name = "HABIT,…", value_delimiter = ',', value_parser = habit)]
    habits: Vec<&'static Habit>,
    /// Lead time in days: 1 predicts the next day
    #[arg(long, value_name = "DAYS", default_value_t = 1, value_parser = clap::value_parser!(u32).range(1..=100))]
    ahead: u32,
    /// Folder of the results
    #[arg(long, value_name = "DIR", default_value = "habits-results")]
    out: PathBuf,
}

fn habit(name: &str) -> Result<&'static Habit, String> {
    let names = || HABITS.each_ref().map(|habit| habit.name).join(", ");
    Habit::named(name).ok_or_else(|| format!("there is no such habit; the habits are {}", names()))
}

#[derive(Debug, Args)]
struct FieldArgs {
    /// Folder of data, with the folders of the recordings
    #[arg(value_name = "FOLDER")]
    folder: PathBuf,
    /// The recordings, with commas between them; all by default
    #[arg(long, value_name = "NAME,…", value_delimiter = ',', value_parser = field_recording)]
    recordings: Vec<&'static FieldRecording>,
    /// Folder of the results
    #[arg(long, value_name = "DIR", default_value = "field-results")]
    out: PathBuf,
}

fn field_recording(name: &str) -> Result<&'static FieldRecording, String> {
    let names = || FIELD_RECORDINGS.each_ref().map(|recording| recording.name).join(", ");
    FieldRecording::named(name).ok_or_else(|| format!("there is no such recording; the recordings are {}", names()))
}

#[derive(Debug, Args)]
struct FlowsArgs {
    /// Number of floors, each with its own random seed
    #[arg(long, value_name = "N", default_value_t = 5, value_parser = clap::value_parser!(u64).range(1..=1_000))]
    seeds: u64,
    /// The first seed
    #[arg(long, value_name = "N", default_value_t = 0)]
    first_seed: u64,
    /// Weeks to learn
    #[arg(long, value_name = "N", default_value_t = 3, value_parser = clap::value_parser!(u64).range(1..=104))]
    weeks: u64,
    /// Weeks after these, to test
    #[arg(long, value_name = "N", default_value_t = 2, value_parser = clap::value_parser!(u64).range(1..=104))]
    tested: u64,
    /// Folder of the results
    #[arg(long, value_name = "DIR", default_value = "flows-results")]
    out: PathBuf,
}

#[derive(Debug, Args)]
struct RoutesArgs {
    /// Number of runs, each with its own random seed
    #[arg(long, value_name = "N", default_value_t = 20, value_parser = clap::value_parser!(u64).range(1..=1_000))]
    seeds: u64,
    /// The first seed
    #[arg(long, value_name = "N", default_value_t = 0)]
    first_seed: u64,
    /// Weeks of each run
    #[arg(long, value_name = "N", default_value_t = 10, value_parser = clap::value_parser!(u64).range(2..=520))]
    weeks: u64,
    /// Tasks per robot and day
    #[arg(long, value_name = "N", default_value_t = 24, value_parser = clap::value_parser!(u64).range(1..=500))]
    tasks: u64,
    /// Folder of the results
    #[arg(long, value_name = "DIR", default_value = "routes-results")]
    out: PathBuf,
}

/// Tasks per day.
const TASKS_BY_DEFAULT: u64 = 20;

#[derive(Debug, Args)]
struct TasksArgs {
    /// The world
    #[arg(long, value_enum, value_name = "WORLD", default_value_t = TaskWorld::Building)]
    world: TaskWorld,
    /// Number of runs, each with its own random seed
    #[arg(long, value_name = "N", default_value_t = 10, value_parser = clap::value_parser!(u64).range(1..=1_000))]
    seeds: u64,
    /// The first seed
    #[arg(long, value_name = "N", default_value_t = 0)]
    first_seed: u64,
    /// Weeks of each run
    #[arg(long, value_name = "N", default_value_t = 10, value_parser = clap::value_parser!(u64).range(1..=52))]
    weeks: u64,
    /// Tasks per day in the building, without charging; 20 by default
    #[arg(long, value_name = "N", value_parser = clap::value_parser!(u64).range(1..=90))]
    tasks: Option<u64>,
    /// Folder of the results
    #[arg(long, value_name = "DIR", default_value = "tasks-results")]
    out: PathBuf,
}

/// A world of tasks.
#[derive(Clone, Copy, Debug, PartialEq, Eq, ValueEnum)]
enum TaskWorld {
    /// Tasks with windows, in a building whose ways are not always open
    Building,
    /// An information terminal that should be where people are
    Terminal,
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

impl CompareArgs {
    fn shown(&self) -> String {
        self.protocol.display().to_string()
    }
}

fn protocol_file(text: &str) -> Result<PathBuf, String> {
    let path = PathBuf::from(text);
    match path.extension().and_then(|ending| ending.to_str()) {
        Some("yaml" | "yml") => Ok(path),
        _ => Err(
            "it is neither a protocol, a file that ends in .yaml or .yml, nor a kind of experiment: compare, explore, \
             search, routes, tasks, habits, field, activity, flows, localise"
                .to_owned(),
        ),
    }
}

fn main() -> ExitCode {
    let error = match run(ResearchLine::parse()) {
        Ok(code) => return code,
        Err(error) => error,
    };
    if is_broken_pipe(&error) {
        return ExitCode::SUCCESS;
    }
    status_line(&format!("error: {error:#}"));
    if error.is::<UsageError>() { ExitCode::from(2) } else { ExitCode::FAILURE }
}

fn run(line: ResearchLine) -> anyhow::Result<ExitCode> {
    let format = line.output.unwrap_or_else(default_format);
    match (line.kind, line.compare) {
        (Some(_), Some(_)) => Err(usage("a protocol file and a kind of experiment were given: give one of them")),
        (Some(ExperimentKind::Compare(args)), _) | (None, Some(args)) => compare(&args, format),
        (Some(ExperimentKind::Explore(args)), _) => explore(&args, format),
        (Some(ExperimentKind::Search(args)), _) => search(&args, format),
        (Some(ExperimentKind::Routes(args)), _) => routes(args, format),
        (Some(ExperimentKind::Tasks(args)), _) => tasks(args, format),
        (Some(ExperimentKind::Habits(args)), _) => habits(args, format),
        (Some(ExperimentKind::Field(args)), _) => field(args, format),
        (Some(ExperimentKind::Localise(args)), _) => localise(&args, format),
        (Some(ExperimentKind::Flows(args)), _) => flows(args, format),
        (Some(ExperimentKind::Activity(args)), _) => activity(args, format),
        (None, None) => Err(usage("name a protocol, a file that ends in .yaml or .yml")),
    }
}

/// Runs an experiment under a progress bar, writes its files and prints its summary.
fn conduct<T>(
    out: &Path,
    unit: &'static str,
    run: impl FnOnce(&Bar) -> anyhow::Result<T>,
    write: impl FnOnce(&T, &Path) -> anyhow::Result<()>,
    summary: impl FnOnce(&T, output::Stdout) -> io::Result<()>,
) -> anyhow::Result<T> {
    // First, so that a folder that cannot be created costs no work.
    fs::create_dir_all(out).with_context(|| format!("folder of the results {}", out.display()))?;
    let bar = Bar::count(unit);
    let outcome = run(&bar);
    bar.clear();
    let outcome = outcome?;
    write(&outcome, out)?;
    summary(&outcome, output::stdout())?;
    if io::stderr().is_terminal() {
        status_line(&format!("results are in {}", out.display()));
    }
    Ok(outcome)
}

fn compare(args: &CompareArgs, format: Format) -> anyhow::Result<ExitCode> {
    let protocol = tidemap_research::read(&args.protocol).map_err(|error| refused(&args.protocol, &error))?;
    let outcome = conduct(
        args.out.as_ref().unwrap_or(&protocol.out),
        "models",
        |bar| tidemap_research::run(&protocol, &|done, total| bar.set_of(done, total)).with_context(|| args.shown()),
        |outcome, out| tidemap_research::write(&protocol, outcome, out),
        |outcome, stdout| tidemap_research::summary(&protocol, outcome, format, stdout),
    )?;
    let undecided = |model: &ModelResult| model.difference.is_some_and(|difference| difference.test.is_none());
    if outcome.models.iter().any(undecided) {
        status_line("the test sets have too few days for a test: intervals and p-values are left out");
    }
    Ok(ExitCode::SUCCESS)
}

fn explore(args: &CompareArgs, format: Format) -> anyhow::Result<ExitCode> {
    let out = |own| args.out.as_ref().unwrap_or(own);
    match &explore::read(&args.protocol).map_err(|error| refused(&args.protocol, &error))? {
        ExploreProtocol::Places(protocol) => drop(conduct(
            out(&protocol.out),
            "runs",
            |bar| explore::run(protocol, &|done, total| bar.set_of(done, total)).with_context(|| args.shown()),
            |outcome, out| explore::write(protocol, outcome, out),
            |outcome, stdout| explore::summary(protocol, outcome, format, stdout),
        )?),
        ExploreProtocol::Office(protocol) => drop(conduct(
            out(&protocol.out),
            "days",
            |bar| office::run(protocol, &|done, total| bar.set_of(done, total)).with_context(|| args.shown()),
            |outcome, out| office::write(protocol, outcome, out),
            |outcome, stdout| office::summary(protocol, outcome, format, stdout),
        )?),
    }
    Ok(ExitCode::SUCCESS)
}

fn search(args: &CompareArgs, format: Format) -> anyhow::Result<ExitCode> {
    let protocol = search::read(&args.protocol).map_err(|error| refused(&args.protocol, &error))?;
    conduct(
        args.out.as_ref().unwrap_or(&protocol.out),
        "rounds",
        |bar| search::run(&protocol, &|done, total| bar.set_of(done, total)).with_context(|| args.shown()),
        |outcome, out| search::write(&protocol, outcome, out),
        |outcome, stdout| search::summary(outcome, format, stdout),
    )?;
    Ok(ExitCode::SUCCESS)
}

/// An invalid protocol is a usage error, as if it stood on the command line.
fn refused(path: &Path, error: &ProtocolError) -> anyhow::Error {
    let message = format!("{}: {error}", path.display());
    if error.is_misuse() { usage(message) } else { anyhow::anyhow!(message) }
}

fn routes(args: RoutesArgs, format: Format) -> anyhow::Result<ExitCode> {
    let RoutesArgs { seeds, first_seed, weeks, tasks, out } = args;
    let protocol = RoutesProtocol { seeds, first_seed, weeks: weeks as usize, tasks: tasks as usize };
    conduct(
        &out,
        "runs",
        |bar| Ok(routes::run(&protocol, &|done, total| bar.set_of(done, total))?),
        routes::write,
        |outcome, stdout| routes::summary(outcome, format, stdout),
    )?;
    Ok(ExitCode::SUCCESS)
}

fn flows(args: FlowsArgs, format: Format) -> anyhow::Result<ExitCode> {
    let FlowsArgs { seeds, first_seed, weeks, tested, out } = args;
    let protocol = FlowsProtocol { seeds, first_seed, weeks: weeks as usize, tested: tested as usize };
    conduct(
        &out,
        "floors",
        |bar| Ok(flows::run(&protocol, &|done, total| bar.set_of(done, total))?),
        flows::write,
        |outcome, stdout| flows::summary(outcome, format, stdout),
    )?;
    Ok(ExitCode::SUCCESS)
}

fn tasks(args: TasksArgs, format: Format) -> anyhow::Result<ExitCode> {
    let TasksArgs { world, seeds, first_seed, weeks, tasks, out } = args;
    let weeks = weeks as usize;
    match world {
        TaskWorld::Terminal if tasks.is_some() => return Err(usage("--tasks is of the world building only")),
        TaskWorld::Terminal => drop(conduct(
            &out,
            "runs",
            |bar| {
                let protocol = TerminalProtocol { seeds, first_seed, weeks };
                Ok(terminal::run(&protocol, &|done, total| bar.set_of(done, total))?)
            },
            terminal::write,
            |outcome, stdout| terminal::summary(outcome, format, stdout),
        )?),
        TaskWorld::Building => drop(conduct(
            &out,
            "runs",
            |bar| {
                let tasks = tasks.unwrap_or(TASKS_BY_DEFAULT) as usize;
                let protocol = TasksProtocol { seeds, first_seed, weeks, tasks };
                Ok(tasks::run(&protocol, &|done, total| bar.set_of(done, total))?)
            },
            tasks::write,
            |outcome, stdout| tasks::summary(outcome, format, stdout),
        )?),
    }
    Ok(ExitCode::SUCCESS)
}

fn localise(args: &LocaliseArgs, format: Format) -> anyhow::Result<ExitCode> {
    let recording = LandmarkRecording::read(&args.recording)?;
    let models = if args.models.is_empty() { &VISIBILITY_MODELS[..] } else { &args.models };
    conduct(
        &args.out,
        "months",
        |bar| Ok(localise::run(&recording, models, &|done, total| bar.set_of(done, total))?),
        localise::write,
        |outcome, stdout| localise::summary(outcome, format, stdout),
    )?;
    Ok(ExitCode::SUCCESS)
}

fn habits(args: HabitsArgs, format: Format) -> anyhow::Result<ExitCode> {
    let HabitsArgs { seeds, first_seed, habits, ahead, out } = args;
    let protocol = HabitsProtocol { seeds, first_seed, habits, ahead_days: ahead };
    conduct(
        &out,
        "runs",
        |bar| Ok(habits::run(&protocol, &|done, total| bar.set_of(done, total))?),
        habits::write,
        |outcome, stdout| habits::summary(outcome, format, stdout),
    )?;
    Ok(ExitCode::SUCCESS)
}

fn field(args: FieldArgs, format: Format) -> anyhow::Result<ExitCode> {
    let FieldArgs { folder, recordings, out } = args;
    let protocol = FieldProtocol { folder, recordings };
    let outcome = conduct(
        &out,
        "runs",
        |bar| Ok(field::run(&protocol, &|done, total| bar.set_of(done, total))?),
        field::write,
        |outcome, stdout| field::summary(outcome, format, stdout),
    )?;
    outcome.left_out.iter().for_each(|notice| status_line(notice));
    let (learning, asking) = outcome
        .seconds
        .iter()
        .fold((0.0, 0.0), |(learning, asking), run| (learning + run.learning, asking + run.asking));
    status_line(&format!("{learning:.0} s of learning and {asking:.0} s of asking, all threads together"));
    Ok(ExitCode::SUCCESS)
}

fn activity(args: ActivityArgs, format: Format) -> anyhow::Result<ExitCode> {
    let ActivityArgs { folder, seeds, first_seed, classifier, models, days, out } = args;
    let classifiers = if classifier.is_empty() { ActivityClassifier::ALL.to_vec() } else { classifier };
    let days = days.map(|days| days as usize);
    let protocol = ActivityProtocol { folder, seeds, first_seed, classifiers, models, days };
    conduct(
        &out,
        "runs",
        |bar| Ok(activity::run(&protocol, &|done, total| bar.set_of(done, total))?),
        activity::write,
        |outcome, stdout| activity::summary(outcome, format, stdout),
    )?;
    Ok(ExitCode::SUCCESS)
}
