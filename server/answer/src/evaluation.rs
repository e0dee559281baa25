//! Compares the predictions of models with observations that are not learned.
//!
//! Invariant: only sums and the reasons of missing models are kept, so that memory depends neither on the number of
//! observations nor on the number of trained models. Trained models are lent for one addition.

use std::{
    borrow::Cow,
    collections::{HashMap, HashSet, hash_map::Entry},
    sync::Arc,
};

use tidemap_map::{history::Subject, ids::StateId, predict::PreparedTimes, view::MapView};
use tidemap_model::{
    EarlyStop, Evaluation, Sample, StopSignal, direction_rad,
    label_evidence::normalise,
    selector::{ModelKind, ModelSelector},
};

use crate::{CachedModel, ModelUnavailable, StateOrCell};

/// Number of times whose phasors are held at once.
const TIMES_PER_BLOCK: usize = 1024;

/// The source of the predictions of a state, where a model must be trained on its readings.
#[derive(Clone, Debug)]
pub enum AnswerSource {
    /// The trained model.
    Trained(Arc<CachedModel>),
    /// There is no such model, for this reason.
    Nothing(Arc<str>),
}

/// Sums of errors per state and model.
#[derive(Debug)]
pub struct Evaluator {
    view: Arc<MapView>,
    /// One entry per row of a state: a model without an order of its own covers all orders.
    rows: Vec<ModelSelector>,
    states: Vec<Subject>,
    /// The reasons why there are no models: many states share few reasons.
    reasons: HashSet<Arc<str>>,
    sums: HashMap<Subject, ErrorSums>,
}

/// The kind of observations: those of a state, of an angle by cosine and sine, or of a categorical state by all labels.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Compared {
    /// A state of one value.
    Alone,
    /// An angle, by its cosine and sine.
    Angle,
    /// A categorical state, by all its labels.
    Labels,
}

/// The sums of one state, or of an angle or a categorical state, each as long as the rows.
#[derive(Debug)]
struct ErrorSums {
    target: StateOrCell,
    /// The reason why there is no model, once one was missing.
    missing: Vec<Option<Arc<str>>>,
    compared: Compared,
    errors: Vec<Evaluation>,
}

/// Another part of a state with its prediction sources: the sine of an angle, whose state is its cosine, or a label
/// after the first.
#[derive(Clone, Debug)]
pub struct OtherPart {
    /// The state.
    pub state: StateId,
    /// One source for each of [`Evaluator::kinds_to_train`].
    pub trained: Vec<AnswerSource>,
}

