//! This daemon as a member of a cluster: the connection to the engine, the replicas of the maps that it holds, and the
//! other members.
//!
//! Invariant: without a section `[cluster]` none of this runs. A map is deleted here only if the catalogue of the
//! cluster says that it was deleted.

use std::{
    collections::BTreeMap,
    fmt,
    path::{Path, PathBuf},
    sync::{Arc, Mutex, MutexGuard, PoisonError},
    time::Duration,
};

use tidemap_cluster::{
    assignment::Candidate,
    catalogue::{self, ClusterMap},
    engine::{Engine as _, EngineError, SetError},
    member::MemberReport,
    membership::{self, Members},
    nats::{NatsCheckError, NatsCredentials, NatsEngine, NatsSettings, NatsTls, check},
    replica::{Replica, ReplicaHandle, ReplicaListener, ReplicaSettings, SharedLog},
};
use tidemap_map::{name::MapName, spec::MapSpec};
use tidemap_store::{EventLog as _, GroupLog, encode_spec};
use tokio::sync::{Notify, watch};
use tracing::{info, warn};

use crate::{config::cluster::ClusterSettings, peers::Peers, random_id::random_id, telemetry};

pub(crate) mod operations;

/// Pause before the engine is tried again at the start.
const CONNECT_PAUSE: Duration = Duration::from_secs(1);
/// How long a replica may take to stop.
const STOP_WITHIN: Duration = Duration::from_secs(5);

