//! Models that are trained on the readings of a state on request, and kept for the next request.
//!
//! Invariant: a model is kept under the generation whose readings it was trained on, so that it never predicts for
//! another generation. Concurrent requests for the same model share one training, which ends without a model when none
//! of them waits any more; no lock is held meanwhile. A failure is not kept.

use std::{
    collections::{BTreeMap, HashMap},
    hash::Hash,
    sync::{
        Arc, Mutex, PoisonError,
        atomic::{AtomicBool, AtomicUsize, Ordering},
    },
};

use tidemap_answer::{CachedModel, FlowRequest};
use tidemap_base::task::NoResult;
use tidemap_map::{history::Subject, ids::StateId};
use tidemap_model::selector::ModelKind;
use tidemap_store::MapId;
use tokio::sync::OnceCell;

#[cfg(test)]
mod tests;

/// Identifies a model.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Hash)]
pub(crate) struct ModelKey {
    pub map: MapId,
    /// The number of the map's handle: an erasure gives states other ids.
    pub handle: u64,
    /// The model has learned the updates up to this one.
    pub generation: u64,
    /// The state or cell; for positions, the first axis.
    pub subject: Subject,
    /// The model, with its parameters.
    pub kind: ModelKind,
    /// For models of places: the first axis of the vector that contains the position of each observation.
    pub place: Option<StateId>,
}

/// Identifies a flow.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Hash)]
pub(crate) struct FlowKey {
    pub map: MapId,
    /// The number of the map's handle: an erasure gives states other ids.
    pub handle: u64,
    /// The flow has learned the updates up to this one.
    pub generation: u64,
    /// The first axes of the positions and of the motion.
    pub states: [StateId; 2],
    /// The bits of the corners and of the edge length, if they are given.
    raster: [u64; 5],
    directions: usize,
}

impl FlowKey {
    /// The key of a flow of two vectors.
    pub(crate) fn new(map: MapId, handle: u64, generation: u64, states: [StateId; 2], request: &FlowRequest) -> Self {
        let mut raster = [f64::NAN.to_bits(); 5];
        let corners = request.region_m.iter().flat_map(|corners| corners.as_flattened());
        // Adding 0 makes -0 a 0.
        raster.iter_mut().zip(corners).for_each(|(bits, coordinate)| *bits = (coordinate + 0.0).to_bits());
        raster[4] = request.edge_m.map_or(raster[4], f64::to_bits);
        Self { map, handle, generation, states, raster, directions: request.directions }
    }
}

/// A slot for a model, with the number of requests that wait for it.
#[derive(Debug)]
struct CacheEntry<T> {
    model: OnceCell<Arc<T>>,
    waiting: Arc<AtomicUsize>,
}

impl<T> Default for CacheEntry<T> {
    fn default() -> Self {
        Self { model: OnceCell::new(), waiting: Arc::default() }
    }
}

/// A model, after it has been trained.
type CacheSlot<T> = Arc<CacheEntry<T>>;

/// Counts a request that waits for a model, until it is dropped.
#[derive(Debug)]
struct TrainingInterest<T> {
    slot: CacheSlot<T>,
}

impl<T> TrainingInterest<T> {
    /// The signal for one training of the model that no request waits for it any more.
    fn training_stop(&self) -> TrainingStop {
        TrainingStop { waiting: Arc::clone(&self.slot.waiting), is_over: AtomicBool::new(false) }
    }
}

impl<T> Drop for TrainingInterest<T> {
    fn drop(&mut self) {
        self.slot.waiting.fetch_sub(1, Ordering::Relaxed);
    }
}

/// Ends the training when no request waits for the model.
#[derive(Debug)]
pub(crate) struct TrainingStop {
    waiting: Arc<AtomicUsize>,
    /// Once the training has seen the stop, it returns nothing, even if the model is requested again: that request
    /// trains it anew.
    is_over: AtomicBool,
}

impl TrainingStop {
    /// Whether no request waits any more, or none did at an earlier call.
    pub(crate) fn is_set(&self) -> bool {
        if self.waiting.load(Ordering::Relaxed) == 0 {
            self.is_over.store(true, Ordering::Relaxed);
        }
        self.is_over.load(Ordering::Relaxed)
    }
}

/// The trained models of all maps: models of states, of positions, or of flows.
#[derive(Debug)]
pub(crate) struct ModelCache<T = CachedModel, K = ModelKey> {
    max: usize,
    // The entries have a lock, because a lookup changes the last use of a model; it is never held during training.
    entries: Mutex<CacheEntries<T, K>>,
}

#[derive(Debug)]
struct CacheEntries<T, K> {
    slots: HashMap<K, (CacheSlot<T>, u64)>,
    /// The keys of `slots` by their last use, oldest first.
    by_use: BTreeMap<u64, K>,
    uses: u64,
}

