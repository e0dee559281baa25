//! The long-term model of one state, and its update.
//!
//! An update goes through the local days: first it scores each order on the observations of the day with the model of
//! the day before, then the model learns the day (T-RO section IV.B). So predictions are scored, never training data.
//! Invariant: the result of an update does not depend on how it was batched, as long as no local day is split and
//! batches come in order of time; data older than the last learned observation is never scored. Models that are trained
//! on readings between updates ([`StateModel::with_trained`]) take part from the next day on.

use std::sync::Arc;

use crate::SpectralModel;
use crate::catalogue::{ModelKind, TrainedModel};
use crate::evaluate::score_samples;
use crate::models::{Moment, OrderGains, TemporalModel as _};
use crate::special::square;
use crate::{
    Accumulator, AnyEnsemble, Belief, InvalidParts, LearnedRows, LocalDay, ORDER_MAX, OrderCriterion, OrderErrors,
    OtherModels, Periodicities, Predictive, Reporting, Sample, StateKind, Surprises,
};

mod alternatives;
mod belief_day;
mod in_force;
#[cfg(test)]
mod kind_tests;
mod order_watch;
#[cfg(test)]
mod tests;
mod together;

use alternatives::SpectralAtOrder;
pub use alternatives::{
    ActiveModel, Alternatives, AlternativesParts, ChosenMember, Combination, TrainingRecordParts, UpdateRules,
};
pub use order_watch::{DayScores, LearnedReadings, OrderWatch, OrderWatchParts};
pub use together::choose_together;

/// The long-term model of one state.
#[derive(Clone, Debug, PartialEq)]
pub struct StateModel {
    accumulator: Accumulator,
    spectral: SpectralModel,
    order: usize,
    errors: OrderErrors,
    /// `None` while the state is untrained.
    alternatives: Option<Box<Alternatives>>,
    /// `None` while the state is untrained, unless its sensor is stated.
    belief: Option<Box<Belief>>,
    surprises: Surprises,
    /// The way in which the state is reported, and the record of its learned rows; `None` if each row is a reading.
    reported: Option<Box<(Reporting, LearnedRows)>>,
}

/// The outcome of an update.
#[derive(Clone, Copy, Debug, PartialEq, Default)]
pub struct UpdateOutcome {
    /// The order before the update.
    pub order_before: usize,
    /// The order after the update.
    pub order: usize,
    /// Observations learned.
    pub observations: u64,
    /// Number of these observations that were predicted first and scored.
    pub scored: u64,
    /// Sum of squared errors over the scored observations, per order 0..=[`ORDER_MAX`].
    pub squared_errors: [f64; ORDER_MAX + 1],
    /// Sum of squared errors over the scored observations, each predicted with the model in force on its day.
    pub squared_error_in_force: f64,
}

impl UpdateOutcome {
    /// Adds the outcome of an update that followed this one.
    pub fn add(&mut self, later: &UpdateOutcome) {
        self.order = later.order;
        self.observations += later.observations;
        self.scored += later.scored;
        for (sum, more) in self.squared_errors.iter_mut().zip(&later.squared_errors) {
            *sum += more;
        }
        self.squared_error_in_force += later.squared_error_in_force;
    }
}

impl StateModel {
    /// An untrained probability.
    pub fn new(_periodicities: &Periodicities) -> StateModel {
        StateModel::of_kind(StateKind::Probability)
    }

    /// An untrained state of the given kind. It predicts 0.5 for a probability, else 0.
    pub fn of_kind(kind: StateKind) -> StateModel {
        let accumulator = Accumulator::of_kind(kind);
        let spectral = SpectralModel::from_parts_of(kind, kind.untrained(), 0, Vec::new()).unwrap_or_default();
        let (errors, surprises) = (OrderErrors::default(), Surprises::default());
        StateModel {
            accumulator,
            spectral,
            order: 0,
            errors,
            alternatives: None,
            belief: None,
            surprises,
            reported: None,
        }
    }

    /// An untrained probability with a prior in `[0,1]`; a prior outside of it counts as 0.5.
    pub fn with_prior(periodicities: &Periodicities, prior: f64) -> StateModel {
        let spectral = SpectralModel::from_parts(prior, 0, Vec::new()).unwrap_or_default();
        StateModel { spectral, ..StateModel::new(periodicities) }
    }

