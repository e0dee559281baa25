//! The conditional distribution of a value at one place and time: a mixture of Gaussians.
//!
//! Invariant: shares add up to 1, every result is finite.

use super::axis::{HypertimeAxis, standardised};
use super::cluster::{Cluster, Conditional, HypertimeCluster, factorised};
use super::mixture::Mixture;
use crate::special::normal_tail;
use crate::special::square;

/// The distribution p(a | x, t) of a value at a place and time (RA-L 2019 section III.C).
#[derive(Clone, Debug, PartialEq)]
pub struct HypertimeDistribution {
    /// The mixture over the value's coordinates alone, standardised.
    pub(super) mixture: Mixture,
    pub(super) axes: Vec<HypertimeAxis>,
}

impl HypertimeDistribution {
    pub(super) fn new(shares: Vec<(f64, Conditional)>, axes: Vec<HypertimeAxis>) -> HypertimeDistribution {
        let clusters = shares.into_iter().map(|(weight, given)| {
            Cluster::new(HypertimeCluster {
                weight,
                centre: given.mean,
                factor: given.factor,
                directions_rad: Vec::new(),
                concentrations: Vec::new(),
            })
        });
        HypertimeDistribution { mixture: Mixture { clusters: clusters.collect() }, axes }
    }

    /// The mean of the conditional distribution, limited to the observed range.
    pub fn mean(&self) -> Vec<f64> {
        let standard = (0..self.axes.len()).map(|coordinate| self.standard_mean(coordinate));
        standard.zip(&self.axes).map(|(mean, axis)| axis.observed(mean)).collect()
    }

    fn standard_mean(&self, coordinate: usize) -> f64 {
        self.mixture.clusters.iter().map(|cluster| cluster.parts().weight * cluster.parts().centre[coordinate]).sum()
    }

    /// Variance of each coordinate of the value, in its squared unit; at most the greatest finite number.
    pub fn variance(&self) -> Vec<f64> {
        let standard_variance = |coordinate: usize| {
            let mean = self.standard_mean(coordinate);
            let second = self.mixture.clusters.iter().map(|cluster| {
                let distance = cluster.parts().centre[coordinate] - mean;
                cluster.parts().weight * (cluster.variance(coordinate) + distance * distance)
            });
            second.sum::<f64>()
        };
        let scaled = self
            .axes
            .iter()
            .enumerate()
            .map(|(coordinate, axis)| standard_variance(coordinate) * axis.scale * axis.scale);
        scaled.map(|variance| variance.min(f64::MAX)).collect()
    }

    /// The interval of a value with one coordinate that contains this share of the probability, `level` in `[0,1)`,
    /// with equal shares below and above; limited to the observed range. `None` for another level or more coordinates.
    pub fn interval(&self, level: f64) -> Option<(f64, f64)> {
        let [axis] = self.axes.as_slice() else { return None };
        if !(0.0..1.0).contains(&level) {
            return None;
        }
        let end = |share: f64| axis.observed(self.standard_quantile(share));
        Some((end(0.5 * (1.0 - level)), end(0.5 * (1.0 + level))))
    }

    /// The first coordinate below which a share of the probability lies, standardised, by bisection.
    fn standard_quantile(&self, share: f64) -> f64 {
        let parts = || self.mixture.clusters.iter().map(|cluster| (cluster.parts(), cluster.variance(0).sqrt()));
        let below = |at: f64| -> f64 {
            parts().map(|(parts, deviation)| parts.weight * normal_tail((parts.centre[0] - at) / deviation)).sum()
        };
        let ends = |sign: f64| parts().map(move |(parts, deviation)| parts.centre[0] + sign * 40.0 * deviation);
        let mut low = ends(-1.0).fold(f64::INFINITY, f64::min);
        let mut high = ends(1.0).fold(f64::NEG_INFINITY, f64::max);
        for _ in 0..200 {
            let middle = 0.5 * (low + high);
            if middle <= low || middle >= high {
                break;
            }
            *(if below(middle) < share { &mut low } else { &mut high }) = middle;
        }
        0.5 * (low + high)
    }

    /// Probability density of a value, per unit of each of its coordinates, averaged over a cell of these widths around
    /// it: the variances grow by width²/12. With widths of 0 it is the density at the value, which is very large in the
    /// middle of a narrow cluster; to sum over cells, pass their widths. `None` if a list does not have one number for
    /// each coordinate, a value is not finite, or a width is negative or NaN.
    pub fn density(&self, value: &[f64], widths: &[f64]) -> Option<f64> {
        let coordinates = self.axes.len();
        let is_complete = value.len() == coordinates && widths.len() == coordinates;
        if !is_complete || !value.iter().all(|number| number.is_finite()) || !widths.iter().all(|&width| width >= 0.0) {
            return None;
        }
        let added: Vec<f64> =
            widths.iter().zip(&self.axes).map(|(&width, axis)| square(axis.standard_width(width)) / 12.0).collect();
        let standard = standardised(value, &self.axes);
        let log = if added.iter().all(|&variance| variance == 0.0) {
            self.mixture.log_densities(&standard, coordinates, 0).1
        } else {
            let widened = self.mixture.clusters.iter().map(|cluster| widened(cluster, &added));
            Mixture { clusters: widened.collect() }.log_densities(&standard, coordinates, 0).1
        };
        let scales: f64 = self.axes.iter().map(|axis| libm::log(axis.scale)).sum();
        Some(libm::exp(log - scales).min(f64::MAX))
    }
}

/// The cluster with variance added along each coordinate.
fn widened(cluster: &Cluster, added: &[f64]) -> Cluster {
    let mut covariance = cluster.covariance();
    for (index, added) in added.iter().enumerate() {
        covariance[index * (index + 3) / 2] += added;
    }
    let factor = factorised(&covariance, added.len());
    Cluster::new(HypertimeCluster { factor, ..cluster.parts().clone() })
}
