//! Credible intervals of probabilities: shortest intervals of Beta distributions by numerical integration.
//!
//! With x = 1/(1 + e^-u) the density of u is proportional to x^α (1 - x)^β: smooth, with one peak, for any α and β. So
//! equal steps in u integrate it well, where the density of x itself may be infinite at the ends. The trapezoids of a
//! coarse grid are corrected by the slope of the density at their ends (Euler and Maclaurin), and the cubic polynomials
//! of these masses and densities give the masses of a grid four times finer. The mass beyond the grid is added in
//! closed form. Invariant: the masses do not fall, and reach from 0 to 1.

use super::{HourMoments, Interval};

/// The weights of the priors with little data; they were found by rolling origin on ten weeks of one office door.
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

/// Levels, and the mass that holds the mean of the hour with this frequency. A door is often shut for the whole hour,
/// which a Beta distribution fits only in part: medium intervals would hold too little, and wide ones too, because
/// routines change. The masses were found by rolling origin on ten weeks of one office door, from 08 to 18 h of working
/// days.
const MASSES: [(f64, f64); 9] = [
    (0.0, 0.0),
    (0.3, 0.3),
    (0.4, 0.525),
    (0.5, 0.568),
    (0.6, 0.61),
    (0.8, 0.74),
    (0.9, 0.9),
    (0.95, 0.982),
    (1.0, 1.0),
];

/// The prior of the scatter: the scatter of the uniform distribution, with the weight of one day.
const SCATTER_BEFORE: (f64, f64) = (1.0 / 3.0, 1.0);

/// The band that holds the mean of the state over the hour around a moment with probability `level`.
///
/// `p` is the prediction of a model for the moment; the band is the shortest that contains it. `hour` sums this hour of
/// the day over days of its kind (weekdays, or the weekend), `all` sums all hours together. The band is wider with
/// fewer days; without data of the hour it is `[0,1]`. `p` and `level` outside `[0,1]` count as the nearer end, a `p`
/// that is NaN as no data, a `level` that is NaN as 1.
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
    let found = Beta::with_moments(mean, scatter).shortest_around(p, mass_of(level.max(0.0)), borrowed.end);
    debug_assert!(0.0 <= found.lower && found.contains(p) && found.upper <= 1.0, "{found:?} around {p}");
    found
}

/// The mass of the Beta distribution in an interval of a level, both in `[0,1]`.
fn mass_of(level: f64) -> f64 {
    let next = MASSES.partition_point(|(other, _)| *other < level).clamp(1, MASSES.len() - 1);
    let ((from, low), (to, high)) = (MASSES[next - 1], MASSES[next]);
    low + (high - low) * (level - from) / (to - from)
}

/// The mean of two values by weight.
fn blend((value, weight): (f64, f64), (other, other_weight): (f64, f64)) -> f64 {
    (value * weight + other * other_weight) / (weight + other_weight)
}

/// Number of steps of the coarse grid, and number of parts of each step.
const STEPS: usize = 96;
const PARTS: usize = 4;
/// Number of points of the fine grid.
const POINTS: usize = STEPS * PARTS + 1;
/// The grid ends at x = 8e-7 from 0 or 1, if not earlier.
const FARTHEST: f64 = 14.0;
/// The limits of the scatter, so that α and β stay in range.
const SCATTERS: std::ops::RangeInclusive<f64> = 1e-6..=0.999;

/// A Beta distribution as masses below ascending points in `[0,1]`.
pub(super) struct Beta {
    places: [f64; POINTS],
    /// The probability of less than each point.
    below: [f64; POINTS],
}

/// The coarse grid at one node.
#[derive(Clone, Copy)]
struct Node {
    x: f64,
    /// dx/du.
    x_slope: f64,
    /// The density of u, and its slope.
    density: f64,
    density_slope: f64,
}

/// The cubic polynomial with these values and slopes at the ends of a step of length 1, at the share `s` of the step.
fn cubic(s: f64, (from, from_slope): (f64, f64), (to, to_slope): (f64, f64)) -> f64 {
    let r = 1.0 - s;
    r * r * (1.0 + 2.0 * s) * from + s * s * (3.0 - 2.0 * s) * to + s * r * (r * from_slope - s * to_slope)
}

