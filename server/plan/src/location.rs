//! The information of a visit to a location: the sum over all states that can be observed there.
//!
//! Invariant: no result is NaN or negative; a probability outside `[0,1]` counts as the nearer end, NaN as 0.5.

use tidemap_model::{INFORMATION_CERTAINTY, entropy_bits};

#[cfg(test)]
mod tests;

/// The information of a visit, in bits: the sum of the entropies of the observed states (RAS 2017, eq. 10, in bits).
pub fn information_bits(probabilities: impl IntoIterator<Item = f64>) -> f64 {
    probabilities.into_iter().map(entropy_bits).sum()
}

/// The information of a visit for a model with the probabilities p_info, if the states are as a short-term model
/// expects them (p_expc), in bits: the cross entropy -Σ (p_expc log2 p_info + (1 - p_expc) log2 (1 - p_info)) of RAS
/// 2017, eq. 12. Pairs are (p_expc, p_info).
///
/// p_info is clipped to `[0.05,0.95]`, the certainty of RA-L 2016, section III.B: a certain but wrong prediction would
/// give a visit infinite information.
pub fn surprise_bits(states: impl IntoIterator<Item = (f64, f64)>) -> f64 {
    let of_state = |(expected, informed): (f64, f64)| {
        let expected = probability(expected);
        let informed = probability(informed).clamp(1.0 - INFORMATION_CERTAINTY, INFORMATION_CERTAINTY);
        -expected * informed.log2() - (1.0 - expected) * (1.0 - informed).log2()
    };
    let bits = states.into_iter().map(of_state).sum();
    debug_assert!(bits >= 0.0, "{bits} bits");
    bits
}

/// The expected number of wrong predictions that a visit corrects: the sum of min(p, 1 - p), the probability that the
/// guess p > 0.5 is wrong (RAS 2017, eq. 1 and 2). Between 0 and half the number of states.
pub fn expected_errors(probabilities: impl IntoIterator<Item = f64>) -> f64 {
    let of_state = |p: f64| {
        let p = probability(p);
        p.min(1.0 - p)
    };
    probabilities.into_iter().map(of_state).sum()
}

/// The gain of a visit for the strategy `online-error`: [`expected_errors`], plus a hardly noticeable share of the sum
/// of the probabilities. Of two equally uncertain places, such as 0.7 and 0.3 for the only two possible places, a visit
/// to the likelier one settles more minutes of the slot, because the person leaves from there.
pub fn error_gain(probabilities: impl IntoIterator<Item = f64> + Clone) -> f64 {
    /// Gains that differ by less are considered equal.
    const NEAR_TIE: f64 = 1e-9;
    expected_errors(probabilities.clone()) + NEAR_TIE * probabilities.into_iter().map(probability).sum::<f64>()
}

fn probability(p: f64) -> f64 {
    if p.is_nan() { 0.5 } else { p.clamp(0.0, 1.0) }
}
