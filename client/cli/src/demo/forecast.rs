//! The daemon's forecasts of a day, and the truth of the simulation.
//!
//! Invariant: the truth is computed after the prediction and is never sent.

use tidemap_client::{
    Client,
    queries::{ModelKind, ModelSelector},
};
use tidemap_sim::Office;

use super::MAP;

/// One state over one day; the three series have one entry per time.
#[derive(Clone, Debug, PartialEq)]
pub(super) struct Forecast {
    pub(super) state: &'static str,
    /// Number of observations behind the forecast.
    pub(super) observations: u64,
    /// Probabilities of the chosen model.
    pub(super) predicted: Vec<f64>,
    /// Probabilities of the mean.
    pub(super) plain: Vec<f64>,
    pub(super) truth: Vec<f64>,
}

impl Forecast {
    /// Mean squared error of the prediction.
    pub(super) fn error(&self) -> f64 {
        mean_squared(&self.predicted, &self.truth)
    }

    /// Mean squared error of the mean model.
    pub(super) fn plain_error(&self) -> f64 {
        mean_squared(&self.plain, &self.truth)
    }
}

/// Mean errors over several states: of the predictions, and of the mean model.
pub(super) fn errors(forecasts: &[Forecast]) -> (f64, f64) {
    let mean = |error: fn(&Forecast) -> f64| forecasts.iter().map(error).sum::<f64>() / forecasts.len().max(1) as f64;
    (mean(Forecast::error), mean(Forecast::plain_error))
}

/// Forecasts of all states of the office, in their order, at times in nanoseconds UTC.
pub(super) async fn all(client: &Client, office: &Office, times_nanos: &[i64]) -> anyhow::Result<Vec<Forecast>> {
    let mut forecasts: Vec<Forecast> = office.states().iter().map(|&state| Forecast::empty(state)).collect();
    for kind in [ModelKind::Auto, ModelKind::Mean] {
        let names = office.states().iter().map(|&state| state.to_owned()).collect();
        let model = ModelSelector { kind, ..ModelSelector::default() };
        let mut predictions = client.predict(MAP, names, times_nanos.to_vec(), model);
        while let Some(run) = predictions.next().await? {
            let forecast = &mut forecasts[run.state];
            if kind == ModelKind::Auto {
                forecast.observations = run.observations;
                forecast.predicted.extend(run.probabilities);
            } else {
                forecast.plain.extend(run.probabilities);
            }
        }
    }
    for (state, forecast) in forecasts.iter_mut().enumerate() {
        forecast.truth = times_nanos.iter().map(|&time| office.truth(state, time)).collect();
    }
    Ok(forecasts)
}

impl Forecast {
    fn empty(state: &'static str) -> Self {
        Self { state, observations: 0, predicted: Vec::new(), plain: Vec::new(), truth: Vec::new() }
    }
}

fn mean_squared(predicted: &[f64], truth: &[f64]) -> f64 {
    let sum: f64 = predicted.iter().zip(truth).map(|(p, s)| (p - s) * (p - s)).sum();
    sum / truth.len().max(1) as f64
}
