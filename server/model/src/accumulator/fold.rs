//! The kernel that adds a chunk of observations to A_k and B_k: one observation per lane.
//!
//! Harmonics run by recurrence over k with four vectors of observations side by side; the sums stay in eight lanes and
//! are added up once per chunk. Values of 0 cost as much as others: a multiply-add is cheaper than a branch. Invariant:
//! lanes without an observation add nothing. Observation i of a chunk is added in lane i modulo 8 whatever the width of
//! vectors, so that the sums have the same bits on every instruction set.

use pulp::Simd;

use crate::Sample;
use crate::lanes::{Eight, EightLanes, LANES};
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

impl EightLanes for Fold<'_> {
    type Output = ();

    #[inline(always)]
    fn run<S: Simd, const V: usize>(self, simd: S) {
        match self.cycles {
            Cycles::Harmonics { base, .. } => fold_harmonics::<S, V>(simd, base, self.samples, self.spectrum),
            Cycles::List(list) => fold_list::<S, V>(simd, list, self.samples, self.spectrum),
        }
    }
}

/// Sums of one periodicity, still in lanes: cos·s, sin·s, cos, sin.
type Lanes<S, const V: usize> = [Eight<S, V>; 4];

#[inline(always)]
fn fold_harmonics<S: Simd, const V: usize>(simd: S, base: &Cycle, samples: &[Sample], spectrum: &mut [[f64; 4]]) {
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
        let mut lanes: [Lanes<S, V>; BLOCK] = [[Eight::splat(simd, 0.0); 4]; BLOCK];
        for (group, (wheels, value)) in groups.iter_mut().enumerate() {
            let mut spin = wheels.spin(simd);
            for lanes in &mut lanes[..block.len()] {
                spin.step(simd);
                for (v, ((&value, &cos), &sin)) in value.iter().zip(&spin.cos).zip(&spin.sin).enumerate() {
                    // If V divides a group, the index is v % V.
                    add_vector(simd, lanes, (group * GROUP + v) % V, cos, sin, value);
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
fn fold_list<S: Simd, const V: usize>(simd: S, list: &[Cycle], samples: &[Sample], spectrum: &mut [[f64; 4]]) {
    // Lanes past the last observation keep the weight 0.
    let (mut turns, mut values, mut weights) = ([0.0; CHUNK], [0.0; CHUNK], [0.0; CHUNK]);
    let mut civil_nanos = [0; CHUNK];
    for (i, sample) in samples.iter().enumerate().take(CHUNK) {
        (civil_nanos[i], values[i], weights[i]) = (sample.civil_nanos(), sample.value, 1.0);
    }
    let civil_nanos = &civil_nanos[..samples.len().min(CHUNK)];
    let used = samples.len().next_multiple_of(LANES).min(CHUNK);
    let (values, weights) = (S::as_simd_f64s(&values[..used]).0, S::as_simd_f64s(&weights[..used]).0);
    for (cycle, entry) in list.iter().zip(spectrum) {
        for (turns, &civil) in turns.iter_mut().zip(civil_nanos) {
            *turns = cycle.turns(civil);
        }
        let mut lanes: Lanes<S, V> = [Eight::splat(simd, 0.0); 4];
        let turns = S::as_simd_f64s(&turns[..used]).0;
        for ((turns, values), weights) in turns.chunks(V).zip(values.chunks(V)).zip(weights.chunks(V)) {
            for (v, ((&turns, &value), &weight)) in turns.iter().zip(values).zip(weights).enumerate() {
                let (cos, sin) = unit_phasor(simd, turns);
                add_vector(simd, &mut lanes, v, simd.mul_f64s(cos, weight), simd.mul_f64s(sin, weight), value);
            }
        }
        add_lanes(simd, entry, &lanes);
    }
}

/// Adds a vector of observations, the `v`-th of the eight.
#[inline(always)]
fn add_vector<S: Simd, const V: usize>(
    simd: S,
    lanes: &mut Lanes<S, V>,
    v: usize,
    cos: S::f64s,
    sin: S::f64s,
    value: S::f64s,
) {
    lanes[0].0[v] = simd.mul_add_f64s(value, cos, lanes[0].0[v]);
    lanes[1].0[v] = simd.mul_add_f64s(value, sin, lanes[1].0[v]);
    lanes[2].0[v] = simd.add_f64s(lanes[2].0[v], cos);
    lanes[3].0[v] = simd.add_f64s(lanes[3].0[v], sin);
}

/// The sine enters negative: A and B are sums of e^(-jωt).
#[inline(always)]
fn add_lanes<S: Simd, const V: usize>(simd: S, entry: &mut [f64; 4], lanes: &Lanes<S, V>) {
    entry[0] += lanes[0].sum(simd);
    entry[1] -= lanes[1].sum(simd);
    entry[2] += lanes[2].sum(simd);
    entry[3] -= lanes[3].sum(simd);
}
