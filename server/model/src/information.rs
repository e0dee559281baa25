//! What a look at a state is worth.
//!
//! Two things may be gained. RA-L's gain is what is known of the state afterwards: max(0, H(p) - H(p_c)), where p_c is
//! the certainty of a look (RA-L 2016, eq. 3). It is the same each time for a state that a coin decides. Learning is
//! the mutual information of the look and the habit q ~ Beta(vν, (1 - v)ν), where v is the predicted probability and ν
//! the number of looks for which it stands:
//!
//! > H(v) - E\[H(q)\] = H(v) - (ψ(ν + 1) - v ψ(vν + 1) - (1 - v) ψ((1 - v)ν + 1)) / ln 2,
//!
//! with the digamma function ψ. It falls with every look. Invariant: no result is NaN or negative; what is learned is
//! at most the entropy.

use crate::{entropy::entropy_bits, special::digamma};

#[cfg(test)]
mod tests;

/// How much learning counts beside RA-L's gain.
const LEARNING_WEIGHT: f64 = 4.0;
/// Beyond so many looks nothing is left to learn: less than 1e-8 bits.
const LOOKS_MAX: f64 = 1e8;

/// How the worth of a look is measured.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub enum InformationMeasure {
    /// The gain of RA-L 2016, eq. 3, as published.
    #[default]
    RaL,
    /// What a look teaches of later ones. It is 0 where looks are not counted: in cells, and in states that no ensemble
    /// predicts.
    Learn,
    /// The gain, and four times what is learned.
    Both,
}

impl InformationMeasure {
    /// All of them.
    pub const ALL: [InformationMeasure; 3] =
        [InformationMeasure::RaL, InformationMeasure::Learn, InformationMeasure::Both];

    /// Its name in options and protocols.
    pub fn name(self) -> &'static str {
        match self {
            InformationMeasure::RaL => "ral",
            InformationMeasure::Learn => "learn",
            InformationMeasure::Both => "both",
        }
    }

    /// The worth of a look in bits, at least 0. `gained_bits`: RA-L's gain. `learned_bits`: what is learned, 0 where
    /// looks are not counted. Both are at least 0.
    pub fn bits(self, gained_bits: f64, learned_bits: f64) -> f64 {
        match self {
            InformationMeasure::RaL => gained_bits,
            InformationMeasure::Learn => learned_bits,
            InformationMeasure::Both => gained_bits + LEARNING_WEIGHT * learned_bits,
        }
    }
}

/// What a look teaches of later ones, in bits: from the entropy of `value` where nobody looked to 0 after many looks.
///
/// `value`: the predicted probability, of which one outside `[0,1]` counts as the nearer end and NaN as 0.5. `looks`:
/// the number of looks for which it stands; below 0 and NaN count as none.
pub fn learning_bits(value: f64, looks: f64) -> f64 {
    let v = if value.is_nan() { 0.5 } else { value.clamp(0.0, 1.0) };
    let entropy = entropy_bits(v);
    if looks >= LOOKS_MAX {
        return 0.0;
    }
    let looks = looks.max(0.0);
    let kept = digamma(looks + 1.0) - v * digamma(v * looks + 1.0) - (1.0 - v) * digamma((1.0 - v) * looks + 1.0);
    (entropy - kept / std::f64::consts::LN_2).clamp(0.0, entropy)
}
