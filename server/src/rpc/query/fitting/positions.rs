//! Models of positions, fitted like those of states.
//!
//! Invariant: all axes are gathered from one view, so that each position is complete.

use std::sync::Arc;

use tidemap_map::selector::ModelKind;
use tidemap_model::{Sample, StopSignal};

use super::{LearnedState, ModelFitter};
use crate::{
    model_cache::{FitStop, ModelKey, ModelUnavailable, PositionModel},
    rpc::{permits::run_blocking, status::RpcError},
};

impl ModelFitter {
    /// The model of a vector with these axes, from the cache or fitted now.
    ///
    /// # Errors
    /// [`RpcError::ModelUnavailable`] if there can be no such model; others if the readings cannot be read.
    pub(in crate::rpc::query) async fn position_model(
        self: &Arc<Self>,
        axes: Vec<Arc<LearnedState>>,
        kind: ModelKind,
    ) -> Result<Arc<PositionModel>, RpcError> {
        let first = axes.first().ok_or(RpcError::Stopping)?;
        self.check(first, kind)?;
        if first.observations() == 0 {
            return Err(first.unavailable(kind, ModelUnavailable::Unlearned));
        }
        let (map, generation, subject) = (first.handle.id, first.view.generation(), first.of.subject());
        let key = ModelKey { map, generation, subject, kind };
        if let Some(model) = self.positions.get(&key) {
            return Ok(model);
        }
        let this = Arc::clone(self);
        let interest = self.positions.interest(key);
        let stop = Arc::new(interest.fit_stop());
        // A task of its own: if this request is dropped, others may wait for the same model.
        let fit = async move { this.positions.get_or_fit(key, this.fit_positions(&axes, kind, stop)).await };
        let fitted = tokio::spawn(fit).await.map_err(|_| RpcError::Stopping)?;
        drop(interest);
        fitted
    }

    async fn fit_positions(
        &self,
        axes: &[Arc<LearnedState>],
        kind: ModelKind,
        stop: Arc<FitStop>,
    ) -> Result<PositionModel, RpcError> {
        let first = axes.first().ok_or(RpcError::Stopping)?;
        let options = PositionModel::options(kind).ok_or(RpcError::Stopping)?;
        let permit = self.slow_permits.take().await?;
        let mut samples: Vec<Arc<[Sample]>> = Vec::with_capacity(axes.len());
        for axis in axes {
            samples.push(self.gather(axis, kind, &stop).await?);
        }
        let handle = Arc::clone(&first.handle);
        let fit = move || {
            let is_set = || stop.is_set();
            PositionModel::fit(&options, &samples, &handle.spec, StopSignal::new(&is_set))
        };
        let fitted = run_blocking(permit, fit).await?;
        fitted.map_err(|error| first.unavailable(kind, error))
    }
}
