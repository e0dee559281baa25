//! Trains models on the readings of a state or a cell, for the requests that need them.
//!
//! A request takes one view, and a permit before it computes. The view itself answers at once with the models `auto`,
//! `mean`, `latest` and `spectral`. All other models are trained on request:
//!
//! ```text
//! the model cache ([`crate::model_cache`])   by map, generation, state, and model with its parameters
//!   │ not cached: a permit to train          separate from the permits to predict; slow models have their own
//!   ▼
//! the readings ([`super::readings`])         history files, then history that no save has stored yet, of the
//!   │                                        generations up to the view's
//!   ▼
//! training, on a blocking thread             the result is cached; the least recently used model goes
//! ```
//!
//! - **Trained on what updates have learned**, never on pending observations. The order of the readings, and so the
//!   model, is the same whether they are in files or not. Only persistence takes the newest value too, as `latest`
//!   does.
//! - **Trained once.** Concurrent requests for a model share one training. It goes on as long as one of them waits;
//!   when all are dropped, it stops and gives its permit back.
//! - **Unavailable is an answer.** A model that cannot be trained (no history, too many readings, another kind of
//!   value) is an error of `PredictStates`; in `EvaluateStates` its row is missing, and the reply has the reason.
//!
//! Invariant: a model is trained on exactly the observations that the view's updates have learned, so that a comparison
//! with pending observations is one with unseen data. Training has its own permits: predictions do not wait for it.

use std::{ops::Range, sync::Arc};

use tidemap_answer::{CachedModel, ModelSubject, ModelUnavailable, PlaceModel, PositionModel, StateOrCell};
use tidemap_base::shares::{Share, ShareFull, Shares, Taken, client::Client};
use tidemap_grid::spec::Retention;
use tidemap_ingest::{catalog::Catalog, handle::MapHandle};
use tidemap_map::{
    history::{Reading, Subject},
    ids::StateId,
    row_samples::RequestedReadings,
    view::MapView,
};
use tidemap_model::{Sample, StopSignal, catalogue::TrainingCost, models::FlowModel, selector::ModelKind};
use tokio::sync::OnceCell;

use super::readings::{ReadingsQuery, gather, not_replaced, read, retention};
use crate::{
    lookup::check_limit,
    model_cache::{FlowKey, ModelCache, ModelKey, TrainingStop},
    permits::{Permits, processors, run_blocking, run_while_awaited},
    status::RpcError,
};

mod flows;
mod positions;

/// Maximum number of flows in the cache: a large one takes 80 MB.
const FLOWS_MAX: usize = 8;

/// Trains models, or takes them from the cache.
#[derive(Debug)]
pub(super) struct ModelTrainer {
    catalog: Arc<Catalog>,
    models: Arc<ModelCache>,
    /// The cache of models of positions.
    positions: Arc<ModelCache<PositionModel>>,
    /// The cache of models of states by place.
    places: Arc<ModelCache<PlaceModel>>,
    /// The cache of flows.
    flows: Arc<ModelCache<FlowModel, FlowKey>>,
    /// Permits to gather readings and to train, separate from those to predict.
    permits: Permits,
    /// Permits for models whose training may take seconds, so that others do not wait for them.
    slow_permits: Permits,
    /// Permits to train several models of a state: the holder keeps the readings from the first to the last model.
    comparing_permits: Permits,
    max_readings: u64,
    shares: Shares,
}

/// A state or cell of one view, and the readings that the view's updates have learned, after they are gathered.
#[derive(Debug)]
pub(super) struct LearnedState {
    handle: Arc<MapHandle>,
    view: Arc<MapView>,
    target: StateOrCell,
    samples: OnceCell<Arc<[Sample]>>,
}

impl LearnedState {
    pub(super) fn new(handle: Arc<MapHandle>, view: Arc<MapView>, target: StateOrCell) -> Arc<Self> {
        Arc::new(Self { handle, view, target, samples: OnceCell::new() })
    }

    fn observations(&self) -> u64 {
        self.target.learned(&self.view)
    }

    /// The samples that observations represent. There are at most `max`.
    fn samples_of(&self, kind: ModelKind, observed: Vec<Reading>, max: u64) -> Result<Arc<[Sample]>, RpcError> {
        let mut readings = observed;
        if let StateOrCell::State(id) = self.target {
            let at_most = usize::try_from(max).unwrap_or(usize::MAX).saturating_add(1);
            let requested = RequestedReadings { within_nanos: i64::MIN..i64::MAX, at_most };
            readings = self.view.learned_readings(id, readings, &requested);
        }
        match lacking(readings.len() as u64, max) {
            Some(reason) => Err(self.unavailable(kind, reason)),
            None => Ok(self.target.samples(&self.view, readings).into()),
        }
    }

