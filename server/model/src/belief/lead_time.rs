//! The weight of the newest readings against a prediction, by lead time: the time from the newest reading to the
//! predicted moment.
//!
//! p = a + w₁(u - a) + w₂(u₀ - a₀), with the prediction a and the forecast u from the newest readings, and with both at
//! the newest reading, a₀ and u₀. So w₁ keeps the newest value, and w₂ carries its deviation from the routine on. The
//! weights of a lead time are those of least squares on values that neither a nor u had learned, shrunk to the weights
//! of the next shorter lead time. The same values give the share of the squared error that remains. Invariant: the
//! weights are at least 0 and their sum is at most 1; at the newest reading it is 1.

use crate::InvalidParts;

/// Number of lead times.
pub(super) const LEAD_TIMES: usize = 9;
/// The shortest and the longest lead time in seconds; the others are between them in equal steps of the logarithm.
const SHORTEST_SECS: f64 = 15.0;
const LONGEST_SECS: f64 = 86_400.0;
/// Up to this lead time the newest readings predict.
const NOW_SECS: f64 = 1.0;
/// From this lead time on the newest readings have no weight.
const END_SECS: f64 = 7.0 * 86_400.0;
/// κ of w₁ + w₂, in units of the state's variance.
const SHRINKAGE: f64 = 4.0;
/// κ of w₁ alone, beside that of the sum of both weights.
const KEPT_SHRINKAGE: f64 = 4.0;
/// The share of the squared error begins at 1, with the weight of errors of this many variances of the state.
const ERROR_SHRINKAGE: f64 = 2.0;
/// While lead times are not yet scored, readings of a chain are trusted for this many times 1/(α+β).
pub(super) const TRUSTED_TIMES: f64 = 8.0;
/// While lead times are not yet scored, the newest of other values is trusted for this many seconds.
pub(super) const PRIOR_TRUST_SECS: f64 = 3600.0;
/// The share of the sums that remains after each day that was scored.
const KEPT: f64 = 0.98;

/// Number of stored sums of each lead time, for both kinds of newest readings.
const ALL_SUMS: usize = 2 * 7 * LEAD_TIMES;
/// Number of stored sums that are of the newest value alone.
const NEWEST_SUMS: usize = 2 * LEAD_TIMES;

/// w₁ and w₂.
pub(super) type Weights = [f64; 2];

/// The weights at the newest reading: its value is kept.
const AT_NEWEST: Weights = [1.0, 0.0];

/// A value that was predicted, for the regression.
#[derive(Clone, Copy, Debug)]
pub(super) struct Scored {
    /// The value y.
    pub(super) value: f64,
    /// The prediction a.
    pub(super) predicted: f64,
    /// The prediction a₀ at the newest reading.
    pub(super) predicted_now: f64,
    /// The forecast u from the newest readings.
    pub(super) stored: f64,
    /// That forecast at the newest reading, u₀.
    pub(super) stored_now: f64,
}

impl Scored {
    /// u - a and u₀ - a₀.
    pub(super) fn features(&self) -> [f64; 2] {
        [self.stored - self.predicted, self.stored_now - self.predicted_now]
    }
}

/// The sums of a lead time, in units of the state's variance.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub(super) struct LeadSums {
    /// Σ(u-a)², Σ(u-a)(u₀-a₀), Σ(u₀-a₀)².
    squares: [f64; 3],
    /// Σ(y-a)(u-a), Σ(y-a)(u₀-a₀).
    products: [f64; 2],
    /// Σ(y-a)², and the sum of the squared errors of p before each value was learned.
    errors: [f64; 2],
}

