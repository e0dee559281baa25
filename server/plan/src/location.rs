//! What a visit to a location is worth: the sum over the states that can be observed there together.
//!
//! Invariant: no answer is NaN or negative; a probability outside `[0,1]` counts as the nearer end, and NaN, of which
//! nothing is known, as 0.5.

use tidemap_model::{INFORMATION_CERTAINTY, entropy_bits};

#[cfg(test)]
mod tests;

/// What a visit tells, in bits: the sum of the entropies of the states that it shows (RAS 2017, eq. 10, in bits).
pub fn information_bits(probabilities: impl IntoIterator<Item = f64>) -> f64 {
    probabilities.into_iter().map(entropy_bits).sum()
}

/// What a visit would tell a model that gives the states probabilities p_info if they were as another, of the short term,
/// expects them, in bits: the cross entropy -Σ (p_expc log2 p_info + (1 - p_expc) log2 (1 - p_info)) of RAS 2017, eq. 12.
/// Pairs are (p_expc, p_info).
///
/// p_info is clipped to `[0.05,0.95]`, the certainty of RA-L 2016, section III.B: a model that is wrong for certain would
/// make one visit worth infinitely many.
pub fn surprise_bits(states: impl IntoIterator<Item = (f64, f64)>) -> f64 {
    let of_state = |(expected, informed): (f64, f64)| {
        let expected = probability(expected);
        let informed = probability(informed).clamp(1.0 - INFORMATION_CERTAINTY, INFORMATION_CERTAINTY);
        -expected * informed.log2() - (1.0 - expected) * (1.0 - informed).log2()
    };
    states.into_iter().map(of_state).sum()
}

/// How many wrong guesses a visit saves on average: the sum of min(p, 1 - p), which is how often a state that is guessed
/// by p > 0.5 is not as guessed (RAS 2017, eq. 1 and 2). Between 0 and half the number of states.
pub fn expected_errors(probabilities: impl IntoIterator<Item = f64>) -> f64 {
    let of_state = |p: f64| {
        let p = probability(p);
        p.min(1.0 - p)
    };
    probabilities.into_iter().map(of_state).sum()
}

fn probability(p: f64) -> f64 {
    if p.is_nan() { 0.5 } else { p.clamp(0.0, 1.0) }
}
