//! Flows of people, trained on request from the histories of their positions and directions.
//!
//! Invariant: all axes are gathered from one view, so that each detection is complete.

use std::sync::Arc;

use tidemap_answer::{FlowRequest, ModelSubject, ModelUnavailable, train_flow};
use tidemap_ingest::handle::MapHandle;
use tidemap_map::{event::StateShape, ids::StateId, view::MapView};
use tidemap_model::{Sample, StopSignal, models::FlowModel, selector::ModelKind};
use tidemap_proto::convert::query::FlowSource;

use super::{LearnedState, ModelTrainer};
use crate::{
    lookup::find_state,
    model_cache::{FlowKey, TrainingStop},
    permits::run_blocking,
    status::{Problem, RpcError},
};

impl ModelTrainer {
    /// The flow of a source in a field of the request, from the cache or trained now.
    ///
    /// # Errors
    /// The states do not fit; [`RpcError::ModelUnavailable`] if there can be no flow; others if the readings cannot be
    /// read.
    pub(crate) async fn flow(
        self: &Arc<Self>,
        handle: &Arc<MapHandle>,
        view: &Arc<MapView>,
        (field, source): (&str, &FlowSource),
    ) -> Result<Arc<FlowModel>, RpcError> {
        let places = plane(view, &format!("{field}.state"), &source.state, false)?;
        let motions = plane(view, &format!("{field}.motion_state"), &source.motion_state, true)?;
        let learned = |id: StateId| LearnedState::new(Arc::clone(handle), Arc::clone(view), id.into());
        let axes = [places, StateId(places.0 + 1), motions, StateId(motions.0 + 1)].map(learned);
        let flow_error = |error| flow_error(error, &source.state, &source.motion_state);
        for axis in &axes {
            self.check(axis, ModelKind::default()).map_err(flow_error)?;
            if axis.observations() == 0 {
                return Err(flow_error(axis.unavailable(ModelKind::default(), ModelUnavailable::Unlearned)));
            }
        }
        let plane_of = |corner: &[f64]| [0, 1].map(|axis| corner.get(axis).copied().unwrap_or_default());
        let region_m = source.region.as_ref().map(|region| [plane_of(&region.low_m), plane_of(&region.high_m)]);
        let request = FlowRequest { region_m, edge_m: source.edge_m, directions: source.directions };
        let key = FlowKey::new(handle.id, handle.number, view.generation(), [places, motions], &request);
        let this = Arc::clone(self);
        let train = move |stop| async move { this.train_flow(&axes, request, stop).await };
        self.flows.train_once(key, train).await.map_err(flow_error)
    }

    async fn train_flow(
        &self,
        axes: &[Arc<LearnedState>; 4],
        request: FlowRequest,
        stop: Arc<TrainingStop>,
    ) -> Result<FlowModel, RpcError> {
        let permit = self.slow_permits.take().await?;
        let mut samples: Vec<Arc<[Sample]>> = Vec::with_capacity(axes.len());
        for axis in axes {
            samples.push(self.gather(axis, ModelKind::default(), &stop).await?);
        }
        let handle = Arc::clone(&axes[0].handle);
        let train = move || {
            let is_set = || stop.is_set();
            let [x, y, along, across] = [0, 1, 2, 3].map(|axis: usize| &*samples[axis]);
            train_flow(&request, [x, y], [along, across], &handle.spec, StopSignal::new(&is_set))
        };
        let trained = run_blocking(permit, train).await?;
        trained.map_err(|reason| axes[2].unavailable(ModelKind::default(), reason))
    }
}

/// The first of the two axes in the plane of a vector, or of an angle.
fn plane(view: &MapView, field: &str, name: &str, may_be_angle: bool) -> Result<StateId, RpcError> {
    match view.shape(name) {
        Some((first, StateShape::Vector(_))) => Ok(first),
        Some((first, StateShape::Angle)) if may_be_angle => Ok(first),
        Some((_, shape)) => {
            let state = name.to_owned();
            let problem =
                if may_be_angle { Problem::NoDirection { state, shape } } else { Problem::NoVector { state, shape } };
            Err(problem.of(field).into())
        }
        // This returns the error of an unknown name.
        None => find_state(view, name).and_then(|_| Err(RpcError::Stopping)),
    }
}

/// Names the flow in an error of a model; returns other errors unchanged.
fn flow_error(error: RpcError, state: &str, motion_state: &str) -> RpcError {
    match error {
        RpcError::ModelUnavailable { map, reason, .. } => {
            let subject = ModelSubject::Flow { state: state.to_owned(), motion_state: motion_state.to_owned() };
            RpcError::ModelUnavailable { subject, map, reason }
        }
        other => other,
    }
}