/// The sums of the regression, per lead time.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub(super) struct LeadTimeWeights {
    pub(super) sums: [LeadSums; LEAD_TIMES],
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

    /// Adds a value that was predicted at a lead time, by its number. `blended`: the forecast p; `unit`: the state's
    /// variance.
    pub(super) fn add(&mut self, lead: usize, scored: &Scored, blended: f64, unit: f64) {
        let Some(sums) = self.sums.get_mut(lead) else { return };
        let ([kept, carried], error) = (scored.features(), scored.value - scored.predicted);
        let blended = scored.value - blended;
        // Values whose squares are no numbers in this unit teach nothing.
        if !((kept * kept + carried * carried + error * error + blended * blended) / unit).is_finite() {
            return;
        }
        let add = |sums: &mut [f64], values: &[f64]| {
            sums.iter_mut().zip(values).for_each(|(sum, value)| *sum += value / unit);
        };
        add(&mut sums.squares, &[kept * kept, kept * carried, carried * carried]);
        add(&mut sums.products, &[error * kept, error * carried]);
        add(&mut sums.errors, &[error * error, blended * blended]);
    }

    /// Fades the sums, after each day that was scored.
    pub(super) fn fade(&mut self) {
        for sums in &mut self.sums {
            let all = sums.squares.iter_mut().chain(&mut sums.products).chain(&mut sums.errors);
            all.for_each(|sum| *sum *= KEPT);
        }
    }

    /// The weights of all lead times. `trust_secs`: how long readings are trusted without scores.
    pub(super) fn weights(&self, trust_secs: f64) -> [Weights; LEAD_TIMES] {
        let (mut before, mut before_secs) = (AT_NEWEST, 0.0);
        std::array::from_fn(|lead| {
            let secs = Self::lead_secs(lead);
            let trust = libm::exp((before_secs - secs) / trust_secs);
            (before, before_secs) = (self.sums[lead].solve(before.map(|weight| weight * trust)), secs);
            before
        })
    }

    /// The weights for a newest reading that was learned. The prediction knows it already, so the weights of a lead
    /// time are shrunk to those of other readings, and to 0 where it is long.
    pub(super) fn weights_of_learned(&self, others: &[Weights; LEAD_TIMES]) -> [Weights; LEAD_TIMES] {
        std::array::from_fn(|lead| {
            let trust = libm::exp(-Self::lead_secs(lead) / PRIOR_TRUST_SECS);
            self.sums[lead].solve(others[lead].map(|weight| weight * trust))
        })
    }

    /// The sums of both.
    pub(super) fn and(mut self, other: &LeadTimeWeights) -> LeadTimeWeights {
        for (sums, more) in self.sums.iter_mut().zip(&other.sums) {
            let all = sums.squares.iter_mut().chain(&mut sums.products).chain(&mut sums.errors);
            let more = more.squares.iter().chain(&more.products).chain(&more.errors);
            all.zip(more).for_each(|(sum, more)| *sum += more);
        }
        self
    }

    /// The weights at a lead time in seconds, interpolated in the logarithm of the lead time; beyond the longest they
    /// fade.
    pub(super) fn at(weights: &[Weights; LEAD_TIMES], lead_secs: f64) -> Weights {
        if lead_secs <= NOW_SECS {
            return AT_NEWEST;
        }
        let mut before = (NOW_SECS, AT_NEWEST);
        for (lead, &weights) in weights.iter().enumerate() {
            let secs = Self::lead_secs(lead);
            if lead_secs <= secs {
                let share = libm::log(lead_secs / before.0) / libm::log(secs / before.0);
                return std::array::from_fn(|at| before.1[at] + (weights[at] - before.1[at]) * share);
            }
            before = (secs, weights);
        }
        let faded = faded(lead_secs);
        before.1.map(|weight| weight * faded)
    }

    /// Whether the newest readings have a weight at a lead time in seconds.
    pub(super) fn is_near(lead_secs: f64) -> bool {
        lead_secs < END_SECS
    }

    /// The share of the squared error of the prediction that remains at a lead time in seconds, within `(0,1]`.
    pub(super) fn error_share(&self, lead_secs: f64) -> f64 {
        let mut before = (NOW_SECS, self.sums[0].error_share());
        for (lead, sums) in self.sums.iter().enumerate() {
            let (secs, share) = (Self::lead_secs(lead), sums.error_share());
            if lead_secs <= secs {
                let part = (libm::log(lead_secs.max(NOW_SECS) / before.0) / libm::log(secs / before.0)).max(0.0);
                return before.1 + (share - before.1) * part;
            }
            before = (secs, share);
        }
        1.0 - (1.0 - before.1) * faded(lead_secs)
    }

    /// The weights of a reading that was not learned and of one that was, from stored sums: seven of each lead time of
    /// both. Sums of the newest value alone are two for each lead time: first Σ(y-a)(u-a), then Σ(u-a)². No sums: the
    /// state was never scored.
    ///
    /// # Errors
    /// [`InvalidParts`] for another number of sums, or for one outside its range.
    pub(super) fn from_sums(stored: &[f64]) -> Result<[LeadTimeWeights; 2], InvalidParts> {
        let mut weights = [LeadTimeWeights::default(); 2];
        let all = weights.iter_mut().flat_map(|weights| &mut weights.sums);
        match stored.len() {
            0 => {}
            NEWEST_SUMS => {
                let (products, squares) = stored.split_at(LEAD_TIMES);
                for (sums, (&product, &square)) in all.zip(products.iter().zip(squares)) {
                    *sums = LeadSums { squares: [square, 0.0, 0.0], products: [product, 0.0], errors: [0.0; 2] };
                }
            }
            ALL_SUMS => {
                for (sums, &[own, both, carried, kept_error, carried_error, error, blended]) in
                    all.zip(stored.as_chunks().0)
                {
                    *sums = LeadSums {
                        squares: [own, both, carried],
                        products: [kept_error, carried_error],
                        errors: [error, blended],
                    };
                }
            }
            found => {
                return Err(InvalidParts::OutOfRange { field: "number of sums by lead time", found: found as f64 });
            }
        }
        for sums in weights.iter().flat_map(|weights| &weights.sums) {
            for square in [sums.squares[0], sums.squares[2], sums.errors[0], sums.errors[1]] {
                InvalidParts::check("sum of squares by lead time", square, 0.0..=f64::MAX)?;
            }
            for product in [sums.squares[1], sums.products[0], sums.products[1]] {
                InvalidParts::check("sum of products by lead time", product, f64::MIN..=f64::MAX)?;
            }
        }
        Ok(weights)
    }

    /// The sums to store.
    pub(super) fn to_sums(weights: &[LeadTimeWeights; 2]) -> Vec<f64> {
        if *weights == [LeadTimeWeights::default(); 2] {
            return Vec::new();
        }
        let of_lead = |sums: &LeadSums| [&sums.squares[..], &sums.products, &sums.errors].concat();
        weights.iter().flat_map(|weights| &weights.sums).flat_map(of_lead).collect()
    }
}

