//! A map whose own log has records that the shared log does not have: they are set aside, and the map is opened again
//! without them.
//!
//! Invariant: nothing of the fork is lost: its records stay in a file until an operator has decided about them.

use std::sync::Arc;

use tidemap_map::{live_map::LiveMap, name::MapName};
use tidemap_store::MapId;
use tracing::{error, warn};

use super::{ByName, Catalog, CatalogError, ended, restore_map, share};
use crate::{
    handle::MapHandle,
    writer::{Context, ForkedMap, start_in},
};

impl Catalog {
    /// Sets the fork of a map aside, and opens the map again. The writer of the map has stopped. A map that cannot be
    /// opened is set aside itself.
    pub async fn forked(&self, fork: ForkedMap) {
        let ForkedMap { id, map, common } = fork;
        let open = self.changing.lock().await;
        // The map may have been deleted meanwhile.
        let Some(old) = self.maps.load().get(&map).filter(|handle| handle.id == id).map(Arc::clone) else { return };
        if !*open {
            return;
        }
        if let (Some(cluster), Some(uid)) = (&self.context.cluster, old.shared_uid) {
            cluster.unshare_at(uid, common).await;
        }
        self.open_again(old, move |context| set_aside(context, id, &map, common)).await;
    }

    /// Opens a map again after a change of its files. The writer of the map has stopped. A map that cannot be opened is
    /// set aside. The caller has the lock of changes.
    pub(super) async fn open_again(
        &self,
        old: Arc<MapHandle>,
        change: impl FnOnce(&Context) -> Result<(), CatalogError> + Send + 'static,
    ) {
        let (id, spec) = (old.id, Arc::clone(&old.spec));
        let shown = LiveMap::new(Arc::clone(&spec)).publish();
        let (new, endpoints) =
            MapHandle::with_endpoints((id, old.shared_uid), Arc::clone(&spec), shown, &self.context.clock);
        let new = Arc::new(new);
        self.maps.rcu(|all| {
            let mut maps = ByName::clone(all);
            maps.insert(spec.name.clone(), Arc::clone(&new));
            maps
        });
        old.replace();
        let (context, of_map) = (self.context.clone(), Arc::clone(&spec));
        let opened = ended(tidemap_base::task::blocking(move || {
            change(&context)?;
            restore_map(&context, id, &of_map, &|_, _| true)
        }))
        .await;
        let started = opened.and_then(|restored| {
            let restored = share(&self.context, (id, old.shared_uid), &endpoints, restored)?;
            Ok(start_in(endpoints, self.context.clone(), id, restored)?)
        });
        if let Err(error) = started {
            self.set_aside(id, &spec.name, &error);
        }
    }
}

/// Sets the records of a map's own log aside that the shared log does not have.
fn set_aside(context: &Context, id: MapId, map: &MapName, common: u64) -> Result<(), CatalogError> {
    let fork = context.store.set_fork_aside(id, common).map_err(|error| {
        error!(%map, %error, "a fork cannot be set aside");
        CatalogError::Forked { map: map.clone(), common }
    })?;
    match fork {
        Some(fork) if fork.groups > 1 => {
            metrics::counter!("tidemap_cluster_forks_total").increment(1);
            error!(
                %map, first = fork.first, last = fork.last, file = fork.name,
                "FORKED: the own log of this daemon had records that the shared log does not have. The daemon has set \
                 them aside. `tidemap cluster heal {map}` adds their observations to the map again"
            );
        }
        Some(fork) => warn!(
            %map, first = fork.first, last = fork.last, file = fork.name,
            "this daemon has set records aside whose append may not have been confirmed when it lost the log. `tidemap \
             cluster heal {map}` adds those that the map lacks"
        ),
        None => {}
    }
    Ok(())
}
