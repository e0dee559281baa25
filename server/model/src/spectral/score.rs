//! Scores every order of a model in one pass over a table of phasors: one time per lane of eight.
//!
//! An order's prediction is that of the order below plus one term. The readings at a time are given as sums, so that
//! readings which no candidate period separates cost one prediction together: with the prediction p, n readings of sum
//! s and sum of squares q have the squared error q + p (n p - 2 s).
//!
//! Invariant: an omitted time adds nothing to any sum. Sums have the same bits on every instruction set, and no squared
//! error is below 0.

use pulp::Simd;

use super::SpectralModel;
use super::sweep::Term;
use crate::instruction_set::arch;
use crate::lanes::{Eight, EightLanes, LANES, OnLanes};
use crate::{ORDER_MAX, PhasorTable};

#[cfg(test)]
mod tests;

/// Errors of each order 0..=[`ORDER_MAX`], summed over observations.
#[derive(Clone, Copy, Debug, PartialEq, Default)]
pub struct ScoreSums {
    /// Sum of squared differences of prediction and value.
    pub squared: [f64; ORDER_MAX + 1],
    /// Number of predictions on the other side of 0.5 than the value; 0.5 itself counts as 1 (T-RO eq. 15).
    pub wrong: [f64; ORDER_MAX + 1],
}

/// The readings at the times of a table, one entry per time. All readings of a time have one prediction.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct ReadingSums {
    /// Number of readings, 0 and more; 0: the time is omitted.
    pub counts: Vec<f64>,
    /// Sum of the readings' values, each in `[0,1]`.
    pub sums: Vec<f64>,
    /// Sum of the squares of the readings' values.
    pub squares: Vec<f64>,
    /// Number of values that are at least 0.5.
    pub high: Vec<f64>,
}

impl ReadingSums {
    /// Number of times.
    pub fn len(&self) -> usize {
        self.counts.len()
    }

    /// Whether there are no times.
    pub fn is_empty(&self) -> bool {
        self.counts.is_empty()
    }

    /// Removes all times.
    pub fn clear(&mut self) {
        for column in [&mut self.counts, &mut self.sums, &mut self.squares, &mut self.high] {
            column.clear();
        }
    }

    /// Adds a time with its readings, whose values are in `[0,1]`.
    #[inline]
    pub fn push(&mut self, values: impl Iterator<Item = f64>) {
        let [mut count, mut sum, mut square, mut high] = [0.0; 4];
        for value in values {
            count += 1.0;
            sum += value;
            square += value * value;
            high += f64::from(u8::from(value >= 0.5));
        }
        self.counts.push(count);
        self.sums.push(sum);
        self.squares.push(square);
        self.high.push(high);
    }

    /// Adds some times of `others`; adds nothing if `others` does not have them all.
    pub fn extend_from(&mut self, others: &ReadingSums, times: std::ops::Range<usize>) {
        self.counts.extend_from_slice(others.counts.get(times.clone()).unwrap_or_default());
        self.sums.extend_from_slice(others.sums.get(times.clone()).unwrap_or_default());
        self.squares.extend_from_slice(others.squares.get(times.clone()).unwrap_or_default());
        self.high.extend_from_slice(others.high.get(times).unwrap_or_default());
    }
}

impl SpectralModel {
    /// Adds the errors of every order 0..=[`ORDER_MAX`] at predicting `values`, each in `[0,1]`, at the times of the
    /// table. If there are fewer values than times, only the first times count. `wrong` is counted only if requested.
    pub fn score_run_values(&self, phasors: &PhasorTable, values: &[f64], sums: &mut ScoreSums, with_wrong: bool) {
        let mut readings = ReadingSums::default();
        values.iter().for_each(|&value| readings.push(std::iter::once(value)));
        self.score_readings(phasors, &readings, sums, with_wrong);
    }

    /// Adds the errors of every order 0..=[`ORDER_MAX`] at predicting the readings at the times of the table. If the
    /// readings have fewer times, only the first times count. `wrong` is counted only if requested. It is fast if the
    /// table holds the model's periodicities, and correct in any case.
    pub fn score_readings(
        &self,
        phasors: &PhasorTable,
        readings: &ReadingSums,
        sums: &mut ScoreSums,
        with_wrong: bool,
    ) {
        let ReadingSums { counts, sums: values, squares, high } = readings;
        let times = phasors.len().min(counts.len()).min(values.len()).min(squares.len()).min(high.len());
        let columns = Columns {
            counts: &counts[..times],
            sums: &values[..times],
            squares: &squares[..times],
            high: &high[..times],
        };
        let mean = self.mean;
        let mut terms = [Term::default(); ORDER_MAX];
        match self.terms(ORDER_MAX, phasors, &mut terms) {
            Some(terms) => arch().dispatch(OnLanes(ScoreKernel { mean, terms, columns, with_wrong, sums })),
            None => {
                let own: Vec<u32> = self.components.iter().map(|component| component.periodicity).collect();
                let phasors = PhasorTable::only(phasors.periodicities(), &phasors.civil_nanos()[..times], &own);
                let mut terms = [Term::default(); ORDER_MAX];
                let terms = self.terms(ORDER_MAX, &phasors, &mut terms).unwrap_or(&[]);
                arch().dispatch(OnLanes(ScoreKernel { mean, terms, columns, with_wrong, sums }));
            }
        }
    }
}

