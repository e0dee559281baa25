//! The information value of an observation of a state.
//!
//! An observation has two possible gains. RA-L's gain is the reduced uncertainty about the state itself:
//! max(0, H(p) - H(p_c)), where p_c is the certainty of an observation (RA-L 2016, eq. 3). For a state as random as a
//! coin, it is equal at every observation. Learning is the mutual information of the observation and the habit
//! q ~ Beta(vν, (1 - v)ν), where v is the predicted probability and ν the number of half-hour bins that support it:
//!
//! > H(v) - E\[H(q)\] = H(v) - (ψ(ν + 1) - v ψ(vν + 1) - (1 - v) ψ((1 - v)ν + 1)) / ln 2,
//!
//! ψ is the digamma function. Learning falls with every observed bin. Invariant: no result is NaN or negative; learning
//! is at most the entropy.

use crate::{entropy::entropy_bits, special::digamma};

#[cfg(test)]
mod tests;

/// The weight of learning relative to RA-L's gain.
const LEARNING_WEIGHT: f64 = 4.0;
/// With more bins, learning is below 1e-8 bits and counts as 0.
const BINS_MAX: f64 = 1e8;

/// The measure of the information value of an observation.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub enum InformationMeasure {
    /// The gain of RA-L 2016, eq. 3, as published.
    #[default]
    RaL,
    /// The information of one observation about later ones. It is 0 where bins are not counted: in cells, and in states
    /// that no ensemble predicts.
    Learn,
    /// RA-L's gain plus four times the learning.
    Both,
}

impl InformationMeasure {
    /// All measures.
    pub const ALL: [InformationMeasure; 3] =
        [InformationMeasure::RaL, InformationMeasure::Learn, InformationMeasure::Both];

    /// The name of the measure in options and protocols.
    pub fn name(self) -> &'static str {
        match self {
            InformationMeasure::RaL => "ral",
            InformationMeasure::Learn => "learn",
            InformationMeasure::Both => "both",
        }
    }

    /// The information value of an observation in bits, at least 0. `gained_bits`: RA-L's gain. `learned_bits`: the
    /// learning, 0 where bins are not counted. Both are at least 0.
    pub fn bits(self, gained_bits: f64, learned_bits: f64) -> f64 {
        match self {
            InformationMeasure::RaL => gained_bits,
            InformationMeasure::Learn => learned_bits,
            InformationMeasure::Both => gained_bits + LEARNING_WEIGHT * learned_bits,
        }
    }
}

/// The information of one observation about later ones, in bits: from the entropy of `value` without any observation to
/// 0 after many.
///
/// `value`: the predicted probability; a value outside `[0,1]` counts as the nearer end, and NaN as 0.5. `bins`: the
/// number of half-hour bins that support it; a number below 0 and NaN count as 0.
pub fn learning_bits(value: f64, bins: f64) -> f64 {
    let v = if value.is_nan() { 0.5 } else { value.clamp(0.0, 1.0) };
    let entropy = entropy_bits(v);
    if bins >= BINS_MAX {
        return 0.0;
    }
    let bins = bins.max(0.0);
    let kept = digamma(bins + 1.0) - v * digamma(v * bins + 1.0) - (1.0 - v) * digamma((1.0 - v) * bins + 1.0);
    (entropy - kept / std::f64::consts::LN_2).clamp(0.0, entropy)
}
