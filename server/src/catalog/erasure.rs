//! Erasing states from a map that is served: its writer stops, the store writes the map again without the states, and
//! another writer begins with that.
//!
//! Invariant: the states are found by name when nothing can change their ids any more, and one erasure of the daemon
//! runs at a time. Requests wait for the new writer, and what was read for the old one is not answered.

use std::sync::{Arc, atomic::Ordering};

use tidemap_map::{
    ids::StateId,
    live_map::LiveMap,
    name::{MapName, StateName},
    view::MapView,
};
use tracing::{error, info};

use super::{ByName, Catalog, CatalogError, ended, restore_map};
use crate::{
    access::Caller,
    ingest::{ending::Ending, handle::MapHandle, writer::start_in},
    jobs::{JobCause, UpdateJob},
};

/// The states of a name: one, or the axes of a vector or an angle.
///
/// # Errors
/// [`CatalogError::NoState`], [`CatalogError::Axis`].
pub(crate) fn states_of(view: &MapView, name: &str) -> Result<Vec<StateId>, CatalogError> {
    let unknown = || CatalogError::NoState { map: view.spec().name.clone(), state: name.chars().take(80).collect() };
    if let Ok(stored) = StateName::stored(name)
        && view.find(name).is_some()
        && let Some((whole, _)) = stored.as_axis().or(stored.as_angle_axis())
        && view.shape(whole).is_some_and(|(_, shape)| shape.states() > 1)
    {
        return Err(CatalogError::Axis { state: name.to_owned(), whole: whole.to_owned() });
    }
    let (first, shape) = view.shape(name).ok_or_else(unknown)?;
    let count = u32::try_from(shape.states()).unwrap_or(1);
    Ok((first.0..first.0.saturating_add(count)).map(StateId).collect())
}

impl Catalog {
    /// Erases a state from a map, as a job that continues if the caller goes away.
    pub(crate) fn erase(&self, map: &MapName, state: String, caller: &Caller) -> Arc<UpdateJob> {
        let job = self.context.jobs.create(map.clone(), JobCause::Erasure, self.context.clock.now_nanos());
        let (this, map, by, of) = (self.clone(), map.clone(), caller.shown().to_owned(), Arc::clone(&job));
        info!(%map, state, by, job = job.id, "erasure ordered");
        tokio::spawn(async move {
            let erased = this.erase_now(&map, &state, &of).await;
            match &erased {
                Ok(states) => info!(%map, state, by, job = of.id, states, "erased"),
                Err(error) => error!(%map, state, by, job = of.id, %error, "not erased"),
            }
            of.end_with(erased.map(|_| None).map_err(|error| error.to_string()));
        });
        job
    }

    async fn erase_now(&self, map: &MapName, state: &str, job: &UpdateJob) -> Result<u64, CatalogError> {
        let open = self.changing.lock().await;
        if !*open {
            return Err(CatalogError::Stopping);
        }
        let old = self.get(map.as_str())?;
        if !old.opened().await {
            return Err(CatalogError::Stopping);
        }
        let (id, spec, view) = (old.id, Arc::clone(&old.spec), old.view());
        // States are only added from here on.
        let states = states_of(&view, state)?;
        let count = states.len() as u64;
        job.start(count, 0);
        let shown = LiveMap::new(Arc::clone(&spec)).publish();
        let (new, seat) = MapHandle::with_seat(id, Arc::clone(&spec), shown);
        let new = Arc::new(new);
        self.maps.rcu(|all| {
            let mut maps = ByName::clone(all);
            maps.insert(map.clone(), Arc::clone(&new));
            maps
        });
        old.replace();
        old.stop(Ending::Erasure).await;
        drop((old, view));
        let context = self.context.clone();
        let (erased, restored) = ended(tokio::task::spawn_blocking(move || {
            let erased = context.store.erase_states(id, &states);
            let restored = restore_map(&context, id, &spec, &|_, _| true);
            Ok((erased, restored))
        }))
        .await?;
        match restored {
            Ok(restored) => drop(start_in(seat, self.context.clone(), id, restored)?),
            Err(error) => {
                let aside = self.context.store.set_aside().into_iter().find(|map| map.id == id);
                let reason = aside.map(|map| map.reason);
                let map_error = reason.map(|reason| CatalogError::Unavailable { map: map.to_string(), reason });
                self.set_aside(id, map, map_error.as_ref().unwrap_or(&error));
                drop(seat);
                erased?;
                return Err(error);
            }
        }
        erased?;
        job.states_done.store(count, Ordering::Relaxed);
        Ok(count)
    }
}
