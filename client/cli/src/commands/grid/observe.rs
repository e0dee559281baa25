//! `tidemap grid observe`.
//!
//! Invariant: a scan's number among the files is its sequence number, so that files can be sent any number of times and
//! are learned once. What the daemon has is compared with the files before anything is sent.

mod transfer;

use std::{
    path::{Path, PathBuf},
    process::ExitCode,
    time::Duration,
};

use anyhow::Context as _;
use clap::Args;
use tidemap_client::observe::{ProducerOptions, ProducerSensor, scan::Pose};

use self::transfer::ScanTransfer;
use super::{grid_of, place, scans, sensor};
use crate::{
    commands::{
        Session,
        observe::{INTERRUPTED, LAST_FLUSH, feed::RefusalReport, nights, opened, transfer::TransferEnd},
        producer_id, times,
    },
    progress::status_line,
};

#[derive(Debug, Args)]
pub struct GridObserveArgs {
    /// Name of the map
    map: String,
    /// Files; several are as many scans
    #[arg(required = true, value_name = "FILE")]
    files: Vec<PathBuf>,
    /// When the scan was made, of several files the first; not for .tms files
    #[arg(long, value_name = "TIME", value_parser = times::time)]
    at: Option<i64>,
    /// Time from one file to the next
    #[arg(long, value_name = "DURATION", value_parser = times::duration)]
    every: Option<i64>,
    /// Where the sensor was: metres and a unit quaternion [default: what the file says]
    #[arg(long, value_name = "X,Y,Z,QX,QY,QZ,QW", value_parser = place::pose, allow_hyphen_values = true)]
    pose: Option<Pose>,
    /// Nearer points are left out, such as those of the robot itself [default: 0]
    #[arg(long, value_name = "METRES", value_parser = range)]
    min_range: Option<f32>,
    /// Farther points only say that the way is free up to here [default: no limit but the daemon's]
    #[arg(long, value_name = "METRES", value_parser = range)]
    max_range: Option<f32>,
    /// Who observes [default: a name for this user and machine, made once and kept]
    #[arg(long, value_name = "ID")]
    producer: Option<String>,
    /// Which of the producer's files these are [default: base name of the first]
    #[arg(long, value_name = "LABEL")]
    label: Option<String>,
    /// How far these scans are believed, where that is not as the map says: P(reads occupied | is occupied) [default: 1]
    /// and P(reads occupied | is free) [default: 0]. Fixed for a producer and label once it has sent something
    #[arg(long, value_name = "hit=P,false-alarm=P", value_parser = sensor::sensor)]
    sensor: Option<ProducerSensor>,
    /// Runs the nightly update whenever the scans pass the map's local midnight
    #[arg(long)]
    nightly: bool,
    /// How long to go on trying when the daemon cannot be reached
    #[arg(long, value_name = "DURATION", default_value = "60s", value_parser = times::duration_or_none)]
    patience: i64,
}

fn range(text: &str) -> Result<f32, String> {
    let right = || format!("{text:?} is not a range: use metres, 0 or more");
    text.parse::<f32>().ok().filter(|range| range.is_finite() && *range >= 0.0).ok_or_else(right)
}

pub async fn run(session: &Session, args: GridObserveArgs) -> anyhow::Result<ExitCode> {
    let given = scans::ScanOptions {
        at_nanos: args.at,
        every_nanos: args.every,
        pose: args.pose,
        min_range_m: args.min_range,
        max_range_m: args.max_range,
    };
    let plan = scans::plan(&args.files, &given)?;
    let (grid, cells_before) = grid_of(session, &args.map).await?;
    let (chunks, bar) = scans::open(plan, &grid)?;
    let options = options(&args)?;
    let (producer, label) = (options.producer.clone(), options.label.clone());
    let mut transfer = {
        let (producer, notices) = opened(session, options, &bar).await?;
        ScanTransfer::new(producer, notices, chunks, RefusalReport::of(bar.clone(), "scan", "is refused"), bar.clone())
    };
    if transfer.sent_before() > 0 {
        let scans = transfer.sent_before();
        bar.status_line(&format!(
            "{producer} sent {scans} scans as {label} before; they are compared and not sent again"
        ));
    }
    let sent = async {
        match transfer.run().await {
            TransferEnd::Whole if args.nightly => {
                nights(session, &args.map, &bar).await.map_or_else(TransferEnd::Nights, |()| TransferEnd::Whole)
            }
            // What came before counts.
            TransferEnd::Unreadable(error) => match transfer.flush().await {
                Ok(()) => TransferEnd::Unreadable(error),
                Err(stopped) => TransferEnd::Stopped(stopped),
            },
            ended => ended,
        }
    };
    let ended = tokio::select! {
        ended = sent => ended,
        signal = tokio::signal::ctrl_c() => {
            signal.context("signals")?;
            TransferEnd::Interrupted
        }
    };
    if matches!(ended, TransferEnd::Interrupted) {
        bar.status_line("interrupted; waiting for what is under way");
        let _ = tokio::time::timeout(LAST_FLUSH, transfer.flush()).await;
    }
    bar.clear();
    let counts = transfer.counts();
    if !matches!(ended, TransferEnd::Differs(_)) {
        // The daemon counts cells: it casts the rays. What others observe on this map meanwhile counts as well.
        let cells = grid_of(session, &args.map).await.map_or(0, |(_, cells)| cells.saturating_sub(cells_before));
        let mut table = session.table(&["scans", "cells", "refused", "duplicate"]);
        table.row(vec![counts.accepted.into(), cells.into(), counts.refused.into(), counts.duplicate.into()])?;
        table.finish()?;
    }
    transfer.told.conclude();
    match ended {
        TransferEnd::Whole if transfer.told.all_well() => Ok(ExitCode::SUCCESS),
        TransferEnd::Whole => Ok(ExitCode::FAILURE),
        TransferEnd::Interrupted => Ok(ExitCode::from(INTERRUPTED)),
        TransferEnd::Unreadable(error) => Err(error),
        TransferEnd::Nights(error) => Err(error.context("everything was sent, but the nightly updates failed")),
        TransferEnd::Stopped(error) => {
            status_line("the same command again sends what is missing");
            Err(error.into())
        }
        TransferEnd::Differs(how) => anyhow::bail!(
            "{} differs from what {producer} sent as {label}: {how}; nothing was sent. Other scans need another --label",
            shown(&args.files)
        ),
    }
}

fn shown(files: &[PathBuf]) -> String {
    match files {
        [file] => file.display().to_string(),
        [first, ..] => format!("{} and the files after it", first.display()),
        [] => String::new(),
    }
}

fn options(args: &GridObserveArgs) -> anyhow::Result<ProducerOptions> {
    let producer = match &args.producer {
        Some(producer) => producer.clone(),
        None => producer_id::usual()?,
    };
    let base = args.files.first().and_then(|file| Path::file_name(file));
    let label = args.label.clone().or_else(|| Some(base?.to_string_lossy().into_owned())).unwrap_or_default();
    if args.producer.is_none() {
        status_line(&format!("observing as producer {producer}, label {label}"));
    }
    let patience = Duration::from_nanos(args.patience.unsigned_abs());
    let (nightly, sensor) = (args.nightly, args.sensor);
    Ok(ProducerOptions { nightly, sensor, patience, ..ProducerOptions::new(&producer, &label, &args.map) })
}
