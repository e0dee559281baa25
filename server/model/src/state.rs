//! One state's whole long-term model, and the step that updates it.
//!
//! An update goes through local days: first each order is scored on what the day brought, from the
//! model as it was before, then the day is folded in (T-RO section IV.B). So the score is of
//! predictions, never of data the model has seen. Invariant: the result of an update does not depend
//! on how it was batched, as long as no local day is split and batches come in order of time; data
//! older than the last observation folded in is never scored. What is given between updates, models that were fitted
//! to readings ([`StateModel::refitted`]), has a say from the next day on.

use crate::SpectralModel;
use crate::evaluate::score_samples;
use crate::{
    Accumulator, InvalidParts, LocalDay, ORDER_MAX, OrderCriterion, OrderErrors, Periodicities, Sample, StateKind,
};

mod alternatives;
mod fits;
#[cfg(test)]
mod kind_tests;
#[cfg(test)]
mod tests;

pub use alternatives::{ActiveModel, Alternatives, AlternativesParts, FitParts, HISTOGRAMS, ModelChoice, UpdateRules};
pub use fits::{EnabledModels, FitKind, FittedModel, FittedModelParts};

/// The long-term model of one state.
#[derive(Clone, Debug, PartialEq)]
pub struct StateModel {
    accumulator: Accumulator,
    spectral: SpectralModel,
    order: usize,
    errors: OrderErrors,
    /// Absent where nothing was folded in.
    alternatives: Option<Box<Alternatives>>,
}

/// What an update did.
#[derive(Clone, Copy, Debug, PartialEq, Default)]
pub struct UpdateOutcome {
    /// The order before.
    pub order_before: usize,
    /// The order now.
    pub order: usize,
    /// Observations folded in.
    pub observations: u64,
    /// Of these, observations that were predicted first and scored.
    pub scored: u64,
    /// Sum of squared errors over the scored observations, per order 0..=[`ORDER_MAX`].
    pub squared_errors: [f64; ORDER_MAX + 1],
    /// Sum of squared errors over the scored observations, each predicted with the model in force on its day.
    pub squared_error_in_force: f64,
}

impl StateModel {
    /// A probability of which nothing is known.
    pub fn new(_periodicities: &Periodicities) -> StateModel {
        StateModel::of_kind(StateKind::Probability)
    }

    /// A state of that kind of which nothing is known. It answers 0.5 where it is a probability, else 0.
    pub fn of_kind(kind: StateKind) -> StateModel {
        let accumulator = Accumulator::of_kind(kind);
        let spectral = SpectralModel::from_parts_of(kind, kind.unlearned(), 0, Vec::new()).unwrap_or_default();
        StateModel { accumulator, spectral, order: 0, errors: OrderErrors::default(), alternatives: None }
    }

    /// A probability of which nothing is known but what to expect of such states, in `[0,1]`; 0.5 where it is not.
    pub fn with_prior(periodicities: &Periodicities, prior: f64) -> StateModel {
        let spectral = SpectralModel::from_parts(prior, 0, Vec::new()).unwrap_or_default();
        StateModel { spectral, ..StateModel::new(periodicities) }
    }

    /// A state from what was stored.
    ///
    /// # Errors
    /// [`InvalidParts`] where the order is above [`ORDER_MAX`].
    pub fn from_parts(
        accumulator: Accumulator,
        spectral: SpectralModel,
        order: usize,
        errors: OrderErrors,
    ) -> Result<StateModel, InvalidParts> {
        if order > ORDER_MAX {
            return Err(InvalidParts::OrderTooHigh { found: order });
        }
        Ok(StateModel { accumulator, spectral, order, errors, alternatives: None })
    }

    /// The same with what was stored apart from its spectrum.
    #[must_use]
    pub fn with_alternatives(self, alternatives: Alternatives) -> StateModel {
        StateModel { alternatives: Some(Box::new(alternatives)), ..self }
    }

    /// What is known apart from the spectrum; `None` where nothing was folded in since it is kept.
    pub fn alternatives(&self) -> Option<&Alternatives> {
        self.alternatives.as_deref()
    }

    /// The model that has predicted best so far.
    pub fn choice(&self) -> ModelChoice {
        self.alternatives.as_ref().map_or(ModelChoice::Spectral, |alternatives| alternatives.choice())
    }