    /// A state from stored parts.
    ///
    /// # Errors
    /// [`InvalidParts`] where the order is above [`ORDER_MAX`].
    pub fn from_parts(
        mut accumulator: Accumulator,
        spectral: SpectralModel,
        order: usize,
        errors: OrderErrors,
    ) -> Result<StateModel, InvalidParts> {
        if order > ORDER_MAX {
            return Err(InvalidParts::OrderTooHigh { found: order });
        }
        accumulator.pack();
        let surprises = Surprises::default();
        Ok(StateModel {
            accumulator,
            spectral,
            order,
            errors,
            alternatives: None,
            belief: None,
            surprises,
            reported: None,
        })
    }

    /// Adds the stored alternatives.
    #[must_use]
    pub fn with_alternatives(self, alternatives: Alternatives) -> StateModel {
        StateModel { alternatives: Some(Box::new(alternatives)), ..self }
    }

    /// A copy for readers, without the sums over periodicities, and without trained models that are not in force. It
    /// gives the same predictions to the last bit, and cannot be updated.
    #[must_use]
    pub fn published(&self) -> StateModel {
        StateModel {
            accumulator: self.accumulator.published(),
            spectral: self.spectral.clone(),
            order: self.order,
            errors: self.errors,
            alternatives: self.alternatives.as_ref().map(|known| Box::new(known.published())),
            surprises: self.surprises.clone(),
            belief: self.belief.as_ref().map(|known| Box::new(known.published())),
            reported: self.reported.clone(),
        }
    }

    /// This state with another way of reporting than by samples, and with the record of its learned rows.
    #[must_use]
    pub fn with_reporting(self, reporting: Reporting, learned: LearnedRows) -> StateModel {
        StateModel { reported: reporting.may_end().then(|| Box::new((reporting, learned))), ..self }
    }

    /// The way in which the state is reported.
    pub fn reporting(&self) -> Reporting {
        self.reported.as_ref().map_or(Reporting::Samples, |known| known.0)
    }

    /// The record of the learned rows of the state; `None` if each row is a reading.
    pub fn learned_rows(&self) -> Option<&LearnedRows> {
        self.reported.as_ref().map(|known| &known.1)
    }

    /// Number of learned observations: rows, each of which may represent many readings.
    pub fn learned_observations(&self) -> u64 {
        let of_rows = |learned: &LearnedRows| learned.rows.saturating_sub(learned.waiting.len() as u64);
        self.learned_rows().map_or(self.accumulator.observations(), of_rows)
    }

    /// This state with other unusual observations.
    #[must_use]
    pub fn with_surprises(self, surprises: Surprises) -> StateModel {
        StateModel { surprises, ..self }
    }

    /// The observations that were unusual for the state before it learned them.
    pub fn surprises(&self) -> &Surprises {
        &self.surprises
    }

    /// The alternatives to the spectral model; `None` while the state is untrained.
    pub fn alternatives(&self) -> Option<&Alternatives> {
        self.alternatives.as_deref()
    }

    /// The kind of model that predicts by default: the ensemble where the state has one, else the chosen model.
    pub fn answers(&self) -> ModelKind {
        if self.ensemble().is_some() { ModelKind::Ensemble } else { self.choice() }
    }

    /// The ensemble, if it is used for predictions: it is enabled, and has learned a day.
    pub fn ensemble(&self) -> Option<&AnyEnsemble> {
        self.alternatives.as_ref()?.ensemble().filter(|ensemble| ensemble.last_day().is_some())
    }

    /// The single model that has predicted best so far, a member of the ensemble; it has the highest weight if several
    /// are chosen together.
    pub fn choice(&self) -> ModelKind {
        self.alternatives.as_ref().map_or(ModelKind::Spectral, |alternatives| alternatives.choice())
    }

    /// The model that the last update chose, or the spectral model; it is a member of the ensemble. `periodicities` are
    /// those of the map of the state.
    pub fn chosen_member<'a>(&'a self, periodicities: &'a Periodicities) -> ChosenMember<'a> {
        let (model, order, kind) = (&self.spectral, self.order(), self.kind());
        let spectral = SpectralAtOrder { model, order, kind, periodicities };
        ChosenMember { chosen: self.chosen(periodicities), spectral }
    }

