//! Eight lanes of numbers on every instruction set.
//!
//! Invariant: results are equal bits whatever the width of the machine's vectors: a number keeps its lane, products are
//! added with one rounding (fused) everywhere, and lanes are added up in one fixed order.

use pulp::{Simd, WithSimd};

#[cfg(test)]
mod tests;

/// Number of lanes.
pub(crate) const LANES: usize = 8;

/// Eight numbers, in `V` vectors.
#[derive(Clone, Copy)]
pub(crate) struct Eight<S: Simd, const V: usize>(pub(crate) [S::f64s; V]);

impl<S: Simd, const V: usize> Eight<S, V> {
    #[inline(always)]
    pub(crate) fn splat(simd: S, number: f64) -> Self {
        Eight([simd.splat_f64s(number); V])
    }

    #[inline(always)]
    pub(crate) fn store(self, _simd: S) -> [f64; LANES] {
        let mut numbers = [0.0; LANES];
        for (numbers, vector) in S::as_mut_simd_f64s(&mut numbers).0.iter_mut().zip(self.0) {
            *numbers = vector;
        }
        numbers
    }

    /// The sum of the lanes, always in this order.
    #[inline(always)]
    pub(crate) fn sum(self, simd: S) -> f64 {
        let [a, b, c, d, e, f, g, h] = self.store(simd);
        ((a + e) + (c + g)) + ((b + f) + (d + h))
    }
}

/// A computation on eight lanes.
pub(crate) trait EightLanes {
    /// The result of the computation.
    type Output;

    /// Runs the computation with `V` vectors that have eight numbers together.
    fn run<S: Simd, const V: usize>(self, simd: S) -> Self::Output;
}

/// Runs a computation on the vectors of an instruction set.
pub(crate) struct OnLanes<K>(pub(crate) K);

impl<K: EightLanes> WithSimd for OnLanes<K> {
    type Output = K::Output;

    #[inline(always)]
    fn with_simd<S: Simd>(self, simd: S) -> K::Output {
        match S::F64_LANES {
            8 => self.0.run::<S, 1>(simd),
            4 => self.0.run::<S, 2>(simd),
            2 => self.0.run::<S, 4>(simd),
            // pulp has no other widths.
            _ => self.0.run::<S, 8>(simd),
        }
    }
}
