//! The commands: their names and arguments, and their dispatch.
//!
//! Invariant: names, columns and meanings of commands never change; scripts rely on them.

mod anomalies;
mod backup;
mod classify;
mod cluster;
mod command_texts;
pub(crate) mod connection;
mod day;
mod erase;
mod evaluate;
mod export;
pub(crate) mod files;
mod foxglove;
mod grid;
mod help;
mod import;
mod info;
pub(crate) mod job;
mod landmark;
mod location;
pub(crate) mod map;
mod measure;
mod model;
mod no_go;
mod observe;
pub(crate) mod office_scans;
mod open;
mod point;
mod position;
mod predict;
mod presence;
mod producer;
mod producer_id;
mod reconstruct;
mod route;
mod rows;
mod sample;
mod schema;
mod search;
mod shell_word;
mod slot;
mod state;
mod stats;
mod task;
pub(crate) mod times;
pub(crate) mod topology;
mod topology_picture;
mod topology_reachable;
mod tour;
mod traverse;
mod update;
mod visit;

pub(crate) use cluster::ClusterLost;
pub(crate) use connection::{ConnectionArgs, Session};
pub(crate) use tidemap_terminal::failure::{UsageError, usage};

use std::{path::PathBuf, process::ExitCode};

use clap::{ArgMatches, CommandFactory as _, FromArgMatches as _, Parser, Subcommand};

use crate::demo;

/// A map that knows when things change.
///
/// Times are Unix seconds (1458518400, 1458518400.5), RFC 3339 (2016-03-21T00:00:00Z) or `now`; durations are like 90s,
/// 15m, 1h, 7d.
#[derive(Debug, Parser)]
#[command(name = "tidemap", version = env!("TIDEMAP_VERSION"), max_term_width = 110, arg_required_else_help = true)]
pub(crate) struct CommandLine {
    #[command(flatten)]
    connection: ConnectionArgs,
    #[command(subcommand)]
    command: Command,
}

impl CommandLine {
    /// Whether results and errors are JSON.
    pub(crate) fn prints_json(&self) -> bool {
        self.connection.prints_json()
    }
}

/// The data that decides how a command shows times: the map, whose time zone is used, and whether a picture is drawn.
#[derive(Debug, Default, PartialEq, Eq)]
pub(crate) struct Subject {
    /// Name of the map.
    map: Option<String>,
    /// Whether the result is drawn.
    is_drawn: bool,
}

/// Parses the command line.
///
/// # Errors
/// The command line is wrong, or requests help.
pub(crate) fn parse() -> Result<(CommandLine, Subject), clap::Error> {
    let matches = help::grouped(help::with_examples(CommandLine::command())).try_get_matches()?;
    Ok((CommandLine::from_arg_matches(&matches)?, subject(&matches)))
}

/// Whether arguments that could not be parsed request JSON.
pub(crate) fn ask_for_json(arguments: &[String]) -> bool {
    arguments.windows(2).any(|pair| pair == ["--output", "json"]) || arguments.iter().any(|one| one == "--output=json")
}

/// Commands that show no times; they do not request the map's zone.
const TIMELESS: [&str; 6] = ["classify", "import", "observe", "traverse", "update", "visit"];

fn subject(matches: &ArgMatches) -> Subject {
    let mut matches = matches;
    while let Some((name, inner)) = matches.subcommand() {
        if TIMELESS.contains(&name) {
            return Subject::default();
        }
        matches = inner;
    }
    let text = |id| matches.try_get_one::<String>(id).ok().flatten().cloned();
    let is_drawn = matches.try_get_one::<PathBuf>("picture").is_ok_and(|picture| picture.is_some());
    Subject { map: text("map").or_else(|| text("name")), is_drawn }
}

