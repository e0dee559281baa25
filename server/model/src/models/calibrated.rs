//! The calibrated model: a profile of the week that is only as detailed as the observations justify.
//!
//! The profile is refined in tiers, each shrunk towards the one before: the mean, the day broadly smoothed, the day,
//! the kind of day (Monday to Friday, or weekend), the day of the week. How far a tier departs from the one before
//! follows from credibility (H. Bühlmann, "Experience rating and credibility", ASTIN Bulletin 4, 1967). It compares how
//! much days that should be alike differ with how much the finer profile differs from the coarser. So a state without a
//! weekly rhythm gets none, and pure noise gets its mean. Later days count more, so that the level follows the last
//! weeks.
//!
//! Invariant: a prediction lies between the lowest and the highest reading that it was trained on.

use crate::InvalidParts;
use crate::civil::NANOS_PER_SEC;
use crate::fields::{FINITE, StoredFields, Visitor};

use super::{CannotTrain, Moment, Readings, TemporalModel};

mod options;
mod slots;
mod tiers;

pub use options::CalibratedOptions;
use slots::{DAYS_OF_WEEK, SLOTS_PER_DAY, SlotSums, days};

#[cfg(test)]
mod tests;

/// Slots of ten minutes in a week, from Monday 00:00 local.
const SLOTS_PER_WEEK: usize = SLOTS_PER_DAY * DAYS_OF_WEEK;

/// The parts of a [`Calibrated`] model, for storage.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct CalibratedParts {
    /// Number of readings that it was trained on, at least 1.
    pub observations: u64,
    /// The lowest reading.
    pub lowest: f64,
    /// The highest reading.
    pub highest: f64,
    /// The predicted value in each slot of ten minutes of the week, from Monday 00:00 local: 1,008 of them, each
    /// between the lowest and the highest reading.
    pub profile: Vec<f64>,
}

/// Tags 1 and 2 belong to the training.
impl StoredFields for CalibratedParts {
    fn fields<V: Visitor>(&mut self, visitor: &mut V) -> Result<(), V::Refused> {
        visitor.integer(3, "observations of a calibrated model", &mut self.observations)?;
        visitor.number(4, "lowest reading", FINITE, &mut self.lowest)?;
        visitor.number(5, "highest reading", FINITE, &mut self.highest)?;
        visitor.list(6, "profile of a calibrated model", FINITE, &mut self.profile)
    }
}

/// A profile of the local week, shrunk to what the observations justify; see the module's head.
#[derive(Clone, Debug, PartialEq)]
pub struct Calibrated {
    parts: CalibratedParts,
}

impl Calibrated {
    /// Trains the model on the readings of one state, in time proportional to their number; readings that are not
    /// finite are ignored. A half-life of the readings applies in addition to the memory of the options.
    ///
    /// # Errors
    /// [`CannotTrain`] where there are no readings or an option is outside its range.
    pub fn train(readings: Readings<'_>, options: CalibratedOptions) -> Result<Calibrated, CannotTrain> {
        options.check()?;
        let values = readings.samples.iter().map(|sample| sample.value).filter(|value| value.is_finite());
        let (observations, lowest, highest) = values
            .fold((0, f64::INFINITY, f64::NEG_INFINITY), |(count, lowest, highest), value| {
                (count + 1, value.min(lowest), value.max(highest))
            });
        if observations == 0 {
            return Err(CannotTrain::NoReadings);
        }
        // Values are scaled to the range. The range is computed in halves, because the range itself may overflow.
        let half_range = highest / 2.0 - lowest / 2.0;
        let newest = readings.samples.last().map_or(0, |sample| sample.local_day().0);
        let profile = if half_range > 0.0 {
            let to_unit = |value: f64| (value / 2.0 - lowest / 2.0) / half_range;
            let sums = SlotSums::of(days(readings, to_unit), newest, options);
            tiers::profile(&sums, options).into_iter().map(|x| between(lowest, highest, x)).collect()
        } else {
            vec![lowest; SLOTS_PER_WEEK]
        };
        Ok(Calibrated { parts: CalibratedParts { observations, lowest, highest, profile } })
    }

    /// Number of readings that the model was trained on.
    pub fn observations(&self) -> u64 {
        self.parts.observations
    }

    /// The parts of the model, for storage.
    pub fn to_parts(&self) -> CalibratedParts {
        self.parts.clone()
    }

    /// The model from stored parts.
    ///
    /// # Errors
    /// [`InvalidParts`] if the length of the profile is not 1,008, or a number is not finite or not between the lowest
    /// and the highest reading.
    pub fn from_parts(parts: CalibratedParts) -> Result<Calibrated, InvalidParts> {
        if parts.profile.len() != SLOTS_PER_WEEK {
            return Err(InvalidParts::OutOfRange { field: "slots of the week", found: parts.profile.len() as f64 });
        }
        if parts.observations == 0 {
            return Err(InvalidParts::OutOfRange { field: "observations", found: 0.0 });
        }
        InvalidParts::check("lowest", parts.lowest, f64::MIN..=f64::MAX)?;
        InvalidParts::check("highest", parts.highest, parts.lowest..=f64::MAX)?;
        for &value in &parts.profile {
            InvalidParts::check("profile", value, parts.lowest..=parts.highest)?;
        }
        Ok(Calibrated { parts })
    }
}

impl TemporalModel for Calibrated {
    /// Between the middles of two slots the profile is linear.
    fn predict(&self, at: Moment) -> f64 {
        const NANOS_PER_SLOT: i64 = 86_400 * NANOS_PER_SEC / SLOTS_PER_DAY as i64;
        const NANOS_PER_WEEK: i64 = NANOS_PER_SLOT * SLOTS_PER_WEEK as i64;
        // 1970-01-01 was a Thursday: three days after the week began.
        let since_monday = (at.civil_nanos().rem_euclid(NANOS_PER_WEEK) + 3 * 86_400 * NANOS_PER_SEC) % NANOS_PER_WEEK;
        let since_middle = (since_monday + NANOS_PER_WEEK - NANOS_PER_SLOT / 2) % NANOS_PER_WEEK;
        let before = (since_middle / NANOS_PER_SLOT) as usize;
        let share = (since_middle % NANOS_PER_SLOT) as f64 / NANOS_PER_SLOT as f64;
        let profile = &self.parts.profile;
        let (from, to) = (profile[before], profile[(before + 1) % SLOTS_PER_WEEK]);
        between(from, to, share)
    }
}

/// Linear interpolation that never leaves the two ends, whatever the rounding.
fn between(from: f64, to: f64, share: f64) -> f64 {
    let found = from * (1.0 - share) + to * share;
    found.clamp(from.min(to), from.max(to))
}
