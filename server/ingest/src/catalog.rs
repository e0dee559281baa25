//! The maps that the daemon serves.
//!
//! At a start each map is restored from its newest checkpoint and the log after it. A map with large checkpoints and
//! log is listed at once, with the generation that the index publishes, and restored while the ports are open. The log
//! does not record whether its last update was cut off or ended without a save. This update is repeated beside the
//! served map, so a client may see the generation before one that it has already seen. Earlier updates in the log had
//! ended, because another one followed; they are repeated before the map is open.
//!
//! A map that cannot be opened is set aside: the others serve, and its files stay as they are.
//!
//! Invariant: a lookup of a map never waits. Maps are created and deleted one at a time, and a listed map is durable. A
//! change that has begun is completed even if its caller is gone.

use std::{
    collections::BTreeMap,
    sync::{
        Arc,
        atomic::{AtomicBool, Ordering},
    },
};

use arc_swap::ArcSwap;
use tidemap_base::task::Task;
use tidemap_map::{live_map::LiveMap, name::MapName, spec::MapSpec, update::SumsUnavailable};
use tidemap_store::{CopyError, EraseError, MapCopy, MapId, OpenError, StoreError};
use tracing::{error, info, warn};

use crate::{
    cluster::ClusterError,
    ending::Ending,
    handle::{MapHandle, OpenProgress, WriterEndpoints},
    writer::{Context, start_in},
};

/// A map with more bytes of checkpoints and log is served from the index until it is restored.
pub const RESTORED_FIRST_BYTES: u64 = 8 << 20;

/// The reason why a map is not created or deleted.
#[derive(Debug, thiserror::Error)]
#[expect(missing_docs, reason = "the messages name the variants and fields")]
pub enum CatalogError {
    #[error("map {:?} exists already", .0.as_str())]
    Exists(MapName),
    #[error("map {:?} does not exist", .0)]
    Unknown(String),
    #[error("there are {max} maps, as many as setting max_maps allows")]
    TooMany { max: usize },
    #[error("map {map:?} is unavailable: {reason}. The other maps are served")]
    Unavailable { map: String, reason: String },
    #[error(transparent)]
    Store(#[from] StoreError),
    #[error(transparent)]
    Open(#[from] OpenError),
    #[error("the log of map {map} does not fit the map: {reason}. Restore the folder of this map from a backup")]
    Inconsistent { map: MapName, reason: String },
    #[error(
        "maps {} and {} are both named {:?}. Move the folder of one of them out of the data folder",
        first.0, second.0, name.as_str()
    )]
    Duplicate { name: MapName, first: MapId, second: MapId },
    #[error(
        "the log of map {map} on this daemon and the one that daemons share differ after record {common}: this daemon \
         does not serve it, and the others do"
    )]
    Forked { map: MapName, common: u64 },
    #[error("map {map}: {source}. Restore the folder of this map from a backup")]
    Sums { map: MapName, source: SumsUnavailable },
    #[error("nothing is erased: {0}")]
    Erase(#[from] EraseError),
    #[error("state {state:?} does not exist in map {map:?}")]
    NoState { map: MapName, state: String },
    #[error("state {state:?} is a part of {whole:?}: erase {whole:?}, which erases all its axes or labels")]
    Axis { state: String, whole: String },
    #[error("no thread for the map: {0}")]
    Thread(#[from] std::io::Error),
    #[error(
        "map {map} has no producer {producer:?}{}. tidemap producer list {map} shows those it has",
        label.as_ref().map_or(String::new(), |label| format!(" with label {label:?}"))
    )]
    NoProducer { map: MapName, producer: String, label: Option<String> },
    #[error(transparent)]
    Cluster(#[from] ClusterError),
    #[error(transparent)]
    Copy(#[from] CopyError),
    /// A map that was to be replaced by a copy no longer needs one.
    #[error("map {0} no longer needs a copy from another daemon")]
    NoCopyNeeded(MapName),
    #[error("map {0} belongs to a cluster: start the daemon with its section [cluster]")]
    NoCluster(MapName),
    #[error("map {0} belongs to a cluster, from which nothing can be erased yet: delete the map to remove its data")]
    NotErasedInCluster(MapName),
    #[error("the daemon is stopping")]
    Stopping,
}

impl CatalogError {
    /// Whether only the data of one map has a fault, and not the machine.
    fn is_of_one_map(&self) -> bool {
        match self {
            Self::Open(error) => !error.is_shortage(),
            Self::Inconsistent { .. }
            | Self::Duplicate { .. }
            | Self::Sums { .. }
            | Self::Forked { .. }
            | Self::NoCluster(_) => true,
            _ => false,
        }
    }
}

/// A map that cannot be used.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct UnavailableMap {
    /// Number of the map in the store.
    pub id: MapId,
    /// Name of the map; its number where the name is not known.
    pub name: String,
    /// The reason, for people.
    pub reason: String,
}

