//! Expected information of an observation, in bits.
//!
//! Invariant: no result is NaN or negative. A probability that is NaN counts as 0.5 (nothing is known).

use tidemap_model::{
    INFORMATION_CERTAINTY, InformationMeasure, Predictive, entropy_bits, label_evidence::entropy_of_labels_bits,
};

#[cfg(test)]
mod tests;

/// The certainty of a state after an observation, p_c of RA-L eq. 3.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Certainty(f64);

/// A certainty outside its range.
#[derive(Clone, Copy, Debug, PartialEq, thiserror::Error)]
#[error("certainty {0}: it must be above 0.5 and below 1")]
pub struct InvalidCertainty(pub f64);

impl Default for Certainty {
    /// 0.95, as in RA-L, section III.C.
    fn default() -> Certainty {
        Certainty(INFORMATION_CERTAINTY)
    }
}

impl Certainty {
    /// The certainty `certainty`, in (0.5, 1).
    ///
    /// # Errors
    /// [`InvalidCertainty`] for any other number.
    pub fn new(certainty: f64) -> Result<Certainty, InvalidCertainty> {
        if certainty > 0.5 && certainty < 1.0 { Ok(Certainty(certainty)) } else { Err(InvalidCertainty(certainty)) }
    }

    /// The number, in (0.5, 1).
    #[must_use]
    pub fn get(self) -> f64 {
        self.0
    }

    /// Expected information from observing a state of probability `p`: H(p) - H(p_c), with `p` clipped to [1 - p_c,
    /// p_c]; from 0 to [`Certainty::most_bits`] (RA-L eq. 3).
    #[must_use]
    pub fn bits(self, p: f64) -> f64 {
        let p = if p.is_nan() { 0.5 } else { p.clamp(1.0 - self.0, self.0) };
        (entropy_bits(p) - entropy_bits(self.0)).max(0.0)
    }

    /// Expected information from observing which of several labels holds, whose shares sum to 1: their entropy, less
    /// that after an observation, which leaves the share p_c to one label and the rest to the others alike. For two
    /// labels it equals [`Certainty::bits`].
    #[must_use]
    pub fn bits_of_labels(self, shares: &[f64]) -> f64 {
        let others = shares.len().saturating_sub(1).max(1) as f64;
        let left = entropy_bits(self.0) + (1.0 - self.0) * others.log2();
        (entropy_of_labels_bits(shares) - left).max(0.0)
    }

    /// Expected information from observing several states: the sum over them.
    #[must_use]
    pub fn bits_of(self, probabilities: impl IntoIterator<Item = f64>) -> f64 {
        probabilities.into_iter().map(|p| self.bits(p)).sum()
    }

    /// Expected information from observing an unknown state, which is the maximum.
    #[must_use]
    pub fn most_bits(self) -> f64 {
        self.bits(0.5)
    }
}

/// The worth of an observation of a state: a measure, and the certainty of an observation.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct LookWorth {
    /// The certainty after the observation, for the gain of RA-L.
    pub certainty: Certainty,
    /// The measure of information.
    pub measure: InformationMeasure,
}

impl LookWorth {
    /// The worth of an observation of a state of probability `p`, in bits. `known`: the predictive distribution around
    /// `p`; `None` where bins are not counted, so that an observation has no gain of learning.
    #[must_use]
    pub fn bits(self, p: f64, known: Option<Predictive>) -> f64 {
        self.measure.bits(self.certainty.bits(p), known.map_or(0.0, Predictive::learning_bits))
    }
}

/// Entropy of several independent binary states in bits: the sum over them (RAS eq. 10, there in nats). This is the
/// information of observing them if observations are certain.
#[must_use]
pub fn entropy_of(probabilities: impl IntoIterator<Item = f64>) -> f64 {
    probabilities.into_iter().map(entropy_bits).sum()
}
