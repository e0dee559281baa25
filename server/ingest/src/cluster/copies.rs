//! Copies of maps between the members: which maps of this daemon need a copy, and which members can give it.
//!
//! Invariant: nothing is copied from a daemon that does not report the map, and the request goes to the writer of a map
//! last, unless the writer's bits are needed.

use std::{
    collections::BTreeMap,
    sync::{MutexGuard, PoisonError},
};

use tidemap_base::access::peer_secret::PeerSecret;
use tidemap_cluster::{
    catalogue,
    engine::{Engine as _, EngineError},
    membership::{Members, covered},
    replica::{ReplicaRole, Shortening},
};
use tidemap_map::name::MapName;

use super::Cluster;
use crate::peers::Peers as _;

/// A daemon that has to read less of a log than this needs no copy of the map.
const SHORT_BYTES: u64 = 4 << 20;

/// The reason why an open map of this daemon needs a copy of another daemon's map.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum CopyCause {
    /// The shared log begins behind the end of the own one.
    Behind,
    /// An update has produced other bits than the writer's update.
    Diverged,
}

/// The content of a map's stream, for a daemon that has nothing of the map.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct LogStart {
    /// Whether the stream begins with its first message.
    pub is_whole: bool,
    /// Whether reading the stream is as quick as a copy.
    pub is_short: bool,
}

/// The members that can give a copy of a map, with their addresses. The writer of the map comes last.
fn donors(members: &Members, own: &str, uid: u64, writer: Option<&str>) -> Vec<(String, String)> {
    let holds = |(name, member): &(&String, &tidemap_cluster::membership::Member)| {
        let report = &member.report;
        let has = report.logs.get(&uid).is_some_and(|&end| end > 0);
        name.as_str() != own && member.is_alive && has && !report.address.is_empty()
    };
    let found = members.iter().filter(holds).map(|(name, member)| (name.clone(), member.report.address.clone()));
    let mut found: Vec<(String, String)> = found.collect();
    found.sort_by_key(|(name, _)| writer == Some(name.as_str()));
    found
}

impl Cluster {
    fn waiting_maps(&self) -> MutexGuard<'_, BTreeMap<u64, String>> {
        self.0.waiting_maps.lock().unwrap_or_else(PoisonError::into_inner)
    }

    /// The secret with which the daemons of the cluster authenticate themselves.
    pub fn secret(&self) -> PeerSecret {
        self.0.secret.clone()
    }

    /// The reason why an open map needs a copy of another daemon's map; `None`: it needs no copy. `is_diverged`: its
    /// newest update has produced other bits than the writer's update.
    pub fn copy_cause(&self, uid: u64, is_diverged: bool) -> Option<CopyCause> {
        let status = self.replica_status(uid)?;
        match status.role {
            // The bits of the writer count, and so do the records that this daemon will append.
            ReplicaRole::Writing | ReplicaRole::TakingOver | ReplicaRole::Ahead => None,
            _ if status.needs_copy => Some(CopyCause::Behind),
            _ => is_diverged.then_some(CopyCause::Diverged),
        }
    }

    /// The members that can give a copy of a map, with their addresses.
    pub fn donors(&self, uid: u64, map: &MapName, cause: Option<CopyCause>) -> Vec<(String, String)> {
        let held = self.replica_status(uid).and_then(|status| status.writer);
        let writer = held.or_else(|| self.writer_of(map.as_str()));
        let mut found = donors(&self.0.members.borrow().members, self.member(), uid, writer.as_deref());
        if cause == Some(CopyCause::Diverged) {
            found.retain(|(name, _)| writer.as_ref() == Some(name));
        }
        found
    }

    /// The content of the stream of a map.
    ///
    /// # Errors
    /// [`EngineError`].
    pub async fn log_start(&self, uid: u64) -> Result<LogStart, EngineError> {
        let stream = catalogue::stream(uid);
        let is_whole = self.engine().ends(&stream).await?.first <= 1;
        let is_short = self.engine().health(&stream).await?.bytes < SHORT_BYTES;
        Ok(LogStart { is_whole, is_short })
    }

    /// Sets the reason why a map that this daemon must hold is not held yet; `None`: it is held.
    pub fn set_waiting(&self, uid: u64, why: Option<String>) {
        match why {
            Some(why) => self.waiting_maps().insert(uid, why),
            None => self.waiting_maps().remove(&uid),
        };
    }

    /// The reason why a map that this daemon must hold is not held yet.
    pub fn waiting(&self, uid: u64) -> Option<String> {
        self.waiting_maps().get(&uid).cloned()
    }

    /// The part of a map's stream that may be removed, if this daemon writes the map.
    pub fn shortening(&self, uid: u64) -> Option<Shortening> {
        let is_writing = self.replica_status(uid)?.role == ReplicaRole::Writing;
        let covered = covered(&self.0.members.borrow().members, uid, self.settings().replicas);
        (is_writing && covered > 0).then(|| Shortening {
            map: uid,
            stream: catalogue::stream(uid),
            covered,
            keep_bytes: self.settings().keep_log_mib << 20,
        })
    }
}

#[cfg(test)]
mod tests {
    use tidemap_cluster::{member::MemberReport, membership::Member};

    use super::*;

    #[test]
    fn copies_come_from_followers_before_the_writer_and_from_nobody_who_is_gone_or_has_nothing() {
        let member = |name: &str, end: u64, is_alive| {
            let report = MemberReport {
                address: format!("http://{name}"),
                logs: BTreeMap::from([(7, end)]),
                ..MemberReport::default()
            };
            (name.to_owned(), Member { report, is_alive, ..Member::default() })
        };
        let members = Members::from([
            member("a", 9, true),
            member("b", 9, true),
            member("empty", 0, true),
            member("gone", 9, false),
            member("own", 9, true),
        ]);
        let names =
            |writer| -> Vec<String> { donors(&members, "own", 7, writer).into_iter().map(|(name, _)| name).collect() };
        assert_eq!(names(Some("a")), ["b", "a"]);
        assert_eq!(names(None), ["a", "b"]);
        assert!(donors(&members, "own", 8, None).is_empty());
    }
}