    /// The predictive distributions of a probability at moments; `None` where no ensemble predicts. Faster if the
    /// moments are in order of time. `periodicities` are those of the map of the state.
    pub fn predictive(&self, periodicities: &Periodicities, moments: &[Moment]) -> Option<Vec<Predictive>> {
        Some(self.ensemble()?.of_probability()?.predict(moments, &self.chosen_member(periodicities)))
    }

    /// The predictive distributions around predictions of any model of a probability: the equivalent number of
    /// half-hour bins of an hour, and how its readings depend on each other, do not depend on the model. `None` where
    /// no ensemble predicts.
    pub fn predictive_around(&self, moments: &[Moment], probabilities: &[f64]) -> Option<Vec<Predictive>> {
        let ensemble = self.ensemble()?.of_probability()?;
        let pairs = moments.iter().zip(probabilities);
        Some(pairs.map(|(&at, &probability)| ensemble.around(at, probability)).collect())
    }

    /// The models in force, which have predicted best so far; `None` if it is the spectral model alone. `periodicities`
    /// are those of the map of the state.
    pub fn chosen<'a>(&'a self, periodicities: &'a Periodicities) -> Option<ActiveModel<'a>> {
        let (model, order, kind) = (&self.spectral, self.order(), self.kind());
        self.alternatives.as_ref()?.chosen(SpectralAtOrder { model, order, kind, periodicities })
    }

    /// Whether the model of this kind is due for training: after seven observed local days, seven local days after it
    /// was last trained, and after a change alarm; a cheap one also from the third observed day to the seventh. Never
    /// for a kind that such states do not support, or that updates do not train.
    pub fn is_training_due(&self, kind: ModelKind) -> bool {
        kind.supports(self.kind())
            && self.alternatives.as_ref().is_some_and(|alternatives| alternatives.is_training_due(kind))
    }

    /// This state with a model that was trained on its readings up to a local day, that day included, in place of the
    /// last one of its kind. It is scored on the days learned from now on, and may then come into force. An untrained
    /// state takes no model, nor does a state take a kind that it does not support or that updates do not train.
    #[must_use]
    pub fn with_trained(mut self, model: impl Into<TrainedModel>, day: LocalDay) -> StateModel {
        let model = model.into();
        let state_kind = self.kind();
        let kind = model.kind_at_night().filter(|kind| kind.supports(state_kind));
        if let (Some(alternatives), Some(kind)) = (self.alternatives.as_mut(), kind) {
            alternatives.set_trained(kind, model, day);
        }
        self
    }

    /// The kind of the values of the state.
    pub fn kind(&self) -> StateKind {
        self.accumulator.kind()
    }

    /// The change of value by which persistence measures changes, above 0: 1 of a probability; for other kinds two
    /// standard deviations of the training data, which is the distance of the values of a state that has two values
    /// equally often. 1 if unknown.
    pub fn usual_change(&self) -> f64 {
        let width = 2.0 * self.accumulator.variance().sqrt();
        if self.kind() != StateKind::Probability && width > 0.0 { width } else { 1.0 }
    }

    /// The sums over all learned observations.
    pub fn accumulator(&self) -> &Accumulator {
        &self.accumulator
    }

    /// Mean and components as of the last update.
    pub fn spectral(&self) -> &SpectralModel {
        &self.spectral
    }

    /// The order to predict with, 0..=[`ORDER_MAX`]: the one that has predicted best, limited to the supported
    /// components unless the choice of orders has made predictions better day after day.
    pub fn order(&self) -> usize {
        let supported = self.alternatives.as_ref().map_or(ORDER_MAX, |known| known.supported_order());
        self.order.min(supported)
    }

    /// The order that has predicted best, supported or not.
    pub fn best_order(&self) -> usize {
        self.order
    }

    /// The errors of the predictions of each order.
    pub fn errors(&self) -> &OrderErrors {
        &self.errors
    }

    /// Brings the sums over periodicities into memory, for [`StateModel::update`].
    ///
    /// # Errors
    /// The reason why the stored sums cannot be read. An update would learn nothing.
    pub fn load(&mut self, periodicities: &Periodicities) -> Result<(), String> {
        self.accumulator.unpack(periodicities)
    }

