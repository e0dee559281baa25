//! A linear regression whose sums fade: the weights of the members are learned each night.
//!
//! Recursive least squares on predictions that were made before their day was learned (T-RO section IV.B), with a ridge
//! towards the weights before the first half-hour bin. The ridge is a number of bins with the variance of the state, so
//! the unit of the values does not matter. Invariant: weights are finite.

use nalgebra::{Cholesky, SMatrix, SVector};

/// The weights before the first bin count as this many bins.
const RIDGE_BINS: f64 = 12.0;

/// A regression on `N` features.
#[derive(Clone, Debug, PartialEq)]
pub(super) struct LinearStack<const N: usize> {
    /// The share of the sums that remains after each further observed day.
    kept: f64,
    /// Σ x xᵀ; symmetric.
    pub(super) squares: [[f64; N]; N],
    /// Σ x y.
    pub(super) products: [f64; N],
    /// The weights in force.
    pub(super) weights: [f64; N],
    at_first: [f64; N],
}

impl<const N: usize> LinearStack<N> {
    pub(super) const fn new(kept: f64, at_first: [f64; N]) -> LinearStack<N> {
        LinearStack { kept, squares: [[0.0; N]; N], products: [0.0; N], weights: at_first, at_first }
    }

    pub(super) fn predict(&self, features: &[f64; N]) -> f64 {
        features.iter().zip(&self.weights).map(|(feature, weight)| feature * weight).sum()
    }

    /// Learns the bins of a day from the features that were computed before the day. `variance`: the variance of all
    /// bins.
    pub(super) fn learn<'a>(&mut self, bins: impl Iterator<Item = (&'a [f64; N], f64)>, variance: f64) {
        self.learn_towards(bins, variance, self.at_first, 1.0);
    }

    /// Does the same as [`LinearStack::learn`], but towards other weights, and with a ridge that is `dependence` times
    /// as strong, because bins depend on each other.
    pub(super) fn learn_towards<'a>(
        &mut self,
        bins: impl Iterator<Item = (&'a [f64; N], f64)>,
        variance: f64,
        towards: [f64; N],
        dependence: f64,
    ) {
        let sums = self.squares.as_flattened_mut().iter_mut().chain(&mut self.products);
        sums.for_each(|sum| *sum *= self.kept);
        for (x, target) in bins {
            for (row, &one) in x.iter().enumerate() {
                self.products[row] += target * one;
                self.squares[row].iter_mut().zip(x).for_each(|(sum, other)| *sum += one * other);
            }
        }
        let ridge = RIDGE_BINS * variance * dependence;
        let mut matrix = SMatrix::<f64, N, N>::from_fn(|row, column| self.squares[row][column]);
        let mut vector = SVector::<f64, N>::from(self.products);
        for row in 0..N {
            matrix[(row, row)] += ridge;
            vector[row] += ridge * towards[row];
        }
        // With the ridge the matrix is positive definite, unless all bins were equal: then the weights stay.
        if let Some(factor) = Cholesky::new(matrix) {
            let solved = factor.solve(&vector);
            if solved.iter().all(|weight| weight.is_finite()) {
                self.weights.iter_mut().zip(&solved).for_each(|(weight, &new)| *weight = new);
            }
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_member_that_is_right_gets_the_weight() {
        let mut stack = LinearStack::new(0.985, [1.0, 0.0, 0.0]);
        let features = |bin: i32| {
            let wave = |pace: f64| libm::sin(f64::from(bin) * pace);
            [wave(0.7), wave(1.3), wave(2.9)]
        };
        assert_eq!(stack.predict(&[2.0, 1.0, 1.0]), 2.0);
        for day in 0..40 {
            let bins: Vec<_> = (day * 48..(day + 1) * 48).map(features).collect();
            stack.learn(bins.iter().map(|x| (x, 3.0 * x[1] - x[2])), 5.0);
        }
        for (weight, expected) in stack.weights.into_iter().zip([0.0, 3.0, -1.0]) {
            assert!((weight - expected).abs() < 0.3, "{:?}", stack.weights);
        }
    }

    #[test]
    fn bins_that_are_all_the_same_leave_the_weights() {
        let mut stack = LinearStack::new(0.985, [0.5, 0.25]);
        stack.learn([(&[0.0, 0.0], 0.0)].into_iter(), 0.0);
        assert_eq!(stack.weights, [0.5, 0.25]);
    }
}