type ByName = BTreeMap<MapName, Arc<MapHandle>>;

mod copies;
pub mod erasure;
mod fork;
#[cfg(feature = "test-support")]
mod on_log;
mod restore;
#[cfg(test)]
mod tests;

use restore::open_map;
pub use restore::share;
pub use restore::{restore_map, try_restore};

/// All maps, by name. Clones are handles to the same maps.
#[derive(Clone, Debug)]
pub struct Catalog {
    context: Context,
    max_maps: usize,
    maps: Arc<ArcSwap<ByName>>,
    unavailable: Arc<ArcSwap<Vec<UnavailableMap>>>,
    // The lock allows one change at a time; readers use `maps` and never take this lock. `false`: stopped.
    changing: Arc<tokio::sync::Mutex<bool>>,
    /// Ends the restoring of maps.
    pub is_stopping: Arc<AtomicBool>,
}

/// The origin of a new map.
enum MapOrigin {
    /// The map is empty, and belongs to this daemon alone.
    Alone,
    /// The map is empty, and belongs to a cluster.
    Shared(u64),
    /// The map is made from a complete copy of another daemon's map.
    Copied(Box<MapCopy>, u64),
}

/// A map that serves what the index publishes, and that is not restored yet.
pub struct UnopenedMap {
    id: MapId,
    shared_uid: Option<u64>,
    spec: Arc<MapSpec>,
    endpoints: WriterEndpoints,
}

impl Catalog {
    /// Opens all maps of the store. Maps with at most `restored_first_bytes` of checkpoints and log, and maps of which
    /// the index publishes nothing, are opened completely. The others serve what the index publishes until
    /// [`Self::restore_rest`] has restored them.
    ///
    /// # Errors
    /// [`CatalogError::Thread`], or a lack of memory or descriptors. A map that cannot be opened for another reason is
    /// set aside.
    pub fn open(
        context: Context,
        max_maps: usize,
        restored_first_bytes: u64,
    ) -> Result<(Self, Vec<UnopenedMap>), CatalogError> {
        let stored = context.store.maps();
        let (mut maps, mut rest, mut unavailable) = (ByName::new(), Vec::new(), Vec::new());
        for map in context.store.set_aside() {
            let name = map.name.unwrap_or_else(|| format!("map number {}", map.id.0));
            unavailable.push(set_aside(map.id, name, map.reason));
        }
        let is_stopping = Arc::new(AtomicBool::new(false));
        for (id, spec) in stored {
            let (name, spec) = (spec.name.clone(), Arc::new(spec));
            if let Some(first) = maps.get(&name).map(|handle: &Arc<MapHandle>| handle.id) {
                let error = CatalogError::Duplicate { name: name.clone(), first, second: id };
                unavailable.push(set_aside(id, name.as_str().to_owned(), error.to_string()));
                continue;
            }
            match open_or_publish(&context, id, spec, restored_first_bytes, &mut rest) {
                Ok(handle) => drop(maps.insert(name, handle)),
                Err(error) if error.is_of_one_map() => {
                    unavailable.push(set_aside(id, name.as_str().to_owned(), error.to_string()));
                }
                Err(error) => return Err(error),
            }
        }
        let changing = Arc::new(tokio::sync::Mutex::new(true));
        let unavailable = Arc::new(ArcSwap::from_pointee(unavailable));
        let maps = Arc::new(ArcSwap::from_pointee(maps));
        Ok((Self { context, max_maps, maps, unavailable, changing, is_stopping }, rest))
    }