impl<T, K: Copy + Eq + Hash> ModelCache<T, K> {
    /// Keeps at most `max` models, at least one, besides those that are being trained.
    pub(crate) fn new(max: usize) -> Self {
        let max = max.max(1);
        Self { max, entries: Mutex::new(CacheEntries { slots: HashMap::new(), by_use: BTreeMap::new(), uses: 0 }) }
    }

    /// The model, if it is in the cache.
    pub(crate) fn get(&self, key: &K) -> Option<Arc<T>> {
        self.with_entries(|entries| entries.used(key)?.model.get().cloned())
    }

    /// The model: from the cache, from a training that is running, or from `train`, which receives the signal to stop.
    /// The training has a task of its own: if this request is dropped, others may wait for the same model; it stops
    /// when none waits.
    ///
    /// # Errors
    /// The error of the training, or [`NoResult`] if the training panicked. Other requests that wait for the model then
    /// train it themselves.
    pub(crate) async fn train_once<E, F>(
        self: &Arc<Self>,
        key: K,
        train: impl FnOnce(Arc<TrainingStop>) -> F + Send + 'static,
    ) -> Result<Arc<T>, E>
    where
        T: Send + Sync + 'static,
        K: Send + Sync + 'static,
        E: From<NoResult> + Send + 'static,
        F: Future<Output = Result<T, E>> + Send,
    {
        if let Some(model) = self.get(&key) {
            return Ok(model);
        }
        let interest = self.interest(key);
        let (this, stop) = (Arc::clone(self), Arc::new(interest.training_stop()));
        let task = tidemap_base::task::spawn(async move { this.get_or_train(key, train(stop)).await });
        let trained = task.await?;
        drop(interest);
        trained
    }

    /// Counts a request for a model until the interest is dropped; without any request, the training ends.
    fn interest(&self, key: K) -> TrainingInterest<T> {
        let slot = self.with_entries(|entries| entries.slot(key, self.max));
        slot.waiting.fetch_add(1, Ordering::Relaxed);
        TrainingInterest { slot }
    }

    /// The model: from the cache, from a training that is running, or from `training`.
    ///
    /// # Errors
    /// The error of `training`. Other requests that wait for the model then train it themselves.
    async fn get_or_train<E>(&self, key: K, training: impl Future<Output = Result<T, E>>) -> Result<Arc<T>, E> {
        let slot = self.with_entries(|entries| entries.slot(key, self.max));
        let trained = slot.model.get_or_try_init(|| async { training.await.map(Arc::new) }).await.cloned();
        if trained.is_err() {
            self.with_entries(|entries| entries.forget(&key, &slot));
        }
        trained
    }

    fn with_entries<R>(&self, work: impl FnOnce(&mut CacheEntries<T, K>) -> R) -> R {
        work(&mut self.entries.lock().unwrap_or_else(PoisonError::into_inner))
    }
}

impl<T, K: Copy + Eq + Hash> CacheEntries<T, K> {
    /// An existing slot, which becomes the last used one.
    fn used(&mut self, key: &K) -> Option<CacheSlot<T>> {
        let (slot, last_use) = self.slots.get_mut(key)?;
        self.uses += 1;
        self.by_use.remove(last_use);
        self.by_use.insert(self.uses, *key);
        *last_use = self.uses;
        Some(Arc::clone(slot))
    }

    /// The slot of a key, which becomes the last used one; if there is no room, the least recently used slots are
    /// removed.
    fn slot(&mut self, key: K, max: usize) -> CacheSlot<T> {
        if let Some(slot) = self.used(&key) {
            return slot;
        }
        while self.slots.len() >= max {
            let Some(&last_use) = self.by_use.iter().find(|(_, key)| !self.is_in_flight(key)).map(|(at, _)| at) else {
                break;
            };
            if let Some(key) = self.by_use.remove(&last_use) {
                self.slots.remove(&key);
            }
        }
        self.uses += 1;
        let slot = CacheSlot::default();
        self.slots.insert(key, (Arc::clone(&slot), self.uses));
        self.by_use.insert(self.uses, key);
        slot
    }

    /// Whether a request waits for the model: if its slot were removed, the next request would train it again.
    fn is_in_flight(&self, key: &K) -> bool {
        self.slots.get(key).is_some_and(|(slot, _)| !slot.model.initialized() && Arc::strong_count(slot) > 1)
    }

    /// Removes a slot that has no model.
    fn forget(&mut self, key: &K, slot: &CacheSlot<T>) {
        let is_empty = |(kept, _): &(CacheSlot<T>, u64)| Arc::ptr_eq(kept, slot) && !kept.model.initialized();
        if self.slots.get(key).is_some_and(is_empty)
            && let Some((_, last_use)) = self.slots.remove(key)
        {
            self.by_use.remove(&last_use);
        }
    }
}
