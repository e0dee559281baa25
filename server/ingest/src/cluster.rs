//! This daemon as a member of a cluster: the connection to the engine, the replicas of the maps that it holds, and the
//! other members.
//!
//! Invariant: without a section `[cluster]` nothing in this module runs. A map is deleted here only if the catalogue of
//! the cluster lists it as deleted.

use std::{
    collections::{BTreeMap, BTreeSet},
    fmt,
    path::{Path, PathBuf},
    sync::{Arc, Mutex, MutexGuard, PoisonError},
    time::Duration,
};

use tidemap_base::{
    access::peer_secret::PeerSecret, config::cluster::ClusterSettings, random_id::random_id, telemetry,
};
use tidemap_cluster::{
    assignment::Candidate,
    catalogue::{self, ClusterMap},
    engine::{Engine as _, EngineError, SetError},
    member::MemberReport,
    membership::{self, MembersView, NameTaken},
    nats::{NatsCheckError, NatsCredentials, NatsEngine, NatsSettings, NatsTls, check},
    replica::{Replica, ReplicaHandle, ReplicaListener, ReplicaSettings, SharedLog},
};
use tidemap_map::{name::MapName, spec::MapSpec};
use tidemap_store::{EventLog as _, GroupLog, encode_spec};
use tokio::{
    sync::{Notify, mpsc, watch},
    time::{Instant, timeout_at},
};
use tracing::{info, warn};

use crate::peers::Peers;

pub mod copies;
pub mod operations;

/// Pause before the engine is tried again at the start.
const CONNECT_PAUSE: Duration = Duration::from_secs(1);
/// Time limit for the replicas to stop.
const STOP_WITHIN: Duration = Duration::from_secs(5);

