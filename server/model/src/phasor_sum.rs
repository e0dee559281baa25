//! Sums of phasors over sets of observation times, for values that change rarely.
//!
//! A cell that stays occupied from observation i up to observation j adds `P[j] - P[i]` to its A_k, where
//! `P[i]` = Σ e^(-jω_k t) over the first i observations. P is shared by all cells that were observed at
//! those times, so a cell costs K additions per change of its value and nothing per observation. Sums
//! commute: this is exact for irregular times and any order of arrival.
//!
//! Invariant: every slice has 2K entries, for K periodicities: all real parts, then all imaginary parts.

use std::ops::Range;

use pulp::{Simd, WithSimd};

use crate::instruction_set::arch;
use crate::phasor::AlignedRows;
use crate::{InvalidParts, Periodicities, PhasorTable};

#[cfg(test)]
mod tests;

/// Periodicities, and times, that running sums go through at a time: a cache line either way, and
/// enough independent sums to hide the latency of an addition.
const TILE: usize = 8;
/// Times whose rows are filled together; a multiple of [`TILE`].
const STRIP: usize = 16;

/// Σ e^(-jω_k t) over some times t (local civil, as in [`PhasorTable`]), per periodicity k.
#[derive(Clone, Debug, PartialEq)]
pub struct PhasorSum {
    /// Real parts, then imaginary parts.
    parts: Box<[f64]>,
}

impl PhasorSum {
    /// The sum over no times.
    pub fn zero(periodicities: &Periodicities) -> PhasorSum {
        PhasorSum { parts: vec![0.0; 2 * periodicities.len()].into_boxed_slice() }
    }

    /// A sum from stored parts.
    ///
    /// # Errors
    /// [`InvalidParts`] unless there are two finite numbers per periodicity.
    pub fn from_slice(periodicities: &Periodicities, parts: &[f64]) -> Result<PhasorSum, InvalidParts> {
        let expected = 2 * periodicities.len();
        if parts.len() != expected {
            return Err(InvalidParts::SpectrumLength { expected, found: parts.len() });
        }
        for &part in parts {
            InvalidParts::check("phasor sum", part, f64::MIN..=f64::MAX)?;
        }
        Ok(PhasorSum { parts: parts.into() })
    }

    /// All K real parts, then all K imaginary parts (sums of -sin), for storage.
    pub fn as_slice(&self) -> &[f64] {
        &self.parts
    }

    /// Real parts and imaginary parts.
    pub(crate) fn halves(&self) -> (&[f64], &[f64]) {
        self.parts.split_at(self.parts.len() / 2)
    }

    /// Memory, in bytes.
    pub fn bytes(&self) -> usize {
        size_of::<PhasorSum>() + size_of_val(&*self.parts)
    }

    /// Adds the times of another sum.
    pub fn add(&mut self, other: &PhasorSum) {
        self.add_row(&other.parts);
    }

    /// Adds a row of the same layout. Where the row is shorter than the sum, the rest stays.
    pub fn add_row(&mut self, row: &[f64]) {
        arch().dispatch(AddRow::<false> { sum: &mut self.parts, row });
    }

    /// Subtracts a row of the same layout. Where the row is shorter than the sum, the rest stays.
    pub fn subtract_row(&mut self, row: &[f64]) {
        arch().dispatch(AddRow::<true> { sum: &mut self.parts, row });
    }

    /// Multiplies the weight of all times by a factor.
    pub fn scale(&mut self, factor: f64) {
        self.parts.iter_mut().for_each(|part| *part *= factor);
    }

    /// Adds the times of another sum, each with this weight.
    pub fn add_scaled(&mut self, other: &PhasorSum, factor: f64) {
        for (sum, part) in self.parts.iter_mut().zip(&other.parts) {
            *sum += part * factor;
        }
    }

