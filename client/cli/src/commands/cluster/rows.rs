//! The tables of members and of maps.
//!
//! Invariant: columns keep their names and meanings.

use tidemap_formats::table::Cell;
use tidemap_proto::{
    convert::time::span,
    v1::{self, ReplicaRole},
};

use super::view::{ClusterView, is_writing};

pub(super) const MEMBER_COLUMNS: [&str; 11] = [
    "member",
    "address",
    "version",
    "state",
    "report_secs",
    "writes",
    "follows",
    "lag_records",
    "heard_secs",
    "forks",
    "trouble",
];

pub(super) const MAP_COLUMNS: [&str; 14] = [
    "map",
    "member",
    "role",
    "writer",
    "pinned",
    "epoch",
    "position",
    "lag_records",
    "heard_secs",
    "generation",
    "digest",
    "equal",
    "forks",
    "trouble",
];

/// A role, for people.
pub(super) fn role_name(role: ReplicaRole) -> &'static str {
    match role {
        ReplicaRole::Unspecified => "unknown",
        ReplicaRole::Starting => "starting",
        ReplicaRole::Following => "following",
        ReplicaRole::TakingOver => "taking over",
        ReplicaRole::Writing => "writing",
        ReplicaRole::Ahead => "ahead",
        ReplicaRole::Forked => "FORKED",
    }
}

fn text_or_empty(text: &str) -> Cell {
    if text.is_empty() { Cell::Empty } else { text.into() }
}

/// The state of a member in the cluster: `alive`, `draining`, `silent` (it reports itself and does not answer) or
/// `gone`.
pub(super) fn state(view: &ClusterView, member: &v1::ClusterMember) -> &'static str {
    match view.answers.get(&member.name) {
        _ if !member.is_alive => "gone",
        Some(Ok(_)) if member.is_draining => "draining",
        Some(Ok(_)) => "alive",
        _ => "silent",
    }
}

/// A row for each member.
pub(super) fn members(view: &ClusterView) -> Vec<Vec<Cell>> {
    let row = |member: &v1::ClusterMember| {
        let mut row = vec![
            Cell::Text(member.name.clone()),
            Cell::Text(member.address.clone()),
            Cell::Text(member.version.clone()),
            state(view, member).into(),
            Cell::secs(span(member.report_age)),
        ];
        let Some(answer) = view.answers.get(&member.name).and_then(|answer| answer.as_ref().ok()) else {
            let reason = view.answers.get(&member.name).and_then(|answer| answer.as_ref().err());
            row.extend([Cell::Empty, Cell::Empty, Cell::Empty, Cell::Empty, Cell::Empty]);
            row.push(Cell::maybe(reason.map(String::as_str)));
            return row;
        };
        let held: Vec<(&str, &v1::MapReplica)> =
            answer.maps.iter().filter_map(|map| Some((map.map.as_str(), map.replica.as_ref()?))).collect();
        let writes = held.iter().filter(|(_, replica)| is_writing(replica)).count() as u64;
        let lag = held.iter().map(|(map, replica)| view.end(map).saturating_sub(replica.position)).max();
        let contact_age = held.iter().filter_map(|(_, replica)| span(replica.heard_age)).max();
        let troubles = held.iter().filter(|(_, replica)| !replica.trouble.is_empty());
        let troubles: Vec<String> = troubles.map(|(map, replica)| format!("{map}: {}", replica.trouble)).collect();
        row.extend([
            writes.into(),
            (held.len() as u64 - writes).into(),
            Cell::maybe(lag),
            Cell::secs(contact_age),
            (held.iter().map(|(_, replica)| replica.forks.len() as u64).sum::<u64>()).into(),
            text_or_empty(&troubles.join("; ")),
        ]);
        row
    };
    view.first_reply.members.iter().map(row).collect()
}

/// A row for each map and member that holds it or is to hold it.
pub(super) fn maps(view: &ClusterView) -> Vec<Vec<Cell>> {
    let mut rows = Vec::new();
    for map in &view.first_reply.maps {
        let replicas = view.replicas(&map.map);
        let mut members: Vec<&str> = map.candidates.iter().map(String::as_str).collect();
        for (name, _) in &replicas {
            if !members.contains(name) {
                members.push(name);
            }
        }
        for member in members {
            let head = [Cell::Text(map.map.clone()), member.into()];
            let Some((_, replica)) = replicas.iter().find(|(name, _)| *name == member) else {
                let is_answering = view.answers.get(member).is_some_and(Result::is_ok);
                let role = if is_answering { "absent" } else { "silent" };
                let mut row = Vec::from(head);
                row.extend([role.into(), Cell::Empty, text_or_empty(&map.pinned)]);
                row.resize_with(MAP_COLUMNS.len(), || Cell::Empty);
                rows.push(row);
                continue;
            };
            let digest = replica.digest.as_ref();
            let mut row = Vec::from(head);
            row.extend([
                role_name(replica.role()).into(),
                text_or_empty(&replica.writer),
                text_or_empty(&map.pinned),
                replica.epoch.into(),
                replica.position.into(),
                view.end(&map.map).saturating_sub(replica.position).into(),
                Cell::secs(span(replica.heard_age)),
                Cell::maybe(digest.map(|digest| digest.generation)),
                Cell::maybe(digest.map(|digest| digest.value.as_str())),
                digest.and_then(|digest| digest.is_equal).map_or(Cell::Empty, Cell::Flag),
                (replica.forks.len() as u64).into(),
                text_or_empty(&replica.trouble),
            ]);
            rows.push(row);
        }
    }
    rows
}
