//! The combination of several models, weighted by their past errors.
//!
//! A model has the weight (S_min / S)^n: S is its faded sum of errors, S_min the lowest, n the number of observed days,
//! at least [`DAYS_MIN`]. So after few days models with similar errors have similar weights; from [`COMBINED_DAYS_MAX`]
//! days on the best model predicts alone. The model in force has its advantage of hysteresis here too. Invariant:
//! weights are above 0 and sum to 1, and the model in force has the highest one.

use super::{ActiveModel, Alternatives, CLEARLY_LOWER};
use crate::{
    OtherModels, Periodicities, SpectralModel, StateKind,
    catalogue::ModelKind,
    models::{Moment, TemporalModel},
};

/// The exponent of the errors for a state with fewer days. Chosen on single weeks of one office door's training data
/// and on simulated counts and temperatures.
const DAYS_MIN: u32 = 8;
/// Models are combined while there are fewer days than this. On the training data of the office door, with the error of
/// the best member as 1, combined models had .984 after one week and 1.016 after two, where the winner alone had 1.123
/// and 1.032; after four weeks the winner alone had 1.018, and combined models 1.024.
const COMBINED_DAYS_MAX: u32 = 28;
/// A model with less than this share of the highest weight has none.
const SHARE_MIN: f64 = 0.01;

/// The spectral model of a state with its order.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(in crate::state) struct SpectralAtOrder<'a> {
    pub(in crate::state) model: &'a SpectralModel,
    pub(in crate::state) order: usize,
    pub(in crate::state) kind: StateKind,
    pub(in crate::state) periodicities: &'a Periodicities,
}

impl TemporalModel for SpectralAtOrder<'_> {
    fn predict(&self, at: Moment) -> f64 {
        self.model.predict_value(self.kind, self.periodicities, self.order, at.civil_nanos())
    }
}

/// The choice of an update as one model: the spectral model predicts the moments that a histogram cannot predict.
#[derive(Clone, Debug, PartialEq)]
pub struct ChosenMember<'a> {
    pub(in crate::state) chosen: Option<ActiveModel<'a>>,
    pub(in crate::state) spectral: SpectralAtOrder<'a>,
}

impl ChosenMember<'_> {
    /// The models that an ensemble needs beside its own members.
    pub fn others(&self) -> OtherModels<'_> {
        let expects_year = self.spectral.periodicities.names_year();
        OtherModels { chosen: self, lasting: &self.spectral, expects_year }
    }
}

impl TemporalModel for ChosenMember<'_> {
    fn predict(&self, at: Moment) -> f64 {
        match &self.chosen {
            Some(chosen) if chosen.covers(at) => self.spectral.kind.saturate(chosen.predict(at)),
            _ => self.spectral.predict(at),
        }
    }
}

/// Several models in force, with their weights.
#[derive(Clone, Debug, PartialEq)]
pub struct Combination<'a> {
    spectral: SpectralAtOrder<'a>,
    spectral_weight: f64,
    others: Vec<(ActiveModel<'a>, f64)>,
}

impl Combination<'_> {
    /// The weight of the spectral model at the order in force, 0 to 1.
    pub fn spectral_weight(&self) -> f64 {
        self.spectral_weight
    }

    /// The weighted sum of the predictions of the other models: add that of the spectral model times its weight.
    pub fn others_at(&self, at: Moment) -> f64 {
        // Where a histogram has no readings of that hour, the spectral model predicts.
        let prediction =
            |model: &ActiveModel<'_>| if model.covers(at) { model.predict(at) } else { self.spectral.predict(at) };
        self.others.iter().map(|(model, weight)| weight * prediction(model)).sum()
    }
}

impl TemporalModel for Combination<'_> {
    fn predict(&self, at: Moment) -> f64 {
        let of_spectral =
            if self.spectral_weight > 0.0 { self.spectral_weight * self.spectral.predict(at) } else { 0.0 };
        of_spectral + self.others_at(at)
    }
}

impl Alternatives {
    /// The weights of the models in force, in the order of [`Alternatives::error_sums`]; they sum to 1.
    pub fn weights(&self) -> Vec<(ModelKind, f64)> {
        let in_force = self.parts.choice;
        let handicap = |choice: ModelKind| if choice == in_force { CLEARLY_LOWER } else { 1.0 };
        let sums: Vec<(ModelKind, f64)> =
            self.error_sums().map(|(choice, sum)| (choice, sum * handicap(choice))).collect();
        let own = sums.iter().find(|(choice, _)| *choice == in_force).map_or(0.0, |(_, sum)| *sum);
        let least = sums.iter().map(|(_, sum)| *sum).fold(own, f64::min);
        // Without errors there is nothing to weigh. A model comes into force only when a day is scored.
        if own <= 0.0 || least < own || self.days >= COMBINED_DAYS_MAX {
            return vec![(in_force, 1.0)];
        }
        let exponent = f64::from(self.days.max(DAYS_MIN));
        let weights = sums.into_iter().map(|(choice, sum)| (choice, libm::pow(least / sum, exponent)));
        let mut weights: Vec<(ModelKind, f64)> = weights.filter(|(_, weight)| *weight >= SHARE_MIN).collect();
        let total: f64 = weights.iter().map(|(_, weight)| weight).sum();
        weights.iter_mut().for_each(|(_, weight)| *weight /= total);
        weights
    }

    /// The models in force; `None` if it is the spectral model alone.
    pub(in crate::state) fn chosen<'a>(&'a self, spectral: SpectralAtOrder<'a>) -> Option<ActiveModel<'a>> {
        let weights = self.weights();
        if let [(choice, _)] = weights.as_slice() {
            return self.member(*choice);
        }
        let weight = |wanted| weights.iter().find(|(choice, _)| *choice == wanted).map_or(0.0, |(_, weight)| *weight);
        let others = weights.iter().filter_map(|(choice, weight)| Some((self.member(*choice)?, *weight)));
        let (others, spectral_weight) = (others.collect(), weight(ModelKind::Spectral));
        Some(ActiveModel::Combination(Combination { spectral, spectral_weight, others }))
    }

    /// The model of a kind; `None` for the spectral one.
    fn member(&self, choice: ModelKind) -> Option<ActiveModel<'_>> {
        let trained = || self.trained(choice).map(|(model, _)| ActiveModel::Trained(model));
        self.histogram(choice).map(ActiveModel::Histogram).or_else(trained)
    }
}
