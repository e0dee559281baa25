//! `tidemap cluster verify`: the logs of a map on all members at one position, and their newest generations.
//!
//! Invariant: logs are compared at a log position that all of them have reached, and digests only of one generation.

use std::{collections::BTreeMap, process::ExitCode, time::Duration};

use tidemap_client::{Client, connection::Credentials};
use tidemap_formats::table::Cell;
use tidemap_proto::v1;

use super::{ClusterLost, Session, exit, view::ClusterView};
use crate::{commands::cluster::concerns::Severity, progress::status_line};

/// The maximum number of further requests to members while their newest generations have different numbers.
const ATTEMPTS: usize = 10;
const PAUSE: Duration = Duration::from_millis(500);

type Points = BTreeMap<String, v1::GetLogPointResponse>;

async fn points(clients: &BTreeMap<String, Client>, map: &str, position: u64) -> anyhow::Result<Points> {
    let mut points = Points::new();
    for (name, client) in clients {
        points.insert(name.clone(), client.log_point(map, position).await?);
    }
    Ok(points)
}

/// The newest generation of each member that has made one since its start.
fn generations(points: &Points) -> Vec<u64> {
    points.values().filter_map(|point| point.digest.as_ref()).map(|digest| digest.generation).collect()
}

pub(super) async fn run(session: &Session, credentials: &Credentials, map: &str) -> anyhow::Result<ExitCode> {
    let view = ClusterView::ask(&session.client, credentials).await?;
    let holders: Vec<&str> = view.replicas(map).into_iter().map(|(name, _)| name).collect();
    if holders.is_empty() {
        return Err(ClusterLost(format!("no member that responds holds map {map:?}")).into());
    }
    let mut clients = view.clients(&session.client, credentials)?;
    clients.retain(|name, _| holders.contains(&name.as_str()));
    let (mut common, mut found) = (0, Points::new());
    for attempt in 0..ATTEMPTS {
        if attempt > 0 {
            tokio::time::sleep(PAUSE).await;
        }
        let ends = points(&clients, map, 0).await?;
        common = ends.values().map(|point| point.end_position).min().unwrap_or(0);
        found = points(&clients, map, common).await?;
        if generations(&found).windows(2).all(|pair| pair[0] == pair[1]) {
            break;
        }
    }
    let newest = generations(&found).into_iter().max();
    let columns = ["map", "member", "end", "position", "chain", "generation", "digest"];
    let rows = found.iter().map(|(member, point)| {
        let digest = point.digest.as_ref();
        vec![
            map.into(),
            member.as_str().into(),
            point.end_position.into(),
            common.into(),
            Cell::maybe(point.chain.map(|chain| format!("{chain:08x}")).as_deref()),
            Cell::maybe(digest.map(|digest| digest.generation)),
            Cell::maybe(digest.map(|digest| digest.value.as_str())),
        ]
    });
    session.print(&columns, rows)?;
    let chains: Vec<u32> = found.values().filter_map(|point| point.chain).collect();
    let of_newest = found.values().filter_map(|point| point.digest.as_ref());
    let digests: Vec<&str> =
        of_newest.filter(|digest| Some(digest.generation) == newest).map(|digest| digest.value.as_str()).collect();
    let (logs, generation) = (is_one(&chains), is_one(&digests));
    status_line(&format!("logs of {} members at position {common}: {}", chains.len(), word(logs)));
    if let Some(newest) = newest {
        status_line(&format!("generation {newest} of {} members: {}", digests.len(), word(generation)));
    }
    for (member, _) in view.answers.iter().filter(|(_, answer)| answer.is_err()) {
        status_line(&format!("warning: member {member} does not respond"));
    }
    Ok(exit(if !logs || !generation {
        Severity::Error
    } else if view.answers.values().any(Result::is_err) || chains.len() < found.len() {
        Severity::Warning
    } else {
        Severity::Well
    }))
}

/// Whether all values are one.
fn is_one<T: PartialEq>(values: &[T]) -> bool {
    values.windows(2).all(|pair| pair[0] == pair[1])
}

fn word(is_equal: bool) -> &'static str {
    if is_equal { "equal" } else { "DIFFER" }
}