/// The weight of the newest readings beyond the longest lead time, in parts of the weight there.
fn faded(lead_secs: f64) -> f64 {
    if LeadTimeWeights::is_near(lead_secs) { libm::exp(1.0 - lead_secs / LONGEST_SECS) } else { 0.0 }
}

impl LeadSums {
    /// The share of the squared error of the prediction that remains. Its logarithm is drawn to 0, so that a share of a
    /// thousandth is found as soon as one of a half.
    fn error_share(&self) -> f64 {
        let [of_prediction, blended] = self.errors;
        let ratio = blended / of_prediction;
        if !(ratio > 0.0 && ratio < 1.0) {
            return 1.0;
        }
        libm::pow(ratio, of_prediction / (of_prediction + ERROR_SHRINKAGE))
    }

    /// The weights of least squares, shrunk to prior ones.
    fn solve(&self, prior: Weights) -> Weights {
        let [own, both, carried] = self.squares;
        let (own, both, carried) = (own + SHRINKAGE + KEPT_SHRINKAGE, both + SHRINKAGE, carried + SHRINKAGE);
        let trusted = SHRINKAGE * (prior[0] + prior[1]);
        let kept_error = self.products[0] + trusted + KEPT_SHRINKAGE * prior[0];
        let carried_error = self.products[1] + trusted;
        let determinant = own * carried - both * both;
        let weights = [
            (kept_error * carried - carried_error * both) / determinant,
            (carried_error * own - kept_error * both) / determinant,
        ];
        // Where one weight would be negative, the other one alone is fitted.
        let weights = match weights {
            [kept, _] if kept < 0.0 => [0.0, carried_error / carried],
            [_, carried] if carried < 0.0 => [kept_error / own, 0.0],
            weights => weights,
        };
        let weights = weights.map(|weight| weight.clamp(0.0, 1.0));
        let sum = weights[0] + weights[1];
        if sum > 1.0 { weights.map(|weight| weight / sum) } else { weights }
    }
}
