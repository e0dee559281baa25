//! `tidemap import`: recordings of robots become observations of a map.
//!
//! Invariant: the number of an observation among the observations of the recordings is its sequence number, so the same
//! command can run any number of times, and the observations that the daemon has are compared and not sent again.
//! Nothing is sent before all files were read once and the plan is complete. An update follows only when everything is
//! durable.

mod counts;
mod feed;
mod files;
mod grid;
mod learn;
mod list;
mod prepare;
mod transfer;

use std::{path::PathBuf, process::ExitCode, sync::Arc};

use anyhow::Context as _;
use clap::Args;
use tidemap_client::observe::{ProducerOptions, ProducerSensor};
use tidemap_recordings::{
    convert::Clock,
    mapping::Mapping,
    plan::{Plan, Wishes, plan},
    survey::{PoseSource, Surveyed},
};

use self::{counts::TopicCounts, files::Recording, learn::LearnEnd, prepare::Prepared, transfer::ImportTransfer};
use super::{
    Session,
    grid::sensor,
    map::grid_spec::GridArg,
    observe::{
        INTERRUPTED, SenderArgs, base_name, exit_code, free_label, open_stream, run_transfer, transfer::TransferEnd,
    },
    times, usage,
};
use crate::{
    commands::observe::feed::RefusalReport,
    progress::{Bar, status_line},
};

/// Maximum number of bytes of scans that wait for their acknowledgement.
const WINDOW_BYTES: usize = 16 << 20;

#[derive(Debug, Args)]
pub(crate) struct ImportArgs {
    /// Name of the map; it is created if it does not exist
    map: String,
    /// Recordings: MCAP, bags of ROS 1, databases of rosbag2, or folders of rosbag2; several are read one after the
    /// other
    #[arg(required = true, value_name = "FILE")]
    files: Vec<PathBuf>,
    /// Mapping of topics to observations, in addition to or instead of the usual one: a YAML file
    #[arg(long, value_name = "FILE")]
    mapping: Option<PathBuf>,
    /// Shows the contents of the recordings and the observations that would be made of them, and sends nothing; needs
    /// no daemon
    #[arg(long)]
    list: bool,
    /// Topics to take, such as /scan,/door [default: all from which observations can be made]
    #[arg(long, value_name = "TOPIC,…", value_delimiter = ',')]
    topics: Vec<String>,
    /// Frame in which everything is placed [default: map, else odom, else the root above the sensors]
    #[arg(long, value_name = "FRAME")]
    frame: Option<String>,
    /// Clock that gives the times: that of the robot, which stamps messages, or that of the recorder
    #[arg(long, value_name = "CLOCK", default_value = "stamps")]
    times: ClockArg,
    /// Grid of a new map, as for map create --grid [default: resolution=0.1, flat if all sensors are level]
    #[arg(long, value_name = "SPEC")]
    grid: Option<GridArg>,
    /// Time zone of a new map, for example Europe/London [default: UTC]
    #[arg(long, value_name = "IANA")]
    time_zone: Option<String>,
    /// Beyond this range a reading only frees the space up to it [default: the limit of the sensor, at most 100]
    #[arg(long, value_name = "METRES", value_parser = grid::range)]
    max_range: Option<f32>,
    /// Beams without a return free the space up to this range; only for scanners that return something from every
    /// surface [default: they free nothing]
    #[arg(long, value_name = "METRES", value_parser = grid::range)]
    free_range: Option<f32>,
    /// Nearer readings are left out, such as those of the robot itself [default: the limit of the sensor; of clouds 0]
    #[arg(long, value_name = "METRES", value_parser = grid::range)]
    min_range: Option<f32>,
    /// Takes one scan, cloud or grid of a topic and frame in each interval of this length, such as 1s; 0s takes all
    /// [default: 1s for clouds of 20,000 points or more, else 0s]
    #[arg(long, value_name = "DURATION", value_parser = times::duration_or_none)]
    period: Option<i64>,
    /// Casts a ray to each point of a cloud; by default one to each cell in which points lie
    #[arg(long)]
    every_point: bool,
    /// Places all beams of a scan or cloud where the sensor was at the stamp; by default each is placed where it was at
    /// the beam's own time, if the message gives times
    #[arg(long)]
    at_stamp: bool,
    /// Takes the poses of a topic in place of transforms, such as /odom: nav_msgs/Odometry, geometry_msgs/PoseStamped
    /// or PoseWithCovarianceStamped [default frame: that of the messages, else the body of the first sensor]
    #[arg(long, value_name = "TOPIC[=FRAME]")]
    pose_from: Option<String>,
    /// Between two transforms that differ and are further apart than this, nothing has a place [default: 2s]
    #[arg(long, value_name = "DURATION", value_parser = times::duration_or_none)]
    transform_gap: Option<i64>,
    /// Leaves out the update that ends the import, in which the map learns what was imported
    #[arg(long)]
    no_update: bool,
    #[command(flatten)]
    sender: SenderArgs,
    /// Noise of the sensors, if it differs from the map's: P(reads occupied | is occupied) [default: 1] and P(reads
    /// occupied | is free) [default: 0]
    #[arg(long, value_name = "hit=P,false-alarm=P", value_parser = sensor::sensor)]
    sensor: Option<ProducerSensor>,
}