    /// Restores the maps that serve what the index publishes, one after the other.
    ///
    /// # Errors
    /// The errors of [`Self::open`]; [`CatalogError::Stopping`].
    pub fn restore_rest(&self, rest: Vec<UnopenedMap>) -> Result<(), CatalogError> {
        for UnopenedMap { id, shared_uid, spec, endpoints } in rest {
            let report = |done, total| {
                endpoints.opening.send_replace(OpenProgress::Replay { done, total });
                !self.is_stopping.load(Ordering::Relaxed)
            };
            let restored = restore_map(&self.context, id, &spec, &report)
                .and_then(|restored| share(&self.context, (id, shared_uid), &endpoints, restored));
            match restored {
                Ok(restored) => start_in(endpoints, self.context.clone(), id, restored)?,
                Err(error) if error.is_of_one_map() => {
                    self.set_aside(id, &spec.name, &error);
                    drop(endpoints);
                }
                Err(error) => return Err(error),
            }
        }
        Ok(())
    }

    /// Sets a listed map aside. Requests that wait for it receive the reason if the endpoints of its writer are dropped
    /// afterwards.
    fn set_aside(&self, id: MapId, name: &MapName, error: &CatalogError) {
        let map = set_aside(id, name.as_str().to_owned(), error.to_string());
        self.unavailable.rcu(|all| [&all[..], std::slice::from_ref(&map)].concat());
        self.maps.rcu(|all| {
            let mut maps = ByName::clone(all);
            maps.remove(name);
            maps
        });
    }

    /// Maps that are set aside.
    pub fn unavailable(&self) -> Arc<Vec<UnavailableMap>> {
        self.unavailable.load_full()
    }

    /// Returns the reason why a map is set aside, if it is.
    fn check_available(&self, name: &str) -> Result<(), CatalogError> {
        match self.unavailable.load().iter().find(|map| map.name == name) {
            Some(map) => Err(CatalogError::Unavailable { map: map.name.clone(), reason: map.reason.clone() }),
            // Whether there was a map of this name is not known.
            None => match self.context.store.lost_map_list() {
                Some(lost) => Err(CatalogError::Unavailable { map: shortened(name), reason: lost.to_string() }),
                None => Ok(()),
            },
        }
    }

    /// The map of this name.
    ///
    /// # Errors
    /// [`CatalogError::Unknown`], [`CatalogError::Unavailable`].
    pub fn get(&self, name: &str) -> Result<Arc<MapHandle>, CatalogError> {
        let name_checked = MapName::new(name).map_err(|_| CatalogError::Unknown(shortened(name)))?;
        if let Some(handle) = self.maps.load().get(&name_checked) {
            return Ok(Arc::clone(handle));
        }
        self.check_available(name)?;
        Err(CatalogError::Unknown(shortened(name)))
    }

    /// All maps, by name.
    pub fn all(&self) -> Arc<ByName> {
        self.maps.load_full()
    }

    /// The context that all writers share.
    pub fn context(&self) -> &Context {
        &self.context
    }

    /// Creates a map; it is durable when this returns. Continues if the caller is dropped.
    ///
    /// # Errors
    /// See [`CatalogError`].
    pub async fn create(&self, spec: MapSpec) -> Result<Arc<MapHandle>, CatalogError> {
        let this = self.clone();
        ended(tidemap_base::task::spawn(async move { this.create_now(spec).await })).await
    }

    async fn create_now(&self, spec: MapSpec) -> Result<Arc<MapHandle>, CatalogError> {
        let open = self.changing.lock().await;
        if !*open {
            return Err(CatalogError::Stopping);
        }
        self.check_new(&spec)?;
        let shared = match &self.context.cluster {
            Some(cluster) => MapOrigin::Shared(cluster.create(&spec).await?),
            None => MapOrigin::Alone,
        };
        self.add(spec, shared).await
    }