/// The readings at each time; all columns are equally long.
#[derive(Clone, Copy)]
pub(super) struct Columns<'a> {
    counts: &'a [f64],
    sums: &'a [f64],
    squares: &'a [f64],
    high: &'a [f64],
}

impl<'a> Columns<'a> {
    #[inline(always)]
    fn from(self, at: usize) -> Columns<'a> {
        Columns {
            counts: &self.counts[at..],
            sums: &self.sums[at..],
            squares: &self.squares[at..],
            high: &self.high[at..],
        }
    }
}

/// Adds the errors of every order.
pub(super) struct ScoreKernel<'a, 'b> {
    pub(super) mean: f64,
    pub(super) terms: &'b [Term<'a>],
    pub(super) columns: Columns<'b>,
    pub(super) with_wrong: bool,
    pub(super) sums: &'b mut ScoreSums,
}

impl EightLanes for ScoreKernel<'_, '_> {
    type Output = ();

    #[inline(always)]
    fn run<S: Simd, const V: usize>(self, simd: S) {
        // The kernel runs as many vectors side by side as registers hold, each with its prediction and its readings.
        match (V, self.with_wrong) {
            (1, false) => self.add::<S, V, 8, false>(simd),
            (1, true) => self.add::<S, V, 4, true>(simd),
            (2, false) => self.add::<S, V, 2, false>(simd),
            (_, false) => self.add::<S, V, 1, false>(simd),
            (_, true) => self.add::<S, V, 1, true>(simd),
        }
    }
}

impl ScoreKernel<'_, '_> {
    #[inline(always)]
    fn add<S: Simd, const V: usize, const SIDE_BY_SIDE: usize, const WRONG: bool>(self, simd: S) {
        let used = self.terms.len().min(ORDER_MAX);
        let terms = &self.terms[..used];
        let mut lanes = ScoreLanes::<S, V>::new(simd);
        let times = self.columns.counts.len();
        let mut at = 0;
        while at + SIDE_BY_SIDE * LANES <= times {
            lanes.add::<SIDE_BY_SIDE, WRONG>(simd, self.mean, terms, self.columns.from(at), at);
            at += SIDE_BY_SIDE * LANES;
        }
        while at + LANES <= times {
            lanes.add::<1, WRONG>(simd, self.mean, terms, self.columns.from(at), at);
            at += LANES;
        }
        if at < times {
            // The last eight are padded with omitted times.
            let rest = self.columns.from(at);
            let [counts, sums, squares, high] = [rest.counts, rest.sums, rest.squares, rest.high].map(padded);
            let columns = Columns { counts: &counts, sums: &sums, squares: &squares, high: &high };
            let mut rows = [([0.0; LANES], [0.0; LANES]); ORDER_MAX];
            for (row, term) in rows.iter_mut().zip(terms) {
                *row = (padded(&term.cos[at..times]), padded(&term.sin[at..times]));
            }
            let mut padded_terms = [Term::default(); ORDER_MAX];
            for ((padded, term), (cos, sin)) in padded_terms.iter_mut().zip(terms).zip(&rows) {
                *padded = Term { cos, sin, ..*term };
            }
            lanes.add::<1, WRONG>(simd, self.mean, &padded_terms[..used], columns, 0);
        }
        lanes.add_to::<WRONG>(simd, used, self.sums);
    }
}

/// At most eight numbers, and zeros behind them.
#[inline(always)]
fn padded(numbers: &[f64]) -> [f64; LANES] {
    let mut padded = [0.0; LANES];
    for (padded, number) in padded.iter_mut().zip(numbers) {
        *padded = *number;
    }
    padded
}

/// The first `N` times eight numbers in vectors; `None` if there are fewer.
#[inline(always)]
fn eights<S: Simd, const V: usize, const N: usize>(numbers: &[f64]) -> Option<&[[S::f64s; V]; N]> {
    S::as_simd_f64s(numbers).0.as_chunks::<V>().0.first_chunk::<N>()
}

/// The readings at `N` times eight times.
struct ReadingLanes<S: Simd, const V: usize, const N: usize> {
    counts: [[S::f64s; V]; N],
    /// -2 times the sum of the values.
    minus_twice: [[S::f64s; V]; N],
    /// The increase in wrong predictions when the prediction reaches 0.5.
    step: [[S::f64s; V]; N],
}

/// Sums of each order, still in lanes.
struct ScoreLanes<S: Simd, const V: usize> {
    /// Σ p (n p - 2 s).
    squared: [Eight<S, V>; ORDER_MAX + 1],
    wrong: [Eight<S, V>; ORDER_MAX + 1],
    /// Σ q, equal for every order.
    squares: Eight<S, V>,
    /// Number of values of at least 0.5: the wrong predictions of each order if all were below 0.5.
    high: Eight<S, V>,
}

