//! One cluster in hypertime: a Gaussian over some coordinates and a von Mises distribution on each of some circles.
//!
//! The given coordinates of a prediction come first in the Gaussian, and the value last. Then the factor of the
//! covariance contains the factor of the given coordinates, and the conditional distribution of the value follows from
//! the rest. With HyT-EM the cosines and sines are coordinates of the Gaussian; with HyT-KM each circle is separate.
//! Invariant: the stored triangular factor has a positive diagonal, so the covariance is positive definite.

use nalgebra::{Cholesky, DMatrix};

use super::concentration::{CONCENTRATION_MAX, log_normaliser};
use crate::InvalidParts;
use crate::fields::{FINITE, StoredFields, Visitor};

#[cfg(test)]
mod tests;

/// Maximum number of coordinates of a Gaussian: locations, values and two for each of five periods.
pub(super) const COORDINATES_MAX: usize = 26;
/// Least variance along a coordinate, whose deviation over all readings is about 1: a hundredth of it, squared.
pub(super) const VARIANCE_MIN: f64 = 1e-4;
/// Bound on stored numbers; coordinates are standardised.
const BOUND: f64 = 1e9;
/// Deviations from a centre are cut off here, so that their squares are finite.
const FARTHEST: f64 = 1e150;

/// One cluster of a hypertime model, in plain numbers. Linear coordinates are standardised by the model's axes;
/// cosines and sines are as they are.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct HypertimeCluster {
    /// Share of the readings in the cluster, in `[0,1]`.
    pub weight: f64,
    /// Centre of the Gaussian: location, then (HyT-EM) cosine and sine for each period, then value.
    pub centre: Vec<f64>,
    /// The rows of the lower triangular factor of the covariance, one after the other, n(n + 1)/2 numbers.
    pub factor: Vec<f64>,
    /// Direction on the circle of each period, in radians (HyT-KM; otherwise empty).
    pub directions_rad: Vec<f64>,
    /// Concentration κ around each direction, at least 0 (HyT-KM; otherwise empty).
    pub concentrations: Vec<f64>,
}

impl StoredFields for HypertimeCluster {
    fn fields<V: Visitor>(&mut self, visitor: &mut V) -> Result<(), V::Refused> {
        visitor.number(1, "cluster.weight", FINITE, &mut self.weight)?;
        visitor.list(2, "cluster.centre", FINITE, &mut self.centre)?;
        visitor.list(3, "cluster.factor", FINITE, &mut self.factor)?;
        visitor.list(4, "cluster.directions_rad", FINITE, &mut self.directions_rad)?;
        visitor.list(5, "cluster.concentrations", FINITE, &mut self.concentrations)
    }
}

/// A cluster with precomputed values.
#[derive(Clone, Debug, PartialEq)]
pub(super) struct Cluster {
    parts: HypertimeCluster,
    log_weight: f64,
    /// Cosine and sine of each direction.
    directions: Vec<(f64, f64)>,
    /// Logarithm of the normaliser of the density on all circles.
    circles_log_normaliser: f64,
    /// For each coordinate, ln of the factor's diagonal plus half of ln 2π.
    log_diagonal: Vec<f64>,
}

/// The conditional distribution of a value under one cluster, given the rest.
pub(super) struct Conditional {
    /// ln(weight · density of the given coordinates).
    pub(super) log_share: f64,
    pub(super) mean: Vec<f64>,
    /// Rows of the lower triangular factor of the covariance.
    pub(super) factor: Vec<f64>,
}

fn row(factor: &[f64], index: usize) -> &[f64] {
    let start = index * (index + 1) / 2;
    &factor[start..=start + index]
}

impl Cluster {
    pub(super) fn new(parts: HypertimeCluster) -> Cluster {
        let half_log_tau = 0.5 * libm::log(std::f64::consts::TAU);
        let diagonal = (0..parts.centre.len()).map(|index| libm::log(row(&parts.factor, index)[index]) + half_log_tau);
        Cluster {
            log_weight: libm::log(parts.weight.max(f64::MIN_POSITIVE)),
            directions: parts.directions_rad.iter().map(|&angle| (libm::cos(angle), libm::sin(angle))).collect(),
            circles_log_normaliser: parts.concentrations.iter().map(|&kappa| log_normaliser(kappa)).sum(),
            log_diagonal: diagonal.collect(),
            parts,
        }
    }

    /// Checks stored parts for the given numbers of coordinates and circles.
    pub(super) fn from_parts(
        parts: HypertimeCluster,
        coordinates: usize,
        circles: usize,
    ) -> Result<Cluster, InvalidParts> {
        let exactly = |field, found: usize, expected: usize| {
            InvalidParts::check(field, found as f64, expected as f64..=expected as f64)
        };
        exactly("cluster.centre", parts.centre.len(), coordinates)?;
        exactly("cluster.factor", parts.factor.len(), coordinates * (coordinates + 1) / 2)?;
        exactly("cluster.directions_rad", parts.directions_rad.len(), circles)?;
        exactly("cluster.concentrations", parts.concentrations.len(), circles)?;
        InvalidParts::check("cluster.weight", parts.weight, 0.0..=1.01)?;
        for &number in parts.centre.iter().chain(&parts.factor).chain(&parts.directions_rad) {
            InvalidParts::check("cluster", number, -BOUND..=BOUND)?;
        }
        for index in 0..coordinates {
            InvalidParts::check("cluster.factor", row(&parts.factor, index)[index], 1e-3..=BOUND)?;
        }
        for &kappa in &parts.concentrations {
            InvalidParts::check("cluster.concentrations", kappa, 0.0..=CONCENTRATION_MAX * 1.01)?;
        }
        Ok(Cluster::new(parts))
    }