/// The reason why an operation of the cluster fails.
#[derive(Debug, thiserror::Error)]
pub enum ClusterError {
    /// The engine does not have the properties on which tidemap relies.
    #[error("the engine of the cluster cannot be used: {0}")]
    Check(#[from] NatsCheckError),
    /// A call to the engine has failed.
    #[error("the engine of the cluster: {0}")]
    Engine(#[from] EngineError),
    /// There is already a map of this name.
    #[error("map {0:?} exists already")]
    Exists(String),
}

impl ClusterError {
    /// Whether another attempt may succeed.
    pub(crate) fn is_passing(&self) -> bool {
        match self {
            Self::Check(NatsCheckError::Engine(error)) | Self::Engine(error) => {
                matches!(error, EngineError::Unknown(_) | EngineError::Unavailable(_))
            }
            _ => false,
        }
    }
}

/// A replica of this daemon.
struct RunningReplica {
    handle: ReplicaHandle,
    log: SharedLog,
    name: MapName,
    ended: tidemap_base::task::Task<()>,
}

struct Membership {
    engine: NatsEngine,
    settings: ClusterSettings,
    address: String,
    id: String,
    boot: u64,
    members: watch::Sender<MembersView>,
    /// The replicas, by the number of the map in the cluster. The lock is held only for a lookup.
    replicas: Mutex<BTreeMap<u64, RunningReplica>>,
    /// The ends of the own logs of maps whose replicas do not run yet, or no longer run. A daemon that takes over a map
    /// waits for a daemon with a longer log only if that log has been reported.
    ends: Mutex<BTreeMap<u64, u64>>,
    /// Receives the fault that ends this daemon.
    fatal: mpsc::UnboundedSender<String>,
    /// Wakes the task that follows the catalogue.
    changed: Notify,
    is_draining: watch::Sender<bool>,
    secret: PeerSecret,
    /// The reasons why maps that this daemon must hold are not held yet, by the number of the map in the cluster.
    waiting_maps: Mutex<BTreeMap<u64, String>>,
    /// The maps that this daemon does not hold, and their writers as far as they are known; `None`: the catalogue has
    /// not been read yet.
    others: Mutex<Option<BTreeMap<String, Option<String>>>>,
}

/// The cluster, as this daemon is a member of it. Clones are handles of one.
#[derive(Clone)]
pub struct Cluster(Arc<Membership>);

impl fmt::Debug for Cluster {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.debug_struct("Cluster").field("member", &self.0.settings.member).finish_non_exhaustive()
    }
}

fn named(path: &Path) -> Option<PathBuf> {
    Some(path.to_owned()).filter(|path| !path.as_os_str().is_empty())
}

/// The settings of the engine, from a section of the config file.
pub fn nats_settings(settings: &ClusterSettings) -> NatsSettings {
    let credentials = match (named(&settings.credentials_file), named(&settings.nkey_file)) {
        (Some(file), _) => NatsCredentials::File(file),
        (None, Some(file)) => NatsCredentials::NkeySeed(file),
        (None, None) => NatsCredentials::None,
    };
    let client = named(&settings.tls_certificate).zip(named(&settings.tls_key));
    let authority = named(&settings.tls_ca);
    let tls = (authority.is_some() || client.is_some()).then_some(NatsTls { authority, client });
    NatsSettings {
        credentials,
        tls,
        cluster: settings.name.clone(),
        client: format!("tidemapd {}", settings.member),
        ..NatsSettings::new(settings.servers.clone())
    }
}

/// The engine, identity and secret of the cluster, and the ends of the own logs of this daemon at its last report.
type Connected = (NatsEngine, String, PeerSecret, BTreeMap<u64, u64>);

async fn try_to_connect(settings: &ClusterSettings, proposed: &str) -> Result<Connected, ClusterError> {
    let engine = NatsEngine::connect(nats_settings(settings)).await?;
    check(&engine, settings.require_synced_engine).await?;
    engine.create_buckets(settings.engine_replicas).await?;
    let id = catalogue::cluster_id(&engine, proposed).await?;
    let random = random_id().map_err(|_| EngineError::Refused("the system provides no random numbers".to_owned()))?;
    let secret = catalogue::cluster_secret(&engine, &random).await?;
    let before = membership::last_report(&engine, &settings.member).await?;
    Ok((engine, id, PeerSecret::new(secret), before.unwrap_or_default().logs))
}

/// The URLs of servers without user and password, so that a log may contain them.
fn without_secrets(servers: &[String]) -> Vec<String> {
    let shown = |url: &String| match url.rsplit_once('@') {
        Some((secret, host)) => match secret.split_once("://") {
            Some((scheme, _)) => format!("{scheme}://{host}"),
            None => host.to_owned(),
        },
        None => url.clone(),
    };
    servers.iter().map(shown).collect()
}

/// The data with which a daemon joins a cluster.
#[derive(Clone, Debug)]
pub struct ClusterStart {
    /// Address of the gRPC port.
    pub listen: String,
    /// Becomes the identity of a new cluster.
    pub proposed_id: String,
    /// Numbers of the shared maps that are on this daemon's disk.
    pub held: BTreeSet<u64>,
    /// Receives the fault that ends this daemon.
    pub fatal: mpsc::UnboundedSender<String>,
}

impl Cluster {
    /// Connects to the engine, and waits for it as long as it takes.
    ///
    /// # Errors
    /// The engine cannot be used.
    pub async fn connect(settings: &ClusterSettings, start: ClusterStart) -> Result<Cluster, ClusterError> {
        let ClusterStart { listen, proposed_id, held, fatal } = start;
        let mut attempts = 0_u64;
        let (engine, id, secret, ends) = loop {
            match try_to_connect(settings, &proposed_id).await {
                Ok(connected) => break connected,
                Err(error) if error.is_passing() => {
                    if attempts.is_multiple_of(10) {
                        let servers = without_secrets(&settings.servers);
                        warn!(%error, ?servers, "the engine of the cluster is not there yet");
                    }
                    attempts += 1;
                    tokio::time::sleep(CONNECT_PAUSE).await;
                }
                Err(error) => return Err(error),
            }
        };
        let address =
            if settings.advertise.is_empty() { format!("http://{listen}") } else { settings.advertise.clone() };
        let boot = u64::from_str_radix(proposed_id.get(16..32).unwrap_or_default(), 16).unwrap_or_default();
        info!(cluster = settings.name, id, member = settings.member, address, "member of a cluster");
        Ok(Cluster(Arc::new(Membership {
            engine,
            settings: settings.clone(),
            address,
            id,
            boot,
            members: watch::Sender::default(),
            replicas: Mutex::default(),
            ends: Mutex::new(ends.into_iter().filter(|(uid, _)| held.contains(uid)).collect()),
            fatal,
            changed: Notify::new(),
            is_draining: watch::Sender::new(false),
            secret,
            waiting_maps: Mutex::default(),
            others: Mutex::default(),
        })))
    }

    fn replicas(&self) -> MutexGuard<'_, BTreeMap<u64, RunningReplica>> {
        self.0.replicas.lock().unwrap_or_else(PoisonError::into_inner)
    }

