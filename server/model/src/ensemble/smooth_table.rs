//! A smooth table of the hours of weekday and weekend, for states with few half-hour bins and for hours without any.
//!
//! A linear hierarchical model: the value at an hour is a common level, plus a daily shape that is smooth over
//! neighbouring hours and partly shared by weekdays and weekends, plus noise of single bins (the best linear unbiased
//! prediction of C. R. Henderson, "Best linear unbiased estimation and prediction under a selection model", Biometrics
//! 31, 1975). Three strengths and widths of the shape are averaged by their marginal likelihood; one of them has no
//! shape. Near an hour with bins the prediction follows them; far from all bins it is the state's level. Invariant:
//! every value lies strictly between 0 and 1.

use std::sync::OnceLock;

use nalgebra::{Cholesky, DMatrix, DVector};

use super::week_table::WeekTable;
use crate::hours_seen::{HOURS, Hours};
use crate::special::square;

/// Number of cells: the hours of weekday and weekend.
const CELLS: usize = 2 * HOURS;
/// The share of the variance that the daily shape has.
const SHAPE_SHARE: f64 = 0.6;
/// The widths of the shape, in hours.
const WIDTHS: [f64; 2] = [1.5, 3.0];
/// The prior probability that there is no daily shape.
const NO_SHAPE: f64 = 0.7;
/// The share of the variance of the shape that is separate for each kind of day.
const OWN_KIND: f64 = 0.3;
/// The share of the variance that is separate for each hour, without correlation to its neighbours.
const OWN_HOUR: f64 = 0.15;
/// Bins keep at least this share of the variance as noise.
const NOISE_MIN: f64 = 0.08;
/// The value before the first bin, which counts as one bin.
const PRIOR: f64 = 0.5;

/// The value by hour of the kind of day: of weekdays, then of weekends.
pub(super) type KindHours = [Hours; 2];

/// The correlation of the daily shape between two cells, for each width.
fn shapes() -> &'static [DMatrix<f64>; WIDTHS.len()] {
    static SHAPES: OnceLock<[DMatrix<f64>; WIDTHS.len()]> = OnceLock::new();
    SHAPES.get_or_init(|| {
        WIDTHS.map(|width| {
            DMatrix::from_fn(CELLS, CELLS, |one, other| {
                let turn = std::f64::consts::PI * (one % HOURS).abs_diff(other % HOURS) as f64 / HOURS as f64;
                let scale = 2.0 * std::f64::consts::PI * width / HOURS as f64;
                let near = libm::exp(-2.0 * square(libm::sin(turn) / scale));
                let same_hour = f64::from(u8::from(one % HOURS == other % HOURS));
                let hour = (1.0 - OWN_HOUR) * near + OWN_HOUR * same_hour;
                let same_kind = f64::from(u8::from(one / HOURS == other / HOURS));
                (1.0 - OWN_KIND) * hour + same_kind * OWN_KIND * (0.6 * hour + 0.4)
            })
        })
    })
}

/// The prediction of one strength and width, with the logarithm of its marginal likelihood.
struct Solved {
    evidence: f64,
    values: [f64; CELLS],
}

/// The smooth table of the bins in a table of sums.
pub(super) fn smooth_table(table: &WeekTable) -> KindHours {
    let (sums, bins) = (table.sums_by_kind(), table.bins_by_kind());
    let (sums, bins) = (sums.as_flattened(), bins.as_flattened());
    let (number, sum): (f64, f64) = (bins.iter().sum(), sums.iter().sum());
    let mean = (sum + PRIOR) / (number + 1.0);
    let variance = (mean * (1.0 - mean)).max(0.25 / (number + 2.0));
    let seen: Vec<usize> = (0..CELLS).filter(|&cell| bins[cell] > 1e-9).collect();
    let edge = 0.5 / (number + 2.0);
    let solve = |shape: Option<&DMatrix<f64>>| {
        let share = if shape.is_some() { SHAPE_SHARE } else { 0.0 };
        let covariance = |one: usize, other: usize| variance * (1.0 + share * shape.map_or(0.0, |s| s[(one, other)]));
        let noise = variance * (1.0 - share).max(NOISE_MIN);
        let of_seen = DMatrix::from_fn(seen.len(), seen.len(), |row, column| {
            let own = if row == column { noise / bins[seen[row]] } else { 0.0 };
            covariance(seen[row], seen[column]) + own
        });
        let departures = DVector::from_iterator(seen.len(), seen.iter().map(|&cell| sums[cell] / bins[cell] - PRIOR));
        let factor = Cholesky::new(of_seen)?;
        let weights = factor.solve(&departures);
        let halved_log: f64 = factor.l_dirty().diagonal().iter().map(|&entry| libm::log(entry)).sum();
        let evidence = -halved_log - 0.5 * departures.dot(&weights);
        let mut values = [PRIOR; CELLS];
        for (cell, value) in values.iter_mut().enumerate() {
            let pull: f64 = seen.iter().zip(&weights).map(|(&other, weight)| covariance(cell, other) * weight).sum();
            *value = (PRIOR + pull).clamp(edge, 1.0 - edge);
        }
        Some(Solved { evidence, values })
    };
    let flat = solve(None).map(|solved| (libm::log(NO_SHAPE), solved));
    let shaped = shapes()
        .iter()
        .filter_map(|shape| Some((libm::log((1.0 - NO_SHAPE) / WIDTHS.len() as f64), solve(Some(shape))?)));
    let solved: Vec<(f64, Solved)> = flat.into_iter().chain(shaped).collect();
    let highest = solved.iter().map(|(prior, solved)| prior + solved.evidence).fold(f64::MIN, f64::max);
    let (mut all, mut cells) = (0.0, [0.0; CELLS]);
    for (prior, solved) in &solved {
        let share = libm::exp(prior + solved.evidence - highest);
        all += share;
        cells.iter_mut().zip(solved.values).for_each(|(cell, value)| *cell += share * value);
    }
    // A covariance plus noise is positive definite; if rounding breaks this, the prediction is the mean.
    let value = |cell: f64| if all > 0.0 { cell / all } else { mean };
    let mut values = [[0.0; HOURS]; 2];
    values.as_flattened_mut().iter_mut().zip(cells).for_each(|(out, cell)| *out = value(cell));
    values
}
