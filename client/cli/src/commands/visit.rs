//! `tidemap visit`.
//!
//! Invariant: the report is durable when the command ends.

use std::process::ExitCode;

use clap::{ArgAction, Args};

use super::{Session, point::Point, times};

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
