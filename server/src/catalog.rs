//! The maps that the daemon serves.
//!
//! Invariant: looking a map up never waits. Creating and deleting maps happens one at a time, and a map that is listed
//! is durable.

use std::{collections::BTreeMap, sync::Arc};

use arc_swap::ArcSwap;
use tidemap_map::{live_map::LiveMap, name::MapName, spec::MapSpec};
use tidemap_store::{MapId, OpenError, StoreError};
use tracing::{info, warn};

use crate::ingest::{
    protocol::Ending,
    writer::{Context, MapHandle, start},
};

/// Why a map is not created or deleted.
#[derive(Debug, thiserror::Error)]
pub enum CatalogError {
    /// The name is taken.
    #[error("map {:?} exists already", .0.as_str())]
    Exists(MapName),
    /// There is no such map.
    #[error("map {:?} does not exist", .0)]
    Unknown(String),
    /// As many maps as allowed.
    #[error("there are {max} maps, as many as setting max_maps allows")]
    TooMany {
        /// The limit.
        max: usize,
    },
    /// The store could not do it.
    #[error(transparent)]
    Store(#[from] StoreError),
    /// The new map could not be opened.
    #[error(transparent)]
    Open(#[from] OpenError),
    /// The log holds what this map cannot have written.
    #[error("the log of map {map} is not its own: {reason}. Restore the folder of this map from a backup")]
    Inconsistent {
        /// The map.
        map: MapName,
        /// What does not fit.
        reason: String,
    },
    /// No thread for the map.
    #[error("no thread for the map: {0}")]
    Thread(#[from] std::io::Error),
    /// The daemon stops.
    #[error("the daemon is stopping")]
    Stopping,
}

type ByName = BTreeMap<MapName, Arc<MapHandle>>;

/// All maps, by name.
#[derive(Debug)]
pub struct Catalog {
    context: Context,
    max_maps: usize,
    maps: ArcSwap<ByName>,
    // One change at a time; readers use `maps` and never take it. `false`: stopped.
    changing: tokio::sync::Mutex<bool>,
}

impl Catalog {
    /// Opens every map that the store holds.
    ///
    /// # Errors
    /// The first map that cannot be opened, with what is wrong.
    pub fn open(context: Context, max_maps: usize) -> Result<Self, CatalogError> {
        let mut maps = ByName::new();
        for (id, spec) in context.store.maps() {
            let name = spec.name.clone();
            maps.insert(name, open_map(&context, id, spec)?);
        }
        Ok(Self { context, max_maps, maps: ArcSwap::from_pointee(maps), changing: tokio::sync::Mutex::new(true) })
    }

    /// The map of this name.
    ///
    /// # Errors
    /// [`CatalogError::Unknown`].
    pub fn get(&self, name: &str) -> Result<Arc<MapHandle>, CatalogError> {
        let name_checked = MapName::new(name).map_err(|_| CatalogError::Unknown(shortened(name)))?;
        self.maps.load().get(&name_checked).cloned().ok_or_else(|| CatalogError::Unknown(shortened(name)))
    }

    /// All maps, by name.
    #[must_use]
    pub fn all(&self) -> Arc<ByName> {
        self.maps.load_full()
    }

    /// What the writers share.
    #[must_use]
    pub fn context(&self) -> &Context {
        &self.context
    }

    /// Creates a map; it is durable when this returns.
    ///
    /// # Errors
    /// See [`CatalogError`].
    pub async fn create(&self, spec: MapSpec) -> Result<Arc<MapHandle>, CatalogError> {
        let open = self.changing.lock().await;
        if !*open {
            return Err(CatalogError::Stopping);
        }
        let mut maps = ByName::clone(&self.maps.load());
        if maps.contains_key(&spec.name) {
            return Err(CatalogError::Exists(spec.name));
        }
        if maps.len() >= self.max_maps {
            return Err(CatalogError::TooMany { max: self.max_maps });
        }
        let context = self.context.clone();
        let name = spec.name.clone();
        let handle = blocking(move || {
            let id = context.store.create_map(&spec)?;
            open_map(&context, id, spec)
        })
        .await?;
        info!(map = %name, id = handle.id.0, "map created");
        maps.insert(name, Arc::clone(&handle));
        self.maps.store(Arc::new(maps));
        Ok(handle)
    }

    /// Deletes a map for good.
    ///
    /// # Errors
    /// See [`CatalogError`].
    pub async fn delete(&self, name: &str) -> Result<(), CatalogError> {
        let open = self.changing.lock().await;
        if !*open {
            return Err(CatalogError::Stopping);
        }
        let handle = self.get(name)?;
        let mut maps = ByName::clone(&self.maps.load());
        maps.remove(&handle.spec.name);
        self.maps.store(Arc::new(maps));
        handle.stop(Ending::MapDeleted).await;
        let (context, id) = (self.context.clone(), handle.id);
        blocking(move || Ok(context.store.delete_map(id)?)).await?;
        info!(map = name, id = handle.id.0, "map deleted");
        Ok(())
    }

    /// Stops all writers; what is in flight is made durable and acknowledged first.
    pub async fn stop(&self) {
        let mut open = self.changing.lock().await;
        *open = false;
        let maps = self.all();
        let mut stopping: Vec<_> = Vec::with_capacity(maps.len());
        for handle in maps.values() {
            let handle = Arc::clone(handle);
            stopping.push(tokio::spawn(async move { handle.stop(Ending::Shutdown).await }));
        }
        for stopped in stopping {
            if let Err(error) = stopped.await {
                warn!(%error, "a map did not stop in order");
            }
        }
    }
}

fn shortened(name: &str) -> String {
    name.chars().take(80).collect()
}

async fn blocking<T: Send + 'static>(
    work: impl FnOnce() -> Result<T, CatalogError> + Send + 'static,
) -> Result<T, CatalogError> {
    match tokio::task::spawn_blocking(work).await {
        Ok(result) => result,
        Err(_) => Err(CatalogError::Stopping),
    }
}

/// Brings a map back from its newest snapshot and the log after it, and starts its writer.
fn open_map(context: &Context, id: MapId, spec: MapSpec) -> Result<Arc<MapHandle>, CatalogError> {
    let opened = context.store.open_map(id, &spec)?;
    for report in &opened.reports {
        warn!(map = %spec.name, "{report}");
    }
    let spec = Arc::new(spec);
    let (mut map, known) = match opened.snapshot {
        Some(snapshot) => {
            let known = snapshot.position;
            (LiveMap::restore(Arc::clone(&spec), snapshot), known)
        }
        None => (LiveMap::new(Arc::clone(&spec)), 0),
    };
    let mut replayed = 0u64;
    for entry in opened.replay {
        let (position, event) = entry?;
        replayed += 1;
        let result = if position <= known {
            map.recover_pending(position, &event).map(|()| None)
        } else {
            map.apply(position, &event)
        };
        let work =
            result.map_err(|error| CatalogError::Inconsistent { map: spec.name.clone(), reason: error.to_string() })?;
        if let Some(work) = work {
            let done = std::sync::atomic::AtomicU64::new(0);
            let result = context.update_pool.install(|| work.run(&done));
            // What it learned is saved with the next update; until then the log gives it back.
            drop(map.finish_update(result));
        }
    }
    info!(
        map = %spec.name, source = ?opened.source, replayed, states = map.states(), pending = map.pending(),
        "map opened"
    );
    Ok(start(context.clone(), id, map, opened.log)?)
}
