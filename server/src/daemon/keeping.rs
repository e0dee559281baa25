//! Keeps this daemon consistent with the catalogue of the cluster: creates the maps that it must hold, deletes the maps
//! that were deleted, and sets for replicas whether they may become writers.
//!
//! Invariant: nothing is deleted only because it is missing in the catalogue.

use std::{
    collections::{BTreeMap, BTreeSet},
    sync::{Arc, atomic::Ordering},
    time::{Duration, Instant},
};

use tidemap_base::task::Task;
use tidemap_cluster::{
    assignment::{self, Candidate},
    catalogue::{self, ClusterMap, Listing},
    engine::{Bucket, Engine as _, EngineError, SetError},
    lease::Lease,
    membership::NameTaken,
};
use tidemap_ingest::{
    catalog::{Catalog, CatalogError},
    cluster::Cluster,
};
use tidemap_map::name::MapName;
use tidemap_rpc::{copies::CopyClient, forks};
use tidemap_store::{decode_spec, encode_spec};
use tracing::{info, warn};

use super::copying::CopyNotes;

/// Interval at which the catalogue is read.
const EVERY: Duration = Duration::from_secs(1);

/// A daemon that must write a map gets its log when it has all records up to this time ago, so that the map stands
/// still only for the records since then.
const HAND_OVER_BEHIND: Duration = Duration::from_secs(2);

/// Interval at which forks are checked.
const FORKS_EVERY: Duration = Duration::from_secs(10);

/// A map that another daemon must write.
struct Leaving {
    to: String,
    /// The position up to which that daemon must have the log.
    end: u64,
    since: Instant,
}

/// The data that is kept between two reads of the catalogue.
#[derive(Default)]
struct KeepingNotes {
    /// The messages that were logged, so that each is logged once.
    reported: BTreeSet<String>,
    /// The maps to hand over, by the number of the map.
    leaving: BTreeMap<u64, Leaving>,
    forks_seen: Option<Instant>,
}

impl KeepingNotes {
    fn warn(&mut self, text: String) {
        if !self.reported.contains(&text) {
            warn!("{text}");
            self.reported.insert(text);
        }
    }

    /// Whether a map, whose log ends at `end`, is handed over now to a daemon that reports the position `has`.
    fn may_hand_over(&mut self, uid: u64, to: &str, (has, end): (Option<u64>, u64), now: Instant) -> bool {
        let new = || Leaving { to: to.to_owned(), end, since: now };
        let leaving = self.leaving.entry(uid).or_insert_with(new);
        let has_it = has.is_some_and(|has| has >= leaving.end);
        if leaving.to != to {
            *leaving = new();
            return false;
        }
        if has_it {
            self.leaving.remove(&uid);
        } else if now.saturating_duration_since(leaving.since) > HAND_OVER_BEHIND {
            *leaving = new();
        }
        has_it
    }
}

/// The daemon that must write a map in place of this one, which has this rank, if this one writes it: a daemon that an
/// operator has named, or the first one if this daemon no longer has to hold the map.
fn successor(order: &[String], rank: Option<u32>, map: &ClusterMap) -> Option<String> {
    let first = order.first()?;
    match rank {
        Some(0) => None,
        Some(_) => Some(first).filter(|first| map.pinned.as_ref() == Some(first)).cloned(),
        None => Some(first.clone()),
    }
}

/// Publishes the report of this daemon, and keeps it consistent with the catalogue, until the daemon stops or must stop
/// because another one has its name.
pub(super) async fn keep(cluster: Cluster, catalog: Arc<Catalog>, client: CopyClient) -> Option<NameTaken> {
    let keeping = async {
        let (mut notes, mut copies) = (KeepingNotes::default(), CopyNotes::new(client));
        while !catalog.is_stopping.load(Ordering::Relaxed) {
            keep_once(&cluster, &catalog, &mut notes, &mut copies).await;
            // The wait ends with the first of the two.
            let _ = tokio::time::timeout(EVERY, cluster.changed()).await;
        }
    };
    // Reads from the engine must not wait for the work on a map.
    let mut reporting = tokio::spawn(cluster.clone().keep_reporting());
    let taken = tokio::select! {
        () = keeping => None,
        taken = &mut reporting => taken.ok(),
    };
    reporting.abort();
    taken
}

/// The reason why a daemon that runs `keep` has to end; never returns if the daemon is not a member of a cluster.
pub(super) async fn name_taken(keeping: Option<Task<Option<NameTaken>>>) -> NameTaken {
    if let Some(keeping) = keeping
        && let Ok(Some(taken)) = keeping.await
    {
        return taken;
    }
    std::future::pending().await
}