    /// Learns observations, local day by local day: scores those newer than the last learned one with every order and
    /// every enabled model, chooses, learns the day and trains the spectral model again. Models that are trained on
    /// readings stay as they are: the caller trains them between days, with [`StateModel::with_trained`].
    ///
    /// A local day that is split over two updates is scored in two parts, the second with the model that has learned
    /// the first. With a half-life, data is weighted by its age in whole local days, late data too.
    pub fn update(
        &mut self,
        periodicities: &Periodicities,
        rules: impl Into<UpdateRules>,
        samples: Vec<Sample>,
    ) -> UpdateOutcome {
        self.update_judged(periodicities, rules, samples, &mut |_, _, _| ())
    }

    /// Does the same as [`StateModel::update`], and calls `judge` for each local day, with the state before it learns
    /// the day; `judge` brings the state's unusual observations up to date.
    pub fn update_judged(
        &mut self,
        periodicities: &Periodicities,
        rules: impl Into<UpdateRules>,
        mut samples: Vec<Sample>,
        judge: &mut dyn FnMut(&StateModel, &[Sample], &mut Surprises),
    ) -> UpdateOutcome {
        let mut rules = rules.into();
        if self.kind() != StateKind::Probability {
            // The zero-one error is defined for probabilities only.
            rules.criterion = OrderCriterion::SquaredError;
        }
        if !samples.is_sorted_by_key(|sample| sample.utc_nanos) {
            samples.sort_by_key(|sample| sample.utc_nanos);
        }
        let mut outcome = UpdateOutcome { order_before: self.order(), ..UpdateOutcome::default() };
        if self.load(periodicities).is_err() {
            return outcome;
        }
        let mut rest = samples.as_slice();
        while let Some(first) = rest.first() {
            let day = first.local_day();
            // Clocks set back over midnight return to a date that has already ended: this is not a new day.
            let length = rest.iter().position(|sample| sample.local_day() > day).unwrap_or(rest.len());
            let (of_day, later) = rest.split_at(length);
            self.with_ensemble(periodicities, rules, |ensemble, others| ensemble.prepare(day, others));
            let mut surprises = std::mem::take(&mut self.surprises);
            judge(self, of_day, &mut surprises);
            self.surprises = surprises;
            self.learn_belief(periodicities, of_day);
            let in_force = self.learn_ensemble(periodicities, rules, day, of_day);
            self.score_day(periodicities, rules, day, of_day, in_force, &mut outcome);
            self.learn_day(periodicities, rules, day, of_day);
            // Trained again each day, so that the next day is scored with a model of all days before it.
            if let Some(alternatives) = &mut self.alternatives {
                self.spectral = SpectralModel::train_with_gaps(&self.accumulator, periodicities, alternatives.gaps());
                alternatives.support(&self.spectral, periodicities, &self.accumulator);
            }
            rest = later;
        }
        self.accumulator.pack();
        outcome.observations = samples.len() as u64;
        outcome.order = self.order();
        outcome
    }

    /// Learns a day, each observation weighted by its age in local days.
    fn learn_day(&mut self, periodicities: &Periodicities, rules: UpdateRules, day: LocalDay, of_day: &[Sample]) {
        let kind = self.kind();
        let alternatives = self.alternatives.get_or_insert_with(|| Box::new(Alternatives::new(kind, rules.models)));
        let Some(half_life_days) = rules.half_life_days else {
            self.accumulator.add(periodicities, of_day);
            alternatives.add(day, of_day);
            return;
        };
        let age_days = alternatives.learned_day().map_or(0, |last| i64::from(day.0) - i64::from(last.0));
        let factor = libm::exp2(-(age_days.unsigned_abs() as f64) / half_life_days);
        if age_days >= 0 {
            self.accumulator.fade(factor);
            self.accumulator.add(periodicities, of_day);
            alternatives.fade(factor);
            alternatives.add(day, of_day);
        } else {
            let mut late = Accumulator::of_kind(self.accumulator.kind());
            late.add(periodicities, of_day);
            late.fade(factor);
            self.accumulator.merge(&late);
            alternatives.add_late(of_day, factor);
        }
    }

