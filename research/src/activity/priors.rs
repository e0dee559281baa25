//! The priors: the probability of each activity at each minute of a day, learned from the days before.
//!
//! Invariant: a day is predicted before it is learned; the days before the first are even.

use tidemap_map::{
    event::{Observations, StateKind},
    ids::StateId,
    name::{MapName, ProducerKey, StateName},
    spec::MapSpec,
};
use tidemap_model::{
    ORDER_MAX, Periodicities, Sample, TrainedModel,
    catalogue::{ModelKind, TrainingOptions},
    models::{Moment, Readings, TemporalModel as _},
    selector::ModelSelector,
};

use super::{ActivityError, ActivityModel, minute_nanos};
use crate::{nightly_map::NightlyMap, place_recording::DAY_MINUTES};

/// The temporal priors of all activities.
#[derive(Debug)]
pub(super) enum TemporalPriors {
    Even(usize),
    One(Box<TrainedNightly>),
    Auto(Box<ActivityMap>),
}

impl TemporalPriors {
    pub(super) fn new(model: ActivityModel, labels: usize) -> Result<Self, ActivityError> {
        Ok(match model {
            ActivityModel::Even => Self::Even(labels),
            ActivityModel::One(kind, order) => Self::One(Box::new(TrainedNightly::new(kind, order, labels))),
            ActivityModel::Auto => Self::Auto(Box::new(ActivityMap::new(labels)?)),
        })
    }

    /// For each minute of a day, the probability of each activity.
    pub(super) fn day(&mut self, day: usize) -> Vec<Vec<f64>> {
        let times: Vec<i64> = (0..DAY_MINUTES).map(|minute| minute_nanos(day, minute)).collect();
        match self {
            Self::Even(labels) => vec![vec![even(*labels); *labels]; DAY_MINUTES],
            Self::One(trained) => times.iter().map(|&nanos| trained.predict(nanos)).collect(),
            Self::Auto(map) => map.predict(day, &times),
        }
    }

    /// Learns which activity was recognised in each minute of a day, at the midnight that ends it.
    pub(super) fn learn(&mut self, day: usize, recognised: &[usize]) -> Result<(), ActivityError> {
        match self {
            Self::Even(_) => Ok(()),
            Self::One(trained) => trained.learn(day, recognised),
            Self::Auto(map) => map.learn(day, recognised),
        }
    }
}

fn even(labels: usize) -> f64 {
    1.0 / labels as f64
}

/// Whether an activity was the recognised one, minute by minute.
fn samples(day: usize, recognised: &[usize], label: usize) -> impl Iterator<Item = Sample> {
    recognised.iter().enumerate().map(move |(minute, &found)| Sample {
        utc_nanos: minute_nanos(day, minute),
        offset_secs: 0,
        value: f64::from(u8::from(found == label)),
    })
}

/// A kind of model for each activity, trained on all days before.
#[derive(Debug)]
pub(super) struct TrainedNightly {
    kind: ModelKind,
    options: TrainingOptions,
    periodicities: Periodicities,
    readings: Vec<Vec<Sample>>,
    trained: Vec<TrainedModel>,
}

impl TrainedNightly {
    fn new(kind: ModelKind, order: Option<usize>, labels: usize) -> Self {
        let options = TrainingOptions { order: order.unwrap_or(ORDER_MAX), ..TrainingOptions::default() };
        let (periodicities, readings) = (Periodicities::default(), vec![Vec::new(); labels]);
        Self { kind, options, periodicities, readings, trained: Vec::new() }
    }

    fn predict(&self, utc_nanos: i64) -> Vec<f64> {
        if self.trained.is_empty() {
            return vec![even(self.readings.len()); self.readings.len()];
        }
        self.trained.iter().map(|model| model.predict(Moment { utc_nanos, offset_secs: 0 })).collect()
    }

    fn learn(&mut self, day: usize, recognised: &[usize]) -> Result<(), ActivityError> {
        for (label, readings) in self.readings.iter_mut().enumerate() {
            readings.extend(samples(day, recognised, label));
        }
        let train = |readings: &Vec<Sample>| {
            let readings = Readings::new(readings);
            self.kind.train_with(readings, StateKind::Probability, &self.periodicities, self.options)
        };
        self.trained = self.readings.iter().map(train).collect::<Result<Vec<TrainedModel>, _>>()?;
        Ok(())
    }
}

/// A map with a state for each activity, as a daemon has it: observed through the day, updated at midnight.
#[derive(Debug)]
pub(super) struct ActivityMap {
    map: NightlyMap,
    labels: usize,
}

impl ActivityMap {
    fn new(labels: usize) -> Result<Self, ActivityError> {
        let name = MapName::new("activities").map_err(ActivityError::setting)?;
        let producer = ProducerKey::new("classifier", "").map_err(ActivityError::setting)?;
        let mut map = NightlyMap::new(MapSpec { created_nanos: minute_nanos(0, 0), ..MapSpec::new(name) }, producer);
        for label in 0..labels {
            let name = StateName::new(&format!("activity-{label}")).map_err(ActivityError::setting)?;
            map.add_probability(name)?;
        }
        Ok(Self { map, labels })
    }

    fn predict(&mut self, day: usize, times: &[i64]) -> Vec<Vec<f64>> {
        if day == 0 {
            return vec![vec![even(self.labels); self.labels]; times.len()];
        }
        let view = self.map.view();
        let prepared = view.prepare(times);
        let mut by_time = vec![vec![0.0; self.labels]; times.len()];
        let mut values = vec![0.0; times.len()];
        for label in 0..self.labels {
            view.predict_into(StateId(label as u32), &prepared, ModelSelector::default(), &mut values);
            by_time.iter_mut().zip(&values).for_each(|(priors, &value)| priors[label] = value);
        }
        by_time
    }

    fn learn(&mut self, day: usize, recognised: &[usize]) -> Result<(), ActivityError> {
        let midnight_nanos = minute_nanos(day + 1, 0);
        let mut event = Observations::default();
        for label in 0..self.labels {
            samples(day, recognised, label).for_each(|sample| event.push(StateId(label as u32), sample));
        }
        self.map.observe(event, (self.labels * recognised.len()) as u64, midnight_nanos)?;
        self.map.update(midnight_nanos)
    }
}