/// Why something cannot be done in the cluster.
#[derive(Debug, thiserror::Error)]
pub(crate) enum ClusterError {
    /// The engine is not what tidemap relies on.
    #[error("the engine of the cluster cannot be used: {0}")]
    Check(#[from] NatsCheckError),
    /// The engine does not do what is asked of it.
    #[error("the engine of the cluster: {0}")]
    Engine(#[from] EngineError),
    /// There is a map of this name.
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
    ended: crate::task::Task<()>,
}

struct Membership {
    engine: NatsEngine,
    settings: ClusterSettings,
    address: String,
    id: String,
    boot: u64,
    members: watch::Sender<Result<Members, EngineError>>,
    /// By the number of the map in the cluster. Held for a look-up.
    replicas: Mutex<BTreeMap<u64, RunningReplica>>,
    /// Wakes who keeps the catalogue.
    changed: Notify,
    is_draining: watch::Sender<bool>,
    /// The writers of the maps that this daemon does not hold, by the names of the maps.
    others: Mutex<BTreeMap<String, String>>,
}

/// The cluster, as this daemon is a member of it. Clones are handles of one.
#[derive(Clone)]
pub(crate) struct Cluster(Arc<Membership>);

impl fmt::Debug for Cluster {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.debug_struct("Cluster").field("member", &self.0.settings.member).finish_non_exhaustive()
    }
}

fn named(path: &Path) -> Option<PathBuf> {
    Some(path.to_owned()).filter(|path| !path.as_os_str().is_empty())
}

fn nats_settings(settings: &ClusterSettings) -> NatsSettings {
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

async fn try_to_connect(settings: &ClusterSettings, proposed: &str) -> Result<(NatsEngine, String), ClusterError> {
    let engine = NatsEngine::connect(nats_settings(settings)).await?;
    let servers = check(&engine, settings.require_synced_engine).await?;
    if servers.iter().any(|server| server.syncs_always.is_none()) {
        warn!(
            "whether the engine writes to its disk before it acknowledges is not known: let this account ask \
             $SYS.REQ.SERVER.PING.VARZ, and set `sync_interval: always`"
        );
    }
    engine.create_buckets(settings.engine_replicas).await?;
    let id = catalogue::cluster_id(&engine, proposed).await?;
    Ok((engine, id))
}

impl Cluster {
    /// Connects to the engine, and waits for it as long as it takes. `listen` is the address of the gRPC port,
    /// `proposed_id` becomes the identity of a new cluster.
    ///
    /// # Errors
    /// The engine cannot be used.
    pub(crate) async fn connect(
        settings: &ClusterSettings,
        listen: &str,
        proposed_id: &str,
    ) -> Result<Cluster, ClusterError> {
        let mut attempts = 0_u64;
        let (engine, id) = loop {
            match try_to_connect(settings, proposed_id).await {
                Ok(connected) => break connected,
                Err(error) if error.is_passing() => {
                    if attempts.is_multiple_of(10) {
                        warn!(%error, servers = ?settings.servers, "the engine of the cluster is not there yet");
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
            members: watch::Sender::new(Ok(Members::new())),
            replicas: Mutex::default(),
            changed: Notify::new(),
            is_draining: watch::Sender::new(false),
            others: Mutex::default(),
        })))
    }

    fn replicas(&self) -> MutexGuard<'_, BTreeMap<u64, RunningReplica>> {
        self.0.replicas.lock().unwrap_or_else(PoisonError::into_inner)
    }

    /// The identity of the cluster, which its producers know in place of a store's.
    pub(crate) fn id(&self) -> &str {
        &self.0.id
    }

    /// Makes the log of a map one that daemons share. `listener` is told what happens in it.
    pub(crate) fn share(&self, uid: u64, name: &MapName, log: GroupLog, listener: ReplicaListener) -> SharedLog {
        let settings = &self.0.settings;
        let settings = ReplicaSettings {
            map: uid,
            stream: catalogue::stream(uid),
            member: settings.member.clone(),
            version: telemetry::VERSION.to_owned(),
            maths: tidemap_model::MATHS,
            lease: Duration::from_millis(settings.lease_ms),
            heal_wait: Duration::from_secs(settings.heal_wait_secs),
            group_bytes: settings.group_bytes,
            patience: Duration::from_millis(500),
            disk_inline: false,
        };
        // A clone follows its stream on its own.
        let (replica, handle, log) = Replica::new(self.0.engine.clone(), settings, log, listener);
        let ended = crate::task::spawn(replica.run());
        let running = RunningReplica { handle, log: log.clone(), name: name.clone(), ended };
        self.replicas().insert(uid, running);
        self.0.changed.notify_one();
        log
    }

    /// Ends the replica of a map, in order.
    pub(crate) async fn unshare(&self, uid: u64) {
        let Some(replica) = self.replicas().remove(&uid) else { return };
        replica.handle.stop();
        if tokio::time::timeout(STOP_WITHIN, replica.ended).await.is_err() {
            warn!(map = %replica.name, "the replica did not stop in time");
        }
    }

    /// Adds a map to the cluster; gives its number.
    ///
    /// # Errors
    /// [`ClusterError::Exists`], [`ClusterError::Engine`].
    pub(crate) async fn create(&self, spec: &MapSpec) -> Result<u64, ClusterError> {
        let (engine, name) = (&self.0.engine, spec.name.as_str());
        if catalogue::find(engine, name).await?.is_some() {
            return Err(ClusterError::Exists(name.to_owned()));
        }
        let random = random_id().unwrap_or_default();
        let uid = u64::from_str_radix(random.get(..16).unwrap_or_default(), 16)
            .map_err(|_| EngineError::Refused("the system gives no random numbers".to_owned()))?;
        engine.create_stream(&catalogue::stream(uid), self.0.settings.engine_replicas).await?;
        match catalogue::add(engine, name, &ClusterMap::new(uid, &encode_spec(spec))).await {
            Ok(_) => Ok(uid),
            Err(error) => {
                // Nobody knows the stream.
                drop(engine.delete_stream(&catalogue::stream(uid)).await);
                Err(match error {
                    SetError::NotExpected => ClusterError::Exists(name.to_owned()),
                    SetError::Engine(error) => error.into(),
                })
            }
        }
    }

    /// Deletes a map from the cluster. The other daemons delete what they have of it when they see that.
    ///
    /// # Errors
    /// [`ClusterError::Engine`]; it can be tried again.
    pub(crate) async fn delete(&self, name: &MapName, uid: u64) -> Result<(), ClusterError> {
        Ok(catalogue::delete(&self.0.engine, name.as_str(), uid).await?)
    }

    /// The connection to the engine.
    pub(crate) fn engine(&self) -> &NatsEngine {
        &self.0.engine
    }

    /// The section of the config file.
    pub(crate) fn settings(&self) -> &ClusterSettings {
        &self.0.settings
    }

    /// Those that may hold maps; `None` where the engine does not tell.
    pub(crate) fn candidates(&self) -> Option<Vec<Candidate>> {
        self.0.members.borrow().as_ref().ok().map(membership::candidates)
    }

    /// Tells the replica of a map after how many others it may become the writer; `false`: there is no replica here.
    pub(crate) fn set_candidacy(&self, uid: u64, rank: Option<u32>) -> bool {
        match self.replicas().get(&uid) {
            Some(replica) => {
                replica.handle.set_candidacy(rank);
                true
            }
            None => false,
        }
    }

    /// From now on these daemons write the maps that this one does not hold.
    pub(crate) fn set_others(&self, writers: BTreeMap<String, String>) {
        *self.0.others.lock().unwrap_or_else(PoisonError::into_inner) = writers;
    }

    /// The maps that this daemon holds.
    pub(crate) fn held(&self) -> Vec<(u64, MapName)> {
        self.replicas().iter().map(|(&uid, replica)| (uid, replica.name.clone())).collect()
    }

    /// Returns when a replica was added.
    pub(crate) async fn changed(&self) {
        self.0.changed.notified().await;
    }

    fn report(&self, counter: u64) -> MemberReport {
        let inner = &self.0;
        let logs = self.replicas().iter().map(|(&uid, replica)| (uid, replica.log.end())).collect();
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
        }
    }