impl Beta {
    /// The distribution with the given mean and variance scatter · mean · (1 - mean), scatter = 1/(α + β + 1).
    pub(super) fn with_moments(mean: f64, scatter: f64) -> Beta {
        let total = 1.0 / scatter.clamp(*SCATTERS.start(), *SCATTERS.end()) - 1.0;
        let mean = mean.clamp(1e-9, 1.0 - 1e-9);
        let (alpha, beta) = (total * mean, total * (1.0 - mean));
        // The grid extends twelve standard deviations of u about the peak, which contains nearly all of the tails.
        let (peak, reach) = (libm::log(alpha / beta), 12.0 * (1.0 / alpha + 1.0 / beta).sqrt());
        let first = (peak - reach).clamp(-FARTHEST, FARTHEST - 1.0);
        let last = (peak + reach).clamp(first + 1e-3, FARTHEST);
        let step = (last - first) / STEPS as f64;

        // x, 1 - x and α ln x + β ln(1 - x), without cancellation on either side.
        let at = |u: f64| {
            let small = libm::exp(-u.abs());
            let log = libm::log1p(small);
            let (near, far) = (1.0 / (1.0 + small), small / (1.0 + small));
            let (x, y) = if u < 0.0 { (far, near) } else { (near, far) };
            (x, y, alpha * (u.min(0.0) - log) - beta * (u.max(0.0) + log))
        };
        let (_, _, largest) = at(peak.clamp(first, last));
        let node = |i: usize| {
            let (x, y, log) = at(first + step * i as f64);
            let density = libm::exp(log - largest);
            Node { x, x_slope: x * y, density, density_slope: density * (alpha * y - beta * x) }
        };
        let mut from = node(0);
        // ∫ x^(α-1) (1 - x)^(β-1) from 0 to x0 is nearly x0^α (1 - x0)^β / α; the other end is symmetric.
        let mut sum = from.density / alpha;
        let (mut places, mut below) = ([from.x; POINTS], [sum; POINTS]);
        for i in 0..STEPS {
            let to = node(i + 1);
            let slopes = step * step / 12.0 * (from.density_slope - to.density_slope);
            let mass = (0.5 * step * (from.density + to.density) + slopes).max(0.0);
            for part in 1..=PARTS {
                let (s, point) = (part as f64 / PARTS as f64, i * PARTS + part);
                let (low, high) = ((0.0, step * from.density), (mass, step * to.density));
                // Where the density falls steeply, a polynomial may overshoot.
                below[point] = (sum + cubic(s, low, high)).clamp(below[point - 1], sum + mass);
                let place = cubic(s, (from.x, step * from.x_slope), (to.x, step * to.x_slope));
                places[point] = place.clamp(places[point - 1], to.x);
            }
            sum += mass;
            from = to;
        }
        let all = sum + from.density / beta;
        below.iter_mut().for_each(|mass| *mass /= all);
        Beta { places, below }
    }

    /// The shortest interval that contains `p` and holds at least `level`. The parts within `end` of 0, and of 1, are
    /// included as a whole or not at all.
    pub(super) fn shortest_around(&self, p: f64, level: f64, end: f64) -> Interval {
        let (cuts, count) = self.cuts(p, end);
        let cuts = &cuts[..count];
        // The point at which the mass below reaches `mass`, in the part that ends with a cut. The parts at the ends are
        // not divided.
        let place = |next: usize, mass: f64| -> f64 {
            let (to, Some(from)) = (cuts[next], next.checked_sub(1).map(|i| cuts[i])) else { return cuts[next].0 };
            if next == 1 || next + 1 == count || to.1 <= from.1 {
                return to.0;
            }
            from.0 + (to.0 - from.0) * ((mass - from.1) / (to.1 - from.1)).clamp(0.0, 1.0)
        };
        let mut best = Interval { lower: 0.0, upper: 1.0 };
        let mut offer = |lower: f64, upper: f64| {
            if upper - lower < best.width() {
                best = Interval { lower, upper };
            }
        };
        let mut upper = 0;
        for &(from, below) in cuts.iter().take_while(|cut| cut.0 <= p) {
            // Both ends move up together: the loop finds the first upper end for this lower end.
            while upper < count && (cuts[upper].0 < p || cuts[upper].1 - below < level) {
                upper += 1;
            }
            if upper == count {
                break;
            }
            offer(from, place(upper, below + level).max(p));
        }
        // The loop finds the last lower end for the upper ends that are the prediction or near 1.
        for &(to, below) in cuts.iter().filter(|cut| cut.0 == p || cut.0 >= 1.0 - end).filter(|cut| cut.0 >= p) {
            let Some(last) = cuts.partition_point(|cut| cut.1 <= below - level).checked_sub(1) else { continue };
            let is_divided = last > 0 && last + 2 < count;
            let lower = if is_divided { place(last + 1, below - level) } else { cuts[last].0 };
            offer(lower.min(p), to);
        }
        best
    }

    /// The points at which an interval may begin or end, in order, with the probability of less than each, and the
    /// number of points. They are 0 and 1, `end` from both, the fine grid between, and `p`.
    fn cuts(&self, p: f64, end: f64) -> ([(f64, f64); POINTS + 5], usize) {
        let mut cuts = [(1.0, 1.0); POINTS + 5];
        let (first, last) =
            (self.places.partition_point(|&x| x <= end), self.places.partition_point(|&x| x < 1.0 - end));
        let middle = (p > end && p < 1.0 - end).then(|| (p, self.mass_below(p)));
        let split = if middle.is_some() {
            self.places.partition_point(|&x| x < p).clamp(first, last.max(first))
        } else {
            first
        };
        let mut count = 0;
        let mut push = |x: f64, below: f64| {
            cuts[count] = (x, below);
            count += 1;
        };
        push(0.0, 0.0);
        push(end, self.mass_below(end));
        (first..split).for_each(|i| push(self.places[i], self.below[i]));
        if let Some((x, below)) = middle {
            push(x, below);
        }
        (split..last).for_each(|i| push(self.places[i], self.below[i]));
        push(1.0 - end, self.mass_below(1.0 - end));
        push(1.0, 1.0);
        (cuts, count)
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
