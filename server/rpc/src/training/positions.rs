//! Models of positions, and of states by place, trained like those of states.
//!
//! Invariant: all axes are gathered from one view, so that each position is complete.

use std::sync::Arc;

use tidemap_answer::{ModelUnavailable, PlaceModel, PositionModel};
use tidemap_map::ids::StateId;
use tidemap_model::{Sample, StopSignal, models::CannotTrain, selector::ModelKind};

use super::{LearnedState, ModelTrainer};
use crate::{model_cache::TrainingStop, permits::run_blocking, status::RpcError};

impl ModelTrainer {
    /// The model of a vector with these axes, from the cache or trained now.
    ///
    /// # Errors
    /// [`RpcError::ModelUnavailable`] if there can be no such model; others if the readings cannot be read.
    pub(crate) async fn position_model(
        self: &Arc<Self>,
        axes: Vec<Arc<LearnedState>>,
        kind: ModelKind,
    ) -> Result<Arc<PositionModel>, RpcError> {
        let first = axes.first().ok_or(RpcError::Stopping)?;
        self.check(first, kind)?;
        if first.observations() == 0 {
            return Err(first.unavailable(kind, ModelUnavailable::Unlearned));
        }
        let (key, this) = (first.key(kind, None), Arc::clone(self));
        self.positions.train_once(key, move |stop| async move { this.train_positions(&axes, kind, stop).await }).await
    }

    async fn train_positions(
        &self,
        axes: &[Arc<LearnedState>],
        kind: ModelKind,
        stop: Arc<TrainingStop>,
    ) -> Result<PositionModel, RpcError> {
        let first = axes.first().ok_or(RpcError::Stopping)?;
        let options = kind.hypertime_options().ok_or(RpcError::Stopping)?;
        let permit = self.slow_permits.take().await?;
        let mut samples: Vec<Arc<[Sample]>> = Vec::with_capacity(axes.len());
        for axis in axes {
            samples.push(self.gather(axis, kind, &stop).await?);
        }
        let handle = Arc::clone(&first.handle);
        let train = move || {
            let is_set = || stop.is_set();
            PositionModel::train(&options, &samples, &handle.spec, StopSignal::new(&is_set))
        };
        let trained = run_blocking(permit, train).await?;
        trained.map_err(|error| first.unavailable(kind, error))
    }

    /// The model of a state by the places that a vector with these axes had at the same times.
    ///
    /// # Errors
    /// See [`ModelTrainer::position_model`]; also if the state and the vector have no time in common.
    pub(crate) async fn place_model(
        self: &Arc<Self>,
        learned: Arc<LearnedState>,
        axes: Vec<Arc<LearnedState>>,
        place: StateId,
        kind: ModelKind,
    ) -> Result<Arc<PlaceModel>, RpcError> {
        for state in axes.iter().take(1).chain([&learned]) {
            self.check(state, kind)?;
            if state.observations() == 0 {
                return Err(state.unavailable(kind, ModelUnavailable::Unlearned));
            }
        }
        let (key, this) = (learned.key(kind, Some(place)), Arc::clone(self));
        let train = move |stop| async move { this.train_places(&learned, &axes, kind, stop).await };
        self.places.train_once(key, train).await
    }

    async fn train_places(
        &self,
        learned: &Arc<LearnedState>,
        axes: &[Arc<LearnedState>],
        kind: ModelKind,
        stop: Arc<TrainingStop>,
    ) -> Result<PlaceModel, RpcError> {
        let options = kind.hypertime_options().ok_or(RpcError::Stopping)?;
        let permit = self.slow_permits.take().await?;
        let values = self.gather(learned, kind, &stop).await?;
        let mut samples: Vec<Arc<[Sample]>> = Vec::with_capacity(axes.len());
        for axis in axes {
            samples.push(self.gather(axis, kind, &stop).await?);
        }
        let handle = Arc::clone(&learned.handle);
        let train = move || {
            let is_set = || stop.is_set();
            PlaceModel::train(&options, &values, &samples, &handle.spec, StopSignal::new(&is_set))
        };
        let trained = run_blocking(permit, train).await?;
        trained.map_err(|error| match error {
            CannotTrain::NoReadings => learned.unavailable(kind, ModelUnavailable::NoPlaces),
            error => learned.unavailable(kind, error),
        })
    }
}
