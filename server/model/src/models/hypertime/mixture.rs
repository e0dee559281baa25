//! Mixtures of clusters, trained by expectation-maximisation (RA-L 2019 sections III.E and III.H).
//!
//! Covariances are shrunk towards that of all readings, as by a few more readings (C. Fraley and A. Raftery, "Bayesian
//! regularization for normal mixture estimation", J. Classification 2007), which regularises clusters of few readings;
//! one reading here means one hour of readings. Invariant: every cluster has weight, and densities are finite.

use super::cluster::{Cluster, Conditional, HypertimeCluster, VARIANCE_MIN, factorised};
use super::concentration::concentration;
use super::options::HypertimeOptions;
use super::seeding::{Points, first_clusters, spread};
use crate::InvalidParts;

/// Training stops when a step gains fewer nats per reading than this.
const GAIN_MIN: f64 = 1e-5;

/// The sums of one step over the readings, for one cluster; coordinates are relative to its present centre.
struct Moments {
    weight: f64,
    first: Vec<f64>,
    /// The second moments as a row-major lower triangle.
    second: Vec<f64>,
    circles: Vec<f64>,
}

#[derive(Clone, Debug, Default, PartialEq)]
pub(super) struct Mixture {
    pub(super) clusters: Vec<Cluster>,
}

impl Mixture {
    /// Trains the given number of clusters, or fewer if there are fewer points; none without points.
    pub(super) fn train(points: &Points, clusters: usize, seed: u64, max_steps: usize) -> Mixture {
        let mut mixture = Mixture { clusters: first_clusters(points, clusters, seed) };
        mixture.train_further(points, max_steps);
        mixture
    }

    /// Continues training, possibly with other points.
    pub(super) fn train_further(&mut self, points: &Points, max_steps: usize) {
        if points.weights.is_empty() {
            return;
        }
        let spread = spread(points);
        let mut likelihood = f64::NEG_INFINITY;
        for _ in 0..max_steps {
            let before = likelihood;
            likelihood = self.step(points, &spread);
            if self.clusters.len() == 1 || likelihood - before < GAIN_MIN || points.stop.is_set() {
                break;
            }
        }
    }

    /// Makes one step and returns the mean log-likelihood of the mixture before it.
    fn step(&mut self, points: &Points, spread: &[f64]) -> f64 {
        let coordinates = points.coordinates;
        let mut moments: Vec<Moments> = self.clusters.iter().map(|_| Moments::new(points)).collect();
        let mut shares = vec![0.0; self.clusters.len()];
        let (mut total, mut likelihood) = (0.0, 0.0);
        for (numbers, weight) in points.iter() {
            let (linear, circles) = numbers.split_at(coordinates);
            for (share, cluster) in shares.iter_mut().zip(&self.clusters) {
                *share = cluster.log_densities(linear, circles, 0).1;
            }
            likelihood += weight * normalise(&mut shares);
            total += weight;
            for ((share, cluster), moments) in shares.iter().zip(&self.clusters).zip(&mut moments) {
                if *share > 1e-12 {
                    moments.add(numbers, weight * share, &cluster.parts().centre);
                }
            }
        }
        let prior = Prior { spread, clusters: self.clusters.len(), unit: points.unit };
        let updated = moments.iter().zip(&self.clusters).filter(|(moments, _)| moments.weight > 1e-9 * total);
        self.clusters = updated.map(|(moments, cluster)| moments.cluster(cluster, total, &prior)).collect();
        likelihood / total
    }

    /// ln density of the circles and the first `given` coordinates, and of the circles and all coordinates.
    pub(super) fn log_densities(&self, numbers: &[f64], coordinates: usize, given: usize) -> (f64, f64) {
        let (linear, circles) = numbers.split_at(coordinates);
        let (mut first, mut all) = (LogSum::default(), LogSum::default());
        for cluster in &self.clusters {
            let (log_given, log_all) = cluster.log_densities(linear, circles, given);
            first.add(log_given);
            all.add(log_all);
        }
        (first.get(), all.get())
    }

    /// The conditional distribution of the remaining coordinates by each cluster, and its share.
    pub(super) fn given(&self, coordinates: &[f64], circles: &[f64]) -> Vec<(f64, Conditional)> {
        let conditionals: Vec<Conditional> =
            self.clusters.iter().map(|cluster| cluster.given(coordinates, circles)).collect();
        let mut shares: Vec<f64> = conditionals.iter().map(|given| given.log_share).collect();
        normalise(&mut shares);
        shares.into_iter().zip(conditionals).collect()
    }
}

