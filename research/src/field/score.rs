//! Scores: the squared error, the loss and the coverage of every way to predict, by unit and lead time.
//!
//! Invariant: the standard deviation of a baseline comes from its errors on earlier test days, or else from training
//! data.

use tidemap_model::{LocalDay, Sample, StateKind, models::Interval};

use super::{
    baselines::BASELINES,
    lead::Lead,
    recording::ReadRecording,
    replay::{ASKED_MODELS, Forecast, MapAnswer},
};
use crate::score::log_loss;

/// The names of all ways to predict: the map's, then the baselines.
pub const FIELD_MODELS: [&str; ASKED_MODELS + BASELINES.len()] = {
    let [mean, hours, fading, newest, weeks] = BASELINES;
    ["auto", "ensemble", mean, hours, fading, newest, weeks]
};
/// Standard deviations from the middle to the end of an interval of 80 %.
const HALF_WIDTH: f64 = 1.2816;

/// The sums of one way to predict.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct FieldErrors {
    /// Number of predicted readings.
    pub predictions: u64,
    squares: f64,
    losses: f64,
    intervals: u64,
    held: u64,
}

impl FieldErrors {
    /// The mean squared error, in the square of the unit.
    pub fn mse(&self) -> f64 {
        self.squares / self.predictions.max(1) as f64
    }

    /// The mean log loss of probabilities in nats, the mean CRPS of other values in their unit.
    pub fn loss(&self) -> f64 {
        self.losses / self.predictions.max(1) as f64
    }

    /// The share of intervals of 80 % that contained the mean of their hour; none without intervals.
    pub fn coverage(&self) -> Option<f64> {
        (self.intervals > 0).then(|| self.held as f64 / self.intervals as f64)
    }

    fn cover(&mut self, interval: Interval, mean: f64) {
        // The ends may be off by rounding.
        let rounding = 1e-9 * (1.0 + mean.abs());
        self.intervals += 1;
        self.held += u64::from(interval.lower - rounding <= mean && mean <= interval.upper + rounding);
    }
}

/// The errors of a way to predict a state on the test days before.
#[derive(Clone, Copy, Debug, Default)]
struct EarlierErrors {
    day: LocalDay,
    today: (f64, f64),
    before: (f64, f64),
}

impl EarlierErrors {
    /// The standard deviation of errors of earlier days; none on the first.
    fn deviation(&mut self, day: LocalDay) -> Option<f64> {
        if day != self.day {
            let (count, squares) = std::mem::take(&mut self.today);
            self.before = (self.before.0 + count, self.before.1 + squares);
            self.day = day;
        }
        let (count, squares) = self.before;
        (count > 0.0).then(|| (squares / count).sqrt())
    }

    fn add(&mut self, error: f64) {
        self.today = (self.today.0 + 1.0, self.today.1 + error * error);
    }
}

type ByLead<T> = [[T; FIELD_MODELS.len()]; Lead::ALL.len()];

/// The scores of one recording, full or thinned.
pub(super) struct Scorer<'a> {
    recording: &'a ReadRecording,
    /// By state: the deviation of the training data around its mean.
    deviations: Vec<f64>,
    /// By state.
    earlier: Vec<ByLead<EarlierErrors>>,
    /// By group.
    errors: Vec<ByLead<FieldErrors>>,
}

impl<'a> Scorer<'a> {
    /// No scores of a recording of which these readings of each state are learned.
    pub(super) fn new(recording: &'a ReadRecording, learned: &[Vec<Sample>]) -> Self {
        let first = recording.asked.keys().next().copied().unwrap_or_default();
        let training = |samples: &Vec<Sample>| {
            let values = samples.iter().take_while(|sample| sample.local_day() < first).map(|sample| sample.value);
            deviation(&values.collect::<Vec<_>>())
        };
        Self {
            recording,
            deviations: learned.iter().map(training).collect(),
            earlier: vec![ByLead::default(); recording.states.len()],
            errors: vec![ByLead::default(); recording.groups.len()],
        }
    }

    /// Adds the predictions of a reading.
    pub(super) fn add(&mut self, forecast: &Forecast) {
        let Forecast { state, truth, lead, answers, baselines } = *forecast;
        let asked = answers.into_iter();
        let tables = baselines.into_iter().map(|value| Some(MapAnswer { value, interval: None }));
        for (model, answer) in asked.chain(tables).enumerate() {
            if let Some(answer) = answer {
                self.add_answer((state, lead, model), truth, answer);
            }
        }
    }

    fn add_answer(&mut self, (index, lead, model): (usize, Lead, usize), truth: Sample, answer: MapAnswer) {
        let state = &self.recording.states[index];
        let MapAnswer { value, interval } = answer;
        let earlier = &mut self.earlier[index][lead as usize][model];
        let usual = earlier.deviation(truth.local_day()).unwrap_or(self.deviations[index]);
        earlier.add(value - truth.value);
        let errors = &mut self.errors[state.group][lead as usize][model];
        errors.predictions += 1;
        errors.squares += (value - truth.value).powi(2);
        errors.losses += if state.kind == StateKind::Probability {
            log_loss(value, truth.value)
        } else {
            let stated = interval.map(|interval| (interval.upper - interval.lower) / 2.0 / HALF_WIDTH);
            crps(value, stated.unwrap_or(usual), truth.value)
        };
        if let Some(interval) = interval {
            errors.cover(interval, state.mean_of_hour(truth));
        }
    }

    /// The errors by group, lead time and way to predict.
    pub(super) fn errors(self) -> Vec<ByLead<FieldErrors>> {
        self.errors
    }
}

/// The standard deviation of values; 0 without values.
fn deviation(values: &[f64]) -> f64 {
    let count = values.len().max(1) as f64;
    let mean = values.iter().sum::<f64>() / count;
    (values.iter().map(|value| (value - mean).powi(2)).sum::<f64>() / count).sqrt()
}

/// The continuous ranked probability score of a normal distribution, in the unit of the values: the distance of a value
/// if the deviation is 0.
pub(super) fn crps(mean: f64, deviation: f64, value: f64) -> f64 {
    use std::f64::consts::{PI, SQRT_2};
    let distance = (value - mean).abs();
    if deviation <= f64::EPSILON * distance {
        return distance;
    }
    let z = distance / deviation;
    let density = (-z * z / 2.0).exp() / (2.0 * PI).sqrt();
    deviation * (z * libm::erf(z / SQRT_2) + 2.0 * density - 1.0 / PI.sqrt())
}
