//! All harmonics of a group of phases by recurrence: two fused multiply-adds a harmonic and vector.
//!
//! cos((k+1)θ) = 2·cosθ·cos kθ - cos((k-1)θ), and the same for sine. The rounding error grows with the square of the
//! number of steps, so every 64 steps the recurrence starts again from a power of e^(j64θ). Invariant: errors stay
//! below 1e-11 up to harmonic 2048.

use pulp::Simd;

use super::turn::{product, squared, unit_phasor};

/// Vectors that run side by side: enough to hide the latency of a multiply-add, few enough for 32 registers.
pub(crate) const GROUP: usize = 4;
/// Steps of the recurrence between exact restarts.
pub(crate) const BLOCK: usize = 64;
const ONES: [f64; 64] = [1.0; 64];

/// The phasors of a group of phases, at the start of a block of harmonics.
pub(crate) struct Wheels<S: Simd> {
    /// e^(jθ)
    base: [(S::f64s, S::f64s); GROUP],
    /// e^(j·64θ)
    stride: [(S::f64s, S::f64s); GROUP],
    /// e^(jkθ), where k is the last harmonic before the block; 0 in lanes without a phase.
    start: [(S::f64s, S::f64s); GROUP],
}

/// Some consecutive harmonics, one after the other.
pub(crate) struct Spin<S: Simd> {
    two_cos_base: [S::f64s; GROUP],
    previous_cos: [S::f64s; GROUP],
    previous_sin: [S::f64s; GROUP],
    pub(crate) cos: [S::f64s; GROUP],
    pub(crate) sin: [S::f64s; GROUP],
}

impl<S: Simd> Wheels<S> {
    /// Wheels for at most [`GROUP`] vectors of phases in turns, positioned before harmonic 1. In lanes without a phase
    /// every harmonic is 0.
    #[inline(always)]
    pub(crate) fn new(simd: S, turns: &[f64]) -> Wheels<S> {
        let zero = (simd.splat_f64s(0.0), simd.splat_f64s(0.0));
        let mut wheels = Wheels { base: [zero; GROUP], stride: [zero; GROUP], start: [zero; GROUP] };
        for (vector, turns) in turns.chunks(S::F64_LANES).take(GROUP).enumerate() {
            let base = unit_phasor(simd, simd.partial_load_f64s(turns));
            let mut stride = base;
            for _ in 0..BLOCK.ilog2() {
                stride = squared(simd, stride);
            }
            wheels.base[vector] = base;
            wheels.stride[vector] = stride;
            wheels.start[vector] = (simd.partial_load_f64s(&ONES[..turns.len()]), zero.1);
        }
        wheels
    }

    /// The harmonics of the block; the first `step` returns the first harmonic.
    #[inline(always)]
    pub(crate) fn spin(&self, simd: S) -> Spin<S> {
        let zero = simd.splat_f64s(0.0);
        let mut spin = Spin {
            two_cos_base: [zero; GROUP],
            previous_cos: [zero; GROUP],
            previous_sin: [zero; GROUP],
            cos: [zero; GROUP],
            sin: [zero; GROUP],
        };
        for v in 0..GROUP {
            let (cos, sin) = self.base[v];
            spin.two_cos_base[v] = simd.add_f64s(cos, cos);
            (spin.previous_cos[v], spin.previous_sin[v]) = product(simd, self.start[v], (cos, simd.neg_f64s(sin)));
            (spin.cos[v], spin.sin[v]) = self.start[v];
        }
        spin
    }

    /// Moves on to the next block.
    #[inline(always)]
    pub(crate) fn next_block(&mut self, simd: S) {
        for v in 0..GROUP {
            self.start[v] = product(simd, self.start[v], self.stride[v]);
        }
    }
}

impl<S: Simd> Spin<S> {
    /// Moves on to the next harmonic.
    #[inline(always)]
    pub(crate) fn step(&mut self, simd: S) {
        for v in 0..GROUP {
            let cos = simd.mul_add_f64s(self.two_cos_base[v], self.cos[v], simd.neg_f64s(self.previous_cos[v]));
            let sin = simd.mul_add_f64s(self.two_cos_base[v], self.sin[v], simd.neg_f64s(self.previous_sin[v]));
            (self.previous_cos[v], self.cos[v]) = (self.cos[v], cos);
            (self.previous_sin[v], self.sin[v]) = (self.sin[v], sin);
        }
    }
}
