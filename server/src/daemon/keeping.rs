//! Keeping this daemon as the catalogue of the cluster says: maps that it is to hold are created here, maps that were
//! deleted are deleted, and replicas hear whether they may become writers.
//!
//! Invariant: nothing is deleted because something is missing in the catalogue.

use std::{
    collections::{BTreeMap, BTreeSet},
    sync::{Arc, atomic::Ordering},
    time::Duration,
};

use tidemap_cluster::{
    assignment::{self, Candidate},
    catalogue::{self, ClusterMap, Listing},
    engine::{Bucket, Engine as _, SetError},
    lease::Lease,
};
use tidemap_map::name::MapName;
use tidemap_store::{decode_spec, encode_spec};
use tracing::{info, warn};

use crate::{catalog::Catalog, cluster::Cluster};

/// How often the catalogue is looked at.
const EVERY: Duration = Duration::from_secs(1);

/// What was said, so that it is said once.
#[derive(Default)]
struct Said(BTreeSet<String>);

impl Said {
    fn warn(&mut self, text: String) {
        if !self.0.contains(&text) {
            warn!("{text}");
            self.0.insert(text);
        }
    }
}

/// Reports this daemon, and keeps it as the catalogue says, until the daemon stops.
pub(super) async fn keep(cluster: Cluster, catalog: Arc<Catalog>) {
    let reporting = tokio::spawn(cluster.clone().report_for_ever());
    let mut said = Said::default();
    while !catalog.is_stopping.load(Ordering::Relaxed) {
        keep_once(&cluster, &catalog, &mut said).await;
        // Whichever comes first.
        let _ = tokio::time::timeout(EVERY, cluster.changed()).await;
    }
    reporting.abort();
}

async fn keep_once(cluster: &Cluster, catalog: &Catalog, said: &mut Said) {
    // Whoever may write stays as it is while the engine does not tell.
    let Some(candidates) = cluster.candidates() else { return };
    let Ok(listing) = catalogue::list(cluster.engine()).await else { return };
    let mut listed = BTreeSet::new();
    for (name, map, _) in &listing.maps {
        match (map.uid(), MapName::new(name)) {
            (Some(uid), Ok(name)) => {
                listed.insert(uid);
                if !listing.deleted.contains(&uid) {
                    keep_map(cluster, catalog, (uid, &name, map), &candidates, said).await;
                }
            }
            _ => said.warn(format!("the entry of map {name:?} in the catalogue of the cluster is damaged")),
        }
    }
    keep_held(cluster, catalog, &listing, &listed, said).await;
    find_writers(cluster, &listing).await;
}

/// Finds out who writes the maps that this daemon does not hold, so that it can pass requests on.
async fn find_writers(cluster: &Cluster, listing: &Listing) {
    let held: BTreeSet<u64> = cluster.held().into_iter().map(|(uid, _)| uid).collect();
    let is_elsewhere = |map: &ClusterMap| map.uid().is_some_and(|uid| !held.contains(&uid));
    if !listing.maps.iter().any(|(_, map, _)| is_elsewhere(map)) {
        return cluster.set_others(BTreeMap::new());
    }
    let Ok(leases) = cluster.engine().list(Bucket::Writers).await else { return };
    let writer = |uid: u64| {
        let key = format!("{uid:016x}");
        let lease = leases.iter().find(|(known, _)| *known == key).map(|(_, entry)| Lease::decode(&entry.value))?;
        Some(lease.writer).filter(|writer| !writer.is_empty())
    };
    let others = listing.maps.iter().filter(|(_, map, _)| is_elsewhere(map));
    cluster.set_others(others.filter_map(|(name, map, _)| Some((name.clone(), writer(map.uid()?)?))).collect());
}

/// Tells the replica of a map its rank, or makes a replica where this daemon is to hold the map.
async fn keep_map(
    cluster: &Cluster,
    catalog: &Catalog,
    (uid, name, map): (u64, &MapName, &ClusterMap),
    candidates: &[Candidate],
    said: &mut Said,
) {
    let mut order = assignment::order(uid, candidates);
    if let Some(at) = order.iter().position(|member| map.pinned.as_ref() == Some(member)) {
        let first = order.remove(at);
        order.insert(0, first);
    }
    order.truncate(cluster.settings().replicas);
    let rank = order.iter().position(|member| *member == cluster.settings().member);
    let rank = rank.and_then(|rank| u32::try_from(rank).ok());
    if cluster.set_candidacy(uid, rank) || rank.is_none() {
        return;
    }
    match map.spec().map(|spec| decode_spec(&spec)) {
        Some(Ok(spec)) => match catalog.adopt(spec, uid).await {
            Ok(()) => info!(map = %name, uid = format!("{uid:016x}"), "map of the cluster held"),
            Err(error) => said.warn(format!("map {name} of the cluster cannot be held here: {error}")),
        },
        _ => said.warn(format!("map {name} of the cluster cannot be held by this version of tidemapd")),
    }
}

/// Deletes what was deleted, and lists again what the catalogue has forgotten.
async fn keep_held(cluster: &Cluster, catalog: &Catalog, listing: &Listing, listed: &BTreeSet<u64>, said: &mut Said) {
    for (uid, name) in cluster.held() {
        if listing.deleted.contains(&uid) {
            if let Err(error) = catalog.delete_held(&name, uid).await {
                said.warn(format!("map {name}, which was deleted from the cluster, is not deleted here: {error}"));
            }
        } else if !listed.contains(&uid)
            && let Ok(handle) = catalog.get(name.as_str())
        {
            let map = ClusterMap::new(uid, &encode_spec(&handle.spec));
            match catalogue::add(cluster.engine(), name.as_str(), &map).await {
                Ok(_) => warn!(map = %name, "the catalogue of the cluster had forgotten a map: it is listed again"),
                Err(SetError::NotExpected) => said.warn(format!(
                    "map {name} is held here as number {uid:016x}, and the catalogue of the cluster knows another map of \
                     this name"
                )),
                Err(SetError::Engine(_)) => {}
            }
        }
    }
}
