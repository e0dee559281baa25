//! `tidemap demo`: weeks of robots' observations in a simulated office, sent through the real API to a new daemon, and
//! a picture of its predictions.
//!
//! Invariant: predictions come from the daemon, which receives only the robots' observations; the truth comes from the
//! simulation. The daemon and its folder are removed at the end, also after an error or Ctrl-C.

mod calendar;
mod daemon;
mod feed;
mod forecast;
mod picture;
mod report;
mod updates;
mod words;

use std::{
    env,
    io::{self, ErrorKind, Write as _},
    path::PathBuf,
    process::ExitCode,
};

use anyhow::{Context as _, anyhow};
use tidemap_client::{Client, maps::NewMap};
use tidemap_sim::Office;
use tokio::signal::unix::{SignalKind, signal};

use self::{calendar::Calendar, daemon::Daemon, feed::Robots};

/// Name of the demo's map.
const MAP: &str = "office";
/// Time zone of the simulated people.
const ZONE: &str = "Europe/London";
/// States whose forecasts are shown: two daily habits, a weekly one, a random one, and a constant.
const SHOWN: [&str; 5] = ["office-1-door", "meeting-room", "kitchen", "storage-door", "corridor-door"];
/// States that are shown again for a day off.
const SHOWN_ON_DAY_OFF: [&str; 2] = ["office-1-door", "kitchen"];

/// Exit status after a signal: 128 plus its number.
const INTERRUPTED: u8 = 130;
const TERMINATED: u8 = 143;

#[derive(Clone, Debug, clap::Args)]
pub(crate) struct DemoArgs {
    /// Weeks to observe before the prediction
    #[arg(long, value_name = "N", default_value_t = 6, value_parser = clap::value_parser!(u32).range(1..=52))]
    pub(crate) weeks: u32,
    /// Seed of the people's days; their routines stay the same
    #[arg(long, value_name = "N", default_value_t = 1)]
    pub(crate) seed: u64,
    /// Leaves the daemon running afterwards
    #[arg(long)]
    pub(crate) keep: bool,
    /// The daemon's program [default: tidemapd beside this program]
    #[arg(long, value_name = "PATH")]
    pub(crate) daemon: Option<PathBuf>,
}

/// Runs the demo; after a signal the exit status is the status that a shell gives.
///
/// # Errors
/// The daemon does not start, or fails; the error holds the end of the daemon's log.
pub(crate) async fn run(args: &DemoArgs) -> anyhow::Result<ExitCode> {
    // Registered before the daemon starts, so that no signal can end the demo alone.
    let mut interrupt = signal(SignalKind::interrupt()).context("signals")?;
    let mut terminate = signal(SignalKind::terminate()).context("signals")?;
    let daemon = Daemon::start(args.daemon.as_deref())?;
    tokio::select! {
        shown = show(args, &daemon) => shown?,
        _ = interrupt.recv() => return Ok(stopped(daemon, INTERRUPTED)),
        _ = terminate.recv() => return Ok(stopped(daemon, TERMINATED)),
    }
    let program = env::args().next().unwrap_or_else(|| "tidemap".to_owned());
    if args.keep {
        let (address, http) = (daemon.address().to_owned(), daemon.http().to_owned());
        let kept = daemon.keep();
        print(&report::kept(&program, &address, &http, kept.pid, &kept.folder)?)?;
    } else {
        drop(daemon);
        print(&report::ended(&program)?)?;
    }
    Ok(ExitCode::SUCCESS)
}

fn stopped(daemon: Daemon, status: u8) -> ExitCode {
    drop(daemon);
    eprintln!("stopped; the daemon is stopped and its folder removed");
    ExitCode::from(status)
}

async fn show(args: &DemoArgs, daemon: &Daemon) -> anyhow::Result<()> {
    learn(args, daemon.address())
        .await
        .map_err(|error| if reader_gone(&error) { error } else { anyhow!("{error:#}{}", daemon.last_words()) })
}

fn reader_gone(error: &anyhow::Error) -> bool {
    error.downcast_ref().is_some_and(|error: &io::Error| error.kind() == ErrorKind::BrokenPipe)
}

async fn learn(args: &DemoArgs, address: &str) -> anyhow::Result<()> {
    let office = Office::new(args.seed, ZONE)?;
    let calendar = Calendar::new(ZONE, args.weeks)?;
    let client = Client::connect(address).await?;
    let map = NewMap { name: MAP.to_owned(), time_zone: Some(ZONE.to_owned()), ..NewMap::default() };
    client.create_map(map).await?;
    print(&report::opening(args.weeks, &office.robots(), office.states().len(), address)?)?;

    let mut robots = Robots::open(&client, &office, calendar.start()).await?;
    for week in 1..=args.weeks {
        let until = calendar.week_end(week);
        robots.drive(&office, until).await?;
        updates::await_updates(&client, calendar.midnight_before(robots.seen_until())).await?;
        if week == args.weeks {
            // No later data triggers the last update.
            updates::run_last(&client, until).await?;
        }
        let forecasts = forecast::all(&client, &office, &calendar.samples(until)).await?;
        print(&report::week(week, &calendar.last_day(until), robots.sent(), &forecasts)?)?;
    }

    let [tomorrow, day_off] = calendar.days();
    let mut shown = Vec::new();
    for forecast in forecast::all(&client, &office, &tomorrow.1).await? {
        if SHOWN.contains(&forecast.state) {
            let model = client.describe_model(MAP, forecast.state).await?;
            shown.push((forecast, model));
        }
    }
    print(&report::tomorrow(&tomorrow.0, &shown)?)?;
    let off_forecasts = forecast::all(&client, &office, &day_off.1).await?;
    print(&report::day_off(&day_off.0, &off_forecasts, &SHOWN_ON_DAY_OFF)?)?;
    print(report::lesson())
}

/// Writes to stdout and flushes; a closed stdout is an error, not a panic.
fn print(text: &str) -> anyhow::Result<()> {
    let mut stdout = io::stdout().lock();
    stdout.write_all(text.as_bytes())?;
    Ok(stdout.flush()?)
}
