//! `tidemap visit` and `tidemap reachability`.
//!
//! Invariant: a report is durable when the command ends.

use std::process::ExitCode;

use clap::{ArgAction, Args, Subcommand};
use tidemap_formats::table::Cell;

use tidemap_client::exploration::ReachedPlace;

use super::{Session, point::Point, times};
use crate::progress::status_line;

#[derive(Debug, Args)]
pub(crate) struct VisitArgs {
    /// Name of the map
    map: String,
    /// Goal of the robot, metres
    #[arg(value_name = "X,Y", allow_hyphen_values = true)]
    at: Point,
    /// Whether the robot reached it
    #[arg(long, value_name = "true|false", action = ArgAction::Set)]
    reached: bool,
    /// Time of the visit [default: now]
    #[arg(long = "at", value_name = "TIME", value_parser = times::time)]
    time: Option<i64>,
}

pub(crate) async fn run(session: &Session, args: &VisitArgs) -> anyhow::Result<ExitCode> {
    let VisitArgs { map, at: Point(at_m), reached, time } = args;
    let (reachability, attempts) = session.client.report_visit(map, *at_m, *reached, *time).await?;
    session.print(
        &["x", "y", "reachability", "attempts"],
        [vec![at_m[0].into(), at_m[1].into(), reachability.into(), attempts.into()]],
    )
}

#[derive(Debug, Subcommand)]
pub(crate) enum ReachabilityCommand {
    /// Lists the squares of 0.5 m that robots tried to reach, with the share of the last five attempts that succeeded
    ///
    /// Other places have the map's prior reachability, 0.5.
    List {
        /// Name of the map
        map: String,
    },
}

pub(crate) async fn list(session: &Session, command: &ReachabilityCommand) -> anyhow::Result<ExitCode> {
    let ReachabilityCommand::List { map } = command;
    let places = session.client.reachability(map).await?;
    if places.is_empty() {
        status_line(&format!(
            "no robot has reported a visit: tidemap visit {map} X,Y --reached true|false reports one"
        ));
    }
    let row = |place: &ReachedPlace| {
        let [x, y] = place.at_m.map(Cell::from);
        vec![x, y, place.reachability.into(), place.attempts.into(), Cell::Time(place.last_nanos)]
    };
    session.print(&["x", "y", "reachability", "attempts", "last_time"], places.iter().map(row))
}