    /// The key of a model of this state or cell. `place` is the first axis of the place, for a model by place.
    fn key(&self, kind: ModelKind, place: Option<StateId>) -> ModelKey {
        let (map, handle, generation) = (self.handle.id, self.handle.number, self.view.generation());
        ModelKey { map, handle, generation, subject: self.target.subject(), kind, place }
    }

    fn unavailable(&self, model: ModelKind, reason: impl Into<ModelUnavailable>) -> RpcError {
        RpcError::ModelUnavailable {
            subject: ModelSubject::State { model, state: self.target.name(&self.view).into_owned() },
            map: self.handle.spec.name.as_str().to_owned(),
            reason: reason.into(),
        }
    }
}

impl ModelTrainer {
    /// Creates a trainer that limits the caches to `max_trained` models, and a training to `max_readings` readings. The
    /// models that requests hold take from these shares.
    pub(super) fn new(catalog: Arc<Catalog>, max_trained: usize, max_readings: u64, shares: Shares) -> Self {
        // The other half of the processors stays free.
        let slow_permits = Permits::new((processors() / 2).max(1));
        let (permits, comparing_permits) = (Permits::default(), Permits::default());
        Self {
            catalog,
            models: Arc::new(ModelCache::new(max_trained)),
            positions: Arc::new(ModelCache::new(max_trained)),
            places: Arc::new(ModelCache::new(max_trained)),
            flows: Arc::new(ModelCache::new(max_trained.min(FLOWS_MAX))),
            permits,
            slow_permits,
            comparing_permits,
            max_readings,
            shares,
        }
    }

    /// Several models of a state, each as from [`ModelTrainer::trained`], from readings that are gathered once.
    ///
    /// # Errors
    /// The readings cannot be read, or no permit was free in time.
    pub(super) async fn all_trained(
        self: &Arc<Self>,
        learned: &Arc<LearnedState>,
        kinds: impl Iterator<Item = ModelKind>,
    ) -> Result<Vec<Result<Arc<CachedModel>, ModelUnavailable>>, RpcError> {
        let mut kinds = kinds.peekable();
        let mut models = Vec::new();
        if kinds.peek().is_none() {
            return Ok(models);
        }
        let _permit = self.comparing_permits.take().await?;
        for kind in kinds {
            models.push(match self.trained(learned, kind).await {
                Ok(trained) => Ok(trained),
                Err(RpcError::ModelUnavailable { reason, .. }) => Err(reason),
                Err(error) => return Err(error),
            });
        }
        Ok(models)
    }

    /// The model of a state, from the cache or trained now.
    ///
    /// # Errors
    /// [`RpcError::ModelUnavailable`] if there can be no such model; others if the readings cannot be read.
    pub(super) async fn trained(
        self: &Arc<Self>,
        learned: &Arc<LearnedState>,
        kind: ModelKind,
    ) -> Result<Arc<CachedModel>, RpcError> {
        self.check(learned, kind)?;
        let key = learned.key(kind, None);
        if learned.observations() == 0 {
            return Ok(Arc::new(CachedModel::Unlearned));
        }
        let (this, learned) = (Arc::clone(self), Arc::clone(learned));
        self.models.train_once(key, move |stop| async move { this.train(&learned, kind, stop).await }).await
    }

