//! The weights of the members for the next days, by how well each predicted days before these were learned.
//!
//! A member has its prior weight times exp(-½ L), where L is its faded sum of log loss and squared error over half-hour
//! bins. The pool is the weighted mean of the members' probabilities. Invariant: the weights sum to 1.

use super::stack::clip;
use crate::special::square;

/// The members of the pool, in the order in which they are stored.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) enum Member {
    /// The mean of all bins.
    Mean,
    /// The table of all history by hour of the day.
    Hour,
    /// The table of all history by hour of weekdays and of the weekend.
    Kind,
    /// The table of all history by hour of the weekday.
    Weekday,
    /// The table with a half-life of a week by hour of weekdays and of the weekend.
    RecentKind,
    /// The table with a half-life of a week by hour of the weekday.
    RecentWeekday,
    /// The earlier days that the best rotation repeats.
    Rotation,
    /// The last days of the same kind.
    Alike,
    /// Days that are the same weekday of their months, such as first Mondays.
    Nth,
    /// The stack that forgets slowly.
    SlowStack,
    /// The stack that forgets fast.
    FastStack,
    /// The model that the update chose: an order of the spectral model, a histogram, or a model trained on readings.
    Chosen,
    /// The smooth table for few bins.
    Smooth,
}

/// Number of members.
pub(super) const MEMBERS: usize = 13;

/// All members, in order.
pub(super) const ALL: [Member; MEMBERS] = [
    Member::Mean,
    Member::Hour,
    Member::Kind,
    Member::Weekday,
    Member::RecentKind,
    Member::RecentWeekday,
    Member::Rotation,
    Member::Alike,
    Member::Nth,
    Member::SlowStack,
    Member::FastStack,
    Member::Chosen,
    Member::Smooth,
];

/// The share of the losses that remains after each further observed day.
const KEPT: f64 = 0.97;
/// The factor on losses in the exponent of the weights.
const RATE: f64 = 0.5;
/// The smooth table loses its weight while the number of bins grows to this.
const SMOOTH_BINS: f64 = 300.0;

impl Member {
    /// The prior weight of a member of a state with `bins` bins.
    fn prior(self, bins: f64) -> f64 {
        match self {
            Member::Mean => 4.0,
            Member::Hour => 1.0,
            Member::Kind | Member::Weekday | Member::Chosen => 2.0,
            Member::SlowStack | Member::FastStack => 3.0,
            Member::Smooth => 20.0 * (1.0 - bins / SMOOTH_BINS).max(0.0),
            _ => 0.5,
        }
    }
}

/// The losses of the members.
#[derive(Clone, Debug, PartialEq)]
pub(super) struct Pool {
    pub(super) losses: [f32; MEMBERS],
}

/// Log loss and squared error of a prediction.
pub(super) fn loss(predicted: f64, value: f64) -> f64 {
    let p = clip(predicted);
    -(value * libm::log(p) + (1.0 - value) * libm::log(1.0 - p)) + square(p - value)
}

impl Pool {
    pub(super) const fn new() -> Pool {
        Pool { losses: [0.0; MEMBERS] }
    }

    /// The weights of the members after `bins` bins.
    pub(super) fn weights(&self, bins: f64) -> [f64; MEMBERS] {
        let mut weights = [0.0; MEMBERS];
        for ((weight, member), &loss) in weights.iter_mut().zip(ALL).zip(&self.losses) {
            *weight = libm::log(member.prior(bins)) - RATE * f64::from(loss);
        }
        normalised(weights)
    }

    /// The weight of the first of two members if there were only these two, without priors.
    pub(super) fn share(&self, one: Member, other: Member) -> f64 {
        1.0 / (1.0 + libm::exp((self.counted(one) - self.counted(other)).clamp(-30.0, 30.0)))
    }

    /// The losses of a member, as they count in its weight.
    pub(super) fn counted(&self, member: Member) -> f64 {
        RATE * f64::from(self.losses[member as usize])
    }

    /// Adds the losses of a day.
    pub(super) fn learn(&mut self, losses: &[f64; MEMBERS]) {
        for (sum, loss) in self.losses.iter_mut().zip(losses) {
            *sum = (KEPT * f64::from(*sum) + loss) as f32;
        }
    }
}

/// Weights from their logarithms; a logarithm may be minus infinity, but not all.
pub(super) fn normalised<const N: usize>(logs: [f64; N]) -> [f64; N] {
    let highest = logs.iter().copied().fold(f64::NEG_INFINITY, f64::max);
    let weights = logs.map(|log| libm::exp(log - highest));
    let all: f64 = weights.iter().sum();
    weights.map(|weight| weight / all)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn weights_follow_the_losses() {
        let mut pool = Pool::new();
        let weights = pool.weights(1e6);
        assert!((weights.iter().sum::<f64>() - 1.0).abs() < 1e-12);
        assert_eq!(weights[Member::Smooth as usize], 0.0);
        assert!(pool.weights(0.0)[Member::Smooth as usize] > 0.5);
        let mut losses = [40.0; MEMBERS];
        losses[Member::Nth as usize] = 0.0;
        pool.learn(&losses);
        assert!(pool.weights(1e6)[Member::Nth as usize] > 0.99);
        assert!(pool.share(Member::Nth, Member::Mean) > 0.99 && pool.share(Member::Mean, Member::Hour) == 0.5);
        // Members are stored by their indices.
        assert!(ALL.into_iter().enumerate().all(|(place, member)| member as usize == place));
    }
}
