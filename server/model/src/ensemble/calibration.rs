//! The last correction of the predictions of an ensemble, and the scatter of an hour of a day around its prediction.
//!
//! The correction draws predictions towards the mean, the more the last days differed from their predictions; its
//! half-life is three days, so that a change of habit lowers the certainty of the next days. The dependence is the
//! correlation of the errors of neighbouring half-hours, from which the scatter of the mean of an hour follows.
//! Invariant: the correction is in `[0,1]`, the dependence in `[0,1)`.

use super::bins::DayBins;
use super::forecast::DayForecast;

/// The half-life of the correction, in observed days.
const HALF_LIFE_DAYS: f64 = 3.0;
/// The prior weight of no correction: that of a day or two of a state that is nearly certain at all hours, so that one
/// odd day does not lower the certainty of every hour.
const PRIOR: f64 = 20.0;
/// The half-life of the dependence, in observed days.
const DEPENDENCE_DAYS: f64 = 28.0;
/// The dependence before the first bin, that of a state that keeps its value for 40 minutes, and the weight of this
/// prior.
const DEPENDENCE: f64 = 0.45;
const DEPENDENCE_PRIOR: f64 = 0.5;

/// The faded sums from which the correction and the dependence follow.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(super) struct Calibration {
    /// Σ u (y - μ) and Σ u², where u is the pool's departure from the mean μ.
    pub(super) departures: [f32; 2],
    /// Σ e e' of the errors of neighbouring half-hours, and Σ √(v v') of their expected squares.
    pub(super) neighbours: [f32; 2],
}

impl Calibration {
    pub(super) const fn new() -> Calibration {
        Calibration { departures: [0.0; 2], neighbours: [0.0; 2] }
    }

    /// The factor on departures from the mean.
    pub(super) fn factor(&self) -> f64 {
        let [product, square] = self.departures.map(f64::from);
        ((product + PRIOR) / (square + PRIOR)).clamp(0.0, 1.0)
    }

    /// The correlation of the errors of neighbouring half-hours.
    pub(super) fn dependence(&self) -> f64 {
        let [product, square] = self.neighbours.map(f64::from);
        ((product + DEPENDENCE * DEPENDENCE_PRIOR) / (square + DEPENDENCE_PRIOR)).clamp(0.0, 0.999)
    }

    /// Learns from a day that was predicted before.
    pub(super) fn learn(&mut self, forecast: &DayForecast, bins: &DayBins) {
        let add = |sums: &mut [f32; 2], half_life_days: f64, more: [f64; 2]| {
            let kept = libm::exp2(-1.0 / half_life_days);
            sums.iter_mut().zip(more).for_each(|(sum, more)| *sum = (kept * f64::from(*sum) + more) as f32);
        };
        let (mut departures, mut neighbours) = ([0.0; 2], [0.0; 2]);
        let mut before: Option<(usize, f64, f64)> = None;
        for (slot, value) in bins.seen() {
            let departure = forecast.uncorrected(slot) - forecast.mean();
            departures[0] += departure * (value - forecast.mean());
            departures[1] += departure * departure;
            let p = forecast.at_slot(slot);
            let (error, expected) = (value - p, p * (1.0 - p));
            if let Some((_, error_before, expected_before)) = before.filter(|(earlier, ..)| earlier + 1 == slot) {
                neighbours[0] += error * error_before;
                neighbours[1] += (expected * expected_before).sqrt();
            }
            before = Some((slot, error, expected));
        }
        add(&mut self.departures, HALF_LIFE_DAYS, departures);
        add(&mut self.neighbours, DEPENDENCE_DAYS, neighbours);
    }
}
