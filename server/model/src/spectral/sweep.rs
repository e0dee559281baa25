//! The kernel that runs a model over a table of phasors: one time per lane.
//!
//! Invariant: all slices that it is given are as long as the table has times, or longer.

use pulp::{Simd, WithSimd};

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

#[inline(always)]
fn vectors<S: Simd>(_simd: S, term: &Term<'_>, i: usize) -> (S::f64s, S::f64s) {
    (S::as_simd_f64s(term.cos).0[i], S::as_simd_f64s(term.sin).0[i])
}

/// ς: into `[0,1]`.
#[inline(always)]
fn saturate<S: Simd>(simd: S, p: S::f64s) -> S::f64s {
    simd.min_f64s(simd.max_f64s(p, simd.splat_f64s(0.0)), simd.splat_f64s(1.0))
}
