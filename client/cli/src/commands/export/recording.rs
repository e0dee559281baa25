//! Maps over time as MCAP.
//!
//! Invariant: one time after the other, in order; the prediction for a time is written before the next one is
//! requested.

use std::io::BufWriter;

use tidemap_client::maps::Map;
use tidemap_formats::map_recording::{MapRecording, MessageCounts, RecordingHead, STATES_MAX};
use tidemap_model::time::format_rfc3339;

use super::{
    super::{Session, files::Replacement, predict::names, usage},
    ExportArgs, Written,
    args::Content,
    frames,
    graph::{USUAL_FRAME, report_left_out},
};
use crate::progress::Bar;

/// The contents that a recording will have.
struct Plan {
    has_map: bool,
    has_grid: bool,
    has_topology: bool,
    states: Vec<String>,
    frame: String,
}

type Recording = MapRecording<BufWriter<Replacement>>;

pub(super) async fn write(session: &Session, args: &ExportArgs, mut times: Vec<i64>) -> anyhow::Result<Vec<Written>> {
    times.sort_unstable();
    times.dedup();
    let map = session.client.map(&args.map).await?;
    let plan = plan(session, args, &map).await?;
    let ends = [times.first(), times.last()].map(|time| format_rfc3339(time.copied().unwrap_or_default()));
    let [from, to] = ends;
    let about = [("map", args.map.clone()), ("time_zone", map.time_zone.clone()), ("from", from), ("to", to)];
    let is_ros2_only = plan.has_map && !plan.has_grid && !plan.has_topology && plan.states.is_empty();
    let head = RecordingHead { is_ros2_only, about: about.map(|(name, text)| (name.to_owned(), text)).into() };
    let mut recording = MapRecording::new(BufWriter::new(Replacement::begin(&args.path)?), &head)?;
    let bar = Bar::count("times");
    for (done, &time_nanos) in times.iter().enumerate() {
        bar.set_of(done as u64, times.len() as u64);
        put(session, args, &plan, time_nanos, &mut recording, done == 0).await?;
    }
    bar.clear();
    let (file, counts) = recording.finish()?;
    file.into_inner().map_err(std::io::IntoInnerError::into_error)?.keep()?;
    Ok(rows(args, counts))
}

/// The requested contents that the map has.
async fn plan(session: &Session, args: &ExportArgs, map: &Map) -> anyhow::Result<Plan> {
    let region = map.grid_summary.as_ref().and_then(|summary| summary.region);
    let has_grid = map.grid.is_some() && region.is_some();
    let has_topology = args.wants(Content::Topology) && session.client.topology(&args.map).await?.nodes().len() > 0;
    let states = match args.wants(Content::States) {
        false => Vec::new(),
        true if args.states.is_empty() => names::all(session, &args.map).await?,
        true => names::meant(session, &args.map, args.states.clone()).await?,
    };
    if states.len() > STATES_MAX {
        let count = states.len();
        return Err(usage(format!("{count} states, and a recording takes {STATES_MAX}: choose some with --state")));
    }
    let plan = Plan {
        has_map: has_grid && args.wants(Content::Map),
        has_grid: has_grid && args.wants(Content::Grid),
        has_topology,
        frame: map.grid.as_ref().map_or(USUAL_FRAME, |grid| &grid.frame_id).to_owned(),
        states,
    };
    for (content, is_there, what) in [
        (Content::Map, plan.has_map, "grid with scans"),
        (Content::Grid, plan.has_grid, "grid with scans"),
        (Content::Topology, plan.has_topology, "topological map"),
        (Content::States, !plan.states.is_empty(), "states"),
    ] {
        if args.names(content) && !is_there {
            return Err(usage(format!("map {:?} has no {what}: leave it out of --content", args.map)));
        }
    }
    if !(plan.has_map || plan.has_grid || plan.has_topology) && plan.states.is_empty() {
        return Err(usage(format!("map {:?} is empty: it has no grid with scans, no nodes and no states", args.map)));
    }
    Ok(plan)
}

/// Writes the whole content of a map at one time. `with_report`: whether to report omissions.
async fn put(
    session: &Session,
    args: &ExportArgs,
    plan: &Plan,
    time_nanos: i64,
    recording: &mut Recording,
    with_report: bool,
) -> anyhow::Result<()> {
    let options = args.options();
    if plan.has_map || plan.has_grid {
        let grid = frames::grid(session, &options, time_nanos).await?;
        if plan.has_map {
            recording.map(time_nanos, &grid.frame, &grid.picture)?;
        }
        if plan.has_grid {
            recording.grid(time_nanos, &grid.frame, &grid.picture)?;
        }
    }
    if plan.has_topology
        && let Some(graph) = frames::topology(session, &options, time_nanos, &plan.frame).await?
    {
        recording.topology(time_nanos, &graph.text)?;
        if with_report {
            report_left_out(graph.unplaced_nodes, graph.closed_edges);
        }
    }
    if !plan.states.is_empty() {
        for (name, value) in frames::states(session, &options, time_nanos, &plan.states).await? {
            recording.state(time_nanos, &name, value)?;
        }
    }
    Ok(())
}

fn rows(args: &ExportArgs, counts: MessageCounts) -> Vec<Written> {
    let MessageCounts { maps, grids, topologies, states } = counts;
    let all = [("map", maps), ("grid", grids), ("topology", topologies), ("states", states)];
    let written =
        |(content, count)| Written { path: args.path.display().to_string(), content, count, ever_occupied: None };
    all.into_iter().filter(|(_, count)| *count > 0).map(written).collect()
}
