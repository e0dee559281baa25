//! One state's whole long-term model, and the step that updates it.
//!
//! An update goes through local days: first each order is scored on what the day brought, from the
//! model as it was before, then the day is folded in (T-RO section IV.B). So the score is of
//! predictions, never of data the model has seen. Invariant: the result of an update does not depend
//! on how it was batched, as long as no local day is split and batches come in order of time; data
//! older than the last observation folded in is never scored.

use crate::SpectralModel;
use crate::evaluate::score_samples;
use crate::{Accumulator, InvalidParts, LocalDay, MAX_ORDER, OrderCriterion, OrderErrors, Periodicities, Sample};

#[cfg(test)]
mod tests;

/// The long-term model of one state.
#[derive(Clone, Debug, PartialEq)]
pub struct StateModel {
    accumulator: Accumulator,
    spectral: SpectralModel,
    order: usize,
    errors: OrderErrors,
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
    /// Sum of squared errors over the scored observations, per order 0..=[`MAX_ORDER`].
    pub squared_errors: [f64; MAX_ORDER + 1],
    /// Sum of squared errors over the scored observations, each predicted with the order in force on its day.
    pub squared_error_in_force: f64,
}

impl StateModel {
    /// A state of which nothing is known.
    pub fn new(periodicities: &Periodicities) -> StateModel {
        StateModel {
            accumulator: Accumulator::new(periodicities),
            spectral: SpectralModel::default(),
            order: 0,
            errors: OrderErrors::default(),
        }
    }

    /// A state from what was stored.
    ///
    /// # Errors
    /// [`InvalidParts`] where the order is above [`MAX_ORDER`].
    pub fn from_parts(
        accumulator: Accumulator,
        spectral: SpectralModel,
        order: usize,
        errors: OrderErrors,
    ) -> Result<StateModel, InvalidParts> {
        if order > MAX_ORDER {
            return Err(InvalidParts::OrderTooHigh { found: order });
        }
        Ok(StateModel { accumulator, spectral, order, errors })
    }

    /// The sums over all observations folded in.
    pub fn accumulator(&self) -> &Accumulator {
        &self.accumulator
    }

    /// Mean and components as of the last update.
    pub fn spectral(&self) -> &SpectralModel {
        &self.spectral
    }

    /// The order to predict with, 0..=[`MAX_ORDER`].
    pub fn order(&self) -> usize {
        self.order
    }

    /// How well each order has predicted.
    pub fn errors(&self) -> &OrderErrors {
        &self.errors
    }

    /// Takes in observations, day by local day: scores those newer than the last one folded in before
    /// that day with every order, chooses the order, folds the day in and refits.
    ///
    /// A local day that is split over two updates is scored in two parts, the second against the model
    /// that has seen the first.
    pub fn update(
        &mut self,
        periodicities: &Periodicities,
        criterion: OrderCriterion,
        mut samples: Vec<Sample>,
    ) -> UpdateOutcome {
        if !samples.is_sorted_by_key(|sample| sample.utc_nanos) {
            samples.sort_by_key(|sample| sample.utc_nanos);
        }
        let mut outcome = UpdateOutcome { order_before: self.order, ..UpdateOutcome::default() };
        let mut rest = samples.as_slice();
        while let Some(first) = rest.first() {
            let day = first.local_day();
            // Clocks set back over midnight return to a date that has already ended: no new day.
            let length = rest.iter().position(|sample| sample.local_day() > day).unwrap_or(rest.len());
            let (of_day, later) = rest.split_at(length);
            self.score_day(periodicities, criterion, day, of_day, &mut outcome);
            self.accumulator.add(periodicities, of_day);
            // Refitted each day: the next is scored by what was known before it.
            self.spectral = SpectralModel::fit(&self.accumulator, periodicities);
            rest = later;
        }
        outcome.observations = samples.len() as u64;
        outcome.order = self.order;
        outcome
    }

    /// Scores the samples of a day that are newer than all before it, and chooses the order.
    fn score_day(
        &mut self,
        periodicities: &Periodicities,
        criterion: OrderCriterion,
        day: LocalDay,
        of_day: &[Sample],
        outcome: &mut UpdateOutcome,
    ) {
        let Some(last_nanos) = self.accumulator.last_nanos() else { return };
        let newer = &of_day[of_day.partition_point(|sample| sample.utc_nanos <= last_nanos)..];
        if newer.is_empty() {
            return;
        }
        let sums = score_samples(&self.spectral, periodicities, newer);
        let errors = match criterion {
            OrderCriterion::SquaredError => &sums.squared,
            OrderCriterion::ZeroOne => &sums.wrong,
        };
        outcome.squared_error_in_force += sums.squared[self.order];
        self.errors.record(day, errors);
        self.order = self.errors.best();
        outcome.scored += newer.len() as u64;
        for (total, error) in outcome.squared_errors.iter_mut().zip(&sums.squared) {
            *total += error;
        }
    }
}
