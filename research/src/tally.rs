//! Sums of readings, whose means are the predictions of simple tables.
//!
//! Invariant: a mean is finite with any number of readings, also with none.

/// After this many days a reading counts half in a fading table.
const HALF_LIFE_DAYS: f64 = 21.0;
/// A probability from a single reading is at least this far from 0 and 1.
const CERTAIN: f64 = 0.02;
/// The hours of a week.
pub(crate) const WEEK_HOURS: usize = 168;

/// Sum and number of readings.
#[derive(Clone, Copy, Debug, Default)]
pub(crate) struct Tally {
    sum: f64,
    readings: f64,
}

impl Tally {
    /// Adds a reading.
    pub(crate) fn add(&mut self, value: f64) {
        self.sum += value;
        self.readings += 1.0;
    }

    /// The mean; 0 without readings.
    pub(crate) fn mean(self) -> f64 {
        if self.readings > 0.0 { self.sum / self.readings } else { 0.0 }
    }

    /// The mean with a reading of 0 and one of 1 before all others (Laplace).
    pub(crate) fn laplace(self) -> f64 {
        (self.sum + 1.0) / (self.readings + 2.0)
    }

    /// The mean with one reading of another mean before all others.
    pub(crate) fn shrunk(self, mean: f64) -> f64 {
        (self.sum + mean) / (self.readings + 1.0)
    }

    /// The sum a day later, if readings fade: all of them count less by the same factor.
    #[must_use]
    pub(crate) fn a_day_later(self) -> Tally {
        let kept = 0.5_f64.powf(1.0 / HALF_LIFE_DAYS);
        Tally { sum: kept * self.sum, readings: kept * self.readings }
    }
}

/// The probability that a single reading gives.
pub(crate) fn bounded(p: f64) -> f64 {
    p.clamp(CERTAIN, 1.0 - CERTAIN)
}