impl<S: Simd, const V: usize> ScoreLanes<S, V> {
    #[inline(always)]
    fn new(simd: S) -> ScoreLanes<S, V> {
        let zero = Eight::splat(simd, 0.0);
        ScoreLanes { squared: [zero; ORDER_MAX + 1], wrong: [zero; ORDER_MAX + 1], squares: zero, high: zero }
    }

    /// Adds the errors at `N` times eight times: the first times of the columns, and the times of the terms from `at`
    /// on.
    #[inline(always)]
    fn add<const N: usize, const WRONG: bool>(
        &mut self,
        simd: S,
        mean: f64,
        terms: &[Term<'_>],
        columns: Columns<'_>,
        at: usize,
    ) {
        let (zero, minus_two) = (simd.splat_f64s(0.0), simd.splat_f64s(-2.0));
        let Some(counts) = eights::<S, V, N>(columns.counts) else { return };
        let Some(sums) = eights::<S, V, N>(columns.sums) else { return };
        let Some(squares) = eights::<S, V, N>(columns.squares) else { return };
        let mut prediction = [[simd.splat_f64s(mean); V]; N];
        let mut readings = ReadingLanes { counts: *counts, minus_twice: *sums, step: [[zero; V]; N] };
        for n in 0..N {
            for v in 0..V {
                readings.minus_twice[n][v] = simd.mul_f64s(minus_two, sums[n][v]);
                self.squares.0[v] = simd.add_f64s(self.squares.0[v], squares[n][v]);
            }
        }
        if WRONG {
            let Some(high) = eights::<S, V, N>(columns.high) else { return };
            for n in 0..N {
                for v in 0..V {
                    readings.step[n][v] = simd.mul_add_f64s(minus_two, high[n][v], counts[n][v]);
                    self.high.0[v] = simd.add_f64s(self.high.0[v], high[n][v]);
                }
            }
        }
        self.add_order::<N, WRONG>(simd, 0, &prediction, &readings);
        for (order, term) in (1..=ORDER_MAX).zip(terms) {
            let Some(cos) = eights::<S, V, N>(&term.cos[at..]) else { return };
            let Some(sin) = eights::<S, V, N>(&term.sin[at..]) else { return };
            let (cos_weight, sin_weight) = (simd.splat_f64s(term.cos_weight), simd.splat_f64s(term.sin_weight));
            for n in 0..N {
                for v in 0..V {
                    let once = simd.mul_add_f64s(cos_weight, cos[n][v], prediction[n][v]);
                    prediction[n][v] = simd.mul_add_f64s(sin_weight, sin[n][v], once);
                }
            }
            self.add_order::<N, WRONG>(simd, order, &prediction, &readings);
        }
    }

    #[inline(always)]
    fn add_order<const N: usize, const WRONG: bool>(
        &mut self,
        simd: S,
        order: usize,
        prediction: &[[S::f64s; V]; N],
        readings: &ReadingLanes<S, V, N>,
    ) {
        let (zero, half, one) = (simd.splat_f64s(0.0), simd.splat_f64s(0.5), simd.splat_f64s(1.0));
        let mut squared = self.squared[order].0;
        for (n, prediction) in prediction.iter().enumerate() {
            for (v, &prediction) in prediction.iter().enumerate() {
                let saturated = simd.min_f64s(simd.max_f64s(prediction, zero), one);
                let inner = simd.mul_add_f64s(readings.counts[n][v], saturated, readings.minus_twice[n][v]);
                squared[v] = simd.mul_add_f64s(saturated, inner, squared[v]);
            }
        }
        self.squared[order].0 = squared;
        if WRONG {
            let mut wrong = self.wrong[order].0;
            for (n, prediction) in prediction.iter().enumerate() {
                for (v, &prediction) in prediction.iter().enumerate() {
                    let is_high = simd.greater_than_or_equal_f64s(prediction, half);
                    let step = simd.select_f64s(is_high, readings.step[n][v], zero);
                    wrong[v] = simd.add_f64s(wrong[v], step);
                }
            }
            self.wrong[order].0 = wrong;
        }
    }

    /// Adds the lanes up. Every order above the `used` components has the same prediction.
    #[inline(always)]
    fn add_to<const WRONG: bool>(&self, simd: S, used: usize, sums: &mut ScoreSums) {
        let (mut squared, mut wrong) = (0.0, 0.0);
        for order in 0..=ORDER_MAX {
            if order <= used {
                // With a perfect prediction, rounding may make the sum negative.
                squared = (self.squares.sum(simd) + self.squared[order].sum(simd)).max(0.0);
                if WRONG {
                    wrong = self.high.sum(simd) + self.wrong[order].sum(simd);
                }
            }
            sums.squared[order] += squared;
            sums.wrong[order] += wrong;
        }
    }
}