    /// The readings that the observations of states represent within an interval, learned or pending: a list per state,
    /// ascending by time.
    ///
    /// # Errors
    /// The map keeps no history, or it cannot be read; too many readings.
    pub(super) async fn readings(
        &self,
        handle: &Arc<MapHandle>,
        view: &Arc<MapView>,
        states: &[StateId],
        within_nanos: Range<i64>,
    ) -> Result<Vec<Vec<Reading>>, RpcError> {
        let mut found = Vec::with_capacity(states.len());
        let mut left = self.max_readings;
        for &state in states {
            let subject = Subject::State(state);
            if retention(&handle.spec, subject).is_none() {
                let map = handle.spec.name.as_str().to_owned();
                return Err(RpcError::NoHistory { map, what: "states", option: "a retention" });
            }
            let enough = usize::try_from(left).unwrap_or(usize::MAX);
            let wanted = ReadingsQuery { subject, within_nanos: view.rows_about(state, &within_nanos), enough };
            let tail = read(handle, &wanted).await?;
            let history = self.catalog.context().store.history(handle.id)?.before(tail.stored_before);
            let (permit, handle) = (self.permits.take().await?, Arc::clone(handle));
            let requested = RequestedReadings { within_nanos: within_nanos.clone(), at_most: enough.saturating_add(1) };
            let (view, max) = (Arc::clone(view), self.max_readings);
            let check = move |readings: &[Reading]| {
                let got = (max - left).saturating_add(readings.len() as u64);
                check_limit("readings of the locations", got, max, "setting max_training_readings")
            };
            let read = move |stop: StopSignal<'_>| {
                let rows = gather(&history, &handle.spec, tail, &wanted, stop)?;
                check(&rows)?;
                let readings = view.observed_readings(state, rows, &requested);
                check(&readings)?;
                Ok::<_, RpcError>(readings)
            };
            let readings = run_while_awaited(permit, None, read).await??;
            left -= readings.len() as u64;
            found.push(readings);
        }
        Ok(found)
    }

    /// Reserves room for the models that a request holds, none yet.
    ///
    /// # Errors
    /// [`RpcError::Share`] if all requests together, or those of the client, would hold too many.
    pub(super) fn reserve(&self) -> Result<Taken, ShareFull> {
        self.shares.take(Share::TrainedModels, &Client::current(), 0)
    }

    /// Checks the conditions that need no observation to be read.
    fn check(&self, learned: &LearnedState, kind: ModelKind) -> Result<(), RpcError> {
        let retention = retention(&learned.handle.spec, learned.target.subject());
        let retention = retention.ok_or_else(|| {
            let option = if matches!(learned.target, StateOrCell::Cell(_)) { "grid retention" } else { "retention" };
            learned.unavailable(kind, ModelUnavailable::NotKept { option })
        })?;
        ModelUnavailable::check(&learned.target, &learned.view, kind)
            .map_err(|reason| learned.unavailable(kind, reason))?;
        // With a shorter retention fewer observations may be left.
        let (got, max) = (learned.observations(), self.max_readings);
        if retention == Retention::Forever && got > max {
            return Err(learned.unavailable(kind, ModelUnavailable::TooMany { got, max }));
        }
        Ok(())
    }

    async fn train(
        &self,
        learned: &Arc<LearnedState>,
        kind: ModelKind,
        stop: Arc<TrainingStop>,
    ) -> Result<CachedModel, RpcError> {
        let is_slow = kind.cost() == Some(TrainingCost::High);
        let permit = if is_slow { self.slow_permits.take().await? } else { self.permits.take().await? };
        let samples = learned.samples.get_or_try_init(|| self.gather(learned, kind, &stop)).await?;
        let (samples, handle) = (Arc::clone(samples), Arc::clone(&learned.handle));
        let state_kind = learned.target.kind(&learned.view);
        let train = move || {
            let is_set = || stop.is_set();
            CachedModel::train(kind, state_kind, &samples, &handle.spec, StopSignal::new(&is_set))
        };
        let trained = run_blocking(permit, train).await?;
        trained.map_err(|error| learned.unavailable(kind, error))
    }

    /// The readings of a state that the view's updates have learned, ascending by time.
    async fn gather(
        &self,
        learned: &Arc<LearnedState>,
        kind: ModelKind,
        stop: &Arc<TrainingStop>,
    ) -> Result<Arc<[Sample]>, RpcError> {
        let subject = learned.target.subject();
        let enough = usize::try_from(self.max_readings).unwrap_or(usize::MAX);
        // The query excludes pending observations, and does not wait for a running update.
        let mut tail = read(&learned.handle, &ReadingsQuery { subject, within_nanos: 0..0, enough }).await?;
        let generation = learned.view.generation();
        // An update may have ended since the view was taken.
        tail.unsaved.retain(|piece| piece.generation <= generation);
        tail.pending.clear();
        let before = tail.stored_before.min(generation + 1);
        let history = self.catalog.context().store.history(learned.handle.id)?.before(before);
        let wanted = ReadingsQuery { subject, within_nanos: i64::MIN..i64::MAX, enough };
        let learned = Arc::clone(learned);
        let max = self.max_readings;
        let stop = Arc::clone(stop);
        let gather = move || {
            let is_set = || stop.is_set();
            let readings = gather(&history, &learned.handle.spec, tail, &wanted, StopSignal::new(&is_set))?;
            not_replaced(&learned.handle)?;
            match lacking(readings.len() as u64, max) {
                Some(reason) => Err(learned.unavailable(kind, reason)),
                None => learned.samples_of(kind, readings, max),
            }
        };
        tidemap_base::task::blocking(gather).await?
    }
}

/// The reason why a model cannot be trained on `kept` readings, if at most `max` are allowed.
fn lacking(kept: u64, max: u64) -> Option<ModelUnavailable> {
    match kept {
        _ if kept > max => Some(ModelUnavailable::TooMany { got: kept, max }),
        0 => Some(ModelUnavailable::Forgotten),
        _ => None,
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_model_is_trained_on_everything_or_to_what_the_map_is_to_keep() {
        assert_eq!(lacking(5, 5), None);
        assert_eq!(lacking(0, 5), Some(ModelUnavailable::Forgotten));
        assert_eq!(lacking(6, 5), Some(ModelUnavailable::TooMany { got: 6, max: 5 }));
    }
}
