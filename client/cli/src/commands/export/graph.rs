//! A topological map at a time as GeoJSON, for Nav2's route server.
//!
//! Invariant: omissions are reported.

use tidemap_formats::route_graph::RouteGraph;

use super::{
    super::{Session, files},
    ExportArgs, Written, frames,
};
use crate::progress::status_line;

/// The frame of maps without a grid.
pub(super) const USUAL_FRAME: &str = "map";

pub(super) async fn write(session: &Session, args: &ExportArgs, time_nanos: i64) -> anyhow::Result<Vec<Written>> {
    let map = session.client.map(&args.map).await?;
    let frame = map.grid.as_ref().map_or(USUAL_FRAME, |grid| &grid.frame_id);
    let graph = frames::topology(session, &args.options(), time_nanos, frame).await?;
    let Some(RouteGraph { text, nodes, edges, unplaced_nodes, closed_edges }) = graph else {
        anyhow::bail!("map {:?} has no topological map: load one with topology load", args.map);
    };
    report_left_out(unplaced_nodes, closed_edges);
    files::replace(&args.path, text)?;
    let written =
        |content, count| Written { path: args.path.display().to_string(), content, count, ever_occupied: None };
    Ok(vec![written("nodes", nodes), written("edges", edges)])
}

/// Reports the nodes and edges that a graph lacks.
pub(super) fn report_left_out(unplaced_nodes: u64, closed_edges: u64) {
    if unplaced_nodes > 0 {
        status_line(&format!(
            "left out: {unplaced_nodes} nodes without a position, and their edges; topology edit set-node sets positions"
        ));
    }
    if closed_edges > 0 {
        status_line(&format!("left out: {closed_edges} edges that touch a no-go area"));
    }
}
