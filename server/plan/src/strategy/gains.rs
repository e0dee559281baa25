//! The gain of each place in each slot.
//!
//! Invariant: every gain is finite and from 0 to [`GAIN_MAX`]; there is at least one slot and one place, and at most
//! [`GAINS_MAX`] of both together.

use super::{GAIN_MAX, GAINS_MAX, StrategyError};

/// The gain of visiting a place in a slot, for all slots and places: the entropy of the observed states, in bits, or
/// another measure that is 0 for a useless visit.
#[derive(Clone, Debug, PartialEq)]
pub struct Gains {
    slots: usize,
    places: usize,
    /// The gains, by slot and then by place.
    values: Vec<f64>,
}

impl Gains {
    /// Calls `gain` for all slots and places, slot by slot.
    ///
    /// # Errors
    /// [`StrategyError`] where there are no slots or no places, or too many of both together (`gain` is not called
    /// then), or a gain is negative, NaN or above [`GAIN_MAX`].
    pub fn of(slots: usize, places: usize, mut gain: impl FnMut(usize, usize) -> f64) -> Result<Gains, StrategyError> {
        Gains::check_size(slots, places)?;
        let mut values = Vec::with_capacity(slots * places);
        for slot in 0..slots {
            for place in 0..places {
                let found = gain(slot, place);
                if !(0.0..=GAIN_MAX).contains(&found) {
                    return Err(StrategyError::Gain { slot, place, found });
                }
                values.push(found);
            }
        }
        Ok(Gains { slots, places, values })
    }

    /// Returns `Ok` if a matrix may have this size.
    ///
    /// # Errors
    /// The errors are those of [`Gains::of`].
    pub(crate) fn check_size(slots: usize, places: usize) -> Result<(), StrategyError> {
        if slots == 0 {
            return Err(StrategyError::NoSlots);
        }
        if places == 0 {
            return Err(StrategyError::NoPlaces);
        }
        match slots.checked_mul(places) {
            Some(product) if product <= GAINS_MAX => Ok(()),
            _ => Err(StrategyError::TooMany { slots, places }),
        }
    }

    /// Combines learning and a task: w·I/I_max + (1 - w)·p, between 0 and 1. `task` contains the probability p that the
    /// task succeeds at a place in a slot, such as meeting people, and w = `exploration`, from 0 (task only) to 1
    /// (information only). Example: the info-terminal of the STRANDS project (Kulich et al., "To explore or to
    /// exploit?", MESAS 2016), which should be where people are and must learn when that is.
    ///
    /// # Errors
    /// [`StrategyError`] where the sizes differ, the weight or a probability is outside `[0,1]`.
    pub fn weighed(&self, task: &Gains, exploration: f64) -> Result<Gains, StrategyError> {
        if (self.slots, self.places) != (task.slots, task.places) {
            return Err(StrategyError::Sizes { expected: (self.slots, self.places), found: (task.slots, task.places) });
        }
        if !(0.0..=1.0).contains(&exploration) {
            return Err(StrategyError::Weight { found: exploration });
        }
        let highest = self.values.iter().copied().fold(0.0, f64::max);
        Gains::of(self.slots, self.places, |slot, place| {
            let information = if highest > 0.0 { self.at(slot, place) / highest } else { 0.0 };
            match task.at(slot, place) {
                p if p <= 1.0 => exploration * information + (1.0 - exploration) * p,
                _ => f64::NAN,
            }
        })
    }

    /// Number of slots.
    pub fn slots(&self) -> usize {
        self.slots
    }

    /// Number of places.
    pub fn places(&self) -> usize {
        self.places
    }

    /// The gain of a place in a slot; 0 for an unknown one.
    pub fn at(&self, slot: usize, place: usize) -> f64 {
        self.slot(slot).get(place).copied().unwrap_or(0.0)
    }

    /// The gains of all places in a slot; empty for an unknown one.
    pub fn slot(&self, slot: usize) -> &[f64] {
        self.values.chunks(self.places).nth(slot).unwrap_or_default()
    }
}
