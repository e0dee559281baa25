//! `tidemap-bench grid`: sends months of scans of a whole office as fast as the daemon accepts them.
//!
//! Invariant: the scans are recorded before the clock starts and are sent unchanged from the file, so that only the
//! daemon is measured. Updates run whenever the data passes midnight; midnights that pass during an update are joined
//! to one. Updates are part of the measured time.

mod feed;
mod office;
mod probe;
mod quality;
mod recorded_scans;
mod updates;

use std::{
    path::PathBuf,
    time::{Duration, Instant},
};

use clap::Args;
use tidemap_client::{
    Client,
    maps::{GridSpec, NewMap},
};

use self::{probe::Probe, recorded_scans::RecordedScans, updates::UpdateTimes};
use super::{DaemonProcess, Figures, machine::CpuTimes, updated};
use tidemap_cli::{OFFICE_RESOLUTION_M, OFFICE_ZONE};
use tidemap_formats::table::Cell;
use tidemap_terminal::progress::status_line;

#[derive(Clone, Debug, Args)]
pub(crate) struct GridArgs {
    /// Cells of the office, with edges of 0.1 m
    #[arg(long, value_name = "N", default_value_t = 213_000)]
    cells: u32,
    /// Scans per day
    #[arg(long, value_name = "N", default_value_t = 17_200)]
    scans_per_day: u32,
    /// Days
    #[arg(long, value_name = "N", default_value_t = 112, value_parser = clap::value_parser!(u32).range(1..=3650))]
    days: u32,
    /// Number of cells that change
    #[arg(long, value_name = "N", default_value_t = 15_000)]
    changing_cells: u32,
    /// Mean number of changes of each of them per day
    #[arg(long, value_name = "X", default_value_t = 40.0)]
    changes_per_day: f64,
    /// Number of parts of the office that the sensor observes in turn; with 1 each scan shows everything
    #[arg(long, value_name = "N", default_value_t = 1)]
    views: u32,
    /// Consecutive scans of one part
    #[arg(long, value_name = "N", default_value_t = 1)]
    dwell_scans: u32,
    /// Seed of the office
    #[arg(long, value_name = "N", default_value_t = 1)]
    seed: u64,
    /// File of scans: an existing file is sent unchanged, else the file is recorded and kept [default: a temporary
    /// file]. With an existing file, the options that describe the office are used by --compare only, and have to be
    /// those that the file was recorded with
    #[arg(long, value_name = "PATH")]
    file: Option<PathBuf>,
    /// Predicts the whole grid repeatedly during the run, and measures the latency
    #[arg(long)]
    probe: bool,
    /// Pause between these predictions
    #[arg(long, value_name = "DURATION", default_value = "1s", value_parser = tidemap_cli::parse_duration)]
    probe_pause: i64,
    /// Afterwards compares orders 0 to 5 with the office at this number of scans per day, and reports the estimation
    /// error over the changing cells
    #[arg(long, value_name = "N", default_value_t = 0)]
    compare: u32,
    /// Time for which the history of exact cell observations is kept: none, forever or a duration
    #[arg(long, value_name = "RETENTION", default_value = "none", value_parser = tidemap_cli::parse_retention)]
    retention: tidemap_client::maps::Retention,
    /// Does not delete the map
    #[arg(long)]
    keep: bool,
    #[command(flatten)]
    process: DaemonProcess,
}

impl GridArgs {
    /// Checks the options of the office, if they are needed.
    pub(super) fn check(&self) -> anyhow::Result<()> {
        if self.compare > 0 || self.existing().is_none() { office::make(self).map(drop) } else { Ok(()) }
    }

    /// The existing file to send.
    fn existing(&self) -> Option<&PathBuf> {
        self.file.as_ref().filter(|path| path.exists())
    }

    pub(super) fn keeps(&self) -> bool {
        self.keep
    }

    /// The map of the scans.
    pub(super) fn new_map(&self, name: String) -> NewMap {
        let grid = GridSpec { retention: self.retention, ..GridSpec::new(OFFICE_RESOLUTION_M) };
        NewMap { name, time_zone: Some(OFFICE_ZONE.to_owned()), grid: Some(grid), ..NewMap::default() }
    }
}