    /// Lets the ensemble score and learn a day, before the day changes which model is chosen. Returns the sum of the
    /// squared errors of the ensemble's predictions of the day's newer samples; `None` where it did not predict.
    fn learn_ensemble(
        &mut self,
        periodicities: &Periodicities,
        rules: UpdateRules,
        day: LocalDay,
        of_day: &[Sample],
    ) -> Option<f64> {
        let newer_than = self.accumulator.last_nanos().unwrap_or(i64::MIN);
        let newer = &of_day[of_day.partition_point(|sample| sample.utc_nanos <= newer_than)..];
        self.with_ensemble(periodicities, rules, |ensemble, others| {
            let answered = ensemble.last_day().is_some();
            ensemble.learn_day(day, of_day, newer, others).filter(|_| answered)
        })?
    }

    /// Calls `change` with the ensemble and the chosen model; `None` where there is no ensemble.
    fn with_ensemble<T>(
        &mut self,
        periodicities: &Periodicities,
        rules: UpdateRules,
        change: impl FnOnce(&mut AnyEnsemble, OtherModels<'_>) -> T,
    ) -> Option<T> {
        let kind = self.kind();
        let alternatives = self.alternatives.get_or_insert_with(|| Box::new(Alternatives::new(kind, rules.models)));
        // The ensemble is taken out of the state, because `change` also borrows the chosen model from the state.
        let mut ensemble = alternatives.ensemble_mut().take().filter(|_| rules.models.has_ensemble())?;
        let chosen = self.chosen_member(periodicities);
        let changed = change(Arc::make_mut(&mut ensemble), chosen.others());
        if let Some(alternatives) = &mut self.alternatives {
            *alternatives.ensemble_mut() = Some(ensemble);
        }
        Some(changed)
    }

    /// Scores the samples of a day that are newer than all earlier ones, and chooses a model. `in_force`: the sum of
    /// the squared errors of the ensemble, where it predicted.
    fn score_day(
        &mut self,
        periodicities: &Periodicities,
        rules: UpdateRules,
        day: LocalDay,
        of_day: &[Sample],
        in_force: Option<f64>,
        outcome: &mut UpdateOutcome,
    ) {
        let Some(last_nanos) = self.accumulator.last_nanos() else { return };
        let newer = &of_day[of_day.partition_point(|sample| sample.utc_nanos <= last_nanos)..];
        if newer.is_empty() {
            return;
        }
        let sums = score_samples(self.kind(), &self.spectral, periodicities, newer);
        let combined = match self.chosen(periodicities) {
            Some(ActiveModel::Combination(models)) => {
                let error = |sample: &Sample| square(models.predict(sample.moment()) - sample.value);
                Some(newer.iter().map(error).sum())
            }
            _ => None,
        };
        let errors = match rules.criterion {
            OrderCriterion::SquaredError => &sums.squared,
            OrderCriterion::ZeroOne => &sums.wrong,
        };
        let (kind, squared) = (self.kind(), sums.squared[self.order()]);
        let before = (self.order, self.order());
        self.errors.record(day, errors);
        self.order = self.errors.best();
        let by_choice = match &mut self.alternatives {
            Some(alternatives) => {
                if OrderGains::apply_to(periodicities) {
                    alternatives.record_gain(before.0, &sums.squared, newer.len() as u64);
                }
                let spectral_of =
                    |sample: &Sample| self.spectral.predict_value(kind, periodicities, before.1, sample.civil_nanos());
                let order = self.order.min(alternatives.supported_order());
                let spectral = (errors[order], self.errors.sums()[order]);
                let unit = if kind == StateKind::Probability { 1.0 } else { self.accumulator.variance() };
                let was_ringing = alternatives.alarm().is_ringing();
                let in_force =
                    alternatives.score(day, rules, newer, spectral, (squared, unit), (combined, &spectral_of));
                if alternatives.alarm().is_ringing() && !was_ringing {
                    self.errors.fade(alternatives.discount_errors());
                }
                in_force
            }
            None => squared,
        };
        outcome.squared_error_in_force += in_force.unwrap_or(by_choice);
        outcome.scored += newer.len() as u64;
        for (total, error) in outcome.squared_errors.iter_mut().zip(&sums.squared) {
            *total += error;
        }
    }
}
