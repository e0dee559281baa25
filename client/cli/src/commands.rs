//! The commands: what they are called, what they take, and the way to each.
//!
//! Invariant: names, columns and meaning of what is here stay as they are; scripts rely on them.

mod anomalies;
mod bench;
mod day;
mod evaluate;
mod experiment;
mod files;
mod grid;
mod info;
mod job;
mod location;
mod map;
mod model;
mod observe;
mod point;
mod position;
mod predict;
mod presence;
mod producer_id;
mod reconstruct;
mod route;
mod search;
mod slot;
mod state;
mod stats;
mod times;
mod topology;
mod topology_picture;
mod tour;
mod traverse;
mod update;
mod visit;

use std::{
    fs,
    io::{self, BufWriter, Stdout},
    path::PathBuf,
    process::ExitCode,
};

use anyhow::Context as _;
use clap::{Parser, Subcommand};
use tidemap_client::Client;

use crate::{
    demo,
    output::{self, default_format, format_parser},
};
use tidemap_formats::table::{Cell, Format, TableWriter};

/// Heading of the options that every command has.
const GLOBAL: &str = "Options of every command";

/// A command whose arguments are valid one by one, but not together.
#[derive(Debug, thiserror::Error)]
#[error("{0}")]
pub(crate) struct UsageError(pub(crate) String);

/// A [`UsageError`] as the error of a command.
fn usage(text: impl Into<String>) -> anyhow::Error {
    UsageError(text.into()).into()
}

/// A map that knows when things change.
///
/// Times are Unix seconds (1458518400, 1458518400.5), RFC 3339 (2016-03-21T00:00:00Z) or `now`; durations are like 90s,
/// 15m, 1h, 7d.
#[derive(Debug, Parser)]
#[command(name = "tidemap", version, max_term_width = 110, arg_required_else_help = true)]
pub(crate) struct CommandLine {
    /// Address of the daemon, HOST:PORT or http://HOST:PORT
    #[arg(long, global = true, help_heading = GLOBAL, display_order = 100, env = "TIDEMAP_SERVER", value_name = "URL", default_value = "http://127.0.0.1:7435")]
    server: String,
    /// File that holds the token to present to the daemon
    #[arg(long, global = true, help_heading = GLOBAL, display_order = 101, value_name = "FILE")]
    token_file: Option<PathBuf>,
    /// How results are written [default: table on a terminal, csv otherwise]
    #[arg(long, global = true, help_heading = GLOBAL, display_order = 101, value_name = "FORMAT", value_parser = format_parser())]
    output: Option<Format>,
    #[command(subcommand)]
    command: Command,
}

