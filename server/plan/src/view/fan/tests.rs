//! Paths of single rays, and the tree of several.

use super::*;

fn way(direction: [f64; 3], range: f64) -> Vec<u8> {
    path(direction, range, [100; 3])
}

#[test]
fn a_ray_that_meets_an_edge_crosses_along_x_then_y_then_z() {
    let along = 1.0 / 3.0_f64.sqrt();
    // The first corner is √3/2 cells away, the second 3√3/2.
    assert_eq!(way([along; 3], 2.0), [0, 2, 4]);
    assert_eq!(way([-along; 3], 2.7), [1, 3, 5, 1, 3, 5]);
    assert_eq!(way([0.6, 0.0, 0.8], 0.7), [4]);
    assert_eq!(way([0.5, 0.5, 0.0], 1.5), [0, 2]);
    assert_eq!(way([0.0, 0.5, 0.5], 1.5), [2, 4]);
    assert_eq!(way([0.5, 0.0, 0.5], 1.5), [0, 4]);
}

#[test]
fn a_cell_is_passed_if_the_ray_enters_it_before_its_range_is_used_up() {
    assert!(way([1.0, 0.0, 0.0], 0.5).is_empty());
    assert_eq!(way([1.0, 0.0, 0.0], 0.51), [0]);
    assert_eq!(way([0.0, -1.0, 0.0], 3.0), [3, 3, 3]);
}
