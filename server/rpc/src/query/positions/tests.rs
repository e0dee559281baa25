//! Tests of the regions and cells of requests.

use super::*;

#[test]
fn cells_cover_what_was_requested_and_no_more_than_a_cell_beyond() {
    let cells = Cells::of(&[-1.0, 2.0], &[5.0, 4.5], Some(0.5));
    assert_eq!((cells.counts.as_slice(), cells.edge_m, cells.number()), (&[12, 5][..], 0.5, 60));
    assert_eq!(Cells::of(&[0.0, 0.0], &[1.0, 1.05], Some(0.1)).counts, [10, 11]);
    assert_eq!(Cells::of(&[0.0, 0.0], &[6.4, 0.01], None).counts, [64, 1]);
    assert_eq!(Cells::of(&[0.0; 3], &[12.0, 6.0, 3.0], None).counts, [24, 12, 6]);
    assert_eq!(Cells::of(&[0.0; 2], &[1e12; 2], Some(1e-300)).number(), u64::MAX);
}

#[test]
fn observations_lie_within_their_region() {
    for (low, high) in [
        ([0.0, 0.0], [10.0, 4.0]),
        ([3.0, 3.0], [3.0, 3.0]),
        ([1e12, -1e12], [1e12, -1e12]),
        ([1e12 - 1e-4, 0.0], [1e12, 0.0]),
        ([0.0, 0.0], [5e-324, 0.0]),
    ] {
        for edge in [None, Some(0.25)] {
            let cells = Cells::around(&low, &high, edge);
            assert!(cells.edge_m > 0.0 && cells.edge_m.is_finite());
            for axis in 0..2 {
                let beyond = cells.low_m[axis] + cells.edge_m * cells.counts[axis] as f64;
                assert!(cells.low_m[axis] < low[axis] && high[axis] < beyond, "{low:?}, {high:?}: {cells:?}");
            }
        }
    }
}

#[test]
fn corners_have_the_coordinates_of_the_vector() {
    let field = |low: &[f64], high: &[f64]| {
        let region = PositionRegion { low_m: low.to_vec(), high_m: high.to_vec() };
        cells_of(&region, Dimensions::Two, None).map_err(|misfit| misfit.field)
    };
    assert!(field(&[0.0, 0.0], &[1.0, 1.0]).is_ok());
    assert_eq!(field(&[0.0], &[1.0, 1.0]), Err("region.low_m".to_owned()));
    assert_eq!(field(&[0.0, 0.0], &[1.0, 1.0, 1.0]), Err("region.high_m".to_owned()));
}