    /// Adds `plus - minus`: the times from one row of [`RunningSums`] up to a later one. Where a row is
    /// shorter than the sum, the rest stays.
    pub fn add_difference(&mut self, plus: &[f64], minus: &[f64]) {
        arch().dispatch(AddDifference { sum: &mut self.parts, plus, minus });
    }
}

/// `sum += row`, or `sum -= row` if `NEGATED`.
struct AddRow<'a, const NEGATED: bool> {
    sum: &'a mut [f64],
    row: &'a [f64],
}

impl<const NEGATED: bool> WithSimd for AddRow<'_, NEGATED> {
    type Output = ();

    #[inline(always)]
    fn with_simd<S: Simd>(self, simd: S) {
        let used = self.sum.len().min(self.row.len());
        let (sum, sum_rest) = S::as_mut_simd_f64s(&mut self.sum[..used]);
        let (row, row_rest) = S::as_simd_f64s(&self.row[..used]);
        for (sum, &row) in sum.iter_mut().zip(row) {
            *sum = if NEGATED { simd.sub_f64s(*sum, row) } else { simd.add_f64s(*sum, row) };
        }
        for (sum, row) in sum_rest.iter_mut().zip(row_rest) {
            *sum = if NEGATED { *sum - row } else { *sum + row };
        }
    }
}

/// `sum += plus - minus`
struct AddDifference<'a> {
    sum: &'a mut [f64],
    plus: &'a [f64],
    minus: &'a [f64],
}

impl WithSimd for AddDifference<'_> {
    type Output = ();

    #[inline(always)]
    fn with_simd<S: Simd>(self, simd: S) {
        let used = self.sum.len().min(self.plus.len()).min(self.minus.len());
        let (sum, sum_rest) = S::as_mut_simd_f64s(&mut self.sum[..used]);
        let (plus, plus_rest) = S::as_simd_f64s(&self.plus[..used]);
        let (minus, minus_rest) = S::as_simd_f64s(&self.minus[..used]);
        for ((sum, &plus), &minus) in sum.iter_mut().zip(plus).zip(minus) {
            *sum = simd.add_f64s(*sum, simd.sub_f64s(plus, minus));
        }
        for ((sum, plus), minus) in sum_rest.iter_mut().zip(plus_rest).zip(minus_rest) {
            *sum += plus - minus;
        }
    }
}

/// `P[0]`, `P[1]`, … `P[n]` over a chunk of n consecutive observation times: `P[i]` is the sum over all times
/// before the chunk, since the last [`RunningSums::reset`], and the first i of the chunk.
///
/// A sum over n times is within 1e-9·n of the exact one up to some million times between resets.
#[derive(Clone, Debug)]
pub struct RunningSums {
    /// Number of periodicities K.
    periodicities: usize,
    /// Number of times in the chunk; there is one row more.
    times: usize,
    rows: AlignedRows,
}

impl RunningSums {
    /// The sums before the first time: one row of zeros.
    pub fn new(periodicities: &Periodicities) -> RunningSums {
        let periodicities = periodicities.len();
        RunningSums { periodicities, times: 0, rows: AlignedRows::zeros(1, 2 * periodicities) }
    }

    /// Resets to zeros, before the first time.
    pub fn reset(&mut self) {
        self.times = 0;
        self.rows.row_mut(0).fill(0.0);
    }

    /// Continues with the next chunk of times: its row 0 is the last row of the previous chunk, and each time of the
    /// table adds one row. A periodicity that the table does not hold keeps its sum.
    pub fn extend_chunk(&mut self, phasors: &PhasorTable) {
        self.extend::<false>(phasors, &[]);
    }

    /// Does the same as [`RunningSums::extend_chunk`] with weights: row i becomes Σ w·e^(-jω_k t). The weights are
    /// finite, of either sign, one per time; missing weights are 0.
    pub fn extend_weighted(&mut self, phasors: &PhasorTable, weights: &[f64]) {
        self.extend::<true>(phasors, weights);
    }

