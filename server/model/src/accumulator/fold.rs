//! The kernel that adds a chunk of observations to A_k and B_k: one observation per lane.
//!
//! Harmonics run by recurrence over k with four vectors of observations side by side; the sums stay
//! in lanes and are added up once per chunk. Values of 0 cost what others do: a multiply-add is
//! cheaper than a branch. Invariant: lanes without an observation add nothing.

use pulp::{Simd, WithSimd};

use crate::Sample;
use crate::periodicity::{Cycle, Cycles};
use crate::phasor::{BLOCK, GROUP, Wheels, unit_phasor};

/// Observations added at a time; their phasors and values stay in cache.
pub(super) const CHUNK: usize = 1024;

/// Adds at most [`CHUNK`] samples to the spectrum.
pub(super) struct Fold<'a> {
    pub(super) cycles: &'a Cycles,
    pub(super) samples: &'a [Sample],
    pub(super) spectrum: &'a mut [[f64; 4]],
}

impl WithSimd for Fold<'_> {
    type Output = ();

    #[inline(always)]
    fn with_simd<S: Simd>(self, simd: S) {
        match self.cycles {
            Cycles::Harmonics { base, .. } => fold_harmonics(simd, base, self.samples, self.spectrum),
            Cycles::List(list) => fold_list(simd, list, self.samples, self.spectrum),
        }
    }
}

/// Sums of one periodicity, still in lanes: cos·s, sin·s, cos, sin.
type Lanes<S> = [<S as Simd>::f64s; 4];

#[inline(always)]
fn fold_harmonics<S: Simd>(simd: S, base: &Cycle, samples: &[Sample], spectrum: &mut [[f64; 4]]) {
    let group_len = GROUP * S::F64_LANES;
    let mut groups: Vec<(Wheels<S>, [S::f64s; GROUP])> = Vec::with_capacity(samples.len().div_ceil(group_len));
    for group in samples.chunks(group_len) {
        let mut turns = [0.0; GROUP * 8];
        let mut values = [0.0; GROUP * 8];
        for ((turns, value), sample) in turns.iter_mut().zip(&mut values).zip(group) {
            *turns = base.turns(sample.civil_nanos());
            *value = sample.value;
        }
        let mut value = [simd.splat_f64s(0.0); GROUP];
        for (vector, values) in value.iter_mut().zip(values.chunks(S::F64_LANES)) {
            *vector = simd.partial_load_f64s(values);
        }
        groups.push((Wheels::new(simd, &turns[..group.len().min(turns.len())]), value));
    }
    for block in spectrum.chunks_mut(BLOCK) {
        let mut lanes: [Lanes<S>; BLOCK] = [[simd.splat_f64s(0.0); 4]; BLOCK];
        for (wheels, value) in &mut groups {
            let mut spin = wheels.spin(simd);
            for lanes in &mut lanes[..block.len()] {
                spin.step(simd);
                for ((&value, &cos), &sin) in value.iter().zip(&spin.cos).zip(&spin.sin) {
                    add_vector(simd, lanes, cos, sin, value);
                }
            }
            wheels.next_block(simd);
        }
        for (entry, lanes) in block.iter_mut().zip(&lanes) {
            add_lanes(simd, entry, lanes);
        }
    }
}

#[inline(always)]
fn fold_list<S: Simd>(simd: S, list: &[Cycle], samples: &[Sample], spectrum: &mut [[f64; 4]]) {
    // Lanes past the last observation keep the weight 0.
    let (mut turns, mut values, mut weights) = ([0.0; CHUNK], [0.0; CHUNK], [0.0; CHUNK]);
    let mut civil_nanos = [0; CHUNK];
    for (i, sample) in samples.iter().enumerate().take(CHUNK) {
        (civil_nanos[i], values[i], weights[i]) = (sample.civil_nanos(), sample.value, 1.0);
    }
    let civil_nanos = &civil_nanos[..samples.len().min(CHUNK)];
    let used = samples.len().next_multiple_of(S::F64_LANES).min(CHUNK);
    let (values, weights) = (S::as_simd_f64s(&values[..used]).0, S::as_simd_f64s(&weights[..used]).0);
    for (cycle, entry) in list.iter().zip(spectrum) {
        for (turns, &civil) in turns.iter_mut().zip(civil_nanos) {
            *turns = cycle.turns(civil);
        }
        let mut lanes: Lanes<S> = [simd.splat_f64s(0.0); 4];
        for ((&turns, &value), &weight) in S::as_simd_f64s(&turns[..used]).0.iter().zip(values).zip(weights) {
            let (cos, sin) = unit_phasor(simd, turns);
            add_vector(simd, &mut lanes, simd.mul_f64s(cos, weight), simd.mul_f64s(sin, weight), value);
        }
        add_lanes(simd, entry, &lanes);
    }
}

#[inline(always)]
fn add_vector<S: Simd>(simd: S, lanes: &mut Lanes<S>, cos: S::f64s, sin: S::f64s, value: S::f64s) {
    lanes[0] = simd.mul_add_e_f64s(value, cos, lanes[0]);
    lanes[1] = simd.mul_add_e_f64s(value, sin, lanes[1]);
    lanes[2] = simd.add_f64s(lanes[2], cos);
    lanes[3] = simd.add_f64s(lanes[3], sin);
}

/// The sine enters negative: A and B are sums of e^(-jωt).
#[inline(always)]
fn add_lanes<S: Simd>(simd: S, entry: &mut [f64; 4], lanes: &Lanes<S>) {
    entry[0] += simd.reduce_sum_f64s(lanes[0]);
    entry[1] -= simd.reduce_sum_f64s(lanes[1]);
    entry[2] += simd.reduce_sum_f64s(lanes[2]);
    entry[3] -= simd.reduce_sum_f64s(lanes[3]);
}