    /// Ends all replicas: what is in flight is answered, and the logs that this daemon writes are given to others.
    pub(crate) async fn stop(&self) {
        self.0.is_draining.send_replace(true);
        let replicas = std::mem::take(&mut *self.replicas());
        replicas.values().for_each(|replica| replica.handle.stop());
        for (_, replica) in replicas {
            if tokio::time::timeout(STOP_WITHIN, replica.ended).await.is_err() {
                warn!(map = %replica.name, "the replica did not stop in time");
            }
        }
    }

    /// Reports this daemon and looks at the others, for ever.
    pub(crate) async fn report_for_ever(self) {
        let (engine, member) = (self.0.engine.clone(), self.0.settings.member.clone());
        let sender = self.0.members.clone();
        membership::run(engine, member, move |counter| self.report(counter), sender).await;
    }
}

impl Peers for Cluster {
    fn name(&self) -> &str {
        let ClusterSettings { member, .. } = &self.0.settings;
        member
    }

    fn address_of(&self, member: &str) -> Option<String> {
        let members = self.0.members.borrow();
        let address = members.as_ref().ok()?.get(member)?.report.address.clone();
        Some(address).filter(|address| !address.is_empty())
    }

    fn others(&self) -> Vec<String> {
        let members = self.0.members.borrow();
        let Ok(members) = members.as_ref() else { return Vec::new() };
        let others = members.iter().filter(|(name, member)| member.is_alive && **name != self.0.settings.member);
        others.map(|(name, _)| name.clone()).collect()
    }

    fn writer_of(&self, map: &str) -> Option<String> {
        self.0.others.lock().unwrap_or_else(PoisonError::into_inner).get(map).cloned()
    }

    fn writer_of_held(&self, map: &MapName) -> Option<String> {
        let replicas = self.replicas();
        let replica = replicas.values().find(|replica| replica.name == *map)?;
        replica.log.status().borrow().writer.clone()
    }

    fn heard(&self, map: &MapName) -> Option<std::time::Instant> {
        let replicas = self.replicas();
        let replica = replicas.values().find(|replica| replica.name == *map)?;
        replica.log.status().borrow().heard.map(tokio::time::Instant::into_std)
    }

    fn max_staleness(&self) -> Duration {
        Duration::from_millis(self.0.settings.max_staleness_ms)
    }
}
