//! Kernels that run a model over a table of phasors: one time per lane.
//!
//! Invariant: all slices that a kernel is given are as long as the table has times, or longer.

use pulp::{Simd, WithSimd};

use crate::MAX_ORDER;

/// Vectors of times that run side by side.
const GROUP: usize = 4;

/// A component over a table: its row of phasors and 2·re γ, -2·im γ.
#[derive(Clone, Copy, Default)]
pub(super) struct Term<'a> {
    pub(super) cos: &'a [f64],
    pub(super) sin: &'a [f64],
    pub(super) cos_weight: f64,
    pub(super) sin_weight: f64,
}

impl Term<'_> {
    #[inline(always)]
    fn at(&self, time: usize) -> f64 {
        self.cos_weight * self.cos[time] + self.sin_weight * self.sin[time]
    }
}

/// Predicts at each time.
pub(super) struct Predict<'a> {
    pub(super) mean: f64,
    pub(super) terms: &'a [Term<'a>],
    pub(super) times: usize,
    pub(super) out: &'a mut [f64],
}

impl WithSimd for Predict<'_> {
    type Output = ();

    #[inline(always)]
    fn with_simd<S: Simd>(self, simd: S) {
        let times = self.times.min(self.out.len());
        let mean = simd.splat_f64s(self.mean);
        let (whole, rest) = S::as_mut_simd_f64s(&mut self.out[..times]);
        let rest_at = times - rest.len();
        let (groups, singles) = whole.as_chunks_mut::<GROUP>();
        let singles_at = groups.len() * GROUP;
        for (group, out) in groups.iter_mut().enumerate() {
            let mut p = [mean; GROUP];
            for term in self.terms {
                let cos = &S::as_simd_f64s(term.cos).0[group * GROUP..(group + 1) * GROUP];
                let sin = &S::as_simd_f64s(term.sin).0[group * GROUP..(group + 1) * GROUP];
                let (cos_weight, sin_weight) = (simd.splat_f64s(term.cos_weight), simd.splat_f64s(term.sin_weight));
                for ((p, &cos), &sin) in p.iter_mut().zip(cos).zip(sin) {
                    *p = simd.mul_add_e_f64s(cos_weight, cos, simd.mul_add_e_f64s(sin_weight, sin, *p));
                }
            }
            for (out, &p) in out.iter_mut().zip(&p) {
                *out = saturate(simd, p);
            }
        }
        for (single, out) in singles.iter_mut().enumerate() {
            let mut p = mean;
            for term in self.terms {
                let (cos, sin) = vectors(simd, term, singles_at + single);
                p = simd.mul_add_e_f64s(simd.splat_f64s(term.cos_weight), cos, p);
                p = simd.mul_add_e_f64s(simd.splat_f64s(term.sin_weight), sin, p);
            }
            *out = saturate(simd, p);
        }
        for (time, out) in rest.iter_mut().enumerate() {
            let p = self.terms.iter().fold(self.mean, |p, term| p + term.at(rest_at + time));
            *out = p.clamp(0.0, 1.0);
        }
    }
}

/// Errors of each order 0..=[`MAX_ORDER`], summed.
#[derive(Clone, Copy, Debug, PartialEq, Default)]
pub(crate) struct ErrorSums {
    /// Sum of squared differences of prediction and value.
    pub(crate) squared: [f64; MAX_ORDER + 1],
    /// Number of predictions on the other side of 0.5 than the value.
    pub(crate) wrong: [f64; MAX_ORDER + 1],
}

impl ErrorSums {
    pub(crate) fn add(&mut self, other: &ErrorSums) {
        for order in 0..=MAX_ORDER {
            self.squared[order] += other.squared[order];
            self.wrong[order] += other.wrong[order];
        }
    }
}

/// Scores every order in one pass: an order's prediction is the one below plus one term.
pub(super) struct Score<'a> {
    pub(super) mean: f64,
    pub(super) terms: &'a [Term<'a>],
    pub(super) values: &'a [f64],
}

impl WithSimd for Score<'_> {
    type Output = ErrorSums;

    #[inline(always)]
    fn with_simd<S: Simd>(self, simd: S) -> ErrorSums {
        let (mean, zero) = (simd.splat_f64s(self.mean), simd.splat_f64s(0.0));
        let (half, one) = (simd.splat_f64s(0.5), simd.splat_f64s(1.0));
        let (whole, rest) = S::as_simd_f64s(self.values);
        let rest_at = self.values.len() - rest.len();
        let used = self.terms.len().min(MAX_ORDER);
        let mut squared = [zero; MAX_ORDER + 1];
        let mut wrong = [zero; MAX_ORDER + 1];
        for (i, &value) in whole.iter().enumerate() {
            let positive = simd.greater_than_or_equal_f64s(value, half);
            let mut p = mean;
            for order in 0..=used {
                if order > 0 {
                    let term = &self.terms[order - 1];
                    let (cos, sin) = vectors(simd, term, i);
                    p = simd.mul_add_e_f64s(simd.splat_f64s(term.cos_weight), cos, p);
                    p = simd.mul_add_e_f64s(simd.splat_f64s(term.sin_weight), sin, p);
                }
                let forecast = saturate(simd, p);
                let error = simd.sub_f64s(forecast, value);
                squared[order] = simd.mul_add_e_f64s(error, error, squared[order]);
                let differs = simd.xor_m64s(positive, simd.greater_than_or_equal_f64s(forecast, half));
                wrong[order] = simd.add_f64s(wrong[order], simd.select_f64s(differs, one, zero));
            }
        }
        let mut sums = ErrorSums::default();
        for order in 0..=used {
            sums.squared[order] = simd.reduce_sum_f64s(squared[order]);
            sums.wrong[order] = simd.reduce_sum_f64s(wrong[order]);
        }
        for (i, &value) in rest.iter().enumerate() {
            let mut p = self.mean;
            for order in 0..=used {
                if order > 0 {
                    p += self.terms[order - 1].at(rest_at + i);
                }
                let forecast = p.clamp(0.0, 1.0);
                sums.squared[order] += (forecast - value) * (forecast - value);
                sums.wrong[order] += f64::from(u8::from((forecast >= 0.5) != (value >= 0.5)));
            }
        }
        // Beyond its components a model predicts the same at every order.
        let (squared, wrong) = (sums.squared[used], sums.wrong[used]);
        sums.squared[used..].fill(squared);
        sums.wrong[used..].fill(wrong);
        sums
    }
}

#[inline(always)]
fn vectors<S: Simd>(_simd: S, term: &Term<'_>, i: usize) -> (S::f64s, S::f64s) {
    (S::as_simd_f64s(term.cos).0[i], S::as_simd_f64s(term.sin).0[i])
}

/// ς: into `[0,1]`.
#[inline(always)]
fn saturate<S: Simd>(simd: S, p: S::f64s) -> S::f64s {
    simd.min_f64s(simd.max_f64s(p, simd.splat_f64s(0.0)), simd.splat_f64s(1.0))
}
