//! The problems of a cluster.
//!
//! Invariant: a pure function of the replies of the daemons.

use std::collections::BTreeMap;

use tidemap_proto::{
    convert::time::span,
    v1::{self, ReplicaRole},
};

use super::{rows::state, view::ClusterView};

/// A follower that has not received the end of the log for this long needs attention.
const CONTACT_WITHIN_NANOS: i64 = 10_000_000_000;

/// The severity of a problem; as a number, the exit status.
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord)]
pub(super) enum Severity {
    /// All is well.
    Well = 0,
    /// Something needs attention; the maps are served.
    Warning = 1,
    /// A map is not written, or data is in danger.
    Error = 2,
}

impl Severity {
    /// The word with which a line about the problem begins.
    pub(super) fn word(self) -> &'static str {
        match self {
            Self::Well => "well",
            Self::Warning => "warning",
            Self::Error => "error",
        }
    }
}

/// The worst of all.
pub(super) fn worst(concerns: &[(Severity, String)]) -> Severity {
    concerns.iter().map(|(severity, _)| *severity).max().unwrap_or(Severity::Well)
}

/// The problems, the worst first.
pub(super) fn concerns(view: &ClusterView) -> Vec<(Severity, String)> {
    let mut found = Vec::new();
    let first_reply = &view.first_reply;
    if !first_reply.engine_trouble.is_empty() {
        found.push((Severity::Error, first_reply.engine_trouble.clone()));
    }
    for server in first_reply.engine_servers.iter().filter(|server| server.syncs_always == Some(false)) {
        found.push((
            Severity::Warning,
            format!("engine server {} acknowledges before it writes to its disk", server.name),
        ));
    }
    for member in &first_reply.members {
        match state(view, member) {
            "gone" => found.push((Severity::Warning, format!("member {} is gone", member.name))),
            "silent" => {
                let reason = view.answers.get(&member.name).and_then(|answer| answer.as_ref().err());
                let reason = reason.map_or_else(String::new, |reason| format!(": {reason}"));
                found.push((Severity::Warning, format!("member {} does not respond{reason}", member.name)));
            }
            _ => {}
        }
    }
    for map in &first_reply.maps {
        of_map(view, map, &mut found);
    }
    found.sort_by_key(|(severity, _)| std::cmp::Reverse(*severity));
    found
}

fn of_map(view: &ClusterView, map: &v1::ClusterMapStatus, found: &mut Vec<(Severity, String)>) {
    let name = &map.map;
    let replicas = view.replicas(name);
    if map.uid.is_empty() {
        found.push((Severity::Error, format!("the entry of map {name} in the catalogue is damaged")));
    }
    match view.writer(name) {
        None => found.push((Severity::Error, format!("map {name} has no writer"))),
        Some(writer) if !map.pinned.is_empty() && map.pinned != writer => {
            found.push((Severity::Warning, format!("map {name} is pinned to {}, and {writer} writes it", map.pinned)));
        }
        Some(_) => {}
    }
    for member in map.candidates.iter().filter(|member| replicas.iter().all(|(holder, _)| holder != member)) {
        if view.answers.get(member).is_some_and(Result::is_ok) {
            found.push((Severity::Warning, format!("member {member} has to hold map {name} and does not yet")));
        }
    }
    for (member, replica) in &replicas {
        of_replica(name, member, replica, found);
    }
    for (generation, digests) in by_generation(&replicas) {
        if digests.iter().any(|(_, digest)| *digest != digests[0].1) {
            let members: Vec<&str> = digests.iter().map(|(member, _)| *member).collect();
            let members = members.join(", ");
            found.push((Severity::Error, format!("map {name}: generation {generation} differs between {members}")));
        }
    }
    if let Some(log) = &map.log {
        let others = u32::try_from(log.followers.len()).unwrap_or(u32::MAX);
        if log.leader.is_empty() {
            found.push((Severity::Warning, format!("the log of map {name} has no leader in the engine")));
        } else if others.saturating_add(1) < log.replicas {
            let text = format!("the log of map {name} is on {} of {} servers of the engine", others + 1, log.replicas);
            found.push((Severity::Warning, text));
        }
    }
}

fn of_replica(map: &str, member: &str, replica: &v1::MapReplica, found: &mut Vec<(Severity, String)>) {
    let mut add = |severity, text: String| found.push((severity, format!("map {map} on {member}: {text}")));
    if replica.role() == ReplicaRole::Forked {
        add(Severity::Error, "FORKED: its own log and the shared log differ".to_owned());
    }
    for fork in &replica.forks {
        let text = format!(
            "{}records {} to {} are set aside: see `tidemap cluster heal {map}`",
            if fork.groups > 1 { "FORKED: " } else { "" },
            fork.first_position,
            fork.last_position
        );
        add(if fork.groups > 1 { Severity::Error } else { Severity::Warning }, text);
    }
    if !replica.trouble.is_empty() {
        add(Severity::Warning, replica.trouble.clone());
    }
    if replica.digest.as_ref().is_some_and(|digest| digest.is_equal == Some(false)) {
        add(Severity::Error, "its newest generation differs from the writer's".to_owned());
    }
    match span(replica.heard_age) {
        Some(contact_age) if contact_age <= CONTACT_WITHIN_NANOS => {}
        Some(contact_age) => {
            add(
                Severity::Warning,
                format!("it has not received the end of the shared log for {} s", contact_age / 1_000_000_000),
            );
        }
        None => add(Severity::Warning, "it has never received the end of the shared log".to_owned()),
    }
}

