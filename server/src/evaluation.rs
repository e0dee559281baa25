//! Compares the predictions of models with observations that are not learned.
//!
//! Invariant: only sums are kept, so that memory does not depend on the number of observations.

use std::{
    borrow::Cow,
    collections::{HashMap, HashSet, hash_map::Entry},
    sync::Arc,
};

use tidemap_map::{
    history::Subject,
    ids::StateId,
    predict::PreparedTimes,
    selector::{ModelKind, ModelSelector},
    view::MapView,
};
use tidemap_model::{Evaluation, Sample, direction_rad};

use crate::{model_cache::CachedModel, state_or_cell::StateOrCell};

/// Times whose phasors are held at once.
const TIMES_PER_BLOCK: usize = 1024;

/// What predicts a state where a model must be fitted to its readings.
#[derive(Clone, Debug)]
pub(crate) enum AnswerSource {
    /// The fitted model.
    Fitted(Arc<CachedModel>),
    /// There is no such model, for this reason.
    Nothing(Arc<str>),
}

/// Sums of errors per state and model.
#[derive(Debug)]
pub(crate) struct Evaluator {
    view: Arc<MapView>,
    /// One per row of a state: models without an order of their own stand for all orders.
    rows: Vec<ModelSelector>,
    states: Vec<Subject>,
    /// Why there are no models: many states share few reasons.
    reasons: HashSet<Arc<str>>,
    sums: HashMap<Subject, ErrorSums>,
}

/// The sums of one state, or of an angle, each as long as the rows.
#[derive(Debug)]
struct ErrorSums {
    of: StateOrCell,
    /// What predicts, if not the view.
    answering: Vec<Option<AnswerSource>>,
    /// Of an angle the state of its sine, and what predicts that. The state itself is the cosine.
    sine: Option<(StateId, Vec<Option<AnswerSource>>)>,
    errors: Vec<Evaluation>,
}

impl Evaluator {
    /// Compares these models. A spectral model without an order stands for the orders 0..=`max_order`.
    pub(crate) fn new(view: Arc<MapView>, models: Vec<ModelSelector>, max_order: usize) -> Self {
        let mut rows = Vec::new();
        for model in models {
            if model.kind == ModelKind::Spectral && model.order.is_none() {
                rows.extend((0..=max_order).map(|order| ModelSelector { order: Some(order), ..model }));
            } else {
                rows.push(model);
            }
        }
        Self { view, rows, states: Vec::new(), reasons: HashSet::new(), sums: HashMap::new() }
    }

    /// Number of sums that are kept for each state.
    pub(crate) fn sums_per_state(&self) -> usize {
        self.rows.len()
    }

    /// The model kind of each row that is fitted to the readings of a state, in order.
    pub(crate) fn kinds_to_fit(&self) -> impl Iterator<Item = ModelKind> + use<> {
        let kinds: Vec<_> = self.rows.iter().map(|row| row.kind).filter(|kind| kind.needs_readings()).collect();
        kinds.into_iter()
    }

    /// Whether the state has no sums yet.
    pub(crate) fn is_new(&self, subject: Subject) -> bool {
        !self.sums.contains_key(&subject)
    }

    /// An answer source without a model, for this reason.
    pub(crate) fn nothing(&mut self, reason: &str) -> AnswerSource {
        let known = self.reasons.get(reason).cloned();
        AnswerSource::Nothing(known.unwrap_or_else(|| {
            let reason: Arc<str> = reason.into();
            self.reasons.insert(Arc::clone(&reason));
            reason
        }))
    }

    /// Adds a state with its answer sources, one for each of [`Evaluator::kinds_to_fit`]. No effect if the state is
    /// known.
    pub(crate) fn begin(&mut self, of: StateOrCell, fitted: impl IntoIterator<Item = AnswerSource>) {
        let subject = of.subject();
        if let Entry::Vacant(entry) = self.sums.entry(subject) {
            let answering = by_row(&self.rows, fitted);
            entry.insert(ErrorSums { of, answering, sine: None, errors: vec![Evaluation::default(); self.rows.len()] });
            self.states.push(subject);
        }
    }

    /// Makes a state with its answer sources the sine of an angle whose cosine has just begun: observations are angles.
    pub(crate) fn begin_sine(
        &mut self,
        cosine: StateId,
        sine: StateId,
        fitted: impl IntoIterator<Item = AnswerSource>,
    ) {
        if let Some(sums) = self.sums.get_mut(&Subject::State(cosine)) {
            sums.sine = Some((sine, by_row(&self.rows, fitted)));
        }
    }