    /// The model in force; `None` where it is the spectral one.
    pub fn chosen(&self) -> Option<ActiveModel<'_>> {
        self.alternatives.as_ref()?.chosen()
    }

    /// Whether the model of that kind is to be fitted again: when seven local days were observed, seven local days after
    /// its last fit, and when the change alarm has rung since. Never where such states have no such model.
    pub fn is_fit_due(&self, kind: FitKind) -> bool {
        kind.is_for(self.kind()) && self.alternatives.as_ref().is_some_and(|alternatives| alternatives.is_fit_due(kind))
    }

    /// The same with a model that was fitted to the state's readings up to a local day, that day included, in place of the
    /// last one of its kind. It is scored on what is folded in from now on, and may come into force then. A state into which
    /// nothing was folded takes none, nor one of a kind that such states do not have.
    #[must_use]
    pub fn refitted(mut self, model: impl Into<FittedModel>, day: LocalDay) -> StateModel {
        let (model, of) = (model.into(), self.kind());
        if let Some(alternatives) = self.alternatives.as_mut().filter(|_| model.kind().is_for(of)) {
            alternatives.refit(model, day);
        }
        self
    }

    /// What its values mean.
    pub fn kind(&self) -> StateKind {
        self.accumulator.kind()
    }

    /// The change of value by which persistence measures changes, above 0: 1 of a probability; of other kinds two standard
    /// deviations of what was folded in, which is how far a state apart lies that has two values equally often. 1 where
    /// that is not known.
    pub fn usual_change(&self) -> f64 {
        let width = 2.0 * self.accumulator.variance().sqrt();
        if self.kind() != StateKind::Probability && width > 0.0 { width } else { 1.0 }
    }

    /// The sums over all observations folded in.
    pub fn accumulator(&self) -> &Accumulator {
        &self.accumulator
    }

    /// Mean and components as of the last update.
    pub fn spectral(&self) -> &SpectralModel {
        &self.spectral
    }

    /// The order to predict with, 0..=[`ORDER_MAX`]: the one that has predicted best, or fewer where noise would show
    /// components as strong.
    pub fn order(&self) -> usize {
        let supported = self.alternatives.as_ref().map_or(ORDER_MAX, |known| known.supported_order());
        self.order.min(supported)
    }

    /// The order that has predicted best, supported or not.
    pub fn best_order(&self) -> usize {
        self.order
    }

    /// How well each order has predicted.
    pub fn errors(&self) -> &OrderErrors {
        &self.errors
    }

    /// Takes in observations, day by local day: scores those newer than the last one folded in before
    /// that day with every order and every enabled model, chooses, folds the day in and refits; models that were fitted to
    /// readings stay as they are.
    ///
    /// A local day that is split over two updates is scored in two parts, the second against the model
    /// that has seen the first. With a half-life, what is folded in on a day counts by its age in whole local days, late
    /// data too.
    pub fn update(
        &mut self,
        periodicities: &Periodicities,
        rules: impl Into<UpdateRules>,
        mut samples: Vec<Sample>,
    ) -> UpdateOutcome {
        let mut rules = rules.into();
        if self.kind() != StateKind::Probability {
            // Such values have no two sides of 0.5.
            rules.criterion = OrderCriterion::SquaredError;
        }
        if !samples.is_sorted_by_key(|sample| sample.utc_nanos) {
            samples.sort_by_key(|sample| sample.utc_nanos);
        }
        let mut outcome = UpdateOutcome { order_before: self.order(), ..UpdateOutcome::default() };
        let mut rest = samples.as_slice();
        while let Some(first) = rest.first() {
            let day = first.local_day();
            // Clocks set back over midnight return to a date that has already ended: no new day.
            let length = rest.iter().position(|sample| sample.local_day() > day).unwrap_or(rest.len());
            let (of_day, later) = rest.split_at(length);
            self.score_day(periodicities, rules, day, of_day, &mut outcome);
            self.fold_in(periodicities, rules, day, of_day);
            // Refitted each day: the next is scored by what was known before it.
            self.spectral = SpectralModel::fit(&self.accumulator, periodicities);
            if let Some(alternatives) = &mut self.alternatives {
                alternatives.support(&self.spectral, periodicities, &self.accumulator);
            }
            rest = later;
        }
        outcome.observations = samples.len() as u64;
        outcome.order = self.order();
        outcome
    }

    /// Folds a day in, with each observation's say by its age in local days.
    fn fold_in(&mut self, periodicities: &Periodicities, rules: UpdateRules, day: LocalDay, of_day: &[Sample]) {
        let alternatives = self.alternatives.get_or_insert_with(|| Box::new(Alternatives::new(rules.models)));
        let Some(half_life_days) = rules.half_life_days else {
            self.accumulator.add(periodicities, of_day);
            alternatives.add(day, of_day);
            return;
        };
        let age_days = alternatives.folded_day().map_or(0, |last| i64::from(day.0) - i64::from(last.0));
        let factor = 0.5_f64.powf(age_days.unsigned_abs() as f64 / half_life_days);
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

    /// Scores the samples of a day that are newer than all before it, and chooses.
    fn score_day(
        &mut self,
        periodicities: &Periodicities,
        rules: UpdateRules,
        day: LocalDay,
        of_day: &[Sample],
        outcome: &mut UpdateOutcome,
    ) {
        let Some(last_nanos) = self.accumulator.last_nanos() else { return };
        let newer = &of_day[of_day.partition_point(|sample| sample.utc_nanos <= last_nanos)..];
        if newer.is_empty() {
            return;
        }
        let sums = score_samples(self.kind(), &self.spectral, periodicities, newer);
        let errors = match rules.criterion {
            OrderCriterion::SquaredError => &sums.squared,
            OrderCriterion::ZeroOne => &sums.wrong,
        };
        let (kind, squared) = (self.kind(), sums.squared[self.order()]);
        self.errors.record(day, errors);
        self.order = self.errors.best();
        outcome.squared_error_in_force += match &mut self.alternatives {
            Some(alternatives) => {
                let order = self.order.min(alternatives.supported_order());
                let spectral = (errors[order], self.errors.sums()[order]);
                let unit = if kind == StateKind::Probability { 1.0 } else { self.accumulator.variance() };
                let was_ringing = alternatives.alarm().is_ringing();
                let in_force = alternatives.score(day, rules, newer, spectral, (squared, unit));
                if alternatives.alarm().is_ringing() && !was_ringing {
                    self.errors.fade(alternatives.discount_errors());
                }
                in_force
            }
            None => squared,
        };
        outcome.scored += newer.len() as u64;
        for (total, error) in outcome.squared_errors.iter_mut().zip(&sums.squared) {
            *total += error;
        }
    }
}