/// The digests of members by generation.
fn by_generation<'a>(replicas: &[(&'a str, &'a v1::MapReplica)]) -> BTreeMap<u64, Vec<(&'a str, &'a str)>> {
    let mut digests: BTreeMap<u64, Vec<(&str, &str)>> = BTreeMap::new();
    for (member, replica) in replicas {
        if let Some(digest) = &replica.digest {
            digests.entry(digest.generation).or_default().push((member, &digest.value));
        }
    }
    digests
}

#[cfg(test)]
mod tests {
    use tidemap_proto::convert::time::duration;

    use super::*;

    fn replica(role: ReplicaRole, digest: &str) -> v1::MapReplica {
        v1::MapReplica {
            role: role.into(),
            heard_age: Some(duration(1_000_000_000)),
            digest: Some(v1::GenerationDigest { generation: 3, value: digest.to_owned(), is_equal: None }),
            ..v1::MapReplica::default()
        }
    }

    fn answer(replica: v1::MapReplica) -> v1::GetClusterStatusResponse {
        let map = v1::ClusterMapStatus {
            map: "office".to_owned(),
            uid: "01".to_owned(),
            candidates: vec!["a".to_owned(), "b".to_owned()],
            replica: Some(replica),
            ..v1::ClusterMapStatus::default()
        };
        v1::GetClusterStatusResponse { maps: vec![map], ..v1::GetClusterStatusResponse::default() }
    }

    /// Two members that both hold the map; the replica of `b` is the argument.
    fn cluster(of_b: v1::MapReplica) -> ClusterView {
        let mut first_reply = answer(replica(ReplicaRole::Writing, "0a"));
        let member =
            |name: &str| v1::ClusterMember { name: name.to_owned(), is_alive: true, ..v1::ClusterMember::default() };
        first_reply.members = ["a", "b"].map(member).to_vec();
        let answers = BTreeMap::from([("a".to_owned(), Ok(first_reply.clone())), ("b".to_owned(), Ok(answer(of_b)))]);
        ClusterView { first_reply, answers }
    }

    #[test]
    fn a_cluster_whose_members_agree_is_well() {
        let view = cluster(replica(ReplicaRole::Following, "0a"));
        assert_eq!(concerns(&view), []);
        assert_eq!(worst(&[]), Severity::Well);
    }

    #[test]
    fn each_trouble_is_named_with_how_bad_it_is() {
        let check = |view: &ClusterView, severity, part: &str| {
            let found = concerns(view);
            assert_eq!(found.len(), 1, "{found:?}");
            assert!(found[0].0 == severity && found[0].1.contains(part), "{part}: {found:?}");
        };
        check(&cluster(replica(ReplicaRole::Following, "0b")), Severity::Error, "generation 3 differs between a, b");
        let following = || replica(ReplicaRole::Following, "0a");
        check(&cluster(v1::MapReplica { trouble: "no room".into(), ..following() }), Severity::Warning, "no room");
        check(&cluster(v1::MapReplica { heard_age: None, ..following() }), Severity::Warning, "never received");
        let late = Some(duration(11_000_000_000));
        check(&cluster(v1::MapReplica { heard_age: late, ..following() }), Severity::Warning, "for 11 s");
        for (groups, severity) in [(1, Severity::Warning), (2, Severity::Error)] {
            let fork = v1::LogFork { groups, first_position: 7, last_position: 9, ..v1::LogFork::default() };
            check(&cluster(v1::MapReplica { forks: vec![fork], ..following() }), severity, "7 to 9");
        }
        let mut gone = cluster(following());
        gone.first_reply.members[1].is_alive = false;
        gone.answers.insert("b".to_owned(), Err("refused".to_owned()));
        check(&gone, Severity::Warning, "member b is gone");
        let mut unwritten = cluster(following());
        unwritten.first_reply.maps[0].replica = Some(following());
        unwritten.answers.insert("a".to_owned(), Ok(unwritten.first_reply.clone()));
        check(&unwritten, Severity::Error, "no writer");
        let mut silent = cluster(following());
        silent.answers.insert("b".to_owned(), Err("late".to_owned()));
        check(&silent, Severity::Warning, "member b does not respond: late");
        let mut without_engine = cluster(following());
        without_engine.first_reply.engine_trouble = "no connection".to_owned();
        check(&without_engine, Severity::Error, "no connection");
    }
}
