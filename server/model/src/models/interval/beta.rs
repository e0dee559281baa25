//! Credible intervals of probabilities: shortest intervals of Beta distributions by numerical integration.
//!
//! With x = 1/(1 + e^-u) the density of u is proportional to x^α (1 - x)^β: smooth, with one peak, whatever α and β; so
//! equal steps in u integrate it well, where the density of x itself may be infinite at the ends. The mass beyond the
//! grid is added in closed form. Invariant: the masses are positive and sum to 1.

use super::{HourMoments, Interval};
use crate::special::softplus;

/// The weights of the priors with little data; found by rolling origin on ten weeks of one office door.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(super) struct IntervalPrior {
    /// The weight of the scatter of all hours, in days of the hour itself.
    pub(super) scatter_days: f64,
    /// The weight of the ignorant mean of 1/2, in days.
    pub(super) doubt_days: f64,
    /// An hour whose mean is this close to 0 or 1 counts as 0 or 1.
    pub(super) end: f64,
}

pub(super) const INTERVAL_PRIOR: IntervalPrior = IntervalPrior { scatter_days: 1.0, doubt_days: 1.0, end: 0.0001 };

/// Levels, and the mass that holds the mean of the hour so often. A door is often shut for the whole hour, which a Beta
/// distribution shows only in part: medium intervals would hold too little, and wide ones too, because routines change.
/// Found by rolling origin on ten weeks of one office door, from 08 to 18 h of working days.
const MASSES: [(f64, f64); 9] = [
    (0.0, 0.0),
    (0.3, 0.3),
    (0.4, 0.525),
    (0.5, 0.57),
    (0.6, 0.61),
    (0.8, 0.785),
    (0.9, 0.9),
    (0.95, 0.982),
    (1.0, 1.0),
];

/// The prior of the scatter: that of the uniform distribution, with the weight of one day.
const SCATTER_BEFORE: (f64, f64) = (1.0 / 3.0, 1.0);

/// The band that holds the mean of the state over the hour around a moment with probability `level`.
///
/// `p` is the prediction of a model for the moment; the band is the shortest that contains it. `hour` sums this hour of
/// the day on such days (weekdays, or the weekend), `all` all hours together. The band is wider with fewer days;
/// without data of the hour it is `[0,1]`. `p` and `level` outside `[0,1]` count as the nearer end, a `p` that is NaN
/// as no data, a `level` that is NaN as 1.
pub fn credible_interval(p: f64, hour: HourMoments, all: HourMoments, level: f64) -> Interval {
    interval(p, hour, all, level, INTERVAL_PRIOR)
}

pub(super) fn interval(p: f64, hour: HourMoments, all: HourMoments, level: f64, borrowed: IntervalPrior) -> Interval {
    let hour = hour.plausible();
    if p.is_nan() || hour.days <= 0.0 || level.is_nan() || level >= 1.0 {
        return Interval { lower: 0.0, upper: 1.0 };
    }
    let p = p.clamp(0.0, 1.0);
    let mean = (hour.days * p + borrowed.doubt_days * 0.5) / (hour.days + borrowed.doubt_days);
    let of_all = blend(all.scatter(), SCATTER_BEFORE);
    let scatter = blend(hour.scatter(), (of_all, borrowed.scatter_days));
    Beta::with_moments(mean, scatter).shortest_around(p, mass_of(level.max(0.0)), borrowed.end)
}

/// The mass of the Beta distribution that an interval of a level holds, both in `[0,1]`.
fn mass_of(level: f64) -> f64 {
    let next = MASSES.partition_point(|(other, _)| *other < level).clamp(1, MASSES.len() - 1);
    let ((from, low), (to, high)) = (MASSES[next - 1], MASSES[next]);
    low + (high - low) * (level - from) / (to - from)
}

/// The mean of two values by weight.
fn blend((value, weight): (f64, f64), (other, other_weight): (f64, f64)) -> f64 {
    (value * weight + other * other_weight) / (weight + other_weight)
}

/// Steps of the grid.
const STEPS: usize = 1024;
/// The grid ends at x = 8e-7 from 0 or 1, if not before.
const FARTHEST: f64 = 14.0;
/// The limits of the scatter, so that α and β stay in range.
const SCATTERS: std::ops::RangeInclusive<f64> = 1e-6..=0.999;

