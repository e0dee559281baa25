//! The weight of the forecast from the newest readings against a prediction, by lead time. A lead time is the time from
//! the newest reading to the predicted moment.
//!
//! p = a + w(u - a), with the prediction a and the forecast u from the newest readings. The weight of a lead time is
//! that of least squares on values y that neither a nor u had learned, shrunk to the weight w⁰ of the next shorter lead
//! time: w = (Σ(y-a)(u-a) + κw⁰) / (Σ(u-a)² + κ). Invariant: a weight lies in `[0,1]`; at the newest reading it is 1.

use crate::InvalidParts;

/// Number of lead times.
pub(super) const LEAD_TIMES: usize = 9;
/// The shortest and the longest lead time in seconds; the others are between them in equal steps of the logarithm.
const SHORTEST_SECS: f64 = 15.0;
const LONGEST_SECS: f64 = 86_400.0;
/// Up to this lead time the weight of the newest readings is 1.
const NOW_SECS: f64 = 1.0;
/// κ, in units of the state's variance.
const SHRINKAGE: f64 = 4.0;
/// While lead times are not yet scored, readings of a chain are trusted for this many times 1/(α+β).
pub(super) const TRUSTED_TIMES: f64 = 8.0;
/// While lead times are not yet scored, the newest of other values is trusted for this many seconds.
pub(super) const PRIOR_TRUST_SECS: f64 = 3600.0;
/// The share of the sums that remains after each day that was scored.
const KEPT: f64 = 0.98;

/// The sums of the regression, per lead time.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub(super) struct LeadTimeWeights {
    /// Σ(y-a)(u-a), in units of the state's variance.
    pub(super) products: [f64; LEAD_TIMES],
    /// Σ(u-a)², in the same unit.
    pub(super) squares: [f64; LEAD_TIMES],
}

impl LeadTimeWeights {
    /// The lead time with this number, in seconds.
    pub(super) fn lead_secs(lead: usize) -> f64 {
        SHORTEST_SECS * libm::pow(LONGEST_SECS / SHORTEST_SECS, lead as f64 / (LEAD_TIMES - 1) as f64)
    }

    /// The number of the lead time that is nearest to a number of seconds; `None` where that is too short or too long.
    pub(super) fn nearest(lead_secs: f64) -> Option<usize> {
        let place =
            libm::log(lead_secs / SHORTEST_SECS) / libm::log(LONGEST_SECS / SHORTEST_SECS) * (LEAD_TIMES - 1) as f64;
        let place = place.round();
        (0.0..LEAD_TIMES as f64).contains(&place).then_some(place as usize)
    }

    /// Adds a value y, with its prediction a and the forecast u from readings at this lead time; the arguments are the
    /// number of the lead time, and (y, a, u). `unit`: the state's variance.
    pub(super) fn add(&mut self, lead: usize, (value, predicted, stored): (f64, f64, f64), unit: f64) {
        if let (Some(products), Some(squares)) = (self.products.get_mut(lead), self.squares.get_mut(lead)) {
            *products += (value - predicted) * (stored - predicted) / unit;
            *squares += (stored - predicted) * (stored - predicted) / unit;
        }
    }

    /// Fades the sums, after each day that was scored.
    pub(super) fn fade(&mut self) {
        self.products.iter_mut().chain(&mut self.squares).for_each(|sum| *sum *= KEPT);
    }

    /// The weights of all lead times. `trust_secs`: how long readings are trusted without scores.
    fn weights(&self, trust_secs: f64) -> [f64; LEAD_TIMES] {
        let (mut before, mut before_secs) = (1.0, 0.0);
        std::array::from_fn(|lead| {
            let secs = Self::lead_secs(lead);
            let prior = before * libm::exp((before_secs - secs) / trust_secs);
            let weight = (self.products[lead] + SHRINKAGE * prior) / (self.squares[lead] + SHRINKAGE);
            (before, before_secs) = (weight.clamp(0.0, 1.0), secs);
            before
        })
    }

    /// The weight at a lead time in seconds, interpolated in the logarithm of the lead time; beyond the longest it
    /// fades.
    pub(super) fn at(&self, lead_secs: f64, trust_secs: f64) -> f64 {
        if lead_secs <= NOW_SECS {
            return 1.0;
        }
        let weights = self.weights(trust_secs);
        let mut before = (NOW_SECS, 1.0);
        for (lead, weight) in weights.into_iter().enumerate() {
            let secs = Self::lead_secs(lead);
            if lead_secs <= secs {
                let share = libm::log(lead_secs / before.0) / libm::log(secs / before.0);
                return before.1 + (weight - before.1) * share;
            }
            before = (secs, weight);
        }
        before.1 * libm::exp(1.0 - lead_secs / LONGEST_SECS)
    }

    /// The weights from stored sums: Σ(y-a)(u-a) of each lead time, then Σ(u-a)² of each; no sums for a state that was
    /// never scored.
    ///
    /// # Errors
    /// [`InvalidParts`] where there are not two sums for each lead time, or one is outside its range.
    pub(super) fn from_sums(sums: &[f64]) -> Result<LeadTimeWeights, InvalidParts> {
        if sums.is_empty() {
            return Ok(LeadTimeWeights::default());
        }
        let (products, squares) = sums.split_at(sums.len() / 2);
        let (Ok(products), Ok(squares)) = (products.try_into(), squares.try_into()) else {
            return Err(InvalidParts::OutOfRange { field: "number of sums by lead time", found: sums.len() as f64 });
        };
        let weights = LeadTimeWeights { products, squares };
        for product in weights.products {
            InvalidParts::check("sum of products by lead time", product, f64::MIN..=f64::MAX)?;
        }
        for square in weights.squares {
            InvalidParts::check("sum of squares by lead time", square, 0.0..=f64::MAX)?;
        }
        Ok(weights)
    }

    /// The sums to store.
    pub(super) fn to_sums(self) -> Vec<f64> {
        if self == LeadTimeWeights::default() { Vec::new() } else { [self.products, self.squares].concat() }
    }
}
