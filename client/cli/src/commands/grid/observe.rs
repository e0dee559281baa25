//! `tidemap grid observe`.
//!
//! Invariant: a scan's number among the files is its sequence number. The files can be sent any number of times and are
//! learned once. The scans that the daemon has are compared with the files before anything is sent.

mod transfer;

use std::{path::PathBuf, process::ExitCode};

use clap::Args;
use tidemap_client::observe::{ProducerOptions, ProducerSensor, scan::Isometry3};

use self::transfer::ScanTransfer;
use super::{
    cell_masks::Between,
    file_times::FileTimeArgs,
    grid_of, grid_of_map, place,
    scans::{self, ScanPlan},
    sensor,
};
use crate::{
    commands::{
        Session,
        observe::{
            SenderArgs, base_name, exit_code, feed::RefusalReport, free_label, open_stream, run_transfer,
            transfer::TransferEnd,
        },
    },
    progress::status_line,
};

#[derive(Debug, Args)]
pub(crate) struct GridObserveArgs {
    /// Name of the map
    map: String,
    /// Files; each is one scan, unless it ends in .tms. A folder means its files with a known ending, by name
    #[arg(required = true, value_name = "FILE")]
    files: Vec<PathBuf>,
    #[command(flatten)]
    times: FileTimeArgs,
    /// Pose of the sensor: metres and a unit quaternion [default: the pose in the file]
    #[arg(long, value_name = "X,Y,Z,QX,QY,QZ,QW", value_parser = place::pose, allow_hyphen_values = true)]
    pose: Option<Isometry3<f64>>,
    /// Points nearer than this are left out, such as points of the robot itself [default: 0]
    #[arg(long, value_name = "METRES", value_parser = range)]
    min_range: Option<f32>,
    /// Beyond this range a point only means that the space up to it is free [default: the daemon's limit]
    #[arg(long, value_name = "METRES", value_parser = range)]
    max_range: Option<f32>,
    /// Pixels of a Nav2 map of mode scale or raw that are between free and occupied: they count as occupied from this
    /// probability on and as free below it, or leave, which leaves them out [default: 0.5]
    #[arg(long, value_name = "P|leave")]
    between: Option<Between>,
    /// Pixels of value 205, which map savers write for unknown, are unknown in Nav2 maps of mode trinary; without
    /// this they count as free with free_thresh 0.25, as in Nav2's map server
    #[arg(long)]
    unknown_205: bool,
    #[command(flatten)]
    sender: SenderArgs,
    /// Noise of the sensor, if it differs from the map's: P(reads occupied | is occupied) [default: 1] and P(reads
    /// occupied | is free) [default: 0]. Fixed for a producer and label once they have sent a scan
    #[arg(long, value_name = "hit=P,false-alarm=P", value_parser = sensor::sensor)]
    sensor: Option<ProducerSensor>,
}

fn range(text: &str) -> Result<f32, String> {
    let right = || format!("{text:?} is not a range: use metres, 0 or more");
    text.parse::<f32>().ok().filter(|range| range.is_finite() && *range >= 0.0).ok_or_else(right)
}

pub(crate) async fn run(session: &Session, args: GridObserveArgs) -> anyhow::Result<ExitCode> {
    let scan_options = scans::ScanOptions {
        pose: args.pose,
        min_range_m: args.min_range,
        max_range_m: args.max_range,
        between: args.between,
        is_205_unknown: args.unknown_205,
    };
    let files = scans::named(&args.files)?;
    let plan = scans::plan(&files, args.times.is_given(), &scan_options)?;
    let times = match &plan {
        ScanPlan::Each(..) => Some(args.times.of(&files)?),
        ScanPlan::Scans(_) => None,
    };
    let map = session.client.map(&args.map).await?;
    let (zone, (grid, cells_before)) = (map.time_zone.clone(), grid_of_map(map)?);
    let mut without_time = Vec::new();
    let timed = |files| match times {
        Some(times) => {
            let (timed, refused) = times.resolve(&zone, files)?;
            without_time = refused;
            Ok(timed)
        }
        None => Ok(Vec::new()),
    };
    let (chunks, bar) = scans::open(plan, timed, &grid)?;
    let default_label = args.files.first().map(|file| base_name(file)).unwrap_or_default();
    let options = args.sender.options(&args.map, &default_label)?;
    let options = ProducerOptions { sensor: args.sensor, ..options };
    let (producer, notices) = open_stream(session, options.clone(), &bar).await?;
    let mut report = RefusalReport::new(bar.clone(), "scan", "is refused");
    without_time.iter().for_each(|(file, why)| report.left_out(file, why));
    let mut transfer = ScanTransfer::new(producer, notices, chunks, report, bar.clone());
    let end = run_transfer(session, &mut transfer, &options, &bar, "scans").await?;
    let counts = transfer.counts();
    if !matches!(end, TransferEnd::Differs(_)) {
        // The daemon casts the rays and so counts the cells. Cells that others observe meanwhile count as well.
        let cells = grid_of(session, &args.map).await.map_or(0, |(_, cells)| cells.saturating_sub(cells_before));
        let refused = counts.refused + without_time.len() as u64;
        let cells = vec![counts.accepted.into(), cells.into(), refused.into(), counts.duplicate.into()];
        session.print(&["scans", "cells", "refused", "duplicate"], [cells])?;
    }
    transfer.report.conclude();
    if matches!(end, TransferEnd::Stopped(_)) {
        status_line("the same command again sends the missing observations");
    }
    let what_to_do = if matches!(end, TransferEnd::Differs(_)) {
        format!("Other scans need another label, such as --label {}", free_label(session, &options).await)
    } else {
        String::new()
    };
    exit_code(end, &transfer.report, &options, &display_names(&args.files), &what_to_do)
}

fn display_names(files: &[PathBuf]) -> String {
    match files {
        [file] => file.display().to_string(),
        [first, ..] => format!("{} and the files after it", first.display()),
        [] => String::new(),
    }
}