/// A Beta distribution as masses between ascending points in `[0,1]`.
pub(super) struct Beta {
    /// STEPS + 1 places.
    places: Vec<f64>,
    /// The probability of less than each point.
    below: Vec<f64>,
}

impl Beta {
    /// The distribution with the given mean and variance scatter · mean · (1 - mean), scatter = 1/(α + β + 1).
    pub(super) fn with_moments(mean: f64, scatter: f64) -> Beta {
        let total = 1.0 / scatter.clamp(*SCATTERS.start(), *SCATTERS.end()) - 1.0;
        let mean = mean.clamp(1e-9, 1.0 - 1e-9);
        let (alpha, beta) = (total * mean, total * (1.0 - mean));
        // Twelve standard deviations of u about the peak, which contains nearly all of the tails.
        let (peak, reach) = ((alpha / beta).ln(), 12.0 * (1.0 / alpha + 1.0 / beta).sqrt());
        let first = (peak - reach).clamp(-FARTHEST, FARTHEST - 1.0);
        let last = (peak + reach).clamp(first + 1e-3, FARTHEST);
        let step = (last - first) / STEPS as f64;

        let at = |u: f64| alpha * -softplus(-u) + beta * -softplus(u);
        let nodes: Vec<f64> = (0..=STEPS).map(|i| first + step * i as f64).collect();
        let logs: Vec<f64> = nodes.iter().map(|&u| at(u)).collect();
        // ∫ x^(α-1) (1 - x)^(β-1) from 0 to x0 is nearly x0^α (1 - x0)^β / α, and alike at the other end.
        let (left, right) = (logs[0] - alpha.ln(), logs[STEPS] - beta.ln());
        let largest = logs.iter().copied().fold(left.max(right), f64::max);
        let mut sum = (left - largest).exp();
        let mut below = Vec::with_capacity(STEPS + 1);
        below.push(sum);
        for pair in logs.windows(2) {
            sum += 0.5 * step * ((pair[0] - largest).exp() + (pair[1] - largest).exp());
            below.push(sum);
        }
        let all = sum + (right - largest).exp();
        below.iter_mut().for_each(|mass| *mass /= all);
        Beta { places: nodes.into_iter().map(|u| 1.0 / (1.0 + (-u).exp())).collect(), below }
    }

    /// The shortest interval that contains `p` and holds at least `level`. The parts within `end` of 0, and of 1, are
    /// included as a whole or not at all.
    pub(super) fn shortest_around(&self, p: f64, level: f64, end: f64) -> Interval {
        let first = self.places.partition_point(|&x| x <= end);
        let last = self.places.partition_point(|&x| x < 1.0 - end);
        let mut cuts = vec![(0.0, 0.0), (end, self.mass_below(end))];
        cuts.extend((first..last).map(|i| (self.places[i], self.below[i])));
        cuts.extend([(1.0 - end, self.mass_below(1.0 - end)), (1.0, 1.0)]);
        if p > end && p < 1.0 - end {
            // It may lie beyond the grid.
            cuts.insert(cuts.partition_point(|cut| cut.0 < p), (p, self.mass_below(p)));
        }
        let mut best = Interval { lower: 0.0, upper: 1.0 };
        let mut upper = 0;
        for &(from, below) in cuts.iter().take_while(|cut| cut.0 <= p) {
            // Both ends move up together: finds the first upper end for this lower end.
            while upper < cuts.len() && (cuts[upper].0 < p || cuts[upper].1 - below < level) {
                upper += 1;
            }
            let Some(&(to, _)) = cuts.get(upper) else { break };
            if to - from < best.width() {
                best = Interval { lower: from, upper: to };
            }
        }
        best
    }

    /// The probability of less than x, linear between points.
    pub(super) fn mass_below(&self, x: f64) -> f64 {
        let next = self.places.partition_point(|&place| place < x);
        match (next.checked_sub(1).map(|i| (self.places[i], self.below[i])), self.places.get(next)) {
            (Some((from, mass)), Some(&to)) => mass + (self.below[next] - mass) * (x - from) / (to - from),
            (Some((_, mass)), None) => mass,
            (None, _) => self.below[0],
        }
    }
}
