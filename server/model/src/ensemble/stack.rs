//! Members combined in log odds, with weights that are learned each night (D. H. Wolpert, "Stacked generalization",
//! Neural Networks 5, 1992).
//!
//! A logistic regression on the log odds of some members and on the residuals of the last days, trained on predictions
//! that were made before their day was learned. It makes one step of iteratively reweighted least squares for each
//! half-hour bin, with sums that fade, and a ridge towards the average of the weekday tables and the chosen model. A
//! bin that was predicted with near certainty still has a weight ([`curvature`]), so that a few odd days do not
//! outweigh weeks of usual ones. Invariant: weights are finite.

use nalgebra::{Cholesky, SMatrix, SVector};

use super::bins::{DayBins, SLOTS};

/// Number of members whose log odds are features.
pub(super) const MEMBERS: usize = 7;
/// Number of residuals: of 1, 2, 7, 14 days ago, of the last day of the kind, of 28 days ago.
pub(super) const RESIDUALS: usize = 6;
/// Number of all features; the last feature is 1.
pub(super) const FEATURES: usize = MEMBERS + RESIDUALS + 1;
/// Number of entries of the lower triangle of the matrix of the sums.
pub(super) const PAIRS: usize = FEATURES * (FEATURES + 1) / 2;

/// The weights before the first bin: of kind and weekday tables of all history, and of the chosen model.
const WEIGHTS: [f64; MEMBERS] = [0.335, 0.335, 0.0, 0.0, 0.0, 0.0, 0.33];
/// The weights before the first bin count as this many bins: those of members and residuals, and that of the constant.
const RIDGE: f64 = 20.0;
const RIDGE_CONSTANT: f64 = 300.0;

/// The least curvature of a bin.
const CURVATURE_MIN: f64 = 1e-3;
/// The log odds of the bounds of [`clip`].
const LOG_ODDS_MAX: f64 = 6.906_754_778_648_554;
/// The curvature of a bin whose prediction was at a bound of [`clip`]: the slope of the chord of the logistic function
/// between the bounds. The local curvature is seventy times less.
const CURVATURE_OF_SURE: f64 = 0.998 / (2.0 * LOG_ODDS_MAX);

/// The features of each half-hour of a day.
pub(super) type Features = [[f64; FEATURES]; SLOTS];

/// Log odds of a probability.
pub(super) fn log_odds(p: f64) -> f64 {
    libm::log(p / (1.0 - p))
}

/// The probability of log odds, within [`clip`]'s bounds.
pub(super) fn probability(log_odds: f64) -> f64 {
    clip(1.0 / (1.0 + libm::exp(-log_odds.clamp(-30.0, 30.0))))
}

/// A probability, limited to 0.001 to 0.999: no member is more certain than that.
pub(super) fn clip(p: f64) -> f64 {
    p.clamp(1e-3, 1.0 - 1e-3)
}

/// The curvature of the loss of a bin at the predicted log odds, which is the weight of the bin in the regression.
/// Where a prediction is nearly certain, the local curvature p (1 - p) is nearly 0, though the loss is steep farther
/// away: with it, usual days would have no weight, and a surprise would change the log odds by hundreds. So a surprise
/// has the slope of the chord to the observed value, and a prediction has a share of [`CURVATURE_OF_SURE`] that grows
/// with its certainty.
fn curvature(predicted: f64, value: f64) -> f64 {
    let (p, seen) = (probability(predicted), clip(value));
    let sureness = predicted.abs().min(LOG_ODDS_MAX) / LOG_ODDS_MAX;
    let distance = log_odds(seen) - predicted;
    let chord = if distance.abs() > CURVATURE_MIN { (seen - p) / distance } else { 0.0 };
    (p * (1.0 - p) + CURVATURE_MIN).max(chord).max(CURVATURE_OF_SURE * sureness * sureness)
}

/// A logistic regression with fading sums.
#[derive(Clone, Debug, PartialEq)]
pub(super) struct Stack {
    /// The share of the sums that remains after each further observed day.
    kept: f64,
    /// The lower triangle of Σ v x xᵀ, row by row.
    pub(super) squares: [f32; PAIRS],
    /// Σ (v wᵀx + y - p) x.
    pub(super) products: [f32; FEATURES],
    /// The weights in force.
    pub(super) weights: [f32; FEATURES],
}

fn at_first(feature: usize) -> f64 {
    WEIGHTS.get(feature).copied().unwrap_or(0.0)
}

impl Stack {
    pub(super) fn new(kept: f64) -> Stack {
        let mut weights = [0.0; FEATURES];
        weights.iter_mut().enumerate().for_each(|(feature, weight)| *weight = at_first(feature) as f32);
        Stack { kept, squares: [0.0; PAIRS], products: [0.0; FEATURES], weights }
    }

    fn sum(&self, features: &[f64; FEATURES]) -> f64 {
        features.iter().zip(&self.weights).map(|(feature, &weight)| feature * f64::from(weight)).sum()
    }

    pub(super) fn predict(&self, features: &[f64; FEATURES]) -> f64 {
        probability(self.sum(features))
    }

