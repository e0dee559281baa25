//! Seeded draws.
//!
//! Invariant: the same generator and arguments give the same draws; if all weights are 0, all indices are equally
//! likely.

use rand::{Rng as _, rngs::SmallRng};

/// Draws an index, with a probability in proportion to its weight.
pub(super) fn index(random: &mut SmallRng, weights: impl Iterator<Item = f64> + Clone) -> usize {
    let total: f64 = weights.clone().sum();
    let count = weights.clone().count();
    if total <= 0.0 || !total.is_finite() {
        return random.random_range(0..count.max(1));
    }
    let mut left = random.random::<f64>() * total;
    let mut last = 0;
    for (at, weight) in weights.enumerate() {
        if weight > 0.0 {
            last = at;
            if left < weight {
                return at;
            }
            left -= weight;
        }
    }
    // Rounding may leave a remainder.
    last
}

/// `count` different indices, drawn one after the other, each in proportion to its weight among the remaining ones;
/// ascending.
pub(super) fn distinct(random: &mut SmallRng, weights: &[f64], count: usize) -> Vec<usize> {
    // The largest of u^(1/w) have that distribution (P. Efraimidis and P. Spirakis, "Weighted random sampling with a
    // reservoir", 2006); the smallest of -ln(u)/w have it too, and do not underflow.
    let mut keyed: Vec<(f64, f64, usize)> = weights
        .iter()
        .enumerate()
        .map(|(at, &weight)| {
            let exponential = -(1.0 - random.random::<f64>()).ln();
            (exponential / weight.max(f64::MIN_POSITIVE), exponential, at)
        })
        .collect();
    keyed.sort_by(|a, b| a.0.total_cmp(&b.0).then(a.1.total_cmp(&b.1)));
    let mut drawn: Vec<usize> = keyed.into_iter().take(count).map(|(_, _, at)| at).collect();
    drawn.sort_unstable();
    drawn
}

/// The index of the largest value, with its value; ties are broken at random. `None` without values.
pub(super) fn largest(random: &mut SmallRng, values: &[f64]) -> Option<(usize, f64)> {
    let highest = values.iter().copied().max_by(f64::total_cmp)?;
    let tied = || values.iter().enumerate().filter(|(_, value)| **value >= highest);
    let chosen = random.random_range(0..tied().count().max(1));
    tied().nth(chosen).map(|(at, _)| (at, highest))
}