impl Evaluator {
    /// Compares these models. A spectral model without an order means the orders 0..=`max_order`.
    pub fn new(view: Arc<MapView>, models: Vec<ModelSelector>, max_order: usize) -> Self {
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
    pub fn sums_per_state(&self) -> usize {
        self.rows.len()
    }

    /// The model kind of each row that is trained on the readings of a state, in order.
    pub fn kinds_to_train(&self) -> impl Iterator<Item = ModelKind> + use<> {
        let kinds: Vec<_> = self.rows.iter().map(|row| row.kind).filter(|kind| kind.needs_readings()).collect();
        kinds.into_iter()
    }

    /// A prediction source without a model, for this reason.
    pub fn nothing(&mut self, reason: &str) -> AnswerSource {
        let known = self.reasons.get(reason).cloned();
        AnswerSource::Nothing(known.unwrap_or_else(|| {
            let reason: Arc<str> = reason.into();
            self.reasons.insert(Arc::clone(&reason));
            reason
        }))
    }

    /// Begins the sums of a state, so that rows have the order of the beginnings. No effect if the state is known.
    pub fn begin(&mut self, target: &StateOrCell, compared: Compared) {
        let subject = target.subject();
        if let Entry::Vacant(entry) = self.sums.entry(subject) {
            let rows = self.rows.len();
            entry.insert(ErrorSums {
                target: target.clone(),
                missing: vec![None; rows],
                compared,
                errors: vec![Evaluation::default(); rows],
            });
            self.states.push(subject);
        }
    }

    /// Adds observations of a state that has begun; `trained` has one prediction source for each of
    /// [`Evaluator::kinds_to_train`]. `others`: the sine of an angle, or all labels but the first, where the
    /// observations are angles or numbers of labels.
    ///
    /// # Errors
    /// The work received the signal to stop; the sums must then not be used.
    pub fn add(
        &mut self,
        subject: Subject,
        samples: &[Sample],
        trained: Vec<AnswerSource>,
        others: Vec<OtherPart>,
        stop: StopSignal<'_>,
    ) -> Result<(), EarlyStop> {
        let Some(target) = self.sums.get(&subject).map(|sums| sums.target.clone()) else { return Ok(()) };
        let mut answering = by_row(&self.rows, trained);
        for (index, answering) in answering.iter_mut().enumerate().filter(|(_, answering)| answering.is_none()) {
            let kind = self.rows.get(index).map_or(ModelKind::Auto, |row| row.kind);
            if let Err(reason) = ModelUnavailable::check(&target, &self.view, kind) {
                *answering = Some(self.nothing(&reason.to_string()));
            }
        }
        let Some(sums) = self.sums.get_mut(&subject) else { return Ok(()) };
        let others: Vec<(StateId, Vec<Option<AnswerSource>>)> =
            others.into_iter().map(|OtherPart { state, trained }| (state, by_row(&self.rows, trained))).collect();
        for (index, missing) in sums.missing.iter_mut().enumerate() {
            let sources = others.iter().filter_map(|(_, sources)| sources.get(index)).chain(answering.get(index));
            for source in sources {
                if let Some(AnswerSource::Nothing(reason)) = source {
                    missing.get_or_insert_with(|| Arc::clone(reason));
                }
            }
        }
        for block in samples.chunks(TIMES_PER_BLOCK) {
            let times: Vec<i64> = block.iter().map(|sample| sample.utc_nanos).collect();
            let prepared = self.view.prepare(&times);
            // Predictions of the state, and of each other part.
            let mut predicted = vec![vec![0.0; block.len()]; others.len() + 1];
            let rows = self.rows.iter().zip(&answering).zip(&mut sums.errors).enumerate();
            for (index, ((row, answering), sum)) in rows {
                stop.check()?;
                let others = others.iter().map(|(part, sources)| ((*part).into(), sources.get(index)));
                let parts = [(sums.target.clone(), Some(answering))].into_iter().chain(others);
                let is_answered = parts.zip(&mut predicted).all(|((part, source), predicted)| {
                    answer(&self.view, &part, source.and_then(Option::as_ref), &prepared, *row, predicted)
                });
                if is_answered {
                    add_block(sum, sums.compared, block, &predicted);
                }
            }
        }
        Ok(())
    }

    /// Whether the observations of a state are labels.
    pub fn has_labels(&self, target: &StateOrCell) -> bool {
        self.sums.get(&target.subject()).is_some_and(|sums| sums.compared == Compared::Labels)
    }

    /// The rows: name of the state, model with its order, sums.
    pub fn rows(&self) -> impl Iterator<Item = (StateOrCell, Cow<'_, str>, ModelSelector, &Evaluation)> {
        self.all().filter(|(.., missing, _)| missing.is_none()).map(|(target, row, _, errors)| {
            let order = Some(target.order(&self.view, *row)).filter(|_| row.kind.has_order());
            (target.clone(), self.name(target), ModelSelector { order, ..*row }, errors)
        })
    }

    /// The missing rows, by model: model, reason, and names of the states.
    pub fn unavailable(&self) -> Vec<(ModelSelector, &str, Vec<Cow<'_, str>>)> {
        let mut found: Vec<(ModelSelector, &str, Vec<Cow<'_, str>>)> = Vec::new();
        let mut places = HashMap::new();
        for (target, row, missing, _) in self.all() {
            let Some(reason) = missing.as_deref() else { continue };
            let place = *places.entry((*row, reason)).or_insert_with(|| {
                found.push((*row, reason, Vec::new()));
                found.len() - 1
            });
            if let Some((.., states)) = found.get_mut(place) {
                states.push(self.name(target));
            }
        }
        found.sort_by_key(|(row, ..)| self.rows.iter().position(|other| other == row));
        found
    }

    /// All rows by state, with or without a model.
    fn all(&self) -> impl Iterator<Item = (&StateOrCell, &ModelSelector, &Option<Arc<str>>, &Evaluation)> {
        self.states.iter().filter_map(|subject| self.sums.get(subject)).flat_map(|sums| {
            let rows = self.rows.iter().zip(&sums.missing).zip(&sums.errors);
            rows.map(move |((row, missing), errors)| (&sums.target, row, missing, errors))
        })
    }

    fn name(&self, target: &StateOrCell) -> Cow<'_, str> {
        let StateOrCell::State(id) = *target else { return target.name(&self.view) };
        let compared = self.sums.get(&target.subject()).map_or(Compared::Alone, |sums| sums.compared);
        let name = self.view.info(id).map(|info| &info.name);
        let whole = name.and_then(|name| match compared {
            Compared::Alone => None,
            Compared::Angle => name.as_angle_axis().map(|(angle, _)| angle),
            Compared::Labels => name.as_label().map(|(state, _)| state),
        });
        Cow::Borrowed(whole.or(name.map(|name| name.as_str())).unwrap_or_default())
    }
}

/// Adds observations, and the predictions of each part.
fn add_block(sum: &mut Evaluation, compared: Compared, block: &[Sample], predicted: &[Vec<f64>]) {
    let at = |index: usize| predicted.iter().map(move |part| part[index]);
    for (index, sample) in block.iter().enumerate() {
        match compared {
            Compared::Alone => at(index).for_each(|predicted| sum.add(predicted, sample.value)),
            Compared::Angle => {
                let mut parts = at(index);
                let parts = [(); 2].map(|()| parts.next().unwrap_or_default());
                sum.add_angle(direction_rad(parts), sample.value);
            }
            Compared::Labels => {
                let mut shares: Vec<f64> = at(index).collect();
                normalise(&mut shares);
                sum.add_label(&shares, sample.value as usize);
            }
        }
    }
}

/// The prediction source of each row, from the sources of the rows that are trained on readings.
fn by_row(rows: &[ModelSelector], trained: impl IntoIterator<Item = AnswerSource>) -> Vec<Option<AnswerSource>> {
    let mut trained = trained.into_iter();
    rows.iter().map(|row| if row.kind.needs_readings() { trained.next() } else { None }).collect()
}

/// Predicts a state; `false` if there is no model.
fn answer(
    view: &MapView,
    target: &StateOrCell,
    answering: Option<&AnswerSource>,
    prepared: &PreparedTimes,
    row: ModelSelector,
    predicted: &mut [f64],
) -> bool {
    match answering {
        None => target.predict_long_term_into(view, prepared, row, predicted),
        Some(AnswerSource::Trained(trained)) => trained.predict_into(view, target, prepared.moments(), row, predicted),
        Some(AnswerSource::Nothing(_)) => return false,
    }
    true
}