#[derive(Debug, Subcommand)]
enum Command {
    /// Creates, lists, shows and deletes maps
    #[command(subcommand)]
    Map(map::MapCommand),
    /// Lists and adds states of a map
    #[command(subcommand)]
    State(state::StateCommand),
    /// Sends the observations of a file, each exactly once
    ///
    /// The file has a header and the columns time, state and value, in any order; a value is between 0 and 1. With
    /// columns x, y and optionally z in place of value, the rows are positions in metres. The same producer and label
    /// continue where they stopped; a file that differs from the data sent before is refused. The exit status is 0 only
    /// if no row was refused.
    Observe(observe::ObserveArgs),
    /// Runs the nightly update now and shows the result for each state
    Update(update::UpdateArgs),
    /// Computes the probability of each label of a categorical state from the likelihoods of an observation
    ///
    /// probability is likelihood x temporal_prior x spatial_prior, divided by the sum over all labels. temporal_prior
    /// is the probability of the label at that time; spatial_prior is the probability of being at the place while the
    /// label holds, as the states STATE@PLACE have learned it, and is empty where nothing was learned.
    Classify(classify::ClassifyArgs),
    /// Predicts states at any time, past or future
    ///
    /// Rows are in the order of the states, then of the times. Give the times with --at, --times, or --from, --to and
    /// --step; the time of --to is not included. age_secs is the time since the newest observation, 0 before it.
    Predict(predict::PredictArgs),
    /// Predicts where something will be, as probabilities of places
    ///
    /// Rows are cells of space, given by their centres, the most probable first. The expected position and the
    /// probability outside of the region go to stderr. The state is a vector, observed with columns x and y.
    Position(position::PositionArgs),
    /// Makes observations of the recordings of robots: MCAP, bags of ROS 1, rosbag2
    ///
    /// Scans, clouds and occupancy grids become observations of the grid, placed by the transforms of the recording;
    /// doors and booleans become states, poses and people positions, statistics of navigation traversals. --list shows
    /// the contents of a recording; --mapping makes states of any other topics. The map is created if it does not
    /// exist. Each observation is sent exactly once: the same command again continues where it stopped. The exit status
    /// is 0 only if nothing was refused.
    Import(Box<import::ImportArgs>),
    /// Sends scans of an occupancy grid, and writes maps of any time
    #[command(subcommand)]
    Grid(grid::GridCommand),
    /// Writes maps of any time, past or future, as files for other programs
    ///
    /// The ending of PATH selects the format: .mcap is a recording of the map over time for Foxglove and ROS 2, with
    /// the grid, the topological map and the states; .yaml is a map for Nav2's map server, with its image .pgm beside
    /// it, or with --mask a mask for a costmap filter; .geojson is the topological map for Nav2's route server, whose
    /// edges cost the expected seconds at that time. A .mcap file takes many times, the others one.
    Export(export::ExportArgs),
    /// Serves a map to the program Foxglove, whose time bar then requests maps of the past and of the future
    ///
    /// Foxglove opens the address that is printed. Its time bar begins with the first observation and ends --ahead
    /// after now. Channels: /grid, /topology, /states/NAME and /anomalies. The server runs until it is interrupted.
    Foxglove(foxglove::FoxgloveArgs),
    /// Shows the exact observations of a state, if the map keeps its history
    Reconstruct(reconstruct::ReconstructArgs),
    /// Shows the observations of a state that the model did not expect, or waits for them with --watch
    ///
    /// An observation is an anomaly if the model predicted the opposite with the given confidence: a value below 0.5
    /// when the probability is at least C, or a value of 0.5 or more when it is at most 1 - C. The map must keep its
    /// history, except for --watch.
    Anomalies(anomalies::AnomaliesArgs),
    /// Compares predictions with the observations of a file; the map does not learn them
    Evaluate(evaluate::EvaluateArgs),
    /// Shows trained models
    #[command(subcommand)]
    Model(model::ModelCommand),
    /// Shows the information gain of observing states, locations or the surroundings of a place, in bits
    ///
    /// entropy_bits is the uncertainty of the prediction; it is empty for a view, which has an information gain only.
    Info(info::InfoArgs),
    /// Sets, lists and deletes locations: states that are observed together
    #[command(subcommand)]
    Location(location::LocationCommand),
    /// Reports whether a robot reached its goal
    Visit(visit::VisitArgs),
    /// Lists the places that robots tried to reach
    #[command(subcommand)]
    Reachability(visit::ReachabilityCommand),
    /// Plans one exploration tour over the grid: viewpoints in driving order
    Tour(tour::TourArgs),
    /// Plans which slots of a day to explore, and where
    ///
    /// A slot with an empty location is free, for rest or other tasks.
    Day(day::DayArgs),
    /// Adds, lists and removes areas that no route, tour, search or plan of tasks leads through
    #[command(subcommand)]
    NoGo(no_go::NoGoCommand),
    /// Adds, lists and removes tasks of a map, and reports their execution
    #[command(subcommand)]
    Task(task::TaskCommand),
    /// Shows kept plans of days
    #[command(subcommand)]
    Plan(task::PlanCommand),
    /// Loads, shows and changes topological maps: nodes, and the edges between them
    #[command(subcommand)]
    Topology(topology::TopologyCommand),
    /// Adds, lists and predicts landmarks of nodes and edges, and finds the node of a robot from the landmarks that it
    /// sees
    #[command(subcommand)]
    Landmark(landmark::LandmarkCommand),
    /// Reports traversals of edges of the topological map: those of a file, each exactly once, or a single one
    ///
    /// The file has a header and the columns from, to, start, end and success, in any order, and optionally action and
    /// reason; success is true or false. The map learns the probability of success as state edge/FROM/TO, and the speed
    /// as state speed/FROM/TO in metres per second. For an edge without a length it learns pace/FROM/TO, the nominal
    /// time divided by the actual time. For an edge with an action, /ACTION is appended. The same producer and label
    /// continue where they stopped, as for observe; a single report has the label traverse by default. The exit status
    /// is 0 only if no row was refused.
    Traverse(traverse::TraverseArgs),
    /// Plans the order in which to search the nodes of the topological map for a target
    ///
    /// The probability of finding the target at a node is predicted from the state of the same name. Nodes on the way
    /// are searched too. expected_secs is the expected time until the target is found, the same in each row.
    Search(search::SearchArgs),
    /// Plans a route from one node of the topological map to another, for a time
    ///
    /// Each edge is predicted for the time when the robot reaches it. probability is its probability of success, with
    /// an interval from lower to upper; reports is the number of its reports. expected_secs is the expected time of the
    /// whole route, with failed attempts and recovery.
    Route(route::RouteArgs),
    /// Plans the action at each node in each time slot that leads to a goal, also after failures
    ///
    /// action is take, wait, nothing (the goal cannot be reached any more) or arrived; probability is the probability
    /// of arriving before the last slot ends.
    Policy(route::PolicyArgs),
    /// Predicts the presence of a person or object at each node of the topological map
    ///
    /// share assumes that the target is at exactly one of the nodes: the probability divided by the sum over all nodes.
    /// anybody is the probability of a presence at any node.
    Presence(presence::PresenceArgs),
    /// Finds the next time when all of several states are likely 1, such as several objects in their places
    ///
    /// Prints no row if there is no such time.
    Joint(presence::JointArgs),
    /// Chooses the location to observe in the current slot, by current knowledge
    ///
    /// By default the most uncertain location, given the last observations. With --planned the location of the day's
    /// plan, unless something unexpected was observed elsewhere lately.
    Slot(slot::SlotArgs),
    /// Lists and watches jobs
    #[command(subcommand)]
    Job(job::JobCommand),
    /// Lists producers, which send observations to a map, and frees their places
    #[command(subcommand)]
    Producer(producer::ProducerCommand),
    /// Shows the counters of a map, or of the whole daemon
    Stats(stats::StatsArgs),
    /// Makes a backup of all maps while the daemon runs
    #[command(subcommand)]
    Backup(backup::BackupCommand),
    /// Erases a state from a map, with all its learned data
    ///
    /// History, models, log, checkpoints, index and later backups hold nothing of it afterwards. Earlier backups stay
    /// as they are. A daemon that ends meanwhile completes it at its next start.
    Erase(erase::EraseArgs),
    /// Shows and operates a cluster: daemons that share the logs of their maps
    #[command(subcommand)]
    Cluster(cluster::ClusterCommand),
    /// Writes sample data into a folder, and the commands to try with it
    Sample(sample::SampleArgs),
    /// Prints the JSON schema of the output of a command with --output json, or that of all commands
    Schema(schema::SchemaArgs),
    /// Opens the daemon's page in a browser
    Open(open::OpenArgs),
    /// Shows how tidemap works, with its own daemon and a simulated office
    Demo(demo::DemoArgs),
    /// Prints the completions of a shell, for example: tidemap completions bash
    #[command(hide = true)]
    Completions(command_texts::CompletionsArgs),
    /// Writes a man page for each command
    #[command(hide = true)]
    ManPages(command_texts::ManPagesArgs),
}

