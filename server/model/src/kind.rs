//! The kinds of states: the meaning of a value, and the values that are allowed.
//!
//! The kind is fixed when a state is created.
//!
//! - **Kernels**: probabilities use the kernels that saturate to [0, 1]. Other kinds use `spectral/values.rs`: the same
//!   sums in plain loops, with the bounds of the kind. Sums, learning and training are shared and know no bounds.
//! - **Units do not matter**: the change alarm gets errors divided by the variance of the values; the test for support
//!   and the number of independent readings use this variance instead of μ(1 - μ); persistence measures changes in
//!   units of two standard deviations. So a state in millimetres is learned as one in metres.
//! - **Orders and models are compared by squared error** for other kinds, whatever the criterion: the zero-one error is
//!   defined for probabilities only.
//! - **Intervals** are the prediction ± z·σ (`models/interval/values.rs`). σ is the ensemble's error by lead time
//!   (`ensemble/numbers/spread.rs`) or, without an ensemble, the variation between days. Anomalies are tail
//!   probabilities (`models/interval/single.rs`). There is no interval before two observations are learned.
//! - **Models of one kind only**: the Markov chain, Pergam and the uniform variant support probabilities only, Poisson
//!   supports counts only. Other kinds are refused. Cells of a grid are probabilities.
//!
//! Invariant: the values of every kind are finite and lie in its bounds, so that no sum over them overflows.

use std::ops::RangeInclusive;

#[cfg(test)]
mod tests;

/// The largest magnitude of a value that is not a probability.
pub const VALUE_MAX: f64 = 1e12;

/// The meaning of the value of a state. It is fixed when the state is created. A position
/// ([`crate::Position`]) is a state of continuous values for each of its coordinates.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Hash)]
pub enum StateKind {
    /// A value in [0, 1]; binary states have only 0 and 1.
    #[default]
    Probability,
    /// Any number of magnitude [`VALUE_MAX`] at most, such as a speed or a temperature, in any unit.
    Continuous,
    /// A whole number from 0 to [`VALUE_MAX`], such as the number of people who passed.
    Count,
}

impl StateKind {
    /// All kinds.
    pub const ALL: [StateKind; 3] = [StateKind::Probability, StateKind::Continuous, StateKind::Count];

    /// The name in commands and messages.
    pub fn name(self) -> &'static str {
        match self {
            StateKind::Probability => "probability",
            StateKind::Continuous => "continuous",
            StateKind::Count => "count",
        }
    }

    /// The bounds of observations and predictions. Predictions of counts are means and need not be whole numbers.
    pub fn bounds(self) -> RangeInclusive<f64> {
        match self {
            StateKind::Probability => 0.0..=1.0,
            StateKind::Continuous => -VALUE_MAX..=VALUE_MAX,
            StateKind::Count => 0.0..=VALUE_MAX,
        }
    }

    /// Whether an observation may have this value; never NaN or infinite.
    pub fn allows(self, value: f64) -> bool {
        self.bounds().contains(&value) && (self != StateKind::Count || value.fract() == 0.0)
    }

    /// The values that [`StateKind::allows`] accepts, in words, for a message that ends "… is not".
    pub fn expected(self) -> &'static str {
        match self {
            StateKind::Probability => "between 0 and 1",
            StateKind::Continuous => "a number from -1e12 to 1e12",
            StateKind::Count => "a count: 0, 1, 2, ... up to 1e12",
        }
    }

    /// The nearest number in the bounds; for NaN the prediction of an untrained state.
    pub fn saturate(self, value: f64) -> f64 {
        let bounds = self.bounds();
        if value.is_nan() { self.untrained() } else { value.clamp(*bounds.start(), *bounds.end()) }
    }

    /// The prediction of an untrained state: 0.5 for a probability, else 0.
    pub fn untrained(self) -> f64 {
        if self == StateKind::Probability { 0.5 } else { 0.0 }
    }

    /// The largest magnitude of a value.
    pub(crate) fn magnitude(self) -> f64 {
        *self.bounds().end()
    }
}
