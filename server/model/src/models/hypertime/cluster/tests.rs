//! Tests one cluster, against densities computed from the covariance itself.

use nalgebra::{DMatrix, DVector};
use proptest::prelude::*;

use super::*;

fn cluster(coordinates: usize, numbers: &[f64]) -> Cluster {
    let mut numbers = numbers.iter().copied().cycle();
    let mut next = move || numbers.next().unwrap();
    let factor = (0..coordinates).flat_map(|i| (0..=i).map(move |j| i == j)).collect::<Vec<bool>>();
    Cluster::new(HypertimeCluster {
        weight: 1.0,
        centre: (0..coordinates).map(|_| next()).collect(),
        factor: factor.into_iter().map(|diagonal| if diagonal { 0.2 + next().abs() } else { next() }).collect(),
        directions_rad: Vec::new(),
        concentrations: Vec::new(),
    })
}

fn log_gaussian(difference: &DVector<f64>, covariance: &DMatrix<f64>) -> f64 {
    let inverse = covariance.clone().try_inverse().unwrap();
    let mahalanobis = (difference.transpose() * inverse * difference)[(0, 0)];
    let scale = covariance.nrows() as f64 * std::f64::consts::TAU.ln();
    -0.5 * (mahalanobis + covariance.determinant().ln() + scale)
}

proptest! {
    #[test]
    fn densities_are_those_of_the_covariance(
        numbers in prop::collection::vec(-1.0..1.0_f64, 30),
        point in prop::collection::vec(-2.0..2.0_f64, 4),
        given in 1..4_usize,
    ) {
        let cluster = cluster(4, &numbers);
        let triangle = cluster.covariance();
        let covariance = DMatrix::from_fn(4, 4, |i, j| row(&triangle, i.max(j))[i.min(j)]);
        let difference = DVector::from_fn(4, |i, _| point[i] - cluster.parts().centre[i]);
        let (log_given, log_all) = cluster.log_densities(&point, &[], given);
        let expected_all = log_gaussian(&difference, &covariance);
        prop_assert!((log_all - expected_all).abs() < 1e-6 * expected_all.abs().max(1.0), "{log_all}, {expected_all}");
        let leading = covariance.view((0, 0), (given, given)).into_owned();
        let expected_given = log_gaussian(&difference.rows(0, given).into_owned(), &leading);
        prop_assert!((log_given - expected_given).abs() < 1e-6 * expected_given.abs().max(1.0));

        // The conditional density times the density of the given coordinates is the joint density.
        let conditional = cluster.given(&point[..given], &[]);
        let rest = Cluster::new(HypertimeCluster {
            weight: 1.0,
            centre: conditional.mean,
            factor: conditional.factor,
            directions_rad: Vec::new(),
            concentrations: Vec::new(),
        });
        let (_, log_rest) = rest.log_densities(&point[given..], &[], 0);
        prop_assert!((conditional.log_share + log_rest - log_all).abs() < 1e-6 * log_all.abs().max(1.0));
    }

    #[test]
    fn a_covariance_that_is_none_becomes_one(entries in prop::collection::vec(-10.0..10.0_f64, 6)) {
        let factor = factorised(&entries, 3);
        for index in 0..3 {
            prop_assert!(row(&factor, index)[index] > 0.0 && factor.iter().all(|number| number.is_finite()));
        }
    }
}

#[test]
fn a_covariance_that_is_not_finite_becomes_a_sphere() {
    assert_eq!(factorised(&[f64::NAN, 0.0, f64::INFINITY], 2), [1.0, 0.0, 1.0]);
}
