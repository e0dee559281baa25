//! The short-term memory of RAS 2017, section 4.2: a two-state chain whose rates allow for unobserved changes.
//!
//! Persistence assumes that a state did not change between two equal observations. The chain does not: its rates α
//! (from 0 to 1) and β (back) make the observed share of changes plausible for the time between observations. Nothing
//! is stored for it: the rates are the most likely ones of a [`Belief`](crate::Belief), or follow from the sums of
//! [`Persistence`], the mean and the first time of the state.
//! Invariant: the weight of the last value is in `[0,1]` and falls with its age.

use super::{Persistence, secs_between};

/// 1/(α+β) of an unobserved state: one rise and one fall in an hour at each value. It has the weight of one pair of
/// observations.
const PRIOR_MEMORY_SECS: f64 = 1800.0;

/// The inputs that the memory of a state needs beside its [`Persistence`].
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct MemoryBasis {
    /// The change of a value that counts as one, as in [`Persistence::tau_secs_of`]: 1 for a probability.
    pub usual_change: f64,
    /// Mean of the state, as the share of the time in which it is 1; 0.5 for states that are not probabilities.
    pub mean: f64,
    /// Time of the first observation: UTC, nanoseconds since 1970. If it is `None` (unknown), changes are assumed to be
    /// rare compared with observations.
    pub first_nanos: Option<i64>,
    /// The 1/(α+β) that makes the learned readings most likely, in seconds, above 0. If it is `None`, only sums are
    /// known, and 1/(α+β) is computed from them.
    pub most_likely_secs: Option<f64>,
}

impl Persistence {
    /// 1/(α+β) of the chain (RAS 2017, eq. 5 and 6), in seconds, at least 0: after this time the influence of the last
    /// value has fallen to 1/e.
    ///
    /// With π = α/(α+β), two observations that are Δ apart differ with the probability 2π(1-π)(1 - e^(-(α+β)Δ)). The
    /// mean of |change|/Δ over all pairs, with their mean gap for Δ and the mean of the state for π, gives α+β. With
    /// irregular gaps this is too high rather than too low, so that the memory is short rather than long. The most
    /// likely rates, where they are known, are right with any gaps.
    pub fn memory_secs(&self, basis: MemoryBasis) -> f64 {
        if let Some(secs) = basis.most_likely_secs {
            return secs;
        }
        let pairs = self.parts.pairs as f64;
        let change = if basis.usual_change > 0.0 && basis.usual_change.is_finite() { basis.usual_change } else { 1.0 };
        // The share lies between the mean and one half, because few observations do not determine the mean.
        let share = (basis.mean.clamp(0.0, 1.0) * pairs + 0.5) / (pairs + 1.0);
        let rate = self.parts.change_rate_sum / change / (2.0 * share * (1.0 - share));
        let gap_secs = match (basis.first_nanos, self.parts.last) {
            (Some(first), Some((last, _))) if last > first && pairs > 0.0 => secs_between(first, last) / pairs,
            _ => return (pairs + 1.0) / (1.0 / PRIOR_MEMORY_SECS + rate),
        };
        let before = -libm::expm1(-gap_secs / PRIOR_MEMORY_SECS);
        let forgotten = (before + rate * gap_secs) / (pairs + 1.0);
        if forgotten < 1.0 { gap_secs / -libm::log1p(-forgotten) } else { 0.0 }
    }

    /// The weight of the last value at a time, from 0 to 1: e^(-(α+β)(t-T)). 0 before the last observation.
    pub fn memory_weight(&self, basis: MemoryBasis, utc_nanos: i64) -> f64 {
        match self.parts.last {
            Some((last_nanos, _)) if utc_nanos == last_nanos => 1.0,
            Some((last_nanos, _)) if utc_nanos > last_nanos => {
                libm::exp(-secs_between(last_nanos, utc_nanos) / self.memory_secs(basis))
            }
            _ => 0.0,
        }
    }

    /// The long-term prediction `p` for a time, drawn to the last value by the chain: RAS 2017, eq. 6, with `p` in
    /// place of the chain's constant α/(α+β).
    pub fn remember(&self, basis: MemoryBasis, p: f64, utc_nanos: i64) -> f64 {
        let weight = self.memory_weight(basis, utc_nanos);
        self.parts.last.map_or(p, |(_, last_value)| last_value * weight + p * (1.0 - weight))
    }
}

#[cfg(test)]
mod tests {
    use rand::{Rng as _, SeedableRng as _, rngs::SmallRng};

    use super::*;

    /// A chain with the given 1/(α+β) and share of ones, observed at gaps that vary by up to `spread` of their mean.
    fn chain(memory_secs: f64, share: f64, gap_secs: f64, spread: f64) -> (Persistence, MemoryBasis) {
        let mut random = SmallRng::seed_from_u64(7);
        let (mut known, mut at_secs, mut value, mut sum) = (Persistence::default(), 0.0, false, 0.0);
        for _ in 0..20_000 {
            let gap = gap_secs * (1.0 + spread * (2.0 * random.random::<f64>() - 1.0));
            at_secs += gap;
            let kept = libm::exp(-gap / memory_secs);
            value = random.random::<f64>() < share * (1.0 - kept) + f64::from(u8::from(value)) * kept;
            known.observe((at_secs * 1e9) as i64, f64::from(u8::from(value)));
            sum += f64::from(u8::from(value));
        }
        (
            known,
            MemoryBasis {
                usual_change: 1.0,
                mean: sum / 20_000.0,
                first_nanos: Some((gap_secs * 1e9) as i64),
                most_likely_secs: None,
            },
        )
    }

    #[test]
    fn the_rates_of_a_chain_are_found_although_changes_are_missed() {
        for (memory_secs, share, gap_secs) in [(3600.0, 0.3, 60.0), (3600.0, 0.3, 3600.0), (7200.0, 0.8, 5000.0)] {
            let (known, basis) = chain(memory_secs, share, gap_secs, 0.5);
            let found = known.memory_secs(basis);
            assert!((found / memory_secs - 1.0).abs() < 0.25, "{memory_secs} {share} {gap_secs}: {found}");
        }
        // Persistence estimates slower changes, because it counts every observed change as the only one.
        let (known, basis) = chain(3600.0, 0.3, 3600.0, 0.5);
        assert!(known.tau_secs() > 1.5 * known.memory_secs(basis));
    }

    #[test]
    fn of_independent_readings_nothing_is_remembered() {
        let (known, basis) = chain(1.0, 0.02, 3600.0, 0.9);
        let (last_nanos, _) = known.last().unwrap();
        assert!(known.memory_weight(basis, last_nanos + 600_000_000_000) < 0.3);
    }

    #[test]
    fn the_last_value_fades_into_the_prediction() {
        let (known, basis) = chain(3600.0, 0.5, 600.0, 0.0);
        let (last_nanos, last_value) = known.last().unwrap();
        assert_eq!(known.remember(basis, 0.3, last_nanos), last_value);
        assert_eq!(known.remember(basis, 0.3, last_nanos - 1), 0.3);
        let later = |hours: i64| known.remember(basis, 0.3, last_nanos + hours * 3_600_000_000_000);
        assert!((later(0) - later(1)).abs() > (later(1) - later(2)).abs());
        assert!((later(100) - 0.3).abs() < 1e-9);
        assert_eq!(Persistence::default().remember(basis, 0.3, 5), 0.3);
        assert_eq!(Persistence::default().memory_secs(basis), PRIOR_MEMORY_SECS);
    }
}
