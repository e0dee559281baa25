//! Scores every order of a model in one pass over a table of phasors: one time per lane of eight.
//!
//! An order's prediction is the one below plus one term. The value carried from order to order is prediction minus
//! value, so that saturating the prediction to `[0,1]` is keeping the error between -value and 1 - value, and omitting
//! a time is keeping its error between 0 and 0.
//!
//! Invariant: an omitted time adds nothing to any sum. Sums have the same bits on every instruction set.

use pulp::{Arch, Simd};

use super::SpectralModel;
use super::sweep::Term;
use crate::lanes::{Eight, EightLanes, LANES, OnLanes};
use crate::{ORDER_MAX, PhasorTable};

#[cfg(test)]
mod tests;

const ONES: [f64; LANES] = [1.0; LANES];

/// Errors of each order 0..=[`ORDER_MAX`], summed over observations.
#[derive(Clone, Copy, Debug, PartialEq, Default)]
pub struct ScoreSums {
    /// Sum of squared differences of prediction and value.
    pub squared: [f64; ORDER_MAX + 1],
    /// Number of predictions on the other side of 0.5 than the value; 0.5 itself counts as 1 (T-RO eq. 15).
    pub wrong: [f64; ORDER_MAX + 1],
}

impl SpectralModel {
    /// Adds the errors of every order 0..=[`ORDER_MAX`] at predicting `values`, each in `[0,1]`, at the times of the
    /// table. Times of weight 0 are omitted, others count once; without weights, all count. Where `values` or `weights`
    /// are shorter than the table, for the first times only. `wrong` is counted only if requested. Fast where the table
    /// holds the model's periodicities, correct in any case.
    pub fn score_run_values(
        &self,
        phasors: &PhasorTable,
        values: &[f64],
        weights: Option<&[f64]>,
        sums: &mut ScoreSums,
        with_wrong: bool,
    ) {
        let times = phasors.len().min(values.len()).min(weights.map_or(usize::MAX, <[f64]>::len));
        let (values, weights) = (&values[..times], weights.map(|weights| &weights[..times]));
        let mut terms = [Term::default(); ORDER_MAX];
        match self.terms(ORDER_MAX, phasors, &mut terms) {
            Some(terms) => {
                let mean = self.mean;
                Arch::new().dispatch(OnLanes(ScoreKernel { mean, terms, values, weights, with_wrong, sums }));
            }
            None => {
                let own: Vec<u32> = self.components.iter().map(|component| component.periodicity).collect();
                let phasors = PhasorTable::only(phasors.periodicities(), &phasors.civil_nanos()[..times], &own);
                let mut terms = [Term::default(); ORDER_MAX];
                let terms = self.terms(ORDER_MAX, &phasors, &mut terms).unwrap_or(&[]);
                let mean = self.mean;
                Arch::new().dispatch(OnLanes(ScoreKernel { mean, terms, values, weights, with_wrong, sums }));
            }
        }
    }
}

/// Adds the errors of every order.
pub(super) struct ScoreKernel<'a, 'b> {
    pub(super) mean: f64,
    pub(super) terms: &'b [Term<'a>],
    pub(super) values: &'b [f64],
    /// As long as the values.
    pub(super) weights: Option<&'b [f64]>,
    pub(super) with_wrong: bool,
    pub(super) sums: &'b mut ScoreSums,
}

impl EightLanes for ScoreKernel<'_, '_> {
    type Output = ();