    /// Holds a map of the cluster, which other daemons may hold already.
    ///
    /// # Errors
    /// See [`CatalogError`].
    pub async fn adopt(&self, spec: MapSpec, uid: u64) -> Result<(), CatalogError> {
        let this = self.clone();
        ended(tidemap_base::task::spawn(async move {
            let open = this.changing.lock().await;
            if !*open {
                return Err(CatalogError::Stopping);
            }
            // The map may have been created here meanwhile.
            if let Ok(known) = this.get(spec.name.as_str())
                && known.shared_uid == Some(uid)
            {
                return Ok(());
            }
            this.check_new(&spec)?;
            this.add(spec, MapOrigin::Shared(uid)).await.map(drop)
        }))
        .await
    }

    /// Checks that a map may be added. The result is certain only with the lock of changes.
    pub fn check_new(&self, spec: &MapSpec) -> Result<(), CatalogError> {
        let maps = self.maps.load();
        if maps.contains_key(&spec.name) {
            return Err(CatalogError::Exists(spec.name.clone()));
        }
        self.check_available(spec.name.as_str())?;
        if maps.len() >= self.max_maps {
            return Err(CatalogError::TooMany { max: self.max_maps });
        }
        Ok(())
    }

    /// Adds a map. The caller has the lock of changes.
    async fn add(&self, spec: MapSpec, new: MapOrigin) -> Result<Arc<MapHandle>, CatalogError> {
        let mut maps = ByName::clone(&self.maps.load());
        let context = self.context.clone();
        let name = spec.name.clone();
        let handle = ended(tidemap_base::task::blocking(move || {
            let (id, shared) = match new {
                MapOrigin::Alone => (context.store.create_map(&spec)?, None),
                MapOrigin::Shared(uid) => (context.store.create_shared_map(&spec, uid)?, Some(uid)),
                MapOrigin::Copied(copy, uid) => (copy.install()?.0, Some(uid)),
            };
            open_map(&context, (id, shared), &Arc::new(spec)).inspect_err(|_| {
                // An unlisted map could be neither used nor deleted, and would take its name at the next start.
                if let Err(error) = context.store.delete_map(id) {
                    warn!(id = id.0, %error, "a map that could not be opened is left in the store");
                }
            })
        }))
        .await?;
        info!(map = %name, id = handle.id.0, "map created");
        maps.insert(name, Arc::clone(&handle));
        self.maps.store(Arc::new(maps));
        Ok(handle)
    }

    /// Deletes a map for good. Continues if the caller is dropped. If the store fails, the map is still listed, but
    /// accepts no observations; the deletion can be tried again.
    ///
    /// # Errors
    /// See [`CatalogError`].
    pub async fn delete(&self, name: &str) -> Result<(), CatalogError> {
        let (this, name) = (self.clone(), name.to_owned());
        ended(tidemap_base::task::spawn(async move { this.delete_now(&name).await })).await
    }

    async fn delete_now(&self, name: &str) -> Result<(), CatalogError> {
        let open = self.changing.lock().await;
        if !*open {
            return Err(CatalogError::Stopping);
        }
        let cluster = self.context.cluster.as_ref().zip(MapName::new(name).ok());
        if let Some(map) = self.unavailable().iter().find(|map| map.name == name && self.get(name).is_err()) {
            // If the number cannot be read, only the local map is deleted.
            if let (Some((cluster, name)), Ok(Some(uid))) = (&cluster, self.context.store.shared(map.id)) {
                cluster.delete_unheld(name, Some(uid)).await.map_err(ClusterError::from)?;
            }
            let (store, id) = (Arc::clone(&self.context.store), map.id);
            ended(tidemap_base::task::blocking(move || Ok(store.delete_map(id)?))).await?;
            self.unavailable.rcu(|all| all.iter().filter(|other| other.id != id).cloned().collect::<Vec<_>>());
            info!(map = name, id = id.0, "unavailable map deleted");
            return Ok(());
        }
        let found = self.get(name);
        if let (Err(CatalogError::Unknown(_)), Some((cluster, name))) = (&found, &cluster)
            && cluster.delete_unheld(name, None).await.map_err(ClusterError::from)?
        {
            info!(map = %name, "map of the cluster deleted, which this daemon does not hold");
            return Ok(());
        }
        let handle = found?;
        if let (Some(cluster), Some(uid)) = (&self.context.cluster, handle.shared_uid) {
            cluster.delete(&handle.spec.name, uid).await?;
            cluster.unshare(uid).await;
        }
        self.delete_open(handle).await
    }

