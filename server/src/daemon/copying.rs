//! Takes copies of other daemons' maps, and shortens the logs that this daemon writes.
//!
//! Invariant: one copy of each map is taken at a time. A map that differs from its writer's is replaced once a day at
//! most.

use std::{
    collections::BTreeMap,
    sync::Arc,
    time::{Duration, Instant},
};

use tidemap_base::task::Task;
use tidemap_cluster::replica::shorten;
use tidemap_ingest::{
    catalog::{Catalog, CatalogError},
    cluster::{
        Cluster,
        copies::{CopyCause, LogStart},
    },
};
use tidemap_map::{name::MapName, spec::MapSpec};
use tidemap_rpc::copies::CopyClient;
use tidemap_store::MapId;
use tracing::{info, warn};

/// Time after which a copy that no member could give is requested again.
const AGAIN_AFTER: Duration = Duration::from_secs(10);
/// Least time between two replacements of a map that differs from its writer's map.
const DIVERGED_EVERY: Duration = Duration::from_secs(24 * 3600);
/// Least time between two replacements of a map that the shared log has left behind: each time its folder is set aside.
const BEHIND_EVERY: Duration = Duration::from_secs(600);
/// Maximum number of copies that are taken at once.
const COPIES_MAX: usize = 2;
/// Longest time between two shortenings of a log.
const SHORTEN_EVERY: Duration = Duration::from_secs(3600);
/// Maximum number of steps in which a log is shortened at once.
const STEPS_MAX: usize = 8;

/// The way in which a map joins this daemon, which must hold it and has nothing of it.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
enum Join {
    /// The daemon reads the whole log.
    Read,
    /// The daemon takes a copy.
    Copy,
    /// The daemon waits for a member that can give a copy.
    Wait,
}

/// `has_failed`: the members that can give a copy were requested to, and have not given one.
fn join(start: LogStart, has_donors: bool, has_failed: bool) -> Join {
    match start {
        LogStart { is_whole: true, is_short: true } => Join::Read,
        _ if has_donors && !has_failed => Join::Copy,
        LogStart { is_whole: true, .. } => Join::Read,
        _ if has_donors => Join::Copy,
        _ => Join::Wait,
    }
}

/// An order to take a copy.
struct CopyOrder {
    uid: u64,
    name: MapName,
    spec: MapSpec,
    /// The map that the copy replaces.
    replaces: Option<MapId>,
    /// Names and addresses of the members that can give the copy.
    donors: Vec<(String, String)>,
}

/// A copy that is being taken; returns whether it became a map.
struct RunningCopy {
    ended: Task<bool>,
    /// Whether the copy replaces an open map.
    is_replacement: bool,
}

/// The data about copies and shortened logs that is kept between two reads of the catalogue.
pub(super) struct CopyNotes {
    client: Arc<CopyClient>,
    running: BTreeMap<u64, RunningCopy>,
    /// Time of the last failed copy.
    failed: BTreeMap<u64, Instant>,
    /// Time of the last replacement of a map.
    replaced: BTreeMap<u64, Instant>,
    /// Time of the last shortening of a log, and the covered position at that time.
    shortened: BTreeMap<u64, (Instant, u64)>,
}

impl CopyNotes {
    pub(super) fn new(client: CopyClient) -> Self {
        Self {
            client: Arc::new(client),
            running: BTreeMap::new(),
            failed: BTreeMap::new(),
            replaced: BTreeMap::new(),
            shortened: BTreeMap::new(),
        }
    }

    /// Whether a copy of a map is being taken.
    pub(super) async fn is_running(&mut self, uid: u64) -> bool {
        let Some(mut running) = self.running.remove(&uid) else { return false };
        match ended_now(&mut running.ended).await {
            None => {
                self.running.insert(uid, running);
                return true;
            }
            Some(true) => {
                self.failed.remove(&uid);
                if running.is_replacement {
                    self.replaced.insert(uid, Instant::now());
                }
            }
            Some(false) => drop(self.failed.insert(uid, Instant::now())),
        }
        false
    }

    fn failed_lately(&self, uid: u64) -> bool {
        self.failed.get(&uid).is_some_and(|failed| failed.elapsed() < AGAIN_AFTER)
    }

    /// Begins to take a copy, unless enough copies are being taken: then it is requested again after the next read of
    /// the catalogue.
    fn start(&mut self, cluster: &Cluster, catalog: &Catalog, order: CopyOrder) {
        if self.running.len() >= COPIES_MAX {
            return;
        }
        let (uid, is_replacement) = (order.uid, order.replaces.is_some());
        let (cluster, catalog, client) = (cluster.clone(), catalog.clone(), Arc::clone(&self.client));
        let ended = tidemap_base::task::spawn(async move { take_copy(&cluster, &catalog, &client, order).await });
        self.running.insert(uid, RunningCopy { ended, is_replacement });
    }

    /// Takes a copy of a map of which this daemon has nothing, if the map has to join by a copy. `true`: its log has to
    /// be read instead.
    pub(super) async fn join(&mut self, cluster: &Cluster, catalog: &Catalog, uid: u64, spec: &MapSpec) -> bool {
        let Ok(start) = cluster.log_start(uid).await else { return false };
        let donors = cluster.donors(uid, &spec.name, None);
        match join(start, !donors.is_empty(), self.failed.contains_key(&uid)) {
            Join::Read => {
                cluster.set_waiting(uid, None);
                return true;
            }
            Join::Copy if self.failed_lately(uid) => {}
            Join::Copy => {
                let order = CopyOrder { uid, name: spec.name.clone(), spec: spec.clone(), replaces: None, donors };
                self.start(cluster, catalog, order);
            }
            Join::Wait => {
                let why = "the shared log no longer has its first records, and no other daemon that runs holds the map: \
                           this daemon waits for a copy";
                if cluster.waiting(uid).is_none() {
                    warn!(map = %spec.name, "{why}");
                }
                cluster.set_waiting(uid, Some(why.to_owned()));
            }
        }
        false
    }

