//! `tidemap cluster heal`: takes the observations of forks into the map again, and removes forks whose observations are
//! all in the map.
//!
//! Invariant: a fork of which the map lacks something is removed only if the user accepts the loss explicitly.

use std::{
    process::ExitCode,
    time::{Duration, Instant},
};

use tidemap_client::{Client, connection::Credentials};
use tidemap_formats::table::Cell;
use tidemap_proto::v1;

use super::{
    ClusterLost, HealArgs, Session,
    concerns::Severity,
    exit,
    take_in::{TakenIn, take_in},
    view::{ClusterView, answer_of},
};
use crate::progress::status_line;

/// The time limit for a member to follow the map.
const FOLLOW_WITHIN: Duration = Duration::from_secs(10);
const POLL: Duration = Duration::from_millis(100);

const COLUMNS: [&str; 10] = [
    "map",
    "member",
    "fork",
    "producer",
    "label",
    "first_sequence",
    "last_sequence",
    "observations",
    "in_map",
    "removed",
];

/// Records of a fork that the map lacks: observations, and other records, for which this is not known.
fn missing(fork: &v1::LogFork) -> u64 {
    let observations = fork.producers.iter().map(|row| row.observations.saturating_sub(row.known_observations));
    observations.sum::<u64>() + fork.other_records
}

fn rows(map: &str, member: &str, fork: &v1::LogFork, is_removed: bool) -> Vec<Vec<Cell>> {
    let head = || vec![map.into(), member.into(), Cell::Text(fork.name.clone())];
    let mut rows: Vec<Vec<Cell>> = Vec::new();
    for row in &fork.producers {
        let mut cells = head();
        cells.extend([row.producer.as_str().into(), row.label.as_str().into()]);
        cells
            .extend([row.first_sequence, row.last_sequence, row.observations, row.known_observations].map(Cell::Count));
        cells.push(Cell::Flag(is_removed));
        rows.push(cells);
    }
    // A fork may hold nothing of a producer.
    if rows.is_empty() {
        let mut cells = head();
        cells.resize_with(COLUMNS.len() - 1, || Cell::Empty);
        cells.push(Cell::Flag(is_removed));
        rows.push(cells);
    }
    rows
}

/// A fork of which the map has everything.
fn all_known(fork: &v1::LogFork) -> v1::LogFork {
    let mut fork = fork.clone();
    fork.producers.iter_mut().for_each(|row| row.known_observations = row.observations);
    fork
}

/// Removes a fork. Its member may have done so before.
async fn discard(client: &Client, map: &str, fork: &str) -> anyhow::Result<()> {
    match client.discard_fork(map, fork).await {
        Err(_) if fork_now(client, map, fork).await?.is_none() => Ok(()),
        discarded => Ok(discarded?),
    }
}

/// A fork of a member, as it stands.
async fn fork_now(client: &Client, map: &str, fork: &str) -> anyhow::Result<Option<v1::LogFork>> {
    let answer = answer_of(client, false).await?;
    let replica = answer.maps.into_iter().find(|found| found.map == map).and_then(|found| found.replica);
    Ok(replica.and_then(|replica| replica.forks.into_iter().find(|found| found.name == fork)))
}

/// Sends the observations of a fork that the map lacks, and reports those that cannot be sent. Returns the fork as it
/// is then; `None`: its member has removed it, because the map has everything.
async fn take_in_fork(
    session: &Session,
    (member, client): (&str, &Client),
    map: &str,
    fork: &v1::LogFork,
) -> anyhow::Result<Option<v1::LogFork>> {
    let TakenIn { taken, reasons } = take_in(&session.client, client, map, fork).await?;
    status_line(&format!("{taken} observations of fork {} on {member} are in the map now", fork.name));
    for reason in reasons {
        status_line(&format!("warning: fork {} on {member}: {reason}", fork.name));
    }
    // A member that follows the map has it a moment later.
    let (goal, begun) = (missing(fork).saturating_sub(taken), Instant::now());
    loop {
        let now = fork_now(client, map, &fork.name).await?;
        if now.as_ref().is_none_or(|now| missing(now) <= goal) || begun.elapsed() > FOLLOW_WITHIN {
            return Ok(now);
        }
        tokio::time::sleep(POLL).await;
    }
}

pub(super) async fn run(session: &Session, credentials: &Credentials, args: HealArgs) -> anyhow::Result<ExitCode> {
    let HealArgs { map, accept_loss, dry_run } = args;
    let view = ClusterView::ask(&session.client, credentials).await?;
    let clients = view.clients(&session.client, credentials)?;
    if view.first_reply.maps.iter().all(|known| known.map != map) {
        return Err(ClusterLost(format!("map {map:?} does not exist in the cluster")).into());
    }
    let (mut printed, mut left) = (Vec::new(), 0);
    for (member, replica) in view.replicas(&map) {
        let Some(client) = clients.get(member) else { continue };
        for fork in &replica.forks {
            let now = match missing(fork) {
                0 => Some(fork.clone()),
                _ if dry_run => Some(fork.clone()),
                _ => take_in_fork(session, (member, client), &map, fork).await?,
            };
            let Some(fork) = now else {
                printed.extend(rows(&map, member, &all_known(fork), true));
                continue;
            };
            let missing = missing(&fork);
            let is_removed = !dry_run && (accept_loss || missing == 0);
            if is_removed {
                discard(client, &map, &fork.name).await?;
            } else if missing > 0 {
                status_line(&format!(
                    "error: fork {} on {member} has {missing} records that the map lacks, or may lack{}",
                    fork.name,
                    if dry_run { "" } else { ". --accept-loss removes the fork; its records are lost" }
                ));
            }
            left += usize::from(!is_removed);
            if fork.other_records > 0 {
                status_line(&format!(
                    "warning: fork {} on {member} holds {} changes of states or of the site. This command cannot find \
                     out whether the map has them: compare them yourself",
                    fork.name, fork.other_records
                ));
            }
            printed.extend(rows(&map, member, &fork, is_removed));
        }
    }
    let silent: Vec<&str> =
        view.answers.iter().filter(|(_, answer)| answer.is_err()).map(|(member, _)| member.as_str()).collect();
    if !silent.is_empty() {
        status_line(&format!("warning: {} did not respond; there may be forks", silent.join(", ")));
    }
    session.print(&COLUMNS, printed)?;
    Ok(exit(if left > 0 {
        Severity::Error
    } else if silent.is_empty() {
        Severity::Well
    } else {
        Severity::Warning
    }))
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_fork_lacks_nothing_when_all_of_its_observations_are_in_the_map_and_it_holds_nothing_else() {
        let producer = v1::ForkedProducer { observations: 5, known_observations: 5, ..v1::ForkedProducer::default() };
        let fork = v1::LogFork { producers: vec![producer.clone()], ..v1::LogFork::default() };
        assert_eq!(missing(&fork), 0);
        assert_eq!(missing(&v1::LogFork { other_records: 2, ..fork.clone() }), 2);
        let less = v1::ForkedProducer { known_observations: 1, ..producer };
        assert_eq!(missing(&v1::LogFork { producers: vec![less], ..fork }), 4);
    }
}