impl Mixture {
    pub(super) fn to_parts(&self) -> Vec<HypertimeCluster> {
        self.clusters.iter().map(|cluster| cluster.parts().clone()).collect()
    }

    /// Checks stored clusters.
    pub(super) fn from_parts(
        parts: &[HypertimeCluster],
        coordinates: usize,
        circles: usize,
    ) -> Result<Mixture, InvalidParts> {
        InvalidParts::check("clusters", parts.len() as f64, 0.0..=HypertimeOptions::CLUSTERS_MAX as f64)?;
        let clusters = parts.iter().map(|cluster| Cluster::from_parts(cluster.clone(), coordinates, circles));
        Ok(Mixture { clusters: clusters.collect::<Result<_, _>>()? })
    }
}

/// ln Σ exp of numbers, added one by one.
#[derive(Clone, Copy)]
struct LogSum {
    highest: f64,
    sum: f64,
}

impl Default for LogSum {
    fn default() -> LogSum {
        LogSum { highest: f64::NEG_INFINITY, sum: 0.0 }
    }
}

impl LogSum {
    fn add(&mut self, log: f64) {
        if log > self.highest {
            self.sum = self.sum * libm::exp(self.highest - log) + 1.0;
            self.highest = log;
        } else {
            self.sum += libm::exp(log - self.highest);
        }
    }

    fn get(self) -> f64 {
        self.highest + libm::log(self.sum)
    }
}

/// Turns logarithms into shares that add up to 1; returns the logarithm of their sum.
fn normalise(logs: &mut [f64]) -> f64 {
    let highest = logs.iter().copied().fold(f64::NEG_INFINITY, f64::max);
    let mut sum = 0.0;
    for log in logs.iter_mut() {
        *log = libm::exp(*log - highest);
        sum += *log;
    }
    for log in logs.iter_mut() {
        *log /= sum;
    }
    highest + libm::log(sum)
}

/// The prior of a cluster.
struct Prior<'a> {
    /// Variance of all points along each coordinate.
    spread: &'a [f64],
    clusters: usize,
    unit: f64,
}

impl Moments {
    fn new(points: &Points) -> Moments {
        let coordinates = points.coordinates;
        Moments {
            weight: 0.0,
            first: vec![0.0; coordinates],
            second: vec![0.0; coordinates * (coordinates + 1) / 2],
            circles: vec![0.0; 2 * points.circles],
        }
    }

    fn add(&mut self, numbers: &[f64], weight: f64, centre: &[f64]) {
        self.weight += weight;
        let mut place = 0;
        for (i, (number, centre_i)) in numbers.iter().zip(centre).enumerate() {
            let weighted = weight * (number - centre_i);
            self.first[i] += weighted;
            for (other, centre_j) in numbers.iter().zip(&centre[..=i]) {
                self.second[place] += weighted * (other - centre_j);
                place += 1;
            }
        }
        for (sum, number) in self.circles.iter_mut().zip(&numbers[centre.len()..]) {
            *sum += weight * number;
        }
    }

    /// The most likely cluster for these sums, with the prior.
    fn cluster(&self, before: &Cluster, total: f64, prior: &Prior<'_>) -> Cluster {
        let coordinates = self.first.len();
        let shift: Vec<f64> = self.first.iter().map(|sum| sum / self.weight).collect();
        let centre = before.parts().centre.iter().zip(&shift).map(|(centre, shift)| centre + shift).collect();
        let prior_readings = (coordinates as f64 + 2.0) * prior.unit;
        let shrunk = libm::pow(prior.clusters as f64, -2.0 / coordinates.max(1) as f64);
        let mut covariance = self.second.clone();
        let mut place = 0;
        for i in 0..coordinates {
            for j in 0..=i {
                let mut entry = covariance[place] - self.weight * shift[i] * shift[j];
                if i == j {
                    entry += prior_readings * shrunk * prior.spread[i];
                }
                covariance[place] = entry / (self.weight + prior_readings);
                if i == j {
                    covariance[place] += VARIANCE_MIN;
                }
                place += 1;
            }
        }
        let pairs = || self.circles.chunks_exact(2);
        Cluster::new(HypertimeCluster {
            weight: self.weight / total,
            centre,
            factor: factorised(&covariance, coordinates),
            directions_rad: pairs().map(|pair| libm::atan2(pair[1], pair[0])).collect(),
            // One more reading, spread evenly, shrinks the concentration towards 0.
            concentrations: pairs()
                .map(|pair| concentration(libm::hypot(pair[0], pair[1]) / (self.weight + prior.unit)))
                .collect(),
        })
    }
}