    fn extend<const WEIGHTED: bool>(&mut self, phasors: &PhasorTable, weights: &[f64]) {
        let last = self.row(self.times).to_vec();
        self.times = phasors.len();
        if self.rows.count() <= self.times {
            self.rows = AlignedRows::zeros(self.times + 1, last.len());
        }
        self.rows.row_mut(0).copy_from_slice(&last);
        let (cos, sin): (Vec<_>, Vec<_>) =
            (0..self.periodicities).map(|k| phasors.row(k as u32).unwrap_or_default()).unzip();
        // The loop fills few rows at a time, so that all written rows fit into the translation cache (TLB).
        for at in (0..self.times).step_by(STRIP) {
            let strip = at..self.times.min(at + STRIP);
            for (group, (cos, sin)) in cos.chunks(TILE).zip(sin.chunks(TILE)).enumerate() {
                self.run_on::<false, WEIGHTED>(cos, weights, group * TILE, strip.clone());
                self.run_on::<true, WEIGHTED>(sin, weights, self.periodicities + group * TILE, strip.clone());
            }
        }
    }

    /// Fills at most [`TILE`] columns from `column` on, one per row of phasors, in the rows after the times of `strip`.
    /// Each row is the row before plus the phasors of the time, or minus them if `NEGATED`. If `WEIGHTED`, the phasors
    /// of each time are multiplied by its weight.
    fn run_on<const NEGATED: bool, const WEIGHTED: bool>(
        &mut self,
        phasors: &[&[f64]],
        weights: &[f64],
        column: usize,
        strip: Range<usize>,
    ) {
        let columns = column..column + phasors.len();
        let mut sums = [0.0; TILE];
        sums[..phasors.len()].copy_from_slice(&self.rows.row(strip.start)[columns.clone()]);
        for at in strip.clone().step_by(TILE) {
            // Phasors are read along rows and used along columns, so that each cache line is read once.
            let mut tile = [[0.0; TILE]; TILE];
            for (tile, phasors) in tile.iter_mut().zip(phasors) {
                let phasors = phasors.get(at..).unwrap_or_default();
                match phasors.first_chunk::<TILE>() {
                    Some(whole) => *tile = *whole,
                    None => tile.iter_mut().zip(phasors).for_each(|(entry, phasor)| *entry = *phasor),
                }
            }
            if WEIGHTED {
                let mut factors = [0.0; TILE];
                factors.iter_mut().zip(weights.get(at..).unwrap_or_default()).for_each(|(to, from)| *to = *from);
                for tile in &mut tile {
                    tile.iter_mut().zip(&factors).for_each(|(entry, factor)| *entry *= factor);
                }
            }
            for time in 0..TILE.min(strip.end - at) {
                for (sum, tile) in sums.iter_mut().zip(&tile) {
                    *sum = if NEGATED { *sum - tile[time] } else { *sum + tile[time] };
                }
                let entries = &mut self.rows.row_mut(at + time + 1)[columns.clone()];
                match entries.first_chunk_mut::<TILE>() {
                    Some(whole) => *whole = sums,
                    None => entries.iter_mut().zip(&sums).for_each(|(entry, sum)| *entry = *sum),
                }
            }
        }
    }

    /// The sum before time `i` of the chunk, in the layout of [`PhasorSum::as_slice`]; `row(len())` is the sum after
    /// its last time. It is empty if `i` is above [`RunningSums::len`].
    #[inline]
    pub fn row(&self, i: usize) -> &[f64] {
        if i <= self.times { self.rows.row(i) } else { &[] }
    }

    /// Number of times in the chunk.
    pub fn len(&self) -> usize {
        self.times
    }

    /// Whether there are no times in the chunk.
    pub fn is_empty(&self) -> bool {
        self.times == 0
    }

    /// Memory, in bytes.
    pub fn bytes(&self) -> usize {
        size_of::<RunningSums>() + self.rows.bytes()
    }
}
