//! Cosine and sine of whole vectors of phases, without a branch or a table.
//!
//! Invariant: errors stay below 1e-14 for phases of -0.5 to 0.5 turns.

use std::f64::consts::FRAC_PI_2;

use pulp::Simd;

/// Adding and subtracting 1.5·2^52 leaves the nearest whole number, ties to even.
const ROUND: f64 = 6_755_399_441_055_744.0;

/// Taylor coefficients 1/3!, 1/5!, … of sine and 1/2!, 1/4!, … of cosine, signed. To π/4 the
/// remainders are below one unit in the last place.
const SIN: [f64; 7] = [
    -1.0 / 6.0,
    1.0 / 120.0,
    -1.0 / 5_040.0,
    1.0 / 362_880.0,
    -1.0 / 39_916_800.0,
    1.0 / 6_227_020_800.0,
    -1.0 / 1_307_674_368_000.0,
];
const COS: [f64; 8] = [
    -1.0 / 2.0,
    1.0 / 24.0,
    -1.0 / 720.0,
    1.0 / 40_320.0,
    -1.0 / 3_628_800.0,
    1.0 / 479_001_600.0,
    -1.0 / 87_178_291_200.0,
    1.0 / 20_922_789_888_000.0,
];

/// A phase minus its nearest whole turn, for phases below 2^51 turns.
#[inline(always)]
pub(crate) fn nearest_turn<S: Simd>(simd: S, turns: S::f64s) -> S::f64s {
    let round = simd.splat_f64s(ROUND);
    simd.sub_f64s(turns, simd.sub_f64s(simd.add_f64s(turns, round), round))
}

/// Cosine and sine of phases from -0.5 to 0.5 turns.
#[inline(always)]
pub(crate) fn unit_phasor<S: Simd>(simd: S, turns: S::f64s) -> (S::f64s, S::f64s) {
    // A quarter of the angle lies within ±π/4, where short polynomials are precise; squaring twice restores the angle.
    let quarter = simd.mul_f64s(turns, simd.splat_f64s(FRAC_PI_2));
    let square = simd.mul_f64s(quarter, quarter);
    let mut cos = simd.splat_f64s(COS[7]);
    for &coefficient in COS[..7].iter().rev() {
        cos = simd.mul_add_f64s(cos, square, simd.splat_f64s(coefficient));
    }
    let cos = simd.mul_add_f64s(cos, square, simd.splat_f64s(1.0));
    let mut sin = simd.splat_f64s(SIN[6]);
    for &coefficient in SIN[..6].iter().rev() {
        sin = simd.mul_add_f64s(sin, square, simd.splat_f64s(coefficient));
    }
    let sin = simd.mul_add_f64s(simd.mul_f64s(sin, square), quarter, quarter);
    squared(simd, squared(simd, (cos, sin)))
}

/// The product of two complex numbers (real, imaginary).
#[inline(always)]
pub(crate) fn product<S: Simd>(simd: S, a: (S::f64s, S::f64s), b: (S::f64s, S::f64s)) -> (S::f64s, S::f64s) {
    let re = simd.negate_mul_add_f64s(a.1, b.1, simd.mul_f64s(a.0, b.0));
    let im = simd.mul_add_f64s(a.0, b.1, simd.mul_f64s(a.1, b.0));
    (re, im)
}

/// The square of a complex number.
#[inline(always)]
pub(crate) fn squared<S: Simd>(simd: S, a: (S::f64s, S::f64s)) -> (S::f64s, S::f64s) {
    product(simd, a, a)
}
