//! How much the newest readings count against a prediction, by lag.
//!
//! p = a + w(u - a), with the prediction a and what the newest readings say, u. The weight of a lag is that of least
//! squares on values that neither had learned, shrunk to the weight of the lag before: w = (Σ(y-a)(u-a) + κw⁰) /
//! (Σ(u-a)² + κ). Invariant: a weight lies in `[0,1]`; at the newest reading it is 1.

use crate::InvalidParts;

/// Number of lags.
pub(super) const LAGS: usize = 9;
/// The shortest and the longest lag in seconds; the others are between them in equal steps of the logarithm.
const SHORTEST_SECS: f64 = 15.0;
const LONGEST_SECS: f64 = 86_400.0;
/// Below this lag the newest readings answer.
const NOW_SECS: f64 = 1.0;
/// κ, in squares of the state's usual distance of u from a.
const SHRINKAGE: f64 = 4.0;
/// Before lags were scored, readings of a chain are trusted for this many times 1/(α+β).
pub(super) const TRUSTED_TIMES: f64 = 8.0;
/// For how many seconds the newest of other values is trusted before lags were scored.
pub(super) const PRIOR_TRUST_SECS: f64 = 3600.0;
/// The part of the sums that is left after a day that was scored.
const KEPT: f64 = 0.98;

/// The sums of the regression, per lag.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub(super) struct LagWeights {
    /// Σ(y-a)(u-a), in units of the state's variance.
    pub(super) products: [f64; LAGS],
    /// Σ(u-a)², likewise.
    pub(super) squares: [f64; LAGS],
}

impl LagWeights {
    /// The lag with this number, in seconds.
    pub(super) fn lag_secs(lag: usize) -> f64 {
        SHORTEST_SECS * libm::pow(LONGEST_SECS / SHORTEST_SECS, lag as f64 / (LAGS - 1) as f64)
    }

    /// The lag that a number of seconds is nearest to; `None` where it is too short or too long.
    pub(super) fn nearest(lag_secs: f64) -> Option<usize> {
        let place = libm::log(lag_secs / SHORTEST_SECS) / libm::log(LONGEST_SECS / SHORTEST_SECS) * (LAGS - 1) as f64;
        let place = place.round();
        (0.0..LAGS as f64).contains(&place).then_some(place as usize)
    }

    /// Adds a value y, with a prediction a of it and what readings said this long before. `unit`: the state's variance.
    pub(super) fn add(&mut self, lag: usize, (value, predicted, said): (f64, f64, f64), unit: f64) {
        if let (Some(products), Some(squares)) = (self.products.get_mut(lag), self.squares.get_mut(lag)) {
            *products += (value - predicted) * (said - predicted) / unit;
            *squares += (said - predicted) * (said - predicted) / unit;
        }
    }

    /// Forgetting: after each day that was scored.
    pub(super) fn fade(&mut self) {
        self.products.iter_mut().chain(&mut self.squares).for_each(|sum| *sum *= KEPT);
    }

    /// The weights of all lags. `trust_secs`: how long readings are trusted without scores.
    fn weights(&self, trust_secs: f64) -> [f64; LAGS] {
        let (mut before, mut before_secs) = (1.0, 0.0);
        std::array::from_fn(|lag| {
            let secs = Self::lag_secs(lag);
            let prior = before * libm::exp((before_secs - secs) / trust_secs);
            let weight = (self.products[lag] + SHRINKAGE * prior) / (self.squares[lag] + SHRINKAGE);
            (before, before_secs) = (weight.clamp(0.0, 1.0), secs);
            before
        })
    }

    /// The weight at a lag in seconds, between two lags by the logarithm; beyond the longest it fades.
    pub(super) fn at(&self, lag_secs: f64, trust_secs: f64) -> f64 {
        if lag_secs <= NOW_SECS {
            return 1.0;
        }
        let weights = self.weights(trust_secs);
        let mut before = (NOW_SECS, 1.0);
        for (lag, weight) in weights.into_iter().enumerate() {
            let secs = Self::lag_secs(lag);
            if lag_secs <= secs {
                let share = libm::log(lag_secs / before.0) / libm::log(secs / before.0);
                return before.1 + (weight - before.1) * share;
            }
            before = (secs, weight);
        }
        before.1 * libm::exp(1.0 - lag_secs / LONGEST_SECS)
    }

    /// The weights from stored sums: Σ(y-a)(u-a) of each lag, then Σ(u-a)² of each; none of a state never scored.
    ///
    /// # Errors
    /// [`InvalidParts`] where there are not two for each lag, or one is outside its range.
    pub(super) fn from_sums(sums: &[f64]) -> Result<LagWeights, InvalidParts> {
        if sums.is_empty() {
            return Ok(LagWeights::default());
        }
        let (products, squares) = sums.split_at(sums.len() / 2);
        let (Ok(products), Ok(squares)) = (products.try_into(), squares.try_into()) else {
            return Err(InvalidParts::OutOfRange { field: "number of sums by lag", found: sums.len() as f64 });
        };
        let weights = LagWeights { products, squares };
        for product in weights.products {
            InvalidParts::check("sum of products by lag", product, f64::MIN..=f64::MAX)?;
        }
        for square in weights.squares {
            InvalidParts::check("sum of squares by lag", square, 0.0..=f64::MAX)?;
        }
        Ok(weights)
    }

    /// The sums to store.
    pub(super) fn to_sums(self) -> Vec<f64> {
        if self == LagWeights::default() { Vec::new() } else { [self.products, self.squares].concat() }
    }
}