    #[inline(always)]
    fn run<S: Simd, const V: usize>(self, simd: S) {
        // As many vectors side by side as registers hold, each with its error and the error's bounds.
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
        let times = self.values.len();
        let mut at = 0;
        while at + SIDE_BY_SIDE * LANES <= times {
            let weights = self.weights.map(|weights| &weights[at..]);
            lanes.add::<SIDE_BY_SIDE, WRONG>(simd, self.mean, terms, &self.values[at..], weights, at);
            at += SIDE_BY_SIDE * LANES;
        }
        while at + LANES <= times {
            let weights = self.weights.map(|weights| &weights[at..]);
            lanes.add::<1, WRONG>(simd, self.mean, terms, &self.values[at..], weights, at);
            at += LANES;
        }
        if at < times {
            // The last eight are padded with omitted times.
            let padded_values = padded(&self.values[at..]);
            let padded_weights = padded(self.weights.map_or(&ONES[..times - at], |weights| &weights[at..]));
            let mut rows = [([0.0; LANES], [0.0; LANES]); ORDER_MAX];
            for (row, term) in rows.iter_mut().zip(terms) {
                *row = (padded(&term.cos[at..times]), padded(&term.sin[at..times]));
            }
            let mut padded_terms = [Term::default(); ORDER_MAX];
            for ((padded, term), (cos, sin)) in padded_terms.iter_mut().zip(terms).zip(&rows) {
                *padded = Term { cos, sin, ..*term };
            }
            let weights = Some(&padded_weights[..]);
            lanes.add::<1, WRONG>(simd, self.mean, &padded_terms[..used], &padded_values, weights, 0);
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

/// The observations at `N` times eight times.
struct ErrorBounds<S: Simd, const V: usize, const N: usize> {
    /// The bounds of the error.
    lowest: [[S::f64s; V]; N],
    highest: [[S::f64s; V]; N],
    /// The error from which the prediction is at least 0.5.
    threshold: [[S::f64s; V]; N],
    /// How many wrong predictions more there are from there on: 1, or -1 where the value is itself at
    /// least 0.5, or 0 where the time is left out.
    step: [[S::f64s; V]; N],
}

/// Sums of each order, still in lanes.
struct ScoreLanes<S: Simd, const V: usize> {
    squared: [Eight<S, V>; ORDER_MAX + 1],
    wrong: [Eight<S, V>; ORDER_MAX + 1],
    /// Values of at least 0.5: wrong predictions of each order if all were below 0.5.
    positive: Eight<S, V>,
}

impl<S: Simd, const V: usize> ScoreLanes<S, V> {
    #[inline(always)]
    fn new(simd: S) -> ScoreLanes<S, V> {
        let zero = Eight::splat(simd, 0.0);
        ScoreLanes { squared: [zero; ORDER_MAX + 1], wrong: [zero; ORDER_MAX + 1], positive: zero }
    }

    /// Adds the errors at `N` times eight times: the first of `values` and `weights`, and those of the
    /// terms from time `at`.
    #[inline(always)]
    fn add<const N: usize, const WRONG: bool>(
        &mut self,
        simd: S,
        mean: f64,
        terms: &[Term<'_>],
        values: &[f64],
        weights: Option<&[f64]>,
        at: usize,
    ) {
        let (zero, half, one) = (simd.splat_f64s(0.0), simd.splat_f64s(0.5), simd.splat_f64s(1.0));
        let mean = simd.splat_f64s(mean);
        let Some(values) = eights::<S, V, N>(values) else { return };
        let mut counted = [[one; V]; N];
        if let Some(weights) = weights {
            let Some(weights) = eights::<S, V, N>(weights) else { return };
            for (counted, &weight) in counted.as_flattened_mut().iter_mut().zip(weights.as_flattened()) {
                *counted = simd.select_f64s(simd.greater_than_f64s(weight, zero), one, zero);
            }
        }
        let mut error = [[zero; V]; N];
        let mut observed = ErrorBounds { lowest: error, highest: error, threshold: error, step: error };
        for n in 0..N {
            for v in 0..V {
                let (value, counted) = (values[n][v], counted[n][v]);
                error[n][v] = simd.sub_f64s(mean, value);
                observed.lowest[n][v] = simd.neg_f64s(simd.mul_f64s(counted, value));
                observed.highest[n][v] = simd.add_f64s(counted, observed.lowest[n][v]);
                if WRONG {
                    let positive = simd.greater_than_or_equal_f64s(value, half);
                    observed.threshold[n][v] = simd.sub_f64s(half, value);
                    observed.step[n][v] = simd.select_f64s(positive, simd.neg_f64s(counted), counted);
                    let counted = simd.select_f64s(positive, counted, zero);
                    self.positive.0[v] = simd.add_f64s(self.positive.0[v], counted);
                }
            }
        }
        self.add_order::<N, WRONG>(simd, 0, &error, &observed);
        for (order, term) in (1..=ORDER_MAX).zip(terms) {
            let Some(cos) = eights::<S, V, N>(&term.cos[at..]) else { return };
            let Some(sin) = eights::<S, V, N>(&term.sin[at..]) else { return };
            let (cos_weight, sin_weight) = (simd.splat_f64s(term.cos_weight), simd.splat_f64s(term.sin_weight));
            for n in 0..N {
                for v in 0..V {
                    let once = simd.mul_add_f64s(cos_weight, cos[n][v], error[n][v]);
                    error[n][v] = simd.mul_add_f64s(sin_weight, sin[n][v], once);
                }
            }
            self.add_order::<N, WRONG>(simd, order, &error, &observed);
        }
    }

    #[inline(always)]
    fn add_order<const N: usize, const WRONG: bool>(
        &mut self,
        simd: S,
        order: usize,
        error: &[[S::f64s; V]; N],
        observed: &ErrorBounds<S, V, N>,
    ) {
        let mut squared = self.squared[order].0;
        for n in 0..N {
            for v in 0..V {
                let error = simd.max_f64s(error[n][v], observed.lowest[n][v]);
                let saturated = simd.min_f64s(error, observed.highest[n][v]);
                squared[v] = simd.mul_add_f64s(saturated, saturated, squared[v]);
            }
        }
        self.squared[order].0 = squared;
        if WRONG {
            let zero = simd.splat_f64s(0.0);
            let mut wrong = self.wrong[order].0;
            for (n, error) in error.iter().enumerate() {
                for (v, &error) in error.iter().enumerate() {
                    let predicted = simd.greater_than_or_equal_f64s(error, observed.threshold[n][v]);
                    let step = simd.select_f64s(predicted, observed.step[n][v], zero);
                    wrong[v] = simd.add_f64s(wrong[v], step);
                }
            }
            self.wrong[order].0 = wrong;
        }
    }

    /// Adds the lanes up. Beyond its `used` components a model predicts the same at every order.
    #[inline(always)]
    fn add_to<const WRONG: bool>(&self, simd: S, used: usize, sums: &mut ScoreSums) {
        let (mut squared, mut wrong) = (0.0, 0.0);
        for order in 0..=ORDER_MAX {
            if order <= used {
                squared = self.squared[order].sum(simd);
                if WRONG {
                    wrong = self.positive.sum(simd) + self.wrong[order].sum(simd);
                }
            }
            sums.squared[order] += squared;
            sums.wrong[order] += wrong;
        }
    }
}
