//! Whether errors fall from day to day.
//!
//! The slope is the slope of a straight line (least squares). Its p-value is the share of orders of the days whose
//! slope is at least as steep, up or down: a permutation test with a fixed seed.
//!
//! Invariant: the same days give the same trend.

use rand::{SeedableRng as _, rngs::SmallRng, seq::SliceRandom as _};

/// Number of orders that are drawn.
const DRAWS: usize = 9_999;
const SEED: u64 = 1;
/// A slope nearer to 0 than this comes from equal values, and rounding.
const ROUNDING: f64 = 1e-12;

/// The slope of values over days.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct DayTrend {
    /// The change of a value in a day.
    pub slope: f64,
    /// The two-sided p-value.
    pub p_value: f64,
}

impl DayTrend {
    /// The trend of a value for each day; none with fewer than three days.
    pub(super) fn new(values: &[f64]) -> Option<Self> {
        if values.len() < 3 {
            return None;
        }
        let own = slope(values);
        if own.abs() < ROUNDING {
            return Some(Self { slope: 0.0, p_value: 1.0 });
        }
        let mut random = SmallRng::seed_from_u64(SEED);
        let mut shuffled = values.to_vec();
        let is_as_steep = |_: &usize| {
            shuffled.shuffle(&mut random);
            // Slopes of the same values in another order may differ by rounding.
            slope(&shuffled).abs() >= own.abs() * (1.0 - 1e-9)
        };
        let as_steep = (0..DRAWS).filter(is_as_steep).count();
        // The order as it was counts as a draw.
        Some(Self { slope: own, p_value: (as_steep as f64 + 1.0) / (DRAWS as f64 + 1.0) })
    }
}

fn slope(values: &[f64]) -> f64 {
    let middle = (values.len() as f64 - 1.0) / 2.0;
    let (mut along, mut squares) = (0.0, 0.0);
    for (day, value) in values.iter().enumerate() {
        let away = day as f64 - middle;
        along += away * value;
        squares += away * away;
    }
    along / squares
}
