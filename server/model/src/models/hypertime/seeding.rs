//! Initial clusters: k-means over hypertime.
//!
//! On the circles the distance is the cosine distance 1 - cos Δ, elsewhere half the squared Euclidean one (RA-L 2019
//! section III.H; half, because squared chords are 2(1 - cos Δ)). The first centres are drawn by k-means++ (D. Arthur
//! and S. Vassilvitskii, 2007). Invariant: equal points and seed give equal clusters.

use rand::rngs::SmallRng;
use rand::{Rng, SeedableRng};

use super::cluster::{Cluster, HypertimeCluster, VARIANCE_MIN};
use crate::StopSignal;

/// Weighted points: `coordinates` numbers, then cosine and sine on each of `circles` circles.
#[derive(Clone, Debug)]
pub(super) struct Points<'a> {
    pub(super) coordinates: usize,
    pub(super) circles: usize,
    pub(super) numbers: Vec<f64>,
    /// The weights, above 0.
    pub(super) weights: Vec<f64>,
    /// The weight of independent readings: readings of the same hour are nearly repetitions.
    pub(super) unit: f64,
    /// Ends a training on these points early; its result must then not be used.
    pub(super) stop: StopSignal<'a>,
}

impl<'a> Points<'a> {
    pub(super) fn new(coordinates: usize, circles: usize, unit: f64, stop: StopSignal<'a>) -> Points<'a> {
        Points { coordinates, circles, numbers: Vec::new(), weights: Vec::new(), unit, stop }
    }

    pub(super) fn stride(&self) -> usize {
        self.coordinates + 2 * self.circles
    }

    /// The numbers and weight of each point.
    pub(super) fn iter(&self) -> impl Iterator<Item = (&[f64], f64)> {
        // The stride is at least 1, so that points without coordinates and circles are counted.
        let stride = self.stride();
        self.weights.iter().enumerate().map(move |(index, &weight)| (&self.numbers[index * stride..][..stride], weight))
    }
}

const ROUNDS: usize = 10;

/// Variance of all points along each coordinate.
pub(super) fn spread(points: &Points) -> Vec<f64> {
    let total: f64 = points.weights.iter().sum();
    let mut means = vec![0.0; points.coordinates];
    for (numbers, weight) in points.iter() {
        for (mean, number) in means.iter_mut().zip(numbers) {
            *mean += weight * number / total;
        }
    }
    let mut variances = vec![0.0; points.coordinates];
    for (numbers, weight) in points.iter() {
        for ((variance, mean), number) in variances.iter_mut().zip(&means).zip(numbers) {
            *variance += weight * (number - mean) * (number - mean) / total;
        }
    }
    variances
}

/// Clusters of equal weight around the centres that k-means finds; fewer where there are fewer distinct points.
pub(super) fn first_clusters(points: &Points, clusters: usize, seed: u64) -> Vec<Cluster> {
    let centres = k_means(points, clusters, &mut SmallRng::seed_from_u64(seed));
    let variances = spread(points);
    let count = centres.len().max(1) as f64;
    let shrunk = libm::pow(count, -2.0 / points.stride().max(1) as f64);
    let cluster = |centre: Vec<f64>| {
        let (linear, circles) = centre.split_at(points.coordinates);
        let factor = (0..points.coordinates).flat_map(|i| {
            let deviation = (variances[i] * shrunk + VARIANCE_MIN).sqrt();
            (0..=i).map(move |j| if i == j { deviation } else { 0.0 })
        });
        let alone = centres.len() == 1;
        Cluster::new(HypertimeCluster {
            weight: 1.0 / count,
            centre: linear.to_vec(),
            factor: factor.collect(),
            directions_rad: circles.chunks_exact(2).map(|pair| libm::atan2(pair[1], pair[0])).collect(),
            concentrations: vec![if alone { 0.0 } else { 1.0 }; points.circles],
        })
    };
    centres.iter().cloned().map(cluster).collect()
}

fn distance(point: &[f64], centre: &[f64], coordinates: usize) -> f64 {
    let (linear, circles) = point.split_at(coordinates);
    let (centre_linear, centre_circles) = centre.split_at(coordinates);
    let squared: f64 = linear.iter().zip(centre_linear).map(|(a, b)| (a - b) * (a - b)).sum();
    let cosines: f64 = circles.iter().zip(centre_circles).map(|(a, b)| a * b).sum();
    // Rounding must not make the distance negative: it is a weight in a draw.
    (0.5 * squared + (circles.len() / 2) as f64 - cosines).max(0.0)
}

fn k_means(points: &Points, clusters: usize, rng: &mut SmallRng) -> Vec<Vec<f64>> {
    let stride = points.stride();
    let count = points.weights.len();
    let point = |index: usize| &points.numbers[index * stride..][..stride];
    let mut centres: Vec<Vec<f64>> = Vec::new();
    let mut nearest: Vec<f64> = vec![1.0; count];
    while centres.len() < clusters.max(1) {
        let masses = || nearest.iter().zip(&points.weights).map(|(near, weight)| near * weight);
        let total: f64 = masses().sum();
        // If the sum is this small, all points are at a centre.
        if total <= 1e-12 * points.weights.iter().sum::<f64>() {
            break;
        }
        let mut target = rng.random::<f64>() * total;
        let chosen = masses().position(|mass| {
            target -= mass;
            target < 0.0 && mass > 0.0
        });
        let Some(chosen) = chosen.or_else(|| nearest.iter().rposition(|&near| near > 0.0)) else { break };
        let centre = point(chosen).to_vec();
        let first = centres.is_empty();
        for (index, near) in nearest.iter_mut().enumerate() {
            let here = distance(point(index), &centre, points.coordinates);
            *near = if first { here } else { near.min(here) };
        }
        centres.push(centre);
    }
    for _ in 0..ROUNDS {
        if points.stop.is_set() || !move_to_means(points, &mut centres) {
            break;
        }
    }
    centres
}

/// Moves each centre to the mean of the points that are nearest to it, on circles to its direction; returns false if
/// none moved.
fn move_to_means(points: &Points, centres: &mut [Vec<f64>]) -> bool {
    let mut sums = vec![(0.0, vec![0.0; points.stride()]); centres.len()];
    for (numbers, weight) in points.iter() {
        let mut nearest = (f64::INFINITY, 0);
        for (index, centre) in centres.iter().enumerate() {
            let here = distance(numbers, centre, points.coordinates);
            if here < nearest.0 {
                nearest = (here, index);
            }
        }
        let (total, sum) = &mut sums[nearest.1];
        *total += weight;
        for (sum, number) in sum.iter_mut().zip(numbers) {
            *sum += weight * number;
        }
    }
    let mut moved = false;
    for (centre, (total, mut sum)) in centres.iter_mut().zip(sums) {
        if total <= 0.0 {
            continue;
        }
        let (linear, circles) = sum.split_at_mut(points.coordinates);
        for number in linear {
            *number /= total;
        }
        for pair in circles.chunks_exact_mut(2) {
            let length = libm::hypot(pair[0], pair[1]);
            if length > 1e-9 * total {
                pair[0] /= length;
                pair[1] /= length;
            } else {
                // There is no best direction, so the centre gets the direction 0.
                pair.copy_from_slice(&[1.0, 0.0]);
            }
        }
        moved |= *centre != sum;
        *centre = sum;
    }
    moved
}
