//! `tidemap bench grid`: months of scans of a whole office, as fast as the daemon takes them.
//!
//! Invariant: the scans are made before the clock starts, and are sent as they stand in the file; what is measured is the
//! daemon. Updates run as midnights of the data pass, those that pass while one runs joined into one, and count.

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
    maps::{Grid, NewMap},
};

use self::{probe::Probe, recorded_scans::RecordedScans, updates::UpdateTimes};
use super::{DaemonProcess, Figures, machine::CpuTimes, updated};
use crate::{commands::times, progress::status_line};
use tidemap_formats::table::Cell;

#[derive(Clone, Debug, Args)]
pub(crate) struct GridArgs {
    /// Cells of the office, of 0.1 m
    #[arg(long, value_name = "N", default_value_t = 213_000)]
    cells: u32,
    /// Scans a day
    #[arg(long, value_name = "N", default_value_t = 17_200)]
    scans_per_day: u32,
    /// Days
    #[arg(long, value_name = "N", default_value_t = 112, value_parser = clap::value_parser!(u32).range(1..=3650))]
    days: u32,
    /// Cells that change
    #[arg(long, value_name = "N", default_value_t = 15_000)]
    changing_cells: u32,
    /// How often each of them changes in a day, in the mean
    #[arg(long, value_name = "X", default_value_t = 40.0)]
    changes_per_day: f64,
    /// Parts of the office that the sensor sees in turn; 1: it sees everything in each scan
    #[arg(long, value_name = "N", default_value_t = 1)]
    views: u32,
    /// Scans of one part before the next
    #[arg(long, value_name = "N", default_value_t = 1)]
    dwell_scans: u32,
    /// Another seed makes another office
    #[arg(long, value_name = "N", default_value_t = 1)]
    seed: u64,
    /// File of scans: sent as it is where it exists, else made and kept [default: a temporary one]. Of one that exists
    /// --cells, --days and the others that say what the office is like are used by --compare only, and have to be those
    /// that it was made with
    #[arg(long, value_name = "PATH")]
    file: Option<PathBuf>,
    /// Predicts the whole grid again and again meanwhile, and times it
    #[arg(long)]
    probe: bool,
    /// Pause between two such predictions
    #[arg(long, value_name = "DURATION", default_value = "1s", value_parser = times::duration)]
    probe_pause: i64,
    /// Compares orders 0 to 5 with the office afterwards, at this many scans of each day: the estimation error over the
    /// changing cells
    #[arg(long, value_name = "N", default_value_t = 0)]
    compare: u32,
    /// How long the exact readings are kept: none, forever, or a duration
    #[arg(long, value_name = "RETENTION", default_value = "none", value_parser = crate::commands::map::grid_spec::retention)]
    retention: tidemap_client::maps::Retention,
    /// Keeps the map
    #[arg(long)]
    keep: bool,
    #[command(flatten)]
    process: DaemonProcess,
}

impl GridArgs {
    /// Whether there is such an office, where one is needed.
    pub(super) fn check(&self) -> anyhow::Result<()> {
        if self.compare > 0 || self.existing().is_none() { office::make(self).map(drop) } else { Ok(()) }
    }

    /// The file to send as it is.
    fn existing(&self) -> Option<&PathBuf> {
        self.file.as_ref().filter(|path| path.exists())
    }

    pub(super) fn keeps(&self) -> bool {
        self.keep
    }

    /// The map that the scans are for.
    pub(super) fn new_map(&self, name: String) -> NewMap {
        let grid = Grid { resolution_m: office::RESOLUTION_M, retention: Some(self.retention), ..Grid::default() };
        NewMap { name, time_zone: Some(office::ZONE.to_owned()), grid: Some(grid), ..NewMap::default() }
    }
}

pub(super) async fn run(client: &Client, map: &str, args: &GridArgs) -> anyhow::Result<Figures> {
    let folder = tempfile::tempdir()?;
    let path = args.file.clone().unwrap_or_else(|| folder.path().join("bench.tms"));
    let recorded = if args.existing().is_some() {
        let recorded = RecordedScans::inspect(&path)?;
        status_line(&format!(
            "sending {} as it is: --days, --cells, --scans-per-day and what else the office is like are not used for it",
            path.display()
        ));
        anyhow::ensure!(
            args.compare == 0 || recorded.matches(args)?,
            "{} is not of the office that the options describe: --compare takes the options that it was made with",
            path.display()
        );
        Some(recorded)
    } else {
        let began = Instant::now();
        status_line(&format!("making {} days of scans in {}", args.days, path.display()));
        let (of, to) = (args.clone(), path.clone());
        let bytes = tokio::task::spawn_blocking(move || office::write(&to, &of)).await??;
        status_line(&format!("{bytes} bytes in {:.1} s, which do not count", began.elapsed().as_secs_f64()));
        None
    };
    status_line(&format!(
        "sending to map {map}; updates as midnights of the data pass; those that pass while one runs are joined"
    ));
    let updates = UpdateTimes::watch(client, map);
    let pause = Duration::from_nanos(args.probe_pause.unsigned_abs());
    let probe = args.probe.then(|| Probe::start(client, map, pause));
    let (before, began) = (CpuTimes::now(args.process), Instant::now());
    let fed = feed::send(client, map, &path).await?;
    anyhow::ensure!(fed.scans == 0 || fed.refused < fed.scans, "all {} scans were refused", fed.scans);
    let sent_secs = began.elapsed().as_secs_f64();
    updated(client, map).await?;
    let secs = began.elapsed().as_secs_f64();
    let after = CpuTimes::now(args.process);
    let updates = updates.ended(client).await?;
    let statistics = client.statistics(map).await?;
    let figure = |name: &str| Cell::maybe(statistics.iter().find(|row| row.name == name).map(|row| row.value));
    let summary = client.map(map).await?.grid_summary.unwrap_or_default();
    let scans_per_day = recorded.map_or(Some(f64::from(args.scans_per_day)), |recorded| recorded.scans_per_day());
    let days = scans_per_day.map(|a_day| fed.scans as f64 / a_day);
    let mut figures = vec![
        ("scans", Cell::from(fed.scans)),
        ("days", Cell::maybe(days)),
        ("refused", fed.refused.into()),
        ("tiles", summary.tiles.into()),
        ("cell_observations", summary.cell_observations.into()),
        ("file_bytes", fed.bytes.into()),
        ("secs", secs.into()),
        ("sent_secs", sent_secs.into()),
        ("scans_per_sec", (fed.scans as f64 / secs).round().into()),
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
        // Whole days of what was sent.
        let args = GridArgs { days: days.map_or(args.days, |days| days as u32), ..args.clone() };
        figures.extend(quality::estimation_errors(client, map, &args, args.compare).await?);
    }
    Ok(figures)
}
