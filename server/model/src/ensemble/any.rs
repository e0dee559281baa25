//! The ensemble of a state of any kind of values.
//!
//! Invariant: a state of probabilities has an [`Ensemble`], any other a [`NumberEnsemble`].

use super::{Ensemble, NumberEnsemble, OtherModels};
use crate::{LocalDay, Sample, StateKind, models::Moment};

/// The ensemble of a state.
#[derive(Clone, Debug, PartialEq)]
pub enum AnyEnsemble {
    /// An ensemble of probabilities.
    Probability(Box<Ensemble>),
    /// An ensemble of continuous values or counts.
    Number(Box<NumberEnsemble>),
}

impl AnyEnsemble {
    /// An ensemble that has learned no bins.
    pub fn new(kind: StateKind) -> AnyEnsemble {
        match kind {
            StateKind::Probability => AnyEnsemble::Probability(Box::default()),
            StateKind::Continuous | StateKind::Count => AnyEnsemble::Number(Box::default()),
        }
    }

    /// The last learned day.
    pub fn last_day(&self) -> Option<LocalDay> {
        match self {
            AnyEnsemble::Probability(ensemble) => ensemble.last_day(),
            AnyEnsemble::Number(ensemble) => ensemble.last_day(),
        }
    }

    /// The mean of all bins.
    pub fn mean(&self) -> f64 {
        match self {
            AnyEnsemble::Probability(ensemble) => ensemble.mean(),
            AnyEnsemble::Number(ensemble) => ensemble.mean(),
        }
    }

    /// Does the same as [`Ensemble::prepare`].
    pub fn prepare(&mut self, day: LocalDay, others: OtherModels<'_>) {
        match self {
            AnyEnsemble::Probability(ensemble) => ensemble.prepare(day, others.chosen),
            AnyEnsemble::Number(ensemble) => ensemble.prepare(day, others),
        }
    }

    /// Does the same as [`Ensemble::learn_day`].
    pub fn learn_day(
        &mut self,
        day: LocalDay,
        samples: &[Sample],
        newer: &[Sample],
        others: OtherModels<'_>,
    ) -> Option<f64> {
        match self {
            AnyEnsemble::Probability(ensemble) => {
                ensemble.expect_year(others.expects_year);
                ensemble.learn_day(day, samples, newer, others.chosen)
            }
            AnyEnsemble::Number(ensemble) => ensemble.learn_day(day, samples, newer, others),
        }
    }

    /// Predicted values at moments; faster if the moments are in order of time.
    pub fn predict(&self, moments: &[Moment], others: OtherModels<'_>) -> Vec<f64> {
        match self {
            AnyEnsemble::Probability(ensemble) => {
                ensemble.predict(moments, others.chosen).iter().map(|predicted| predicted.value()).collect()
            }
            AnyEnsemble::Number(ensemble) => ensemble.predict(moments, others),
        }
    }

    /// The ensemble of a state of probabilities; `None` for another.
    pub fn of_probability(&self) -> Option<&Ensemble> {
        match self {
            AnyEnsemble::Probability(ensemble) => Some(ensemble),
            AnyEnsemble::Number(_) => None,
        }
    }

    /// The ensemble of a state of numbers; `None` for another.
    pub fn of_number(&self) -> Option<&NumberEnsemble> {
        match self {
            AnyEnsemble::Number(ensemble) => Some(ensemble),
            AnyEnsemble::Probability(_) => None,
        }
    }
}
