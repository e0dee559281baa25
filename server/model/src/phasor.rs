//! Phasors e^(jωt) of many times, computed once and shared by all states that are predicted at these times.
//!
//! Layout: one row per periodicity, one entry per time, cosine and sine apart, so that kernels run
//! with one time per lane. Invariant: entries are within 1e-11 of the exact cosine and sine.

use pulp::{Simd, WithSimd};

use crate::Periodicities;
use crate::instruction_set::arch;
use crate::periodicity::Cycles;

mod rows;
mod turn;
mod wheel;

pub(crate) use rows::AlignedRows;
pub(crate) use turn::{nearest_turn, unit_phasor};
pub(crate) use wheel::{BLOCK, GROUP, Wheels};

#[cfg(test)]
mod tests;
#[cfg(test)]
pub(crate) use tests::every_arch;

/// Cosines and sines of the phases of some times in all or some periodicities.
#[derive(Clone, Debug)]
pub struct PhasorTable {
    periodicities: Periodicities,
    civil_nanos: Vec<i64>,
    /// The periodicities in the table, ascending.
    held: Vec<u32>,
    /// One row per periodicity in the table.
    cos: AlignedRows,
    sin: AlignedRows,
}

impl PhasorTable {
    /// Phasors of local civil times (nanoseconds since 1970 local) in every periodicity.
    pub fn new(periodicities: &Periodicities, civil_nanos: &[i64]) -> PhasorTable {
        let held = (0..periodicities.len() as u32).collect();
        let mut table = PhasorTable::empty(periodicities, civil_nanos, held);
        match periodicities.cycles() {
            Cycles::Harmonics { base, .. } => {
                let turns: Vec<f64> = civil_nanos.iter().map(|&civil| base.turns(civil)).collect();
                let (cos, sin) = (&mut table.cos, &mut table.sin);
                arch().dispatch(FillHarmonics { turns: &turns, harmonics: periodicities.len(), cos, sin });
            }
            Cycles::List(_) => table.fill_rows(),
        }
        table
    }

    /// Phasors in the chosen periodicities alone, in any order. A periodicity that does not exist gets phasors of 0,
    /// which add nothing to any sum.
    pub fn only(periodicities: &Periodicities, civil_nanos: &[i64], chosen: &[u32]) -> PhasorTable {
        let mut held = chosen.to_vec();
        held.sort_unstable();
        held.dedup();
        let mut table = PhasorTable::empty(periodicities, civil_nanos, held);
        table.fill_rows();
        table
    }

    fn empty(periodicities: &Periodicities, civil_nanos: &[i64], held: Vec<u32>) -> PhasorTable {
        let (rows, times) = (held.len(), civil_nanos.len());
        PhasorTable {
            periodicities: periodicities.clone(),
            civil_nanos: civil_nanos.to_vec(),
            held,
            cos: AlignedRows::zeros(rows, times),
            sin: AlignedRows::zeros(rows, times),
        }
    }

    /// Fills each row independently, with one sincos per entry.
    fn fill_rows(&mut self) {
        let mut turns = vec![0.0; self.civil_nanos.len()];
        if let Cycles::Harmonics { base, .. } = self.periodicities.cycles() {
            fill_turns(&mut turns, &self.civil_nanos, |civil| base.turns(civil));
        }
        for (row, &k) in self.held.iter().enumerate() {
            let factor = match self.periodicities.cycles() {
                _ if k as usize >= self.periodicities.len() => continue,
                Cycles::Harmonics { .. } => f64::from(k) + 1.0,
                Cycles::List(list) => {
                    let cycle = &list[k as usize];
                    fill_turns(&mut turns, &self.civil_nanos, |civil| cycle.turns(civil));
                    1.0
                }
            };
            let (cos, sin) = (self.cos.row_mut(row), self.sin.row_mut(row));
            arch().dispatch(FillRow { turns: &turns, factor, cos, sin });
        }
    }

    /// Number of times.
    pub fn len(&self) -> usize {
        self.civil_nanos.len()
    }