    /// Deletes a map here that was deleted from the cluster.
    ///
    /// # Errors
    /// See [`CatalogError`].
    pub async fn delete_held(&self, name: &MapName, uid: u64) -> Result<(), CatalogError> {
        let (this, name) = (self.clone(), name.clone());
        ended(tidemap_base::task::spawn(async move {
            let open = this.changing.lock().await;
            if !*open {
                return Err(CatalogError::Stopping);
            }
            if let Some(cluster) = &this.context.cluster {
                cluster.unshare(uid).await;
            }
            let handle = this.get(name.as_str())?;
            if handle.shared_uid == Some(uid) { this.delete_open(handle).await } else { Ok(()) }
        }))
        .await
    }

    /// Deletes an open map. The caller has the lock of changes.
    async fn delete_open(&self, handle: Arc<MapHandle>) -> Result<(), CatalogError> {
        let name = handle.spec.name.as_str();
        let before = self.all();
        let mut maps = ByName::clone(&before);
        maps.remove(&handle.spec.name);
        self.maps.store(Arc::new(maps));
        handle.stop(Ending::MapDeleted).await;
        let (store, id) = (Arc::clone(&self.context.store), handle.id);
        let deleted = ended(tidemap_base::task::blocking(move || Ok(store.delete_map(id)?))).await;
        match &deleted {
            Ok(()) => info!(map = name, id = id.0, "map deleted"),
            Err(error) => {
                warn!(map = name, id = id.0, %error, "map not deleted completely");
                // No other change of the listing can have happened meanwhile.
                if self.context.store.maps().iter().any(|(stored, _)| *stored == id) {
                    self.maps.store(before);
                }
            }
        }
        deleted
    }

    /// Stops all writers; records in flight become durable and are acknowledged first.
    pub async fn stop(&self) {
        self.is_stopping.store(true, Ordering::Relaxed);
        let mut open = self.changing.lock().await;
        *open = false;
        let maps = self.all();
        let mut stopping: Vec<_> = Vec::with_capacity(maps.len());
        for handle in maps.values() {
            let handle = Arc::clone(handle);
            stopping.push(tidemap_base::task::spawn(async move { handle.stop(Ending::Shutdown).await }));
        }
        for stopped in stopping {
            if let Err(error) = stopped.await {
                warn!(%error, "a map did not stop in order");
            }
        }
    }
}

/// Opens a map. A map with more bytes of checkpoints and log serves what the index publishes, if it publishes the map.
fn open_or_publish(
    context: &Context,
    id: MapId,
    spec: Arc<MapSpec>,
    restored_first_bytes: u64,
    rest: &mut Vec<UnopenedMap>,
) -> Result<Arc<MapHandle>, CatalogError> {
    let shared_uid = context.store.shared(id)?;
    let sizes = context.store.sizes(id);
    let is_large = sizes.log_bytes + sizes.checkpoint_bytes > restored_first_bytes;
    let Some(published) = context.store.published(id, &spec).filter(|_| is_large) else {
        return open_map(context, (id, shared_uid), &spec);
    };
    let generation = published.generation;
    let view = LiveMap::restore(Arc::clone(&spec), published).publish();
    info!(map = %spec.name, states = view.len(), generation, "map served from the index");
    let (handle, endpoints) = MapHandle::with_endpoints((id, shared_uid), Arc::clone(&spec), view, &context.clock);
    rest.push(UnopenedMap { id, shared_uid, spec, endpoints });
    Ok(Arc::new(handle))
}

/// Reports a map that cannot be used.
fn set_aside(id: MapId, name: String, reason: String) -> UnavailableMap {
    error!(map = name, id = id.0, reason, "map unavailable: it is set aside, and its files are left as they are");
    UnavailableMap { id, name, reason }
}

fn shortened(name: &str) -> String {
    name.chars().take(80).collect()
}

async fn ended<T>(task: Task<Result<T, CatalogError>>) -> Result<T, CatalogError> {
    match task.await {
        Ok(result) => result,
        Err(_) => Err(CatalogError::Stopping),
    }
}
