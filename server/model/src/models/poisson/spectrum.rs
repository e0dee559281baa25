//! The spectrum of weighted counts: γ_k = Σ w (c - μ) e^(-jω_k t) / Σ w.
//!
//! The sums are those of the accumulator, but with weights and values above 1. Invariant: components are finite,
//! strongest first, with periods within the observed span.

use crate::{Component, ORDER_MAX, Periodicities, PhasorTable, StopSignal};

/// The count of one observed bin.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(super) struct Bin {
    /// The middle of the bin in local civil time, nanoseconds since 1970 local.
    pub(super) centre_nanos: i64,
    pub(super) count: f64,
    /// The weight of the bin, in `(0,1]`: the weight of its last reading.
    pub(super) weight: f64,
}

/// Number of bins that share one table of phasors.
const CHUNK: usize = 512;

/// γ_k for every periodicity.
pub(super) struct Spectrum {
    gammas: Vec<Component>,
}

impl Spectrum {
    /// The spectrum of observed bins, ascending. It is empty without bins, and it is that of a part of them if the
    /// training is stopped.
    pub(super) fn of(bins: &[Bin], periodicities: &Periodicities, stop: StopSignal<'_>) -> Spectrum {
        let (Some(first), Some(last)) = (bins.first(), bins.last()) else { return Spectrum { gammas: Vec::new() } };
        let weight: f64 = bins.iter().map(|bin| bin.weight).sum();
        // The weights are shares of the whole, so that sums of huge counts stay in range.
        let mean: f64 = bins.iter().map(|bin| bin.count * (bin.weight / weight)).sum();
        let mut gammas: Vec<Component> = (0..periodicities.len() as u32)
            .map(|periodicity| Component { periodicity, gamma_re: 0.0, gamma_im: 0.0 })
            .collect();
        for chunk in bins.chunks(CHUNK) {
            if stop.is_set() {
                break;
            }
            let times: Vec<i64> = chunk.iter().map(|bin| bin.centre_nanos).collect();
            let values: Vec<f64> = chunk.iter().map(|bin| (bin.count - mean) * (bin.weight / weight)).collect();
            let phasors = PhasorTable::new(periodicities, &times);
            for gamma in &mut gammas {
                let Some((cos, sin)) = phasors.row(gamma.periodicity) else { continue };
                gamma.gamma_re += values.iter().zip(cos).map(|(value, cos)| value * cos).sum::<f64>();
                gamma.gamma_im -= values.iter().zip(sin).map(|(value, sin)| value * sin).sum::<f64>();
            }
        }
        let span_nanos = last.centre_nanos.abs_diff(first.centre_nanos);
        gammas.retain(|gamma| periodicities.is_eligible(gamma.periodicity as usize, span_nanos));
        Spectrum { gammas }
    }

    /// The [`ORDER_MAX`] strongest components; of equal components the lower index comes first.
    pub(super) fn strongest(mut self) -> Vec<Component> {
        self.gammas.retain(|gamma| gamma.amplitude() > 0.0);
        self.gammas.sort_by(|a, b| b.amplitude().total_cmp(&a.amplitude()));
        self.gammas.truncate(ORDER_MAX);
        self.gammas
    }
}
