//! An ensemble that is trained on all readings at once, as if updates had learned them night by night.
//!
//! The chosen model of the ensemble is the calibrated one, trained again on the days on which updates train it.
//! Invariant: each day is predicted by models that were trained on the days before it.

use super::{AnyEnsemble, OtherModels};
use crate::{
    LocalDay, StateKind,
    models::{Calibrated, CalibratedOptions, CannotTrain, Moment, NIGHTLY_WINDOW_NANOS, Readings, TemporalModel},
};

/// The calibrated model is trained daily up to this day, then once every this many days.
const RETRAIN_DAYS: i64 = 7;
/// The calibrated model is first trained after this many days.
const FIRST_DAYS: i64 = 3;

/// An ensemble with its chosen model.
#[derive(Clone, Debug, PartialEq)]
pub struct TrainedEnsemble {
    kind: StateKind,
    ensemble: AnyEnsemble,
    chosen: Option<Calibrated>,
}

/// A model that always predicts the mean of an ensemble.
struct MeanAlone(f64);

impl TemporalModel for MeanAlone {
    fn predict(&self, _: Moment) -> f64 {
        self.0
    }
}

/// The mean serves as the model of all history.
fn others<'a>(chosen: Option<&'a Calibrated>, mean: &'a MeanAlone) -> OtherModels<'a> {
    match chosen {
        Some(chosen) => OtherModels { chosen, lasting: mean, expects_year: false },
        None => OtherModels { chosen: mean, lasting: mean, expects_year: false },
    }
}

impl TrainedEnsemble {
    /// Trains an ensemble on the readings of a state whose values are of `kind`. A half-life does not apply: the
    /// members forget by themselves.
    ///
    /// # Errors
    /// [`CannotTrain`] where there are no readings, or the stop signal is set.
    pub fn train(readings: Readings<'_>, kind: StateKind) -> Result<TrainedEnsemble, CannotTrain> {
        let samples = readings.samples;
        if samples.is_empty() {
            return Err(CannotTrain::NoReadings);
        }
        let mut trained = TrainedEnsemble { kind, ensemble: AnyEnsemble::new(kind), chosen: None };
        let (mut days, mut trained_on, mut seen) = (0, None::<LocalDay>, 0);
        for of_day in samples.chunk_by(|one, next| one.local_day() == next.local_day()) {
            readings.stop.check()?;
            let (Some(first), Some(newest)) = (of_day.first(), of_day.last()) else { continue };
            let day = first.local_day();
            let mean = MeanAlone(trained.ensemble.mean());
            trained.ensemble.learn_day(day, of_day, &[], others(trained.chosen.as_ref(), &mean));
            seen += of_day.len();
            days += 1;
            let since = trained_on.map(|last| i64::from(day.0) - i64::from(last.0));
            let due = since.map_or(days >= FIRST_DAYS, |since| since >= RETRAIN_DAYS || days <= RETRAIN_DAYS);
            if due {
                let oldest = newest.utc_nanos.saturating_sub(NIGHTLY_WINDOW_NANOS);
                let window = samples.get(..seen).unwrap_or(samples);
                let window = window.get(window.partition_point(|sample| sample.utc_nanos < oldest)..).unwrap_or(window);
                let of_window = Readings { stop: readings.stop, ..Readings::new(window) };
                trained.chosen = Some(Calibrated::train(of_window, CalibratedOptions::default())?);
                trained_on = Some(day);
            }
        }
        Ok(trained)
    }
}

impl TemporalModel for TrainedEnsemble {
    fn predict(&self, at: Moment) -> f64 {
        let mean = MeanAlone(self.ensemble.mean());
        let predicted = self.ensemble.predict(&[at], others(self.chosen.as_ref(), &mean));
        self.kind.saturate(predicted.first().copied().unwrap_or(mean.0))
    }
}
