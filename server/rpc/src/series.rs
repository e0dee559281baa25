//! Probabilities of states at times, by any model.
//!
//! Invariant: a row per state, with one probability per time, in [0, 1].

use std::sync::Arc;

use tidemap_answer::{CachedModel, ModelSubject, ModelUnavailable, StateOrCell};
use tidemap_ingest::handle::MapHandle;
use tidemap_map::{ids::StateId, predict::PreparedTimes, view::MapView};
use tidemap_model::{
    EarlyStop, StopSignal,
    models::Moment,
    selector::{ModelKind, ModelSelector},
};

use super::{
    lookup::check_limit,
    permits::{Permits, run_while_awaited},
    status::RpcError,
    training::{LearnedState, ModelTrainer},
};

/// Number of times whose phasors are held at once.
const TIMES_PER_BLOCK: usize = 4096;
/// Number of times at which a trained model predicts between two checks of the stop signal: the slowest model takes
/// some 0.1 ms for one time.
pub(super) const TRAINED_TIMES: usize = 256;

/// The context of a prediction for a plan.
#[derive(Clone, Copy, Debug)]
pub(super) struct PredictContext<'a> {
    pub trainer: &'a Arc<ModelTrainer>,
    pub permits: &'a Permits,
    /// Maximum number of predictions of one request.
    pub predictions: u64,
}

/// Checks that states or cells support a model that updates publish.
///
/// # Errors
/// The error of the first state or cell that does not.
pub(super) fn check_published<'a>(
    view: &MapView,
    subjects: impl IntoIterator<Item = &'a StateOrCell>,
    kind: ModelKind,
) -> Result<(), RpcError> {
    subjects.into_iter().try_for_each(|subject| {
        ModelUnavailable::check(subject, view, kind).map_err(|reason| RpcError::ModelUnavailable {
            subject: ModelSubject::State { model: kind, state: subject.name(view).into_owned() },
            map: view.spec().name.as_str().to_owned(),
            reason,
        })
    })
}

/// Probabilities that the states or cells are 1 at the times.
///
/// # Errors
/// Too many predictions, or a model cannot be trained.
pub(super) async fn predict_series(
    context: PredictContext<'_>,
    handle: &Arc<MapHandle>,
    view: &Arc<MapView>,
    (states, times_nanos): (Vec<impl Into<StateOrCell>>, Vec<i64>),
    selector: ModelSelector,
) -> Result<Vec<Vec<f64>>, RpcError> {
    let states: Vec<StateOrCell> = states.into_iter().map(Into::into).collect();
    let predictions = states.len() as u64 * times_nanos.len() as u64;
    check_limit("predictions", predictions, context.predictions, "setting max_predictions")?;
    if !selector.kind.needs_readings() {
        check_published(view, &states, selector.kind)?;
        let view = Arc::clone(view);
        let predict = move |stop: StopSignal<'_>| {
            let mut rows = vec![Vec::with_capacity(times_nanos.len()); states.len()];
            for block in times_nanos.chunks(TIMES_PER_BLOCK) {
                let prepared = view.prepare(block);
                for (state, row) in states.iter().zip(&mut rows) {
                    stop.check()?;
                    let from = row.len();
                    row.resize(from + block.len(), 0.0);
                    state.predict_into(&view, &prepared, selector, &mut row[from..]);
                }
            }
            Ok::<_, EarlyStop>(rows)
        };
        return Ok(run_while_awaited(context.permits.take().await?, None, predict).await??);
    }
    let moments: Arc<[_]> = view.moments(&times_nanos).into();
    let mut rows = Vec::with_capacity(states.len());
    for state in states {
        let learned = LearnedState::new(Arc::clone(handle), Arc::clone(view), state.clone());
        let trained = context.trainer.trained(&learned, selector.kind).await?;
        let (view, moments) = (Arc::clone(view), Arc::clone(&moments));
        let predict = move |stop: StopSignal<'_>| {
            let mut row = vec![0.0; moments.len()];
            for (moments, row) in moments.chunks(TRAINED_TIMES).zip(row.chunks_mut(TRAINED_TIMES)) {
                stop.check()?;
                trained.predict_into(&view, &state, moments, selector, row);
            }
            Ok::<_, EarlyStop>(row)
        };
        rows.push(run_while_awaited(context.permits.take().await?, None, predict).await??);
    }
    Ok(rows)
}

/// Predicts states at any time, one after the other.
#[derive(Debug)]
pub(super) struct Predictor {
    view: Arc<MapView>,
    states: Vec<StateId>,
    selector: ModelSelector,
    /// Trained models, one per state; empty if none is needed.
    trained: Vec<Arc<CachedModel>>,
}

impl Predictor {
    /// # Errors
    /// A model cannot be trained.
    pub(super) async fn new(
        context: PredictContext<'_>,
        handle: &Arc<MapHandle>,
        view: &Arc<MapView>,
        states: Vec<StateId>,
        selector: ModelSelector,
    ) -> Result<Predictor, RpcError> {
        let mut trained = Vec::new();
        if selector.kind.needs_readings() {
            for &id in &states {
                let learned = LearnedState::new(Arc::clone(handle), Arc::clone(view), id.into());
                trained.push(context.trainer.trained(&learned, selector.kind).await?);
            }
        }
        Ok(Predictor { view: Arc::clone(view), states, selector, trained })
    }

    /// Probability that a state, by its index, is 1 at a time in nanoseconds UTC.
    pub(super) fn at(&self, index: usize, time_nanos: i64) -> f64 {
        if self.trained.is_empty() {
            return self.at_prepared(index, &self.view.prepare(&[time_nanos]));
        }
        self.at_moments(index, &self.view.moments(&[time_nanos]), None)
    }

    /// Probability that a state, by its index, is 1 at the first of prepared times.
    pub(super) fn at_prepared(&self, index: usize, times: &PreparedTimes) -> f64 {
        self.at_moments(index, times.moments(), Some(times))
    }

    fn at_moments(&self, index: usize, moments: &[Moment], times: Option<&PreparedTimes>) -> f64 {
        let Some(&id) = self.states.get(index) else { return 0.0 };
        let mut row = vec![0.0; moments.len()];
        match (self.trained.get(index), times) {
            (Some(trained), _) => trained.predict_into(&self.view, &id.into(), moments, self.selector, &mut row),
            (None, Some(times)) => self.view.predict_into(id, times, self.selector, &mut row),
            (None, None) => {}
        }
        row.first().copied().unwrap_or_default()
    }
}
