//! Tests cells of space, against the density summed up over much finer cells.

use proptest::prelude::*;

use super::super::{HypertimeAxis, HypertimeCluster, mixture::Mixture};
use super::*;

fn distribution(axes: usize, clusters: Vec<HypertimeCluster>) -> HypertimeDistribution {
    let axis = HypertimeAxis { centre: 1.0, scale: 2.0, low: -10.0, high: 10.0 };
    let clusters = clusters.into_iter().map(Cluster::new).collect();
    HypertimeDistribution { mixture: Mixture { clusters }, axes: vec![axis; axes] }
}

fn cluster(weight: f64, centre: &[f64], factor: &[f64]) -> HypertimeCluster {
    HypertimeCluster {
        weight,
        centre: centre.to_vec(),
        factor: factor.to_vec(),
        directions_rad: Vec::new(),
        concentrations: Vec::new(),
    }
}

proptest! {
    #[test]
    fn cells_hold_what_the_density_sums_up_to(
        centre in prop::array::uniform2(-0.8..0.8_f64),
        diagonal in prop::array::uniform2(0.15..0.8_f64),
        slant in -0.6..0.6_f64,
        share in 0.1..0.9_f64,
    ) {
        let found = distribution(2, vec![
            cluster(share, &centre, &[diagonal[0], slant, diagonal[1]]),
            cluster(1.0 - share, &[0.3, -0.4], &[0.4, 0.1, 0.3]),
        ]);
        let (low, width, counts) = ([-2.0, -3.0], 0.75, [8, 9]);
        let cells = found.cells(&low, width, &counts).unwrap();
        const FINE: usize = 15;
        let fine = width / FINE as f64;
        for (number, &cell) in cells.iter().enumerate() {
            let corner = [low[0] + width * (number % 8) as f64, low[1] + width * (number / 8) as f64];
            let middle = |corner: f64, i: usize| corner + fine * (i as f64 + 0.5);
            let naive: f64 = (0..FINE * FINE)
                .map(|i| [middle(corner[0], i % FINE), middle(corner[1], i / FINE)])
                .map(|place| found.density(&place, &[0.0; 2]).unwrap() * fine * fine)
                .sum();
            prop_assert!((cell - naive).abs() < 2e-3, "cell {number}: {cell}, {naive}");
        }
    }

    #[test]
    fn cells_that_cover_everything_sum_up_to_one(
        centre in prop::array::uniform3(-3.0..3.0_f64),
        diagonal in prop::array::uniform3(1e-3..2.0_f64),
        slants in prop::array::uniform3(-1.0..1.0_f64),
        width in 0.5..40.0_f64,
    ) {
        let factor = [diagonal[0], slants[0], diagonal[1], slants[1], slants[2], diagonal[2]];
        let found = distribution(3, vec![cluster(1.0, &centre, &factor)]);
        let count = (160.0 / width).ceil() as usize + 1;
        let counts = [count.min(24), count.min(24), count.min(24)];
        let width = width.max(160.0 / 23.0);
        let cells = found.cells(&[-80.0; 3], width, &counts).unwrap();
        let sum: f64 = cells.iter().sum();
        prop_assert!((sum - 1.0).abs() < 1e-9, "{sum}");
        prop_assert!(cells.iter().all(|cell| (0.0..=1.0 + 1e-12).contains(cell)));
    }
}

#[test]
fn a_cluster_far_narrower_than_a_cell_lies_in_its_cell() {
    // The cluster is at (1, 1), standardised to 0, in a cell from 0.9 to 1.9; then on the edge between four cells.
    let found = distribution(2, vec![cluster(1.0, &[0.0, 0.0], &[1e-3, 0.0, 1e-3])]);
    let cells = found.cells(&[-0.1, -0.1], 1.0, &[3, 3]).unwrap();
    assert!((cells[4] - 1.0).abs() < 1e-12, "{cells:?}");
    let cells = found.cells(&[0.0, 0.0], 1.0, &[2, 2]).unwrap();
    assert!(cells.iter().all(|cell| (cell - 0.25).abs() < 1e-9), "{cells:?}");
    // The whole mass is outside.
    assert_eq!(found.cells(&[5.0, 5.0], 1.0, &[2, 2]), Some(vec![0.0; 4]));
}

#[test]
fn boxes_that_make_no_sense_have_no_cells() {
    let found = distribution(2, vec![cluster(1.0, &[0.0, 0.0], &[1.0, 0.0, 1.0])]);
    assert_eq!(found.cells(&[0.0], 1.0, &[2]), None);
    assert_eq!(found.cells(&[0.0; 2], 1.0, &[2]), None);
    assert_eq!(found.cells(&[0.0; 2], 1.0, &[2, 0]), None);
    assert_eq!(found.cells(&[0.0, f64::NAN], 1.0, &[2, 2]), None);
    assert_eq!(found.cells(&[0.0; 2], 1.0, &[usize::MAX, 2]), None);
    for width in [0.0, -1.0, f64::NAN, f64::INFINITY] {
        assert_eq!(found.cells(&[0.0; 2], width, &[2, 2]), None, "{width}");
    }
}