    /// Learns the bins of a day from the features that were computed before the day.
    pub(super) fn learn(&mut self, features: &Features, bins: &DayBins) {
        let mut squares = self.squares.map(|sum| self.kept * f64::from(sum));
        let mut products = self.products.map(|sum| self.kept * f64::from(sum));
        for (slot, value) in bins.seen() {
            let x = &features[slot];
            let log_odds = self.sum(x);
            let p = probability(log_odds);
            let weight = curvature(log_odds, value);
            let target = weight * log_odds + value - p;
            let mut pairs = squares.iter_mut();
            for (row, &one) in x.iter().enumerate() {
                products[row] += target * one;
                for (&other, sum) in x[..=row].iter().zip(&mut pairs) {
                    *sum += weight * one * other;
                }
            }
        }
        self.squares = squares.map(|sum| sum as f32);
        self.products = products.map(|sum| sum as f32);
        let mut pairs = squares.iter();
        let mut matrix = SMatrix::<f64, FEATURES, FEATURES>::zeros();
        let mut vector = SVector::<f64, FEATURES>::from(products);
        for row in 0..FEATURES {
            for (column, &sum) in (0..=row).zip(&mut pairs) {
                matrix[(row, column)] = sum;
            }
            let ridge = if row == FEATURES - 1 { RIDGE_CONSTANT } else { RIDGE };
            matrix[(row, row)] += ridge;
            vector[row] += ridge * at_first(row);
        }
        // The factorisation reads the lower triangle alone. With the ridge it exists; if rounding breaks this, the
        // weights stay.
        if let Some(factor) = Cholesky::new(matrix) {
            let solved = factor.solve(&vector);
            if solved.iter().all(|weight| weight.is_finite()) {
                self.weights.iter_mut().zip(&solved).for_each(|(weight, &new)| *weight = new as f32);
            }
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::Sample;

    #[test]
    fn a_surprise_asks_for_no_more_than_what_was_seen() {
        for predicted in [-12.0, -6.9, -4.0, -1.0, 0.0, 2.0, 6.9, 30.0] {
            for value in [0.0, 0.3, 1.0] {
                let curvature = curvature(predicted, value);
                assert!((1e-3..=0.2511).contains(&curvature), "{predicted} {value}: {curvature}");
                let asked = predicted + (clip(value) - probability(predicted)) / curvature;
                assert!(asked.abs() <= predicted.abs().max(LOG_ODDS_MAX) + 1e-9, "{predicted} {value}: {asked}");
            }
        }
    }

    #[test]
    fn an_odd_day_does_not_turn_what_weeks_have_taught() {
        let bins = |is_odd: bool| {
            let sample = |slot: i64| Sample {
                utc_nanos: slot * 1_800_000_000_000,
                offset_secs: 0,
                value: f64::from(u8::from((18..34).contains(&slot) || is_odd)),
            };
            DayBins::of_samples(&(0..SLOTS as i64).map(sample).collect::<Vec<_>>())
        };
        // All members are nearly certain, and right on the usual day.
        let x = |sign: f64| {
            let mut x = [sign * log_odds(0.999); FEATURES];
            x[MEMBERS..].fill(0.0);
            x[FEATURES - 1] = 1.0;
            x
        };
        let features: [_; SLOTS] = std::array::from_fn(|slot| x(if (18..34).contains(&slot) { 1.0 } else { -1.0 }));
        for kept in [0.985, 0.94] {
            let mut stack = Stack::new(kept);
            (0..60).for_each(|_| stack.learn(&features, &bins(false)));
            stack.learn(&features, &bins(true));
            let (open, shut) = (stack.predict(&x(1.0)), stack.predict(&x(-1.0)));
            assert!(open > 0.9 && shut < 0.5, "{kept}: {open} {shut}");
        }
    }

    #[test]
    fn the_member_that_is_right_gets_the_weight() {
        let mut stack = Stack::new(0.985);
        let bins = |day: i64| {
            let sample = |slot: i64| Sample {
                utc_nanos: slot * 1_800_000_000_000,
                offset_secs: 0,
                value: f64::from(u8::from((slot / 7 + day) % 2 == 0)),
            };
            DayBins::of_samples(&(0..SLOTS as i64).map(sample).collect::<Vec<_>>())
        };
        let features = |day: i64| {
            let mut features = [[0.0; FEATURES]; SLOTS];
            for (slot, x) in features.iter_mut().enumerate() {
                // The third member is right, the first predicts the opposite.
                let right = if (slot as i64 / 7 + day) % 2 == 0 { 0.9 } else { 0.1 };
                x[2] = log_odds(right);
                x[0] = -x[2];
                x[FEATURES - 1] = 1.0;
            }
            features
        };
        assert_eq!(stack.predict(&[0.0; FEATURES]), 0.5);
        for day in 0..60 {
            stack.learn(&features(day), &bins(day));
        }
        assert!(stack.weights[2] > 0.5 && stack.weights[0] < 0.0, "{:?}", stack.weights);
        let p = stack.predict(&features(0)[0]);
        assert!(p > 0.97, "{p}");
    }
}