    /// Takes a copy to replace an open map that needs one.
    pub(super) fn replace(&mut self, cluster: &Cluster, catalog: &Catalog, uid: u64, name: &MapName) {
        let Ok(handle) = catalog.get(name.as_str()) else { return };
        let is_diverged = handle.digest().is_some_and(|digest| digest.is_equal == Some(false));
        let Some(cause) = cluster.copy_cause(uid, is_diverged) else { return };
        let again_after = if cause == CopyCause::Diverged { DIVERGED_EVERY } else { BEHIND_EVERY };
        let was_replaced = self.replaced.get(&uid).is_some_and(|replaced| replaced.elapsed() < again_after);
        if self.failed_lately(uid) || was_replaced {
            return;
        }
        let donors = cluster.donors(uid, name, Some(cause));
        if handle.shared_uid != Some(uid) || donors.is_empty() {
            return;
        }
        info!(map = %name, ?cause, "the map needs a copy from another daemon");
        let spec = MapSpec::clone(&handle.spec);
        let order = CopyOrder { uid, name: name.clone(), spec, replaces: Some(handle.id), donors };
        self.start(cluster, catalog, order);
    }

    /// Removes from the log of a map the records that checkpoints cover, if this daemon writes it.
    pub(super) fn shorten(&mut self, cluster: &Cluster, uid: u64, name: &MapName) {
        let Some(shortening) = cluster.shortening(uid) else { return };
        let known = self.shortened.get(&uid);
        if known.is_some_and(|(at, covered)| *covered == shortening.covered && at.elapsed() < SHORTEN_EVERY) {
            return;
        }
        self.shortened.insert(uid, (Instant::now(), shortening.covered));
        let (cluster, name) = (cluster.clone(), name.clone());
        drop(tidemap_base::task::spawn(async move {
            for _ in 0..STEPS_MAX {
                match shorten(cluster.engine(), &shortening).await {
                    Ok(0) => break,
                    Ok(messages) => info!(map = %name, messages, "the shared log is shortened"),
                    Err(error) => {
                        warn!(map = %name, %error, "the shared log is not shortened; tried again later");
                        break;
                    }
                }
            }
        }));
    }
}

/// The result of a task that has ended; `None` while it runs.
async fn ended_now(task: &mut Task<bool>) -> Option<bool> {
    let now = tokio::time::timeout(Duration::ZERO, task).await;
    now.ok().map(|ended| ended.unwrap_or(false))
}

/// Takes a copy from the first daemon that gives one, and makes it a map; returns whether this succeeded.
async fn take_copy(cluster: &Cluster, catalog: &Catalog, client: &CopyClient, order: CopyOrder) -> bool {
    let CopyOrder { uid, name, spec, replaces, donors } = order;
    let begun = Instant::now();
    let mut why = "no other daemon that runs holds the map".to_owned();
    // This check comes before much data is fetched.
    let donors = match replaces.map_or_else(|| catalog.check_new(&spec), |_| Ok(())) {
        Ok(()) => donors,
        Err(error) => {
            why = error.to_string();
            Vec::new()
        }
    };
    for (member, address) in donors {
        let (store, of_map) = (Arc::clone(&catalog.context().store), spec.clone());
        let copy = match tidemap_base::task::blocking(move || store.begin_copy(&of_map, uid, replaces)).await {
            Ok(Ok(copy)) => copy,
            Ok(Err(error)) => {
                why = error.to_string();
                break;
            }
            Err(_) => return false,
        };
        info!(map = %name, from = member, "a copy of the map is fetched");
        let copy = match client.fetch(&address, uid, copy).await {
            Ok(copy) => copy,
            Err(error) => {
                why = format!("{member}: {error}");
                warn!(map = %name, from = member, %error, "the map is not copied");
                continue;
            }
        };
        let bytes = copy.arrived().bytes;
        let placed = match replaces {
            None => catalog.adopt_copy(spec.clone(), uid, copy).await,
            Some(_) => catalog.replace_by_copy(name.clone(), uid, copy).await,
        };
        match placed {
            Ok(()) => {
                let secs = begun.elapsed().as_secs_f64();
                info!(map = %name, from = member, bytes, secs, "a copy of another daemon's map is in place");
                cluster.set_waiting(uid, None);
                return true;
            }
            Err(CatalogError::Stopping) => return false,
            Err(error) => {
                why = error.to_string();
                warn!(map = %name, %error, "the copy of the map cannot be used");
                break;
            }
        }
    }
    cluster.set_waiting(uid, Some(format!("the map is not copied: {why}")));
    false
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_daemon_without_a_map_copies_it_where_its_log_is_long_or_not_whole() {
        let start = |is_whole, is_short| LogStart { is_whole, is_short };
        assert_eq!(join(start(true, true), true, false), Join::Read, "it is as simple as before");
        assert_eq!(join(start(true, false), true, false), Join::Copy);
        assert_eq!(join(start(true, false), true, true), Join::Read, "nobody has given one");
        assert_eq!(join(start(true, false), false, false), Join::Read);
        for is_short in [true, false] {
            assert_eq!(join(start(false, is_short), true, false), Join::Copy);
            assert_eq!(join(start(false, is_short), true, true), Join::Copy, "it is the only way");
            assert_eq!(join(start(false, is_short), false, false), Join::Wait);
        }
    }
}
