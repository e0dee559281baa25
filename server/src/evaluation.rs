//! How well models tell given observations, which are not learned.
//!
//! Invariant: sums only, so that any number of observations needs a fixed amount of memory per state and model.

use std::{
    collections::{HashMap, HashSet, hash_map::Entry},
    sync::Arc,
};

use tidemap_map::{
    ids::StateId,
    selector::{ModelKind, ModelSelector},
    view::MapView,
};
use tidemap_model::{Evaluation, Sample};

use crate::model_cache::CachedModel;

/// Times whose phasors are held at once.
const TIMES_PER_BLOCK: usize = 1024;

/// What answers for a state where a model has to be fitted to its readings.
#[derive(Clone, Debug)]
pub(crate) enum AnswerSource {
    /// The fitted model.
    Fitted(Arc<CachedModel>),
    /// There is no such model, for this reason.
    Nothing(Arc<str>),
}

/// ErrorSums of errors per state and model.
#[derive(Debug)]
pub(crate) struct Evaluator {
    view: Arc<MapView>,
    /// One per row of a state: kinds without an order of their own are spread over all orders.
    rows: Vec<ModelSelector>,
    states: Vec<StateId>,
    /// Why there are no models: many states share few reasons.
    reasons: HashSet<Arc<str>>,
    sums: HashMap<StateId, ErrorSums>,
}

/// What is known of one state, each as long as the rows.
#[derive(Debug)]
struct ErrorSums {
    /// Who answers, where it is not the view.
    answering: Vec<Option<AnswerSource>>,
    errors: Vec<Evaluation>,
}

impl Evaluator {
    /// Compares these models. A spectral model without an order stands for the orders 0..=`max_order`.
    #[must_use]
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

    /// ErrorSums kept for each state.
    #[must_use]
    pub(crate) fn sums_per_state(&self) -> usize {
        self.rows.len()
    }

    /// The kind of each row that needs a model fitted to the readings of a state, in order.
    pub(crate) fn kinds_to_fit(&self) -> impl Iterator<Item = ModelKind> + use<> {
        let kinds: Vec<_> = self.rows.iter().map(|row| row.kind).filter(|kind| kind.needs_readings()).collect();
        kinds.into_iter()
    }

    /// Whether there is nothing of this state yet.
    #[must_use]
    pub(crate) fn is_new(&self, id: StateId) -> bool {
        !self.sums.contains_key(&id)
    }

    /// That there is no model, for this reason.
    pub(crate) fn nothing(&mut self, reason: &str) -> AnswerSource {
        let known = self.reasons.get(reason).cloned();
        AnswerSource::Nothing(known.unwrap_or_else(|| {
            let reason: Arc<str> = reason.into();
            self.reasons.insert(Arc::clone(&reason));
            reason
        }))
    }

    /// Begins with a state: who answers, for each of [`Evaluator::kinds_to_fit`]. Has no effect on a state that there is.
    pub(crate) fn begin(&mut self, id: StateId, fitted: impl IntoIterator<Item = AnswerSource>) {
        if let Entry::Vacant(entry) = self.sums.entry(id) {
            let mut fitted = fitted.into_iter();
            let answering = self.rows.iter().map(|row| if row.kind.needs_readings() { fitted.next() } else { None });
            entry.insert(ErrorSums {
                answering: answering.collect(),
                errors: vec![Evaluation::default(); self.rows.len()],
            });
            self.states.push(id);
        }
    }

    /// Adds observations, grouped by state; `order` lists the states, with all of which was begun.
    pub(crate) fn add(&mut self, order: &[StateId], by_state: &HashMap<StateId, Vec<Sample>>) {
        for id in order {
            let (Some(samples), Some(sums)) = (by_state.get(id), self.sums.get_mut(id)) else { continue };
            for block in samples.chunks(TIMES_PER_BLOCK) {
                let times: Vec<i64> = block.iter().map(|sample| sample.utc_nanos).collect();
                let prepared = self.view.prepare(&times);
                let mut predicted = vec![0.0; block.len()];
                let rows = self.rows.iter().zip(&sums.answering).zip(&mut sums.errors);
                for ((row, answering), sum) in rows {
                    match answering {
                        None => self.view.predict_into(*id, &prepared, *row, &mut predicted),
                        Some(AnswerSource::Fitted(fitted)) => {
                            let moments = prepared.moments();
                            fitted.predict_into(&self.view, *id, moments, *row, &mut predicted);
                        }
                        Some(AnswerSource::Nothing(_)) => continue,
                    }
                    for (sample, &probability) in block.iter().zip(&predicted) {
                        sum.add(probability, sample.value);
                    }
                }
            }
        }
    }

    /// The rows: name of the state, model with its order, sums.
    pub(crate) fn rows(&self) -> impl Iterator<Item = (&str, ModelSelector, &Evaluation)> {
        self.all().filter(|(.., answering, _)| !matches!(answering, Some(AnswerSource::Nothing(_)))).map(
            |(id, row, _, errors)| {
                let order = Some(row.order_for(self.view.model(id))).filter(|_| row.kind.has_order());
                (self.name(id), ModelSelector { order, ..*row }, errors)
            },
        )
    }

    /// The rows that there are not: model, why, and names of the states, by model.
    #[must_use]
    pub(crate) fn unavailable(&self) -> Vec<(ModelSelector, &str, Vec<&str>)> {
        let mut found: Vec<(ModelSelector, &str, Vec<&str>)> = Vec::new();
        let mut places = HashMap::new();
        for (id, row, answering, _) in self.all() {
            let Some(AnswerSource::Nothing(reason)) = answering else { continue };
            let reason = &**reason;
            let place = *places.entry((*row, reason)).or_insert_with(|| {
                found.push((*row, reason, Vec::new()));
                found.len() - 1
            });
            if let Some((.., states)) = found.get_mut(place) {
                states.push(self.name(id));
            }
        }
        found.sort_by_key(|(row, ..)| self.rows.iter().position(|other| other == row));
        found
    }

    /// All rows by state, whether there is one who answers or not.
    fn all(&self) -> impl Iterator<Item = (StateId, &ModelSelector, &Option<AnswerSource>, &Evaluation)> {
        let of_state = |&id: &StateId| self.sums.get(&id).map(|sums| (id, sums));
        self.states.iter().filter_map(of_state).flat_map(|(id, sums)| {
            let rows = self.rows.iter().zip(&sums.answering).zip(&sums.errors);
            rows.map(move |((row, answering), errors)| (id, row, answering, errors))
        })
    }

    fn name(&self, id: StateId) -> &str {
        self.view.info(id).map_or("", |info| info.name.as_str())
    }
}