#[derive(Debug, Subcommand)]
enum Command {
    /// Creates, lists, shows and deletes maps
    #[command(subcommand)]
    Map(map::MapCommand),
    /// Lists the states of a map
    #[command(subcommand)]
    State(state::StateCommand),
    /// Sends the observations of a file, each exactly once
    ///
    /// The file has a header and the columns time, state and value, in any order; a value is 0, 1 or anything between.
    /// With x and y, and perhaps z, in place of value, its rows are positions in metres.
    /// The same producer and label again continue where it was, and a file that differs from what was sent is refused.
    /// The exit status is 0 only where nothing was refused.
    Observe(observe::ObserveArgs),
    /// Runs the nightly update now and shows what it did to each state
    Update(update::UpdateArgs),
    /// Predicts states at any time, past or future
    ///
    /// Rows come by state as named, then by time as asked. Say when with --at, --times, or --from, --to and --step; the
    /// time of --to is not included. age_secs is the time since the newest observation.
    Predict(predict::PredictArgs),
    /// Predicts where something will be, as probabilities of places
    ///
    /// Rows are cells of space, by their middles, the most probable first; what lies outside of them and the position to
    /// expect go to stderr. The state is a vector, observed with columns x and y.
    Position(position::PositionArgs),
    /// Sends scans of an occupancy grid, and writes maps of any time
    #[command(subcommand)]
    Grid(grid::GridCommand),
    /// Shows what was observed of a state, exactly, where the map keeps its history
    Reconstruct(reconstruct::ReconstructArgs),
    /// Shows the observations of a state that the model did not expect, or waits for them with --watch
    ///
    /// An observation is shown where the model says the contrary with the confidence: a value below 0.5 where the
    /// probability is at least C, and another where it is at most 1 - C. It needs the map's history; --watch does not.
    Anomalies(anomalies::AnomaliesArgs),
    /// Compares predictions with the observations of a file, which are not learned
    Evaluate(evaluate::EvaluateArgs),
    /// Shows what was learned
    #[command(subcommand)]
    Model(model::ModelCommand),
    /// Shows what observing states, locations or a place's surroundings would teach, in bits
    ///
    /// entropy_bits is how unsure the prediction is; it is empty for a view, which tells the information alone.
    Info(info::InfoArgs),
    /// Sets, lists and deletes locations: states that are seen together
    #[command(subcommand)]
    Location(location::LocationCommand),
    /// Reports whether a robot reached a place that it was sent to
    Visit(visit::VisitArgs),
    /// Plans one exploration run over the grid: where to look, in driving order
    Tour(tour::TourArgs),
    /// Plans which slots of a day to explore, and where
    ///
    /// An empty location is a slot to rest, or for other tasks.
    Day(day::DayArgs),
    /// Loads, shows and changes topological maps: nodes, and the ways between them
    #[command(subcommand)]
    Topology(topology::TopologyCommand),
    /// Reports traversals of edges of the topological map, from a file, each exactly once, or a single one
    ///
    /// The file has a header and the columns from, to, start, end and success, in any order, and perhaps action and reason;
    /// success is true or false. The map learns how likely an edge is passed, as state edge/FROM/TO, and how fast, as
    /// speed/FROM/TO in metres a second or, of an edge without a length, pace/FROM/TO next to its nominal time; /ACTION
    /// follows where there is one. The same producer and label again continue where they were, as for observe. The exit
    /// status is 0 only where nothing was refused.
    Traverse(traverse::TraverseArgs),
    /// Plans where to look first for somebody, over the topological map
    ///
    /// How likely it is to find somebody at a node is predicted from the state of the same name. Places that are passed on
    /// the way to others are looked at too. expected_secs is the time to find to expect, the same in each row.
    Search(search::SearchArgs),
    /// Plans the way from one node of the topological map to another, for a time
    ///
    /// Each edge is predicted for when the robot reaches it. probability is how likely it is passed, from lower to upper with
    /// probability --interval; reports is how often it was reported. expected_secs is of the whole route, failed attempts and
    /// recovery included.
    Route(route::RouteArgs),
    /// Tells what to do at each node in each slot of time so as to reach a node, also after failures
    ///
    /// action is take, wait, nothing (which is done here helps any more) or arrived; probability is to be there before the
    /// last slot ends.
    Policy(route::PolicyArgs),
    /// Shows how likely somebody, or something, is at each node of the topological map
    ///
    /// share is the probability over the sum of all nodes', for one that is known to be at one of them; anybody is how likely
    /// anybody is anywhere.
    Presence(presence::PresenceArgs),
    /// Tells when states are next likely to be 1 all at once, such as several objects in their places
    ///
    /// No row where that is at no time.
    Joint(presence::JointArgs),
    /// Chooses where to look in the slot that begins now, for what is known now
    ///
    /// By default the most uncertain location, with what was seen last counted. With --planned the one that a plan of the day
    /// has, unless something unexpected was seen elsewhere lately.
    Slot(slot::SlotArgs),
    /// Lists and watches jobs
    #[command(subcommand)]
    Job(job::JobCommand),
    /// Shows the counters of a map, or of the whole daemon
    Stats(stats::StatsArgs),
    /// Compares temporal models on recordings, by a protocol, without a daemon
    ///
    /// A protocol is a YAML file: training and test data, models with their parameters, how lists of parameters are tuned
    /// on the training data, and the model that the others are compared with. The comparison goes to stdout; tables,
    /// predictions and a picture go to the folder that the protocol names.
    Experiment(experiment::ExperimentArgs),
    /// Measures a running daemon under load
    #[command(subcommand)]
    Bench(bench::BenchCommand),
    /// Shows what tidemap does, with a daemon of its own and a simulated office
    Demo(demo::DemoArgs),
}