    /// Whether there are no times.
    pub fn is_empty(&self) -> bool {
        self.civil_nanos.is_empty()
    }

    /// The times, local civil, in nanoseconds since 1970 local.
    pub fn civil_nanos(&self) -> &[i64] {
        &self.civil_nanos
    }

    /// The periodicities that the phases refer to.
    pub fn periodicities(&self) -> &Periodicities {
        &self.periodicities
    }

    /// Cosines and sines of all times in periodicity `k`, counted from 0; `None` if it is not in the table.
    #[inline]
    pub fn row(&self, k: u32) -> Option<(&[f64], &[f64])> {
        // In a complete table the row is the index.
        let row = match self.held.get(k as usize) {
            Some(&held) if held == k => Some(k as usize),
            _ => self.held.binary_search(&k).ok(),
        };
        row.map(|row| (self.cos.row(row), self.sin.row(row)))
    }
}

fn fill_turns(turns: &mut [f64], civil_nanos: &[i64], turn: impl Fn(i64) -> f64) {
    for (turns, &civil) in turns.iter_mut().zip(civil_nanos) {
        *turns = turn(civil);
    }
}

/// All harmonics of the base phases `turns`, by recurrence.
struct FillHarmonics<'a> {
    turns: &'a [f64],
    harmonics: usize,
    cos: &'a mut AlignedRows,
    sin: &'a mut AlignedRows,
}

impl WithSimd for FillHarmonics<'_> {
    type Output = ();

    #[inline(always)]
    fn with_simd<S: Simd>(self, simd: S) {
        let group_len = GROUP * S::F64_LANES;
        for (group, turns) in self.turns.chunks(group_len).enumerate() {
            let mut wheels = Wheels::new(simd, turns);
            let at = group * group_len;
            for block in (0..self.harmonics).step_by(BLOCK) {
                let mut spin = wheels.spin(simd);
                for k in block..self.harmonics.min(block + BLOCK) {
                    spin.step(simd);
                    let entries = at..at + turns.len();
                    store_group(simd, &mut self.cos.row_mut(k)[entries.clone()], &spin.cos);
                    store_group(simd, &mut self.sin.row_mut(k)[entries], &spin.sin);
                }
                wheels.next_block(simd);
            }
        }
    }
}

#[inline(always)]
fn store_group<S: Simd>(simd: S, out: &mut [f64], group: &[S::f64s; GROUP]) {
    for (out, &vector) in out.chunks_mut(S::F64_LANES).zip(group) {
        match S::as_mut_simd_f64s(out).0 {
            [whole] => *whole = vector,
            _ => simd.partial_store_f64s(out, vector),
        }
    }
}

/// One row: cosine and sine of `factor` times each phase.
struct FillRow<'a> {
    turns: &'a [f64],
    factor: f64,
    cos: &'a mut [f64],
    sin: &'a mut [f64],
}

impl WithSimd for FillRow<'_> {
    type Output = ();

    #[inline(always)]
    fn with_simd<S: Simd>(self, simd: S) {
        let factor = simd.splat_f64s(self.factor);
        let (turns, turns_rest) = S::as_simd_f64s(self.turns);
        let (cos, cos_rest) = S::as_mut_simd_f64s(self.cos);
        let (sin, sin_rest) = S::as_mut_simd_f64s(self.sin);
        for ((&turns, cos), sin) in turns.iter().zip(cos).zip(sin) {
            (*cos, *sin) = multiple(simd, factor, turns);
        }
        if !turns_rest.is_empty() {
            let (cos, sin) = multiple(simd, factor, simd.partial_load_f64s(turns_rest));
            simd.partial_store_f64s(cos_rest, cos);
            simd.partial_store_f64s(sin_rest, sin);
        }
    }
}

/// Cosine and sine of a multiple of each phase. This is a function because a closure might not be inlined; it would
/// then be compiled without vector instructions.
#[inline(always)]
fn multiple<S: Simd>(simd: S, factor: S::f64s, turns: S::f64s) -> (S::f64s, S::f64s) {
    unit_phasor(simd, nearest_turn(simd, simd.mul_f64s(factor, turns)))
}
