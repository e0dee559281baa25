//! The operations of a cluster for operators: they list its members, show the role of this daemon for each map, and
//! choose the writer of a map.
//!
//! Invariant: every reply contains this daemon's own view. Nothing here waits for another daemon, except for its next
//! report, and nothing is decided about a log: a move changes an entry of the catalogue, and the writer follows it.

use std::{collections::BTreeMap, sync::PoisonError, time::Instant};

use tidemap_cluster::{
    assignment,
    catalogue::{self, ClusterMap},
    engine::{Bucket, Engine as _, EngineError, EngineServer, SetError, StreamHealth},
    member::MemberReport,
    membership::{self, Members, MembersView},
    replica::{ReplicaRole, ReplicaStatus},
};
use tidemap_map::name::MapName;
use tidemap_store::{CopyError, EventLog as _, OpenError};

use super::{Cluster, SharedLog};

/// Number of attempts to change the catalogue, when another change came first.
const ATTEMPTS: usize = 5;

/// The reason why an operator's request is refused.
#[derive(Debug, thiserror::Error)]
#[expect(missing_docs, reason = "the messages name the variants and fields")]
pub enum OperationError {
    #[error("this daemon is not a member of a cluster: its config file has no section [cluster]")]
    NoCluster,
    #[error("map {0:?} does not exist in the cluster")]
    UnknownMap(String),
    #[error("this daemon does not hold map {0:?}: `tidemap cluster maps` shows the members that hold it")]
    NotHeld(String),
    #[error("{member:?} is no member of the cluster; members: {}", known.join(", "))]
    UnknownMember { member: String, known: Vec<String> },
    #[error("member {0} is gone: it has not reported itself for a while")]
    Gone(String),
    #[error("member {0} is draining: `tidemap cluster drain {0} --undo` ends that")]
    Draining(String),
    #[error("member {0} is alive: stop its daemon first. A daemon counts as alive for 5 seconds after its last report")]
    Alive(String),
    #[error("member {0} has capacity 0: it holds no maps")]
    NoCapacity(String),
    #[error("member {member} does not hold map {map}; it is held by {}", holders.join(", "))]
    DoesNotHold { member: String, map: String, holders: Vec<String> },
    #[error("the entry of map {0:?} in the catalogue was changed meanwhile, again and again: try again")]
    Changed(String),
    #[error("map {map:?} has no fork {fork:?} on this daemon")]
    UnknownFork { map: String, fork: String },
    #[error("the engine of the cluster: {0}")]
    Engine(#[from] EngineError),
    #[error(transparent)]
    Log(#[from] OpenError),
    #[error("the log of map {0:?} on this daemon and the shared one are being compared, or differ")]
    NotAligned(String),
    #[error(transparent)]
    Copy(#[from] CopyError),
}

/// A map as the catalogue lists it.
#[derive(Clone, Debug)]
pub struct ListedMap {
    /// Name of the map.
    pub name: String,
    /// Number of the map; `None`: the entry of the map is damaged.
    pub uid: Option<u64>,
    /// The member that an operator chose as the writer.
    pub pinned: Option<String>,
    /// Members that hold the map, in the order in which they may become its writer.
    pub holders: Vec<String>,
}

fn unknown_member(members: &Members, member: &str) -> OperationError {
    let known = members.keys().cloned().collect();
    OperationError::UnknownMember { member: member.chars().take(80).collect(), known }
}

/// Checks that a member can be the writer of a map.
fn check_target(members: &Members, member: &str, (map, uid): (&str, Option<u64>)) -> Result<(), OperationError> {
    let found = members.get(member).ok_or_else(|| unknown_member(members, member))?;
    let name = || member.to_owned();
    let holds = |report: &MemberReport| uid.is_some_and(|uid| report.logs.contains_key(&uid));
    if !found.is_alive {
        Err(OperationError::Gone(name()))
    } else if found.report.draining {
        Err(OperationError::Draining(name()))
    } else if found.report.capacity == 0 {
        Err(OperationError::NoCapacity(name()))
    } else if !holds(&found.report) {
        let holders = members.iter().filter(|(_, other)| other.is_alive && holds(&other.report));
        let holders = holders.map(|(name, _)| name.clone()).collect();
        Err(OperationError::DoesNotHold { member: name(), map: map.to_owned(), holders })
    } else {
        Ok(())
    }
}

impl Cluster {
    /// Name of the cluster.
    pub fn name(&self) -> &str {
        &self.0.settings.name
    }

    /// Name of this daemon.
    pub fn member(&self) -> &str {
        &self.0.settings.member
    }

    /// The members.
    ///
    /// # Errors
    /// [`EngineError`] where the members cannot be read now.
    pub fn members(&self) -> Result<Members, EngineError> {
        let MembersView { members, trouble } = self.0.members.borrow().clone();
        trouble.map_or(Ok(members), Err)
    }

    /// The members as this daemon saw them last, and the reason why they cannot be read now.
    pub fn members_view(&self) -> MembersView {
        self.0.members.borrow().clone()
    }

    /// The maps that the catalogue lists.
    ///
    /// # Errors
    /// [`EngineError`].
    pub async fn listed_maps(&self) -> Result<Vec<ListedMap>, EngineError> {
        let candidates = membership::candidates(&self.members()?);
        let listing = catalogue::list(self.engine()).await?;
        let is_deleted = |uid: Option<u64>| uid.is_some_and(|uid| listing.deleted.contains(&uid));
        let listed = |(name, map, _): &(String, ClusterMap, u64)| {
            let (uid, pinned) = (map.uid(), map.pinned.clone());
            let holders = |uid| assignment::holders(uid, &candidates, pinned.as_deref(), self.0.settings.replicas);
            ListedMap { name: name.clone(), uid, holders: uid.map(holders).unwrap_or_default(), pinned }
        };
        Ok(listing.maps.iter().map(listed).filter(|map| !is_deleted(map.uid)).collect())
    }

    /// The maps that this daemon holds, for use when the engine does not reply.
    pub fn held_maps(&self) -> Vec<ListedMap> {
        let held = self.replicas();
        let listed = held.iter().map(|(&uid, replica)| ListedMap {
            name: replica.name.as_str().to_owned(),
            uid: Some(uid),
            pinned: None,
            holders: Vec::new(),
        });
        let mut listed: Vec<ListedMap> = listed.collect();
        listed.sort_by(|a, b| a.name.cmp(&b.name));
        listed
    }

    /// The state of this daemon's replica of a map; `None`: this daemon does not hold the map.
    pub fn replica_status(&self, uid: u64) -> Option<ReplicaStatus> {
        self.replicas().get(&uid).map(|replica| replica.log.status().borrow().clone())
    }

    /// The states of this daemon's replicas.
    pub fn replica_statuses(&self) -> Vec<ReplicaStatus> {
        self.replicas().values().map(|replica| replica.log.status().borrow().clone()).collect()
    }

    /// The number of maps that this daemon does not hold, and whose writers are known.
    pub fn known_elsewhere(&self) -> usize {
        let others = self.0.others.lock().unwrap_or_else(PoisonError::into_inner);
        others.iter().flat_map(BTreeMap::values).flatten().count()
    }

    /// The position of a member in a map that this daemon writes, as the member has reported it, and the end of the
    /// log; `None`: this daemon does not write the map.
    pub fn progress_of(&self, uid: u64, member: &str) -> Option<(Option<u64>, u64)> {
        let replicas = self.replicas();
        let log = replicas.get(&uid).map(|replica| &replica.log)?;
        if log.status().borrow().role != ReplicaRole::Writing {
            return None;
        }
        let view = self.0.members.borrow();
        let report = view.members.get(member).map(|member| &member.report);
        Some((report.and_then(|report| report.logs.get(&uid).copied()), log.end()))
    }

    /// Hands the log of a map over to a member, if this daemon writes it. The result shows later.
    pub fn hand_over(&self, uid: u64, to: String) {
        if let Some(replica) = self.replicas().get(&uid) {
            drop(replica.handle.hand_over(Some(to)));
        }
    }

    /// The servers of the engine that reply.
    ///
    /// # Errors
    /// [`EngineError`].
    pub async fn engine_servers(&self) -> Result<Vec<EngineServer>, EngineError> {
        self.engine().servers().await
    }

    /// The state of a map's log, as the engine reports it.
    ///
    /// # Errors
    /// [`EngineError`].
    pub async fn log_health(&self, uid: u64) -> Result<StreamHealth, EngineError> {
        self.engine().health(&catalogue::stream(uid)).await
    }

    /// Chooses a member as the writer of a map; `None`: the first candidate writes it.
    ///
    /// # Errors
    /// See [`OperationError`].
    pub async fn pin(&self, map: &str, member: Option<&str>) -> Result<(), OperationError> {
        for _ in 0..ATTEMPTS {
            let Some((mut entry, revision)) = catalogue::find(self.engine(), map).await? else {
                return Err(OperationError::UnknownMap(map.chars().take(80).collect()));
            };
            if let Some(member) = member {
                self.wait_for_target(member, (map, entry.uid())).await?;
            }
            if entry.pinned.as_deref() == member {
                return Ok(());
            }
            entry.pinned = member.map(str::to_owned);
            match catalogue::change(self.engine(), map, revision, &entry).await {
                Ok(_) => {
                    self.0.changed.notify_one();
                    return Ok(());
                }
                Err(SetError::NotExpected) => {}
                Err(SetError::Engine(error)) => return Err(error.into()),
            }
        }
        Err(OperationError::Changed(map.to_owned()))
    }

    /// Does the same as [`check_target`]. A member that has begun to hold the map shows this in its next report.
    async fn wait_for_target(&self, member: &str, map: (&str, Option<u64>)) -> Result<(), OperationError> {
        let end = Instant::now() + 3 * membership::REPORT_EVERY;
        loop {
            match check_target(&self.members()?, member, map) {
                Err(OperationError::DoesNotHold { .. }) if Instant::now() < end => {
                    tokio::time::sleep(membership::REPORT_EVERY / 4).await;
                }
                checked => return checked,
            }
        }
    }

    /// Deletes the map of a name from the cluster, if there is one; this daemon does not hold it or cannot use it. With
    /// a number, deletes only the map of this number. Returns whether there was a map.
    ///
    /// # Errors
    /// [`EngineError`]; the deletion can be tried again.
    pub(crate) async fn delete_unheld(&self, name: &MapName, uid: Option<u64>) -> Result<bool, EngineError> {
        let Some((entry, _)) = catalogue::find(self.engine(), name.as_str()).await? else { return Ok(false) };
        let found = entry.uid().filter(|found| uid.is_none_or(|uid| uid == *found));
        let Some(uid) = found else { return Ok(false) };
        catalogue::delete(self.engine(), name.as_str(), uid).await?;
        if let Some(others) = &mut *self.0.others.lock().unwrap_or_else(PoisonError::into_inner) {
            others.remove(name.as_str());
        }
        self.0.changed.notify_one();
        Ok(true)
    }

    /// Removes a member that no longer runs from the list of members.
    ///
    /// # Errors
    /// See [`OperationError`].
    pub async fn forget(&self, member: &str) -> Result<(), OperationError> {
        let members = self.members()?;
        let known = members.get(member).ok_or_else(|| unknown_member(&members, member))?;
        let alive = || OperationError::Alive(member.to_owned());
        if known.is_alive {
            return Err(alive());
        }
        let Some(entry) = self.engine().get(Bucket::Members, member).await? else { return Ok(()) };
        if MemberReport::decode(&entry.value).is_some_and(|report| report != known.report) {
            return Err(alive());
        }
        match self.engine().delete_if(Bucket::Members, member, entry.revision).await {
            Ok(()) => Ok(()),
            Err(SetError::NotExpected) => Err(alive()),
            Err(SetError::Engine(error)) => Err(error.into()),
        }
    }

    /// Hands over the maps that this daemon writes and takes no new ones, until this is revoked or the daemon starts
    /// again.
    pub fn drain(&self, is_draining: bool) {
        self.0.is_draining.send_replace(is_draining);
        self.0.changed.notify_one();
        let member = self.member();
        if is_draining {
            tracing::info!(member, "an operator drains this member: it hands over its maps and accepts no new ones");
        } else {
            tracing::info!(member, "an operator has ended the drain of this member: it may take maps again");
        }
    }

    /// The log of a map that this daemon holds.
    ///
    /// # Errors
    /// [`OperationError::NotHeld`].
    pub fn log_of(&self, map: &str, uid: u64) -> Result<SharedLog, OperationError> {
        let log = self.replicas().get(&uid).map(|replica| replica.log.clone());
        log.ok_or_else(|| OperationError::NotHeld(map.to_owned()))
    }
}

#[cfg(test)]
mod tests {
    use std::collections::BTreeMap;

    use tidemap_cluster::membership::Member;

    use super::*;

    #[test]
    fn a_map_moves_only_to_a_member_that_is_alive_and_holds_it() {
        let report = MemberReport { capacity: 1, logs: BTreeMap::from([(7, 100)]), ..MemberReport::default() };
        let member = |report: MemberReport, is_alive| Member { report, is_alive, ..Member::default() };
        let members = Members::from([
            ("north".to_owned(), member(report.clone(), true)),
            ("gone".to_owned(), member(report.clone(), false)),
            ("drains".to_owned(), member(MemberReport { draining: true, ..report.clone() }, true)),
            ("gateway".to_owned(), member(MemberReport { capacity: 0, ..report.clone() }, true)),
            ("new".to_owned(), member(MemberReport { logs: BTreeMap::new(), ..report }, true)),
        ]);
        let check = |name: &str| check_target(&members, name, ("office", Some(7)));
        assert!(check("north").is_ok());
        assert!(matches!(check("gone"), Err(OperationError::Gone(_))));
        assert!(matches!(check("drains"), Err(OperationError::Draining(_))));
        assert!(matches!(check("gateway"), Err(OperationError::NoCapacity(_))));
        let Err(OperationError::DoesNotHold { holders, .. }) = check("new") else { panic!("it holds nothing") };
        assert!(holders.contains(&"north".to_owned()) && !holders.contains(&"new".to_owned()), "{holders:?}");
        let Err(OperationError::UnknownMember { known, .. }) = check("nowhere") else { panic!("it is unknown") };
        assert_eq!(known.len(), members.len());
    }
}