    pub(super) fn parts(&self) -> &HypertimeCluster {
        &self.parts
    }

    /// Variance along a coordinate.
    pub(super) fn variance(&self, coordinate: usize) -> f64 {
        row(&self.parts.factor, coordinate).iter().map(|factor| factor * factor).sum()
    }

    /// The covariance, as a row-major lower triangle.
    pub(super) fn covariance(&self) -> Vec<f64> {
        let entry = |i: usize, j: usize| {
            let pairs = row(&self.parts.factor, i).iter().zip(row(&self.parts.factor, j));
            pairs.map(|(a, b)| a * b).sum::<f64>()
        };
        let coordinates = self.parts.centre.len();
        (0..coordinates).flat_map(|i| (0..=i).map(move |j| (i, j))).map(|(i, j)| entry(i, j)).collect()
    }

    /// ln(weight · density) on the circles alone; cosine and sine of each follow one another.
    fn log_circles(&self, circles: &[f64]) -> f64 {
        let mut sum = self.log_weight - self.circles_log_normaliser;
        for ((point, direction), kappa) in circles.chunks_exact(2).zip(&self.directions).zip(&self.parts.concentrations)
        {
            sum += kappa * (point[0] * direction.0 + point[1] * direction.1 - 1.0);
        }
        sum
    }

    /// Solves for the standardised coordinates into `solved`; returns ln density of the first `given`, and of all.
    fn solve(&self, coordinates: &[f64], given: usize, solved: &mut [f64; COORDINATES_MAX]) -> (f64, f64) {
        let (mut sum, mut given_sum) = (0.0, 0.0);
        for (index, (coordinate, centre)) in coordinates.iter().zip(&self.parts.centre).enumerate() {
            let row = row(&self.parts.factor, index);
            let mut rest = coordinate - centre;
            for (factor, solved) in row[..index].iter().zip(&solved[..index]) {
                rest -= factor * solved;
            }
            // Stored numbers may have any finite value.
            let standard = Some(rest / row[index]).filter(|standard| standard.abs() < FARTHEST).unwrap_or(FARTHEST);
            solved[index] = standard;
            sum -= 0.5 * standard * standard + self.log_diagonal[index];
            if index + 1 == given {
                given_sum = sum;
            }
        }
        (given_sum, sum)
    }

    /// ln(weight · density) of the circles and the first `given` coordinates, and of the circles and all coordinates.
    pub(super) fn log_densities(&self, coordinates: &[f64], circles: &[f64], given: usize) -> (f64, f64) {
        let circles = self.log_circles(circles);
        let (given, all) = self.solve(coordinates, given, &mut [0.0; COORDINATES_MAX]);
        (circles + given, circles + all)
    }

    /// The conditional distribution of the coordinates after the given ones.
    pub(super) fn given(&self, coordinates: &[f64], circles: &[f64]) -> Conditional {
        let given = coordinates.len();
        let mut solved = [0.0; COORDINATES_MAX];
        let (log_given, _) = self.solve(coordinates, given, &mut solved);
        let mut conditional =
            Conditional { log_share: self.log_circles(circles) + log_given, mean: Vec::new(), factor: Vec::new() };
        for index in given..self.parts.centre.len() {
            let row = row(&self.parts.factor, index);
            let shift: f64 = row[..given].iter().zip(&solved).map(|(factor, solved)| factor * solved).sum();
            conditional.mean.push(self.parts.centre[index] + shift);
            conditional.factor.extend_from_slice(&row[given..]);
        }
        conditional
    }
}

/// The factor of a covariance (row-major lower triangle), after variance has been added along the diagonal until it is
/// positive definite.
pub(super) fn factorised(covariance: &[f64], coordinates: usize) -> Vec<f64> {
    let mut added = 0.0;
    for _ in 0..40 {
        let matrix = DMatrix::from_fn(coordinates, coordinates, |i, j| {
            row(covariance, i.max(j))[i.min(j)] + if i == j { added } else { 0.0 }
        });
        if let Some(cholesky) = Cholesky::new(matrix) {
            let lower = cholesky.l();
            let rows = (0..coordinates).flat_map(|i| (0..=i).map(move |j| (i, j)));
            let factor: Vec<f64> = rows.map(|(i, j)| lower[(i, j)]).collect();
            let firm = (0..coordinates).all(|index| row(&factor, index)[index] > 2e-3);
            if firm && factor.iter().all(|number| number.is_finite()) {
                return factor;
            }
        }
        added = if added == 0.0 { VARIANCE_MIN } else { added * 4.0 };
    }
    // A covariance that is not finite is replaced by the identity.
    (0..coordinates).flat_map(|i| (0..=i).map(move |j| if i == j { 1.0 } else { 0.0 })).collect()
}
