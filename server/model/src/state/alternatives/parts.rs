//! What is known of a state apart from its spectrum, taken to pieces to be stored, and put together again.
//!
//! Invariant: what is put together is what was taken to pieces; what cannot be is refused.

use std::sync::Arc;

use super::{Alternatives, Errors, Fit, HISTOGRAMS, ModelChoice};
use crate::{
    InvalidParts, LocalDay, Persistence, PersistenceParts, StateKind,
    family::{Calibrated, CalibratedParts, ChangeAlarm, ChangeAlarmParts, HourTable, HourTableParts},
};

/// The number under which the calibrated model is stored as the one in force, clear of those of histograms.
const CALIBRATED: u8 = 128;

/// What [`Alternatives`] consist of, for storage.
#[derive(Clone, Debug, PartialEq)]
pub struct AlternativesParts {
    /// What was read in each hour of the week.
    pub hours: HourTableParts,
    /// Faded sums of errors: of the spectral model, then of each of [`HISTOGRAMS`].
    pub error_sums: Vec<f64>,
    /// The last local day that was scored.
    pub last_day: Option<LocalDay>,
    /// The last local day that was folded in.
    pub folded_day: Option<LocalDay>,
    /// The model in force: 0 the spectral model, 128 the calibrated one, else the number of the histogram, from 1.
    pub choice: u8,
    /// The change alarm.
    pub alarm: ChangeAlarmParts,
    /// How the readings that were folded in follow each other.
    pub succession: PersistenceParts,
    /// Components of the spectral model that noise would not show as well.
    pub supported: u8,
    /// Local days folded in, those that came late not counted.
    pub days: u32,
    /// The calibrated model; `None` before its first fit.
    pub calibrated: Option<CalibratedFitParts>,
}

/// What is kept of a calibrated model of a state, for storage.
#[derive(Clone, Debug, PartialEq)]
pub struct CalibratedFitParts {
    /// The model.
    pub model: CalibratedParts,
    /// The last local day that it was fitted to.
    pub day: LocalDay,
    /// Faded sum of errors, of this fit and those before it; `None` before the first day that it was scored on.
    pub error_sum: Option<f64>,
}

impl Alternatives {
    /// What to store.
    pub fn to_parts(&self) -> AlternativesParts {
        AlternativesParts {
            hours: self.hours.to_parts(),
            error_sums: std::iter::once(self.parts.spectral).chain(self.parts.histograms).collect(),
            last_day: self.parts.last_day,
            folded_day: self.parts.folded_day,
            choice: match self.parts.choice {
                ModelChoice::Spectral => 0,
                ModelChoice::Histogram(number) => number + 1,
                ModelChoice::Calibrated => CALIBRATED,
            },
            alarm: self.alarm.to_parts(),
            succession: self.succession.to_parts(),
            supported: self.supported,
            days: self.days,
            calibrated: self.calibrated.as_ref().map(|fit| CalibratedFitParts {
                model: fit.model.to_parts(),
                day: fit.day,
                error_sum: fit.error,
            }),
        }
    }

    /// Those of a probability from what was stored.
    ///
    /// # Errors
    /// [`InvalidParts`] where a number is outside its range, or a model is in force that is not there.
    pub fn from_parts(parts: AlternativesParts) -> Result<Alternatives, InvalidParts> {
        Alternatives::from_parts_of(StateKind::Probability, parts)
    }

    /// Those of a state of that kind from what was stored.
    ///
    /// # Errors
    /// As [`Alternatives::from_parts`].
    pub fn from_parts_of(kind: StateKind, parts: AlternativesParts) -> Result<Alternatives, InvalidParts> {
        let &[spectral, day, kind_of_day, week] = parts.error_sums.as_slice() else {
            return Err(InvalidParts::OutOfRange {
                field: "number of error sums",
                found: parts.error_sums.len() as f64,
            });
        };
        let calibrated_sum = parts.calibrated.as_ref().and_then(|fit| fit.error_sum);
        for &sum in parts.error_sums.iter().chain(&calibrated_sum) {
            InvalidParts::check("error sum", sum, 0.0..=f64::MAX)?;
        }
        let choice = match parts.choice {
            0 => ModelChoice::Spectral,
            number if usize::from(number) <= HISTOGRAMS.len() => ModelChoice::Histogram(number - 1),
            CALIBRATED if parts.calibrated.is_some() => ModelChoice::Calibrated,
            number => return Err(InvalidParts::OutOfRange { field: "chosen model", found: f64::from(number) }),
        };
        let fit = |fit: CalibratedFitParts| {
            let model = Arc::new(Calibrated::from_parts(fit.model)?);
            Ok(Fit { model, day: fit.day, error: fit.error_sum })
        };
        Ok(Alternatives {
            hours: HourTable::from_parts(parts.hours)?,
            parts: Errors {
                spectral,
                histograms: [day, kind_of_day, week],
                last_day: parts.last_day,
                folded_day: parts.folded_day,
                choice,
            },
            alarm: ChangeAlarm::from_parts(parts.alarm)?,
            succession: Persistence::from_parts_of(kind, parts.succession)?,
            supported: parts.supported,
            days: parts.days,
            calibrated: parts.calibrated.map(fit).transpose()?,
        })
    }
}