async fn keep_once(cluster: &Cluster, catalog: &Catalog, notes: &mut KeepingNotes, copies: &mut CopyNotes) {
    if matches!(cluster.members(), Err(EngineError::Missing(_))) {
        cluster.restore_buckets().await;
    }
    // The candidates stay as they are while the engine does not reply.
    let Some(candidates) = cluster.candidates() else { return };
    let listing = match catalogue::list(cluster.engine()).await {
        Ok(listing) => listing,
        Err(EngineError::Missing(_)) => return cluster.restore_buckets().await,
        Err(_) => return,
    };
    // This comes first: a new map takes a while, and other daemons already have it.
    find_writers(cluster, &listing).await;
    let mut listed = BTreeSet::new();
    for (name, map, _) in &listing.maps {
        match (map.uid(), MapName::new(name)) {
            (Some(uid), Ok(name)) => {
                listed.insert(uid);
                if listing.deleted.contains(&uid) {
                    // The deletion was interrupted. If this fails, it is tried again after the next read of the
                    // catalogue.
                    drop(catalogue::delete(cluster.engine(), name.as_str(), uid).await);
                } else {
                    let keeper = Keeper { cluster, catalog, candidates: &candidates };
                    keeper.keep_map((uid, &name, map), notes, copies).await;
                }
            }
            _ => notes.warn(format!("the entry of map {name:?} in the catalogue of the cluster is damaged")),
        }
    }
    keep_held(cluster, catalog, &listing, &listed, notes).await;
    let now = Instant::now();
    if notes.forks_seen.is_none_or(|seen| now.saturating_duration_since(seen) >= FORKS_EVERY) {
        notes.forks_seen = Some(now);
        remove_known_forks(cluster, catalog, notes).await;
    }
    find_writers(cluster, &listing).await;
}

/// Removes forks of a single group whose content the map already has.
async fn remove_known_forks(cluster: &Cluster, catalog: &Catalog, notes: &mut KeepingNotes) {
    for (_, name) in cluster.held() {
        let Ok(handle) = catalog.get(name.as_str()) else { continue };
        match forks::remove_known(&catalog.context().store, &handle).await {
            Ok(removed) => removed.into_iter().for_each(|fork| {
                info!(map = %name, fork, "the map has all records that were set aside: they are removed");
            }),
            Err(error) => notes.warn(format!("forks of map {name} cannot be removed: {error}")),
        }
    }
}

/// Finds the writers of the maps that this daemon does not hold, so that it can pass requests on.
async fn find_writers(cluster: &Cluster, listing: &Listing) {
    let held: BTreeSet<u64> = cluster.held().into_iter().map(|(uid, _)| uid).collect();
    let is_elsewhere =
        |map: &ClusterMap| map.uid().is_some_and(|uid| !held.contains(&uid) && !listing.deleted.contains(&uid));
    if !listing.maps.iter().any(|(_, map, _)| is_elsewhere(map)) {
        return cluster.set_others(BTreeMap::new());
    }
    let leases = match cluster.engine().list(Bucket::Writers).await {
        Err(EngineError::Missing(_)) => return cluster.restore_buckets().await,
        leases => leases.unwrap_or_default(),
    };
    let writer = |uid: u64| {
        let key = format!("{uid:016x}");
        let lease = leases.iter().find(|(known, _)| *known == key).map(|(_, entry)| Lease::decode(&entry.value))?;
        Some(lease.writer).filter(|writer| !writer.is_empty())
    };
    let others = listing.maps.iter().filter(|(_, map, _)| is_elsewhere(map));
    cluster.set_others(others.map(|(name, map, _)| (name.clone(), map.uid().and_then(writer))).collect());
}

/// The data for the work on one map.
struct Keeper<'a> {
    cluster: &'a Cluster,
    catalog: &'a Catalog,
    candidates: &'a [Candidate],
}

impl Keeper<'_> {
    /// Sets the rank of a map's replica, or makes a replica where this daemon must hold the map.
    async fn keep_map(
        &self,
        (uid, name, map): (u64, &MapName, &ClusterMap),
        notes: &mut KeepingNotes,
        copies: &mut CopyNotes,
    ) {
        let Keeper { cluster, catalog, candidates } = *self;
        let order = assignment::holders(uid, candidates, map.pinned.as_deref(), cluster.settings().replicas);
        let rank = order.iter().position(|member| *member == cluster.settings().member);
        let rank = rank.and_then(|rank| u32::try_from(rank).ok());
        let is_copied = copies.is_running(uid).await;
        if cluster.set_candidacy(uid, rank) {
            hand_over(cluster, (uid, name), successor(&order, rank, map), notes);
            if !is_copied {
                copies.replace(cluster, catalog, uid, name);
                copies.shorten(cluster, uid, name);
            }
            return;
        }
        if rank.is_none() || is_copied {
            return;
        }
        let Some(Ok(spec)) = map.spec().map(|spec| decode_spec(&spec)) else {
            return notes.warn(format!("map {name} of the cluster cannot be held by this version of tidemapd"));
        };
        let is_unknown = matches!(catalog.get(name.as_str()), Err(CatalogError::Unknown(_)));
        if is_unknown && !copies.join(cluster, catalog, uid, &spec).await {
            return;
        }
        match catalog.adopt(spec, uid).await {
            Ok(()) => info!(map = %name, uid = format!("{uid:016x}"), "map of the cluster held"),
            Err(error) => notes.warn(format!("map {name} of the cluster cannot be held here: {error}")),
        }
    }
}