#[derive(Clone, Copy, Debug, PartialEq, Eq, clap::ValueEnum)]
enum ClockArg {
    /// The clock of the robot
    Stamps,
    /// The clock of the recorder
    Recorder,
}

impl From<ClockArg> for Clock {
    fn from(clock: ClockArg) -> Self {
        match clock {
            ClockArg::Stamps => Self::Stamps,
            ClockArg::Recorder => Self::Recorder,
        }
    }
}

/// The contents of the recordings, and the plan for them.
struct Planned {
    recording: Recording,
    surveyed: Arc<Surveyed>,
    plan: Arc<Plan>,
    /// Whether the times come from the clock of the recorder.
    by_recorder: bool,
}

pub(crate) async fn run(session: &Session, args: ImportArgs) -> anyhow::Result<ExitCode> {
    let planned = planned(&args).await?;
    if args.list {
        list::print(session, &planned)?;
        return Ok(ExitCode::SUCCESS);
    }
    if !planned.plan.topics.iter().any(|plan| plan.is_observed()) {
        list::print(session, &planned)?;
        let topics = &planned.surveyed.topics;
        status_line(if topics.iter().all(|topic| topic.messages == 0) {
            "no observations can be made from these recordings: they have no messages"
        } else if topics.iter().all(|topic| topic.messages == topic.unread) {
            "no observations can be made from these recordings: their messages cannot be read"
        } else {
            "no observations can be made from these recordings: use --mapping for other topics"
        });
        return Ok(ExitCode::FAILURE);
    }
    list::report(&planned);
    if list::is_all_without_place(&planned) {
        list::print_counts(session, &planned, &TopicCounts::without_place(&planned.surveyed, &planned.plan))?;
        status_line("nothing is sent: none of these messages has a place");
        return Ok(ExitCode::FAILURE);
    }
    send(session, args, planned).await
}

/// Reads the recordings once, and makes the plan.
async fn planned(args: &ImportArgs) -> anyhow::Result<Planned> {
    let mapping = match &args.mapping {
        None => Mapping::default(),
        Some(file) => {
            let shown = || file.display().to_string();
            let text = std::fs::read_to_string(file).with_context(shown)?;
            Mapping::read(&text).with_context(shown)?
        }
    };
    let recording = Recording::open(&args.files)?;
    let bar = Bar::bytes(Some(recording.bytes()));
    let wishes = Wishes {
        mapping,
        topics: args.topics.clone(),
        frame: args.frame.clone(),
        transform_gap_nanos: args.transform_gap,
        pose_from: args.pose_from.as_deref().map(PoseSource::read),
    };
    let reading = (recording.clone(), wishes.clone(), bar.clone());
    let survey = tokio::task::spawn_blocking(move || files::survey(&reading.0, &reading.1, &reading.2)).await;
    bar.clear();
    let surveyed = survey.context("the thread that reads")??;
    let plan = plan(&surveyed, &wishes).map_err(|error| usage(error.to_string()))?;
    let by_recorder = args.times == ClockArg::Recorder;
    Ok(Planned { recording, surveyed: Arc::new(surveyed), plan: Arc::new(plan), by_recorder })
}

async fn send(session: &Session, args: ImportArgs, planned: Planned) -> anyhow::Result<ExitCode> {
    // A folder such as `.` is named by its own name.
    let named = |file: &PathBuf| base_name(&file.canonicalize().unwrap_or_else(|_| file.clone()));
    let label = format!("import/{}", args.files.first().map(named).unwrap_or_default());
    let options = args.sender.options(&args.map, &label)?;
    let options = ProducerOptions { sensor: args.sensor, window_bytes: WINDOW_BYTES, ..options };
    let prepared = Prepared::map(session, &args, &planned).await?;
    let bar = Bar::bytes(Some(planned.recording.bytes()));
    let chunks = feed::open(&planned, &prepared, &args)?;
    let (producer, notices) = open_stream(session, options.clone(), &bar).await?;
    let report = RefusalReport::new(bar.clone(), "observation", "is refused");
    let counts = TopicCounts::new(&planned.surveyed);
    let mut transfer = ImportTransfer::new(
        (producer, notices),
        (chunks, prepared.states, planned.plan.clone()),
        (report, counts),
        bar.clone(),
    );
    let end = run_transfer(session, &mut transfer, &options, &bar, "observations").await?;
    transfer.conclude();
    let differs = matches!(end, TransferEnd::Differs(_));
    if !differs {
        list::print_counts(session, &planned, transfer.counts())?;
    }
    transfer.counts().report(&planned.surveyed);
    if matches!(end, TransferEnd::Stopped(_) | TransferEnd::Interrupted) {
        status_line("the same command again sends the missing observations");
    }
    let what_to_do = if differs {
        format!(
            "A changed mapping, frame or map makes other observations, which need another label, such as --label {}",
            free_label(session, &options).await
        )
    } else {
        String::new()
    };
    let shown = args.files.first().map(|file| file.display().to_string()).unwrap_or_default();
    let is_whole = matches!(end, TransferEnd::Whole);
    let code = exit_code(end, &transfer.report, &options, &shown, &what_to_do)?;
    if is_whole && !args.no_update && learn::learn(session, &args.map).await? == LearnEnd::Interrupted {
        return Ok(ExitCode::from(INTERRUPTED));
    }
    Ok(if code == ExitCode::SUCCESS && transfer.counts().has_refused() { ExitCode::FAILURE } else { code })
}