    fn ends(&self) -> MutexGuard<'_, BTreeMap<u64, u64>> {
        self.0.ends.lock().unwrap_or_else(PoisonError::into_inner)
    }

    /// The identity of the cluster, which its producers use instead of a store's.
    pub fn id(&self) -> &str {
        &self.0.id
    }

    /// Makes the log of a map a shared one. `listener` receives its events.
    pub fn share(&self, uid: u64, name: &MapName, log: GroupLog, listener: ReplicaListener) -> SharedLog {
        let settings = &self.0.settings;
        let settings = ReplicaSettings {
            map: uid,
            stream: catalogue::stream(uid),
            engine_replicas: settings.engine_replicas,
            member: settings.member.clone(),
            version: telemetry::VERSION.to_owned(),
            maths: tidemap_model::MATHS,
            lease: Duration::from_millis(settings.lease_ms),
            heal_wait: Duration::from_secs(settings.heal_wait_secs),
            group_bytes: settings.group_bytes,
            patience: Duration::from_millis(500),
            disk_inline: false,
        };
        // A clone reads its stream independently.
        let (replica, handle, log) = Replica::new(self.0.engine.clone(), settings, log, listener);
        let (run, fatal) = (tidemap_base::task::spawn(replica.run()), self.0.fatal.clone());
        let ended = tidemap_base::task::spawn(async move {
            if run.await.is_err() {
                drop(fatal.send("the replica of a map panicked; this is a defect of tidemap".to_owned()));
            }
        });
        let running = RunningReplica { handle, log: log.clone(), name: name.clone(), ended };
        self.replicas().insert(uid, running);
        self.0.changed.notify_one();
        log
    }

    /// Ends the replica of a map that is opened again, in order. `end` is the least end of its log afterwards.
    pub(crate) async fn unshare_at(&self, uid: u64, end: u64) {
        self.unshare(uid).await;
        self.ends().insert(uid, end);
    }

    /// Ends the replica of a map, in order.
    pub(crate) async fn unshare(&self, uid: u64) {
        self.ends().remove(&uid);
        let Some(replica) = self.replicas().remove(&uid) else { return };
        replica.handle.stop();
        if tokio::time::timeout(STOP_WITHIN, replica.ended).await.is_err() {
            warn!(map = %replica.name, "the replica did not stop in time");
        }
    }

    /// Adds a map to the cluster; returns its number.
    ///
    /// # Errors
    /// [`ClusterError::Exists`], [`ClusterError::Engine`].
    pub async fn create(&self, spec: &MapSpec) -> Result<u64, ClusterError> {
        let (engine, name) = (&self.0.engine, spec.name.as_str());
        if catalogue::find(engine, name).await?.is_some() {
            return Err(ClusterError::Exists(name.to_owned()));
        }
        let random = random_id().unwrap_or_default();
        let uid = u64::from_str_radix(random.get(..16).unwrap_or_default(), 16)
            .map_err(|_| EngineError::Refused("the system provides no random numbers".to_owned()))?;
        engine.create_stream(&catalogue::stream(uid), self.0.settings.engine_replicas).await?;
        match catalogue::add(engine, name, &ClusterMap::new(uid, &encode_spec(spec))).await {
            Ok(_) => Ok(uid),
            Err(SetError::NotExpected) => {
                // No other daemon uses the stream.
                drop(engine.delete_stream(&catalogue::stream(uid)).await);
                Err(ClusterError::Exists(name.to_owned()))
            }
            // The entry may exist all the same.
            Err(SetError::Engine(error)) => match catalogue::find(engine, name).await? {
                Some((map, _)) if map.uid() == Some(uid) => Ok(uid),
                Some(_) => {
                    drop(engine.delete_stream(&catalogue::stream(uid)).await);
                    Err(ClusterError::Exists(name.to_owned()))
                }
                // The entry may still appear, and then needs its stream.
                None => Err(error.into()),
            },
        }
    }

    /// Deletes a map from the cluster. The other daemons delete their data of the map when they see this.
    ///
    /// # Errors
    /// [`ClusterError::Engine`]; the deletion can be tried again.
    pub async fn delete(&self, name: &MapName, uid: u64) -> Result<(), ClusterError> {
        Ok(catalogue::delete(&self.0.engine, name.as_str(), uid).await?)
    }

    /// Creates the buckets of the cluster again where the engine has lost them, with the data of the cluster.
    pub async fn restore_buckets(&self) {
        let inner = &self.0;
        let restored = async {
            inner.engine.create_buckets(inner.settings.engine_replicas).await?;
            let id = catalogue::cluster_id(&inner.engine, &inner.id).await?;
            let secret = catalogue::cluster_secret(&inner.engine, inner.secret.text()).await?;
            Ok::<_, EngineError>((id, secret == inner.secret.text()))
        };
        match restored.await {
            Ok((id, true)) if id == inner.id => {
                warn!(id, "the engine had lost its data about the cluster: the data are restored");
            }
            Ok((id, _)) => {
                warn!(
                    id,
                    own = inner.id,
                    "the engine now serves a cluster of another identity or with another secret: restart this daemon"
                );
            }
            Err(error) => warn!(%error, "the engine has lost its data about the cluster"),
        }
    }

    /// The connection to the engine.
    pub fn engine(&self) -> &NatsEngine {
        &self.0.engine
    }

    /// The section `[cluster]` of the config file.
    pub fn settings(&self) -> &ClusterSettings {
        &self.0.settings
    }

    /// The members that may hold maps; `None` where the engine does not reply.
    pub fn candidates(&self) -> Option<Vec<Candidate>> {
        let view = self.0.members.borrow();
        view.trouble.is_none().then(|| membership::candidates(&view.members))
    }

    /// Sets the rank after which the replica of a map may become the writer; `false`: there is no replica here.
    pub fn set_candidacy(&self, uid: u64, rank: Option<u32>) -> bool {
        match self.replicas().get(&uid) {
            Some(replica) => {
                replica.handle.set_candidacy(rank);
                true
            }
            None => false,
        }
    }

    /// Sets the maps that this daemon does not hold, and their writers where they are known.
    pub fn set_others(&self, writers: BTreeMap<String, Option<String>>) {
        *self.0.others.lock().unwrap_or_else(PoisonError::into_inner) = Some(writers);
    }

    /// The maps that this daemon holds.
    pub fn held(&self) -> Vec<(u64, MapName)> {
        self.replicas().iter().map(|(&uid, replica)| (uid, replica.name.clone())).collect()
    }

    /// Returns when a replica was added.
    pub async fn changed(&self) {
        self.0.changed.notified().await;
    }

    fn report(&self, counter: u64) -> MemberReport {
        let inner = &self.0;
        let mut logs = self.ends().clone();
        let covers = self.replicas().iter().map(|(&uid, replica)| (uid, replica.log.checkpoint())).collect();
        logs.extend(self.replicas().iter().map(|(&uid, replica)| (uid, replica.log.end())));
        MemberReport {
            address: inner.address.clone(),
            version: telemetry::VERSION.to_owned(),
            format: tidemap_store::DISK_FORMAT,
            maths: tidemap_model::MATHS,
            capacity: inner.settings.capacity,
            boot: inner.boot,
            counter,
            draining: *inner.is_draining.borrow(),
            logs,
            covers,
        }
    }

    /// Ends all replicas: calls in flight are completed, and the logs that this daemon writes are handed over to
    /// others.
    pub async fn stop(&self) {
        self.0.is_draining.send_replace(true);
        let replicas = std::mem::take(&mut *self.replicas());
        replicas.values().for_each(|replica| replica.handle.stop());
        let deadline = Instant::now() + STOP_WITHIN;
        for (uid, replica) in replicas {
            if timeout_at(deadline, replica.ended).await.is_err() {
                warn!(map = %replica.name, "the replica did not stop in time");
            }
            self.ends().insert(uid, replica.log.end());
        }
    }

    /// Publishes the report of this daemon and reads those of the others, as long as no other daemon has its name.
    pub async fn keep_reporting(self) -> NameTaken {
        let (engine, member) = (self.0.engine.clone(), self.0.settings.member.clone());
        let sender = self.0.members.clone();
        membership::run(engine, member, move |counter| self.report(counter), sender).await
    }
}