/// Hands a map that this daemon writes over to the daemon that must write it, once that one has caught up.
fn hand_over(cluster: &Cluster, (uid, name): (u64, &MapName), to: Option<String>, notes: &mut KeepingNotes) {
    let Some((to, progress)) = to.and_then(|to| cluster.progress_of(uid, &to).map(|progress| (to, progress))) else {
        notes.leaving.remove(&uid);
        return;
    };
    if notes.may_hand_over(uid, &to, progress, Instant::now()) {
        info!(map = %name, to, "the log of the map is handed over");
        cluster.hand_over(uid, to);
    }
}

/// Deletes the maps that were deleted, and lists the maps again that the catalogue has forgotten.
async fn keep_held(
    cluster: &Cluster,
    catalog: &Catalog,
    listing: &Listing,
    listed: &BTreeSet<u64>,
    notes: &mut KeepingNotes,
) {
    for (uid, name) in cluster.held() {
        if listing.deleted.contains(&uid) {
            if let Err(error) = catalog.delete_held(&name, uid).await {
                notes.warn(format!("map {name}, which was deleted from the cluster, is not deleted here: {error}"));
            }
        } else if !listed.contains(&uid)
            && let Ok(handle) = catalog.get(name.as_str())
        {
            let map = ClusterMap::new(uid, &encode_spec(&handle.spec));
            match catalogue::add(cluster.engine(), name.as_str(), &map).await {
                Ok(_) => warn!(map = %name, "the catalogue of the cluster had lost a map: it is listed again"),
                Err(SetError::NotExpected) => notes.warn(format!(
                    "map {name} is held here as number {uid:016x}, and the catalogue of the cluster has another map of \
                     this name"
                )),
                Err(SetError::Engine(_)) => {}
            }
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_map_goes_to_a_pinned_member_and_away_from_one_that_is_to_hold_it_no_longer() {
        let order = ["a", "b"].map(str::to_owned);
        let pinned = |member: Option<&str>| {
            let mut map = ClusterMap::new(1, &[]);
            map.pinned = member.map(str::to_owned);
            map
        };
        let to = |rank, map: &ClusterMap| successor(&order, rank, map);
        assert_eq!(to(Some(0), &pinned(None)), None);
        assert_eq!(to(Some(1), &pinned(None)), None, "a writer stays where it is");
        assert_eq!(to(Some(1), &pinned(Some("a"))), Some("a".to_owned()));
        assert_eq!(to(Some(1), &pinned(Some("gone"))), None);
        assert_eq!(to(None, &pinned(None)), Some("a".to_owned()), "it drains");
        assert_eq!(successor(&[], None, &pinned(None)), None, "there is nobody else");
    }

    #[test]
    fn a_map_is_given_over_when_the_other_daemon_has_what_was_there_a_while_ago() {
        let (mut notes, start) = (KeepingNotes::default(), Instant::now());
        let later = |secs| start + Duration::from_secs(secs);
        assert!(!notes.may_hand_over(1, "a", (None, 100), start), "it does not hold the map");
        assert!(!notes.may_hand_over(1, "a", (Some(90), 110), later(1)));
        assert!(notes.may_hand_over(1, "a", (Some(105), 120), later(2)), "it has 100, and the log goes on");
        assert!(!notes.may_hand_over(1, "a", (Some(0), 130), later(3)));
        assert!(!notes.may_hand_over(1, "a", (Some(100), 200), later(6)), "it has to have 200 from now on");
        assert!(!notes.may_hand_over(1, "a", (Some(150), 210), later(7)));
        assert!(!notes.may_hand_over(1, "b", (Some(210), 210), later(8)), "another one is meant");
        assert!(notes.may_hand_over(1, "b", (Some(210), 210), later(9)));
        assert!(notes.may_hand_over(2, "a", (Some(5), 5), later(9)), "nothing is written");
    }
}
