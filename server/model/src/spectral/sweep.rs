//! The kernel that runs a model over a table of phasors: one time per lane.
//!
//! Invariant: a prediction has the same bits on every instruction set. All slices that the kernel receives are as long
//! as the table has times, or longer.

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
                for ((p, &cos), &sin) in p.iter_mut().zip(cos).zip(sin) {
                    *p = add_term(simd, term, cos, sin, *p);
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
                p = add_term(simd, term, cos, sin, p);
            }
            *out = saturate(simd, p);
        }
        if !rest.is_empty() {
            let mut p = mean;
            for term in self.terms {
                let cos = simd.partial_load_f64s(&term.cos[rest_at..times]);
                let sin = simd.partial_load_f64s(&term.sin[rest_at..times]);
                p = add_term(simd, term, cos, sin, p);
            }
            simd.partial_store_f64s(rest, saturate(simd, p));
        }
    }
}

/// Adds a term with two roundings at every time, so that a prediction does not depend on the width of vectors.
#[inline(always)]
fn add_term<S: Simd>(simd: S, term: &Term<'_>, cos: S::f64s, sin: S::f64s, p: S::f64s) -> S::f64s {
    let (cos_weight, sin_weight) = (simd.splat_f64s(term.cos_weight), simd.splat_f64s(term.sin_weight));
    simd.mul_add_f64s(cos_weight, cos, simd.mul_add_f64s(sin_weight, sin, p))
}

#[inline(always)]
fn vectors<S: Simd>(_simd: S, term: &Term<'_>, i: usize) -> (S::f64s, S::f64s) {
    (S::as_simd_f64s(term.cos).0[i], S::as_simd_f64s(term.sin).0[i])
}

/// ς: saturates to `[0,1]`.
#[inline(always)]
fn saturate<S: Simd>(simd: S, p: S::f64s) -> S::f64s {
    simd.min_f64s(simd.max_f64s(p, simd.splat_f64s(0.0)), simd.splat_f64s(1.0))
}