    /// Adds observations, grouped by state; `order` lists the states, which must be known.
    pub(crate) fn add(&mut self, order: &[Subject], by_state: &HashMap<Subject, Vec<Sample>>) {
        for subject in order {
            let (Some(samples), Some(sums)) = (by_state.get(subject), self.sums.get_mut(subject)) else { continue };
            for block in samples.chunks(TIMES_PER_BLOCK) {
                let times: Vec<i64> = block.iter().map(|sample| sample.utc_nanos).collect();
                let prepared = self.view.prepare(&times);
                let mut predicted = vec![0.0; block.len()];
                let mut sines = vec![0.0; block.len()];
                let rows = self.rows.iter().zip(&sums.answering).zip(&mut sums.errors).enumerate();
                for (index, ((row, answering), sum)) in rows {
                    if !answer(&self.view, &sums.of, answering.as_ref(), &prepared, *row, &mut predicted) {
                        continue;
                    }
                    if let Some((sine, answering)) = &sums.sine {
                        let answering = answering.get(index).and_then(Option::as_ref);
                        if answer(&self.view, &(*sine).into(), answering, &prepared, *row, &mut sines) {
                            for ((sample, &cos), &sin) in block.iter().zip(&predicted).zip(&sines) {
                                sum.add_angle(direction_rad([cos, sin]), sample.value);
                            }
                        }
                        continue;
                    }
                    for (sample, &probability) in block.iter().zip(&predicted) {
                        sum.add(probability, sample.value);
                    }
                }
            }
        }
    }

    /// The rows: name of the state, model with its order, sums.
    pub(crate) fn rows(&self) -> impl Iterator<Item = (StateOrCell, Cow<'_, str>, ModelSelector, &Evaluation)> {
        self.all().filter(|(.., answering, _)| !matches!(answering, Some(AnswerSource::Nothing(_)))).map(
            |(of, row, _, errors)| {
                let order = Some(of.order(&self.view, *row)).filter(|_| row.kind.has_order());
                (of.clone(), self.name(of), ModelSelector { order, ..*row }, errors)
            },
        )
    }

    /// The missing rows, by model: model, reason, and names of the states.
    pub(crate) fn unavailable(&self) -> Vec<(ModelSelector, &str, Vec<Cow<'_, str>>)> {
        let mut found: Vec<(ModelSelector, &str, Vec<Cow<'_, str>>)> = Vec::new();
        let mut places = HashMap::new();
        for (of, row, answering, _) in self.all() {
            let Some(AnswerSource::Nothing(reason)) = answering else { continue };
            let reason = &**reason;
            let place = *places.entry((*row, reason)).or_insert_with(|| {
                found.push((*row, reason, Vec::new()));
                found.len() - 1
            });
            if let Some((.., states)) = found.get_mut(place) {
                states.push(self.name(of));
            }
        }
        found.sort_by_key(|(row, ..)| self.rows.iter().position(|other| other == row));
        found
    }

    /// All rows by state, with or without a model.
    fn all(&self) -> impl Iterator<Item = (&StateOrCell, &ModelSelector, &Option<AnswerSource>, &Evaluation)> {
        self.states.iter().filter_map(|subject| self.sums.get(subject)).flat_map(|sums| {
            let rows = self.rows.iter().zip(&sums.answering).zip(&sums.errors);
            rows.map(move |((row, answering), errors)| (&sums.of, row, answering, errors))
        })
    }

    fn name(&self, of: &StateOrCell) -> Cow<'_, str> {
        let StateOrCell::State(id) = *of else { return of.name(&self.view) };
        let is_angle = self.sums.get(&of.subject()).is_some_and(|sums| sums.sine.is_some());
        let name = self.view.info(id).map(|info| &info.name);
        let angle = name.filter(|_| is_angle).and_then(|name| name.as_angle_axis()).map(|(angle, _)| angle);
        Cow::Borrowed(angle.or(name.map(|name| name.as_str())).unwrap_or_default())
    }
}

/// The answer source of each row, from those of the rows that are fitted to readings.
fn by_row(rows: &[ModelSelector], fitted: impl IntoIterator<Item = AnswerSource>) -> Vec<Option<AnswerSource>> {
    let mut fitted = fitted.into_iter();
    rows.iter().map(|row| if row.kind.needs_readings() { fitted.next() } else { None }).collect()
}

/// Predicts a state; `false` if there is no model.
fn answer(
    view: &MapView,
    of: &StateOrCell,
    answering: Option<&AnswerSource>,
    prepared: &PreparedTimes,
    row: ModelSelector,
    predicted: &mut [f64],
) -> bool {
    match answering {
        None => of.predict_into(view, prepared, row, predicted),
        Some(AnswerSource::Fitted(fitted)) => fitted.predict_into(view, of, prepared.moments(), row, predicted),
        Some(AnswerSource::Nothing(_)) => return false,
    }
    true
}
