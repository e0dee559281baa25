//! Trains a model of a state of two values, from sums of phasors.
//!
//! Invariant: the same sums give the same model as [`SpectralModel::train`], to 1e-9.

use pulp::{Simd, WithSimd};

use super::component::Strongest;
use super::{Component, SpectralModel};
use crate::instruction_set::arch;
use crate::{Periodicities, PhasorSum};

#[cfg(test)]
mod tests;

/// Periodicities whose γ_k are computed at a time; a multiple of every number of lanes.
const BLOCK: usize = 64;

/// The sums over the observations of a state that is either free or occupied.
#[derive(Clone, Copy, Debug)]
pub struct CellSums<'a> {
    /// Number of observations n.
    pub observations: u64,
    /// Total weight of the observations, above 0: n, or less with a half-life. The mean and the sums have the same
    /// weights.
    pub weight: f64,
    /// Mean in units in which an observation of free counts as 0 and of occupied as 1. Without observations of other
    /// levels, it is the share of observations of occupied.
    pub mean: f64,
    /// Σ x e^(-jω_k t), where x is the observation in the units of `mean`. Without observations of other levels, it is
    /// the sum over the times of observations of occupied.
    pub a: &'a PhasorSum,
    /// Σ e^(-jω_k t) over the times of all observations.
    pub b: &'a PhasorSum,
    /// The observed span, last observation less first, in nanoseconds UTC.
    pub span_nanos: u64,
    /// The median time between observations, and the time between regular ones, in nanoseconds, from
    /// [`GapSample`](crate::GapSample); 0 if unknown.
    pub gap_nanos: (u64, u64),
    /// The values, each in `[0,1]`, of an observation of free and of an observation of occupied.
    pub levels: (f64, f64),
}

impl SpectralModel {
    /// The model of a state of two values; equals the result of [`SpectralModel::train_with_gaps`]. The sums must be
    /// over the same periodicities. Without observations, it is the untrained model.
    pub fn train_on_sums(sums: CellSums<'_>, periodicities: &Periodicities) -> SpectralModel {
        if sums.observations == 0 {
            return SpectralModel::default();
        }
        let (free, occupied) = sums.levels;
        let (b_re, b_im) = sums.b.halves();
        let squares = b_re.iter().zip(b_im).map(|(re, im)| re * re + im * im);
        let in_phase_nanos = periodicities.in_phase_nanos(squares, sums.weight);
        let mut strongest = Strongest::new();
        arch().dispatch(CellTraining {
            sums: &sums,
            scale: (occupied - free) / sums.weight,
            span_nanos: sums.span_nanos.saturating_add(sums.gap_nanos.0),
            resolved_nanos: sums.gap_nanos.1.max(in_phase_nanos),
            periodicities,
            strongest: &mut strongest,
        });
        let mean = (free + (occupied - free) * sums.mean).clamp(0.0, 1.0);
        SpectralModel { mean, observations: sums.observations, components: strongest.into_components(periodicities) }
    }
}

/// γ_k = scale·(A_k - mean·B_k) of each periodicity, offered to the choice of the strongest.
struct CellTraining<'a> {
    sums: &'a CellSums<'a>,
    scale: f64,
    /// The observed span with the median gap added.
    span_nanos: u64,
    /// The readings resolve only periods of at least twice this time.
    resolved_nanos: u64,
    periodicities: &'a Periodicities,
    strongest: &'a mut Strongest,
}

impl WithSimd for CellTraining<'_> {
    type Output = ();

    #[inline(always)]
    fn with_simd<S: Simd>(self, simd: S) {
        let ((a_re, a_im), (b_re, b_im)) = (self.sums.a.halves(), self.sums.b.halves());
        let (minus_mean, scale) = (simd.splat_f64s(-self.sums.mean), simd.splat_f64s(self.scale));
        let parts = a_re.chunks(BLOCK).zip(a_im.chunks(BLOCK)).zip(b_re.chunks(BLOCK).zip(b_im.chunks(BLOCK)));
        for (block, ((a_re, a_im), (b_re, b_im))) in parts.enumerate() {
            let used = a_re.len().min(b_re.len());
            let (mut re, mut im, mut power) = ([0.0; BLOCK], [0.0; BLOCK], [0.0; BLOCK]);
            for at in (0..used).step_by(S::F64_LANES) {
                let here = at..used.min(at + S::F64_LANES);
                let gamma_re = gamma(simd, minus_mean, scale, &a_re[here.clone()], &b_re[here.clone()]);
                let gamma_im = gamma(simd, minus_mean, scale, &a_im[here.clone()], &b_im[here.clone()]);
                let square = simd.mul_add_f64s(gamma_re, gamma_re, simd.mul_f64s(gamma_im, gamma_im));
                simd.partial_store_f64s(&mut re[here.clone()], gamma_re);
                simd.partial_store_f64s(&mut im[here.clone()], gamma_im);
                simd.partial_store_f64s(&mut power[here], square);
            }
            for (at, power) in power.iter().enumerate() {
                let k = block * BLOCK + at;
                if *power > self.strongest.to_beat()
                    && self.periodicities.is_eligible(k, self.span_nanos)
                    && self.periodicities.is_resolved(k, self.resolved_nanos)
                {
                    let component = Component { periodicity: k as u32, gamma_re: re[at], gamma_im: im[at] };
                    self.strongest.offer(*power, component);
                }
            }
        }
    }
}

#[inline(always)]
fn gamma<S: Simd>(simd: S, minus_mean: S::f64s, scale: S::f64s, a: &[f64], b: &[f64]) -> S::f64s {
    let (a, b) = (simd.partial_load_f64s(a), simd.partial_load_f64s(b));
    simd.mul_f64s(scale, simd.mul_add_f64s(minus_mean, b, a))
}