/// Runs a command.
pub(crate) async fn run(line: CommandLine, subject: &Subject) -> anyhow::Result<ExitCode> {
    if let Command::Demo(args) = &line.command {
        return demo::run(args).await;
    }
    if let Command::Sample(args) = &line.command {
        return sample::run(args, line.connection.format());
    }
    match &line.command {
        Command::Schema(args) => return schema::run(args),
        Command::Completions(args) => return command_texts::completions(args),
        Command::ManPages(args) => return command_texts::man_pages(args),
        _ => {}
    }
    let credentials = line.connection.credentials()?;
    let session = Session::new(&line.connection, &credentials)?;
    if let Command::Open(args) = &line.command {
        return open::run(&session.client, args, line.connection.server()).await;
    }
    let session = session.with_times_of(&line.connection, subject).await;
    match line.command {
        Command::Map(command) => map::run(&session, command).await,
        Command::State(command) => state::run(&session, command).await,
        Command::Import(args) => import::run(&session, *args).await,
        Command::Observe(args) => observe::run(&session, args).await,
        Command::Update(args) => update::run(&session, &args).await,
        Command::Classify(args) => classify::run(&session, args).await,
        Command::Predict(args) => predict::run(&session, args).await,
        Command::Position(args) => position::run(&session, args).await,
        Command::Grid(command) => grid::run(&session, command).await,
        Command::Export(args) => export::run(&session, args).await,
        Command::Foxglove(args) => foxglove::run(&session, args).await,
        Command::Reconstruct(args) => reconstruct::run(&session, &args).await,
        Command::Anomalies(args) => anomalies::run(&session, args).await,
        Command::Evaluate(args) => evaluate::run(&session, args).await,
        Command::Model(command) => model::run(&session, &command).await,
        Command::Info(args) => info::run(&session, args).await,
        Command::Location(command) => location::run(&session, command).await,
        Command::Visit(args) => visit::run(&session, &args).await,
        Command::Reachability(command) => visit::list(&session, &command).await,
        Command::Tour(args) => tour::run(&session, args).await,
        Command::Day(args) => day::run(&session, args).await,
        Command::NoGo(command) => no_go::run(&session, command).await,
        Command::Task(command) => task::run(&session, command).await,
        Command::Plan(command) => task::plan(&session, command).await,
        Command::Topology(command) => topology::run(&session, command).await,
        Command::Landmark(command) => landmark::run(&session, command).await,
        Command::Traverse(args) => traverse::run(&session, &args).await,
        Command::Search(args) => search::run(&session, args).await,
        Command::Route(args) => route::run(&session, args).await,
        Command::Policy(args) => route::policy(&session, args).await,
        Command::Presence(args) => presence::run(&session, args).await,
        Command::Joint(args) => presence::joint(&session, args).await,
        Command::Slot(args) => slot::run(&session, args).await,
        Command::Job(command) => job::run(&session, &command).await,
        Command::Producer(command) => producer::run(&session, &command).await,
        Command::Stats(args) => stats::run(&session, &args).await,
        Command::Backup(command) => backup::run(&session, &command).await,
        Command::Erase(args) => erase::run(&session, &args).await,
        Command::Cluster(command) => cluster::run(&session, &credentials, command).await,
        // Handled above.
        Command::Demo(_)
        | Command::Open(_)
        | Command::Completions(_)
        | Command::ManPages(_)
        | Command::Sample(_)
        | Command::Schema(_) => Ok(ExitCode::SUCCESS),
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_map_of_a_command_is_found() {
        for (line, map) in [
            ("tidemap predict home door --at 1", Some("home")),
            ("tidemap map show home", Some("home")),
            ("tidemap model show home door --picture", Some("home")),
            ("tidemap route home A B --at 1 --picture a.svg", Some("home")),
            ("tidemap state list home", Some("home")),
            ("tidemap topology failures home", Some("home")),
            ("tidemap observe home a.csv", None),
            ("tidemap job list", None),
        ] {
            let matches = CommandLine::command().try_get_matches_from(line.split(' '));
            let found = matches.map(|matches| subject(&matches)).unwrap_or_default();
            assert_eq!(found, Subject { map: map.map(str::to_owned), is_drawn: line.contains("--picture") }, "{line}");
        }
    }

    #[test]
    fn the_command_line_is_consistent() {
        CommandLine::command().debug_assert();
    }
}