impl Peers for Cluster {
    fn name(&self) -> &str {
        let ClusterSettings { member, .. } = &self.0.settings;
        member
    }

    fn address_of(&self, member: &str) -> Option<String> {
        let members = self.0.members.borrow();
        let address = members.members.get(member)?.report.address.clone();
        Some(address).filter(|address| !address.is_empty())
    }

    fn others(&self) -> Vec<String> {
        let view = self.0.members.borrow();
        let others = view.members.iter().filter(|(name, member)| member.is_alive && **name != self.0.settings.member);
        others.map(|(name, _)| name.clone()).collect()
    }

    fn may_hold(&self, map: &str) -> bool {
        let others = self.0.others.lock().unwrap_or_else(PoisonError::into_inner);
        others.as_ref().is_none_or(|others| others.contains_key(map))
    }

    fn writer_of(&self, map: &str) -> Option<String> {
        let others = self.0.others.lock().unwrap_or_else(PoisonError::into_inner);
        others.as_ref()?.get(map)?.clone()
    }

    fn writer_of_held(&self, map: &MapName) -> Option<String> {
        let replicas = self.replicas();
        let replica = replicas.values().find(|replica| replica.name == *map)?;
        replica.log.status().borrow().writer.clone()
    }

    fn last_contact(&self, map: &MapName) -> Option<std::time::Instant> {
        let replicas = self.replicas();
        let replica = replicas.values().find(|replica| replica.name == *map)?;
        replica.log.status().borrow().last_contact.map(tokio::time::Instant::into_std)
    }

    fn max_staleness(&self) -> Duration {
        Duration::from_millis(self.0.settings.max_staleness_ms)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_log_shows_no_password_of_an_engine() {
        let servers = ["nats://user:p@ss@host:4222", "nats://host:4222", "user:pass@host"].map(str::to_owned);
        assert_eq!(without_secrets(&servers), ["nats://host:4222", "nats://host:4222", "host"]);
    }
}