pub(super) async fn run(client: &Client, map: &str, args: &GridArgs) -> anyhow::Result<Figures> {
    let folder = tempfile::tempdir()?;
    let path = args.file.clone().unwrap_or_else(|| folder.path().join("bench.tms"));
    let recorded = if args.existing().is_some() {
        let recorded = RecordedScans::inspect(&path)?;
        status_line(&format!(
            "sending {} unchanged: --days, --cells, --scans-per-day and the other options that describe the office are ignored",
            path.display()
        ));
        anyhow::ensure!(
            args.compare == 0 || recorded.matches(args)?,
            "{} does not match the options of the office: --compare needs the options that the file was recorded with",
            path.display()
        );
        Some(recorded)
    } else {
        let began = Instant::now();
        status_line(&format!("recording {} days of scans to {}", args.days, path.display()));
        let (office_args, to) = (args.clone(), path.clone());
        let bytes = tokio::task::spawn_blocking(move || office::write(&to, &office_args)).await??;
        status_line(&format!("{bytes} bytes in {:.1} s, which are not measured", began.elapsed().as_secs_f64()));
        None
    };
    status_line(&format!(
        "sending to map {map}; updates run whenever the data passes midnight; midnights during an update are joined"
    ));
    let updates = UpdateTimes::watch(client, map);
    let pause = Duration::from_nanos(args.probe_pause.unsigned_abs());
    let probe = args.probe.then(|| Probe::start(client, map, pause));
    let (before, began) = (CpuTimes::now(args.process), Instant::now());
    let totals = feed::send(client, map, &path).await?;
    anyhow::ensure!(totals.scans == 0 || totals.refused < totals.scans, "all {} scans were refused", totals.scans);
    let sent_secs = began.elapsed().as_secs_f64();
    updated(client, map).await?;
    let secs = began.elapsed().as_secs_f64();
    let after = CpuTimes::now(args.process);
    let updates = updates.ended(client).await?;
    let statistics = client.statistics(map).await?;
    let figure = |name: &str| Cell::maybe(statistics.iter().find(|row| row.name == name).map(|row| row.value));
    let summary = client.map(map).await?.grid_summary.unwrap_or_default();
    let scans_per_day = recorded.map_or(Some(f64::from(args.scans_per_day)), |recorded| recorded.scans_per_day());
    let days = scans_per_day.map(|a_day| totals.scans as f64 / a_day);
    let mut figures = vec![
        ("scans", Cell::from(totals.scans)),
        ("days", Cell::maybe(days)),
        ("refused", totals.refused.into()),
        ("tiles", summary.tiles.into()),
        ("cell_observations", summary.cell_observations.into()),
        ("file_bytes", totals.bytes.into()),
        ("secs", secs.into()),
        ("sent_secs", sent_secs.into()),
        ("scans_per_sec", (totals.scans as f64 / secs).round().into()),
        ("cell_observations_per_sec", (summary.cell_observations as f64 / secs).round().into()),
        ("feeder_cpu_secs", after.feeder_since(before)),
        ("daemon_cpu_secs", after.daemon_since(before)),
        ("daemon_peak_rss_bytes", CpuTimes::daemon_peak_bytes(args.process)),
        ("updates", updates.count().into()),
        ("update_mean_secs", Cell::maybe(updates.mean_secs())),
        ("update_max_secs", Cell::maybe(updates.max_secs())),
        ("log_bytes", figure("log_bytes")),
        ("checkpoint_bytes", figure("checkpoint_bytes")),
        ("history_bytes", figure("history_bytes")),
    ];
    if let Some(probe) = probe {
        figures.extend(probe.ended().await?);
    }
    for name in ["changed_cells", "published_model_bytes", "compression_ratio", "history_compression_ratio"] {
        figures.push((name, figure(name)));
    }
    if args.compare > 0 {
        // The whole days that were sent.
        let args = GridArgs { days: days.map_or(args.days, |days| days as u32), ..args.clone() };
        figures.extend(quality::estimation_errors(client, map, &args, args.compare).await?);
    }
    Ok(figures)
}
