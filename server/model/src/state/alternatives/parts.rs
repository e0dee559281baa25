//! The stored form of the alternatives to the spectral model of a state.
//!
//! Invariant: a round trip gives the same alternatives; invalid parts are refused.

use std::sync::Arc;

use super::{Alternatives, Errors, TrainingRecord};
use crate::{
    AnyEnsemble, Ensemble, Gaps, GapsParts, InvalidParts, LocalDay, NumberEnsemble, Persistence, PersistenceParts,
    StateKind,
    catalogue::{HISTOGRAMS, ModelKind, TRAINED_AT_NIGHT, TrainedModel, TrainedModelParts},
    models::{ChangeAlarm, ChangeAlarmParts, HourTable, HourTableParts, OrderGains, OrderGainsParts},
};

/// The parts of [`Alternatives`], for storage.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct AlternativesParts {
    /// The readings by hour of the week.
    pub hours: HourTableParts,
    /// Faded sums of errors: of the spectral model, then of each of [`HISTOGRAMS`] where they are tried.
    pub error_sums: Vec<f64>,
    /// The last local day that was scored.
    pub last_day: Option<LocalDay>,
    /// The last learned local day.
    pub learned_day: Option<LocalDay>,
    /// The model in force: see [`ModelKind::id`].
    pub choice: u8,
    /// Total weight of the observations of the accumulator, where it differs from their number. The state keeps it, not
    /// its alternatives.
    pub weight: Option<f64>,
    /// The change alarm.
    pub alarm: ChangeAlarmParts,
    /// Persistence of the learned readings.
    pub succession: PersistenceParts,
    /// The times between the learned readings.
    pub gaps: GapsParts,
    /// Sum of |change of value| between the learned readings.
    pub changes: f64,
    /// Number of components of the spectral model that noise would not show.
    pub supported: u8,
    /// The gains of the choice of orders.
    pub gains: OrderGainsParts,
    /// Local days learned, without late ones.
    pub days: u32,
    /// The first local day of the present routine, where the change alarm has rung before.
    pub since: Option<LocalDay>,
    /// The models that were trained on readings, at most one of a kind.
    pub trained: Vec<TrainingRecordParts>,
    /// The ensemble of a state of probabilities, where it is enabled.
    pub ensemble: Option<Box<Ensemble>>,
    /// The ensemble of a state of other values, where it is enabled.
    pub numbers: Option<Box<NumberEnsemble>>,
}

/// The stored form of a model that was trained on readings.
#[derive(Clone, Debug, PartialEq)]
pub struct TrainingRecordParts {
    /// The model.
    pub model: TrainedModelParts,
    /// The last local day that it was trained on.
    pub day: LocalDay,
    /// Faded sum of errors, of this model and those before it; `None` before the first day that it was scored on.
    pub error_sum: Option<f64>,
}

impl Alternatives {
    /// The parts to store.
    pub fn to_parts(&self) -> AlternativesParts {
        AlternativesParts {
            hours: self.hours.to_parts(),
            error_sums: [self.parts.spectral].into_iter().chain(self.parts.histograms.into_iter().flatten()).collect(),
            last_day: self.parts.last_day,
            learned_day: self.parts.learned_day,
            choice: self.parts.choice.id().unwrap_or_default(),
            weight: None,
            alarm: self.alarm.to_parts(),
            succession: self.succession.to_parts(),
            gaps: self.gaps.to_parts(),
            changes: self.changes,
            supported: self.supported,
            gains: self.gains.to_parts(),
            days: self.days,
            since: self.since,
            trained: self.trained.iter().flatten().filter_map(TrainingRecord::to_parts).collect(),
            ensemble: self.ensemble().and_then(AnyEnsemble::of_probability).cloned().map(Box::new),
            numbers: self.ensemble().and_then(AnyEnsemble::of_number).cloned().map(Box::new),
        }
    }

    /// The alternatives of a probability from stored parts.
    ///
    /// # Errors
    /// [`InvalidParts`] where a number is outside its range, or a model is in force that is not there.
    pub fn from_parts(parts: AlternativesParts) -> Result<Alternatives, InvalidParts> {
        Alternatives::from_parts_of(StateKind::Probability, parts)
    }

    /// The alternatives of a state of the given kind from stored parts.
    ///
    /// # Errors
    /// [`InvalidParts`], as [`Alternatives::from_parts`] returns it.
    pub fn from_parts_of(kind: StateKind, parts: AlternativesParts) -> Result<Alternatives, InvalidParts> {
        let (spectral, histograms) = match *parts.error_sums.as_slice() {
            [spectral] => (spectral, None),
            [spectral, day, kind_of_day, week] => (spectral, Some([day, kind_of_day, week])),
            _ => {
                let found = parts.error_sums.len() as f64;
                return Err(InvalidParts::OutOfRange { field: "number of error sums", found });
            }
        };
        for &sum in parts.error_sums.iter().chain(parts.trained.iter().filter_map(|record| record.error_sum.as_ref())) {
            InvalidParts::check("error sum", sum, 0.0..=f64::MAX)?;
        }
        InvalidParts::check("sum of changes", parts.changes, 0.0..=f64::MAX)?;
        let is_of_other_kind =
            if kind == StateKind::Probability { parts.numbers.is_some() } else { parts.ensemble.is_some() };
        if is_of_other_kind {
            return Err(InvalidParts::OutOfRange { field: "ensemble of another kind of states", found: f64::NAN });
        }
        let ensemble = parts.ensemble.map(AnyEnsemble::Probability).or(parts.numbers.map(AnyEnsemble::Number));
        let mut trained = [const { None }; TRAINED_AT_NIGHT.len()];
        for record in parts.trained {
            let model = TrainedModel::from_parts_of(kind, record.model)?;
            let place = model.kind_at_night().and_then(ModelKind::place_at_night);
            let Some(slot) = place.and_then(|place| trained.get_mut(place)).filter(|slot| slot.is_none()) else {
                return Err(InvalidParts::OutOfRange { field: "models of a kind", found: 2.0 });
            };
            *slot = Some(TrainingRecord { model: Arc::new(model), day: record.day, error: record.error_sum });
        }
        let is_there = |kind: &ModelKind| match kind.place_at_night() {
            Some(place) => trained.get(place).is_some_and(Option::is_some),
            None => !HISTOGRAMS.contains(kind) || histograms.is_some(),
        };
        let choice = ModelKind::from_id(parts.choice).filter(is_there);
        let unknown = InvalidParts::OutOfRange { field: "chosen model", found: f64::from(parts.choice) };
        Ok(Alternatives {
            hours: HourTable::from_parts(&parts.hours)?,
            parts: Errors {
                spectral,
                histograms,
                last_day: parts.last_day,
                learned_day: parts.learned_day,
                choice: choice.ok_or(unknown)?,
            },
            alarm: ChangeAlarm::from_parts(parts.alarm)?,
            succession: Persistence::from_parts_of(kind, parts.succession)?,
            gaps: Gaps::from_parts(parts.gaps)?,
            changes: parts.changes,
            supported: parts.supported,
            gains: OrderGains::from_parts(parts.gains)?,
            days: parts.days,
            since: parts.since,
            ensemble: ensemble.map(Arc::new),
            trained,
        })
    }
}

impl TrainingRecord {
    fn to_parts(&self) -> Option<TrainingRecordParts> {
        Some(TrainingRecordParts { model: self.model.to_parts()?, day: self.day, error_sum: self.error })
    }
}