/// What every command has at hand.
pub(crate) struct Session {
    /// The daemon.
    pub(crate) client: Client,
    /// How results are written.
    pub(crate) format: Format,
}

impl Session {
    /// Prints rows to stdout.
    pub(crate) fn print(&self, columns: &[&str], rows: impl IntoIterator<Item = Vec<Cell>>) -> io::Result<()> {
        let mut table = self.table(columns);
        rows.into_iter().try_for_each(|row| table.row(row))?;
        table.finish()
    }

    /// A result on stdout, for rows that come one by one.
    pub(crate) fn table(&self, columns: &[&str]) -> TableWriter<BufWriter<Stdout>> {
        output::stdout(self.format, columns)
    }
}

/// Does what the command line says.
pub(crate) async fn run(line: CommandLine) -> anyhow::Result<ExitCode> {
    if let Command::Demo(args) = &line.command {
        return demo::run(args).await;
    }
    if let Command::Experiment(args) = line.command {
        return experiment::run(args, line.output.unwrap_or_else(default_format));
    }
    let client = match &line.token_file {
        Some(path) => {
            let text = fs::read_to_string(path).with_context(|| format!("token file {}", path.display()))?;
            Client::with_token(&line.server, text.trim())
        }
        None => Client::new(&line.server),
    };
    let client = client.map_err(|error| UsageError(error.to_string()))?;
    let session = Session { client, format: line.output.unwrap_or_else(default_format) };
    match line.command {
        Command::Map(command) => map::run(&session, command).await,
        Command::State(command) => state::run(&session, command).await,
        Command::Observe(args) => observe::run(&session, args).await,
        Command::Update(args) => update::run(&session, &args).await,
        Command::Predict(args) => predict::run(&session, args).await,
        Command::Position(args) => position::run(&session, args).await,
        Command::Grid(command) => grid::run(&session, command).await,
        Command::Reconstruct(args) => reconstruct::run(&session, &args).await,
        Command::Anomalies(args) => anomalies::run(&session, args).await,
        Command::Evaluate(args) => evaluate::run(&session, args).await,
        Command::Model(command) => model::run(&session, &command).await,
        Command::Info(args) => info::run(&session, args).await,
        Command::Location(command) => location::run(&session, command).await,
        Command::Visit(args) => visit::run(&session, &args).await,
        Command::Tour(args) => tour::run(&session, args).await,
        Command::Day(args) => day::run(&session, args).await,
        Command::Topology(command) => topology::run(&session, command).await,
        Command::Traverse(args) => traverse::run(&session, &args).await,
        Command::Search(args) => search::run(&session, args).await,
        Command::Route(args) => route::run(&session, args).await,
        Command::Policy(args) => route::policy(&session, args).await,
        Command::Presence(args) => presence::run(&session, args).await,
        Command::Joint(args) => presence::joint(&session, args).await,
        Command::Slot(args) => slot::run(&session, args).await,
        Command::Job(command) => job::run(&session, &command).await,
        Command::Stats(args) => stats::run(&session, &args).await,
        Command::Bench(command) => bench::run(&session, &command).await,
        // Done above.
        Command::Demo(_) | Command::Experiment(_) => Ok(ExitCode::SUCCESS),
    }
}

#[cfg(test)]
mod tests {
    use clap::CommandFactory as _;

    use super::*;

    #[test]
    fn the_command_line_is_consistent() {
        CommandLine::command().debug_assert();
    }
}
