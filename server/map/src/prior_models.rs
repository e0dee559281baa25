//! The models of untrained states.
//!
//! Invariant: there is one model of each kind, shared by all states that have learned nothing, report samples, and have
//! no known sensor.

use std::sync::Arc;

use tidemap_model::{LearnedRows, Reporting, StateKind, StateModel};

use crate::{directory::StateInfo, event::StateSensor, spec::MapSpec};

/// An untrained model of each kind.
#[derive(Clone, Debug)]
pub(crate) struct PriorModels {
    probability: Arc<StateModel>,
    continuous: Arc<StateModel>,
    count: Arc<StateModel>,
}

impl PriorModels {
    /// The prior models of a map: probabilities predict the map's prior, other kinds 0.
    pub(crate) fn new(spec: &MapSpec) -> PriorModels {
        PriorModels {
            probability: Arc::new(StateModel::with_prior(&spec.periodicities, spec.prior)),
            continuous: Arc::new(StateModel::of_kind(StateKind::Continuous)),
            count: Arc::new(StateModel::of_kind(StateKind::Count)),
        }
    }

    pub(crate) fn of(&self, kind: StateKind) -> &Arc<StateModel> {
        match kind {
            StateKind::Probability => &self.probability,
            StateKind::Continuous => &self.continuous,
            StateKind::Count => &self.count,
        }
    }

    /// The model with which a state begins to learn.
    pub(crate) fn beginning(&self, info: &StateInfo) -> Arc<StateModel> {
        self.with(info.kind, info.sensor, info.reporting)
    }

    /// The model with which the state of a model began to learn.
    pub(crate) fn beginning_of(&self, model: &StateModel) -> Arc<StateModel> {
        self.with(model.kind(), model.sensor(), model.reporting())
    }

    fn with(&self, kind: StateKind, sensor: Option<StateSensor>, reporting: Reporting) -> Arc<StateModel> {
        let prior = self.of(kind);
        if sensor.is_none() && reporting == Reporting::Samples {
            return Arc::clone(prior);
        }
        let model = StateModel::clone(prior).with_reporting(reporting, LearnedRows::default());
        Arc::new(match sensor {
            Some(sensor) => model.with_sensor(sensor),
            None => model,
        })
    }
}
