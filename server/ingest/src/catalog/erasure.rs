//! Erases states, or some of their observations, from a served map: its writer stops, the store writes the map again
//! without them, and another writer begins with the new map.
//!
//! Invariant: the states are found by name when nothing can change their ids any more, and one erasure of the daemon
//! runs at a time. Requests wait for the new writer; a read for the old writer gets no reply.

use std::{
    collections::BTreeSet,
    sync::{Arc, atomic::Ordering},
};

use tidemap_base::access::Caller;
use tidemap_map::{
    erasure::{ErasureRequest, Selection},
    ids::{ProducerId, StateId},
    live_map::LiveMap,
    name::{MapName, ProducerKey, StateName},
    view::MapView,
};
use tidemap_store::Erased;
use tokio::sync::oneshot;
use tracing::{error, info};

use super::{ByName, Catalog, CatalogError, ended, restore_map, shortened};
use crate::{
    ending::Ending,
    handle::MapHandle,
    jobs::{JobCause, UpdateJob},
    protocol::Command,
    writer::start_in,
};

/// The vector, angle or categorical state that contains this part.
fn whole_of(part: &StateName) -> Option<&str> {
    let axis = part.as_axis().or(part.as_angle_axis()).map(|(whole, _)| whole);
    axis.or_else(|| part.as_label().map(|(whole, _)| whole))
}

/// The states with a name: one state, or the axes of a vector or an angle.
///
/// # Errors
/// [`CatalogError::NoState`], [`CatalogError::Axis`].
pub fn states_of(view: &MapView, name: &str) -> Result<Vec<StateId>, CatalogError> {
    let unknown = || CatalogError::NoState { map: view.spec().name.clone(), state: name.chars().take(80).collect() };
    if let Ok(stored) = StateName::stored_or_label(name)
        && view.find(name).is_some()
        && let Some(whole) = whole_of(&stored)
        && view.shape(whole).is_some_and(|(_, shape)| shape.states() > 1)
    {
        return Err(CatalogError::Axis { state: name.to_owned(), whole: whole.to_owned() });
    }
    let (first, shape) = view.shape(name).ok_or_else(unknown)?;
    let count = u32::try_from(shape.states()).unwrap_or(1);
    Ok((first.0..first.0.saturating_add(count)).map(StateId).collect())
}

impl Catalog {
    /// The producers of a map with a name, and with a label if one is given.
    ///
    /// # Errors
    /// [`CatalogError::NoProducer`].
    pub async fn producers_of(
        &self,
        handle: &MapHandle,
        (producer, label): (&str, Option<&str>),
    ) -> Result<BTreeSet<ProducerId>, CatalogError> {
        let (reply, known) = oneshot::channel();
        if !handle.send(Command::ListProducers(reply)) {
            return Err(CatalogError::Stopping);
        }
        let known = known.await.map_err(|_| CatalogError::Stopping)?;
        let is_meant = |key: &ProducerKey| key.producer() == producer && label.is_none_or(|label| key.label() == label);
        let found: BTreeSet<_> = known.iter().filter(|known| is_meant(&known.mark.key)).map(|known| known.id).collect();
        if found.is_empty() {
            let (map, label) = (handle.spec.name.clone(), label.map(shortened));
            return Err(CatalogError::NoProducer { map, producer: shortened(producer), label });
        }
        Ok(found)
    }

    /// Erases something from a map, as a job that continues if the caller goes away.
    pub fn erase(&self, map: &MapName, request: ErasureRequest, caller: &Caller) -> Arc<UpdateJob> {
        let job = self.context.jobs.create(map.clone(), JobCause::Erasure, self.context.clock.now_nanos());
        let (this, map, by, running) = (self.clone(), map.clone(), caller.shown().to_owned(), Arc::clone(&job));
        info!(%map, %request, by, job = job.id, "erasure ordered");
        tidemap_base::task::spawn(async move {
            let erased = this.erase_now(&map, &request, &running).await;
            match &erased {
                Ok(Erased { states, observations }) => {
                    info!(%map, %request, by, job = running.id, states, observations, "erased");
                }
                Err(error) => error!(%map, %request, by, job = running.id, %error, "not erased"),
            }
            running.end_with(erased.map(|_| None).map_err(|error| error.to_string()));
        });
        job
    }

    async fn erase_now(
        &self,
        map: &MapName,
        request: &ErasureRequest,
        job: &UpdateJob,
    ) -> Result<Erased, CatalogError> {
        let open = self.changing.lock().await;
        if !*open {
            return Err(CatalogError::Stopping);
        }
        let old = self.get(map.as_str())?;
        if !old.opened().await {
            return Err(CatalogError::Stopping);
        }
        let (id, spec, view) = (old.id, Arc::clone(&old.spec), old.view());
        if old.shared_uid.is_some() {
            return Err(CatalogError::NotErasedInCluster(map.clone()));
        }
        // From here on, states and producers are only added.
        let states = request.state.as_deref().map(|state| states_of(&view, state)).transpose()?;
        let mut selection = None;
        if let Some(part) = &request.part {
            let producers = match &part.producer {
                Some((producer, label)) => Some(self.producers_of(&old, (producer, label.as_deref())).await?),
                None => None,
            };
            let (from_nanos, to_nanos) = (part.from_nanos, part.to_nanos);
            let states = states.as_ref().map(|states| states.iter().copied().collect());
            selection = Some((Selection { states, producers, from_nanos, to_nanos }, part.forgets));
        }
        job.step("stop the writer");
        job.start(states.as_ref().map_or(0, |states| states.len() as u64), 0);
        let shown = LiveMap::new(Arc::clone(&spec)).publish();
        let (new, endpoints) = MapHandle::with_endpoints((id, None), Arc::clone(&spec), shown, &self.context.clock);
        let new = Arc::new(new);
        self.maps.rcu(|all| {
            let mut maps = ByName::clone(all);
            maps.insert(map.clone(), Arc::clone(&new));
            maps
        });
        old.replace();
        old.stop(Ending::Erasure).await;
        drop((old, view));
        job.step("write again");
        let context = self.context.clone();
        let (erased, restored) = ended(tidemap_base::task::blocking(move || {
            let erased = match &selection {
                Some((selection, forgets)) => context.store.erase_part(id, selection, *forgets),
                None => context.store.erase_states(id, &states.unwrap_or_default()),
            };
            let restored = restore_map(&context, id, &spec, &|_, _| true);
            Ok((erased, restored))
        }))
        .await?;
        match restored {
            Ok(restored) => drop(start_in(endpoints, self.context.clone(), id, restored)?),
            Err(error) => {
                let aside = self.context.store.set_aside().into_iter().find(|map| map.id == id);
                let reason = aside.map(|map| map.reason);
                let map_error = reason.map(|reason| CatalogError::Unavailable { map: map.to_string(), reason });
                self.set_aside(id, map, map_error.as_ref().unwrap_or(&error));
                drop(endpoints);
                erased?;
                return Err(error);
            }
        }
        let erased = erased?;
        let producer = request.part.iter().filter_map(|part| part.producer.as_ref());
        let producer = producer.flat_map(|(producer, label)| [Some(producer), label.as_ref()]).flatten();
        let names: Vec<&str> = request.state.iter().chain(producer).map(String::as_str).collect();
        self.context.jobs.erased(map, &names);
        job.count(erased.states, erased.observations);
        job.states_done.store(erased.states, Ordering::Relaxed);
        Ok(erased)
    }
}
