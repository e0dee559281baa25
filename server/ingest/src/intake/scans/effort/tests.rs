//! Tests that the permits are bounded, and that the cost of rays is never underestimated.

use std::sync::atomic::{AtomicUsize, Ordering};

use tidemap_grid::index::{CellBox, CellIndex};

use super::*;

fn spec(extent: Option<CellBox>) -> GridSpec {
    GridSpec { extent, ..GridSpec::new(0.5) }
}

#[test]
fn no_more_have_a_turn_than_may() {
    let (permits, inside, highest) = (CastPermits::new(2), AtomicUsize::new(0), AtomicUsize::new(0));
    std::thread::scope(|scope| {
        for _ in 0..8 {
            scope.spawn(|| {
                for _ in 0..50 {
                    let permit = permits.take();
                    highest.fetch_max(inside.fetch_add(1, Ordering::SeqCst) + 1, Ordering::SeqCst);
                    std::thread::yield_now();
                    inside.fetch_sub(1, Ordering::SeqCst);
                    drop(permit);
                }
            });
        }
    });
    assert!(highest.into_inner() <= 2);
    let queue = permits.queue();
    assert_eq!((queue.free, queue.next, queue.first), (2, 400, 400));
}

#[test]
fn what_rays_pass_is_bounded_by_their_ranges_and_the_extent() {
    let cells = RayCells::new(&spec(None));
    let cloud = |xyz_m: &'static [f32], max_range_m| SentRays { readings: SentReadings::Points(xyz_m), max_range_m };
    let along = cells.of_scan(cloud(&[10.0, 10.0, 10.0], None));
    assert!((61..80).contains(&along), "{along}");
    assert!(cells.of_scan(cloud(&[10.0, 10.0, 10.0], Some(1.0))) < 10);
    // The limits of a part may be in another part.
    assert_eq!(cells.of_part(cloud(&[10.0, 10.0, 10.0], Some(1.0))), along);
    assert_eq!(cells.of_scan(cloud(&[f32::NAN, 1.0, 1.0, f32::INFINITY, 0.0, 0.0], None)), 0);
    assert_eq!(cells.of_scan(cloud(&[f32::MAX; 6], None)), 2 * RAY_CELLS_MAX);
    let readings = SentReadings::Ranges(&[f32::INFINITY, f32::NAN, -1.0]);
    let ranges = cells.of_scan(SentRays { readings, max_range_m: Some(5.0) });
    assert!((17..30).contains(&ranges), "{ranges}");
    let extent = CellBox { min: CellIndex { x: 0, y: 0, z: 0 }, max: CellIndex { x: 9, y: 9, z: 9 } };
    assert_eq!(RayCells::new(&spec(Some(extent))).of_scan(cloud(&[f32::MAX; 3], None)), 28);
}
