//! Tests that the last five attempts count, and that stored content is restored.

use proptest::prelude::*;

use super::*;

fn rate(map: &Reachability, x_m: f64, y_m: f64) -> (f64, u8) {
    let ReachabilityRate { rate, attempts } = map.rate(x_m, y_m);
    (rate, attempts)
}

#[test]
fn an_unknown_place_has_the_prior_and_is_tried() {
    assert_eq!(rate(&Reachability::default(), 3.0, -7.0), (0.5, 0));
    assert_eq!(rate(&Reachability::new(1.0, 5).expect("valid"), 3.0, -7.0), (1.0, 0));
    for wrong in [0.0, -0.5, 1.5, f64::NAN] {
        assert!(matches!(Reachability::new(wrong, 5), Err(ReachabilityError::Prior(_))));
    }
}

#[test]
fn places_of_one_cell_of_50_cm_share_their_attempts() {
    let mut map = Reachability::default();
    map.report(0.1, -0.1, true, 5).expect("valid");
    map.report(0.49, -0.49, false, 6).expect("valid");
    assert_eq!(rate(&map, 0.2, -0.4), (0.5, 2));
    assert_eq!(rate(&map, 0.5, -0.4), (0.5, 0));
    assert_eq!(rate(&map, 0.2, 0.0), (0.5, 0));
    assert_eq!(map.len(), 1);
}

#[test]
fn what_is_no_place_is_refused() {
    let mut map = Reachability::default();
    for wrong in [f64::NAN, f64::INFINITY, -1e8] {
        assert!(map.report(wrong, 0.0, true, 0).expect_err("wrong").to_string().contains(&wrong.to_string()));
        assert!(map.report(0.0, wrong, true, 0).is_err());
        assert_eq!(rate(&map, wrong, 0.0), (0.0, 0));
    }
    assert!(map.is_empty());
}

#[test]
fn there_is_room_for_so_many_cells() {
    let mut map = Reachability::new(0.5, 2).expect("valid");
    map.report(0.0, 0.0, true, 0).expect("valid");
    map.report(1.0, 0.0, true, 0).expect("valid");
    assert_eq!(map.report(2.0, 0.0, true, 0), Err(ReachabilityError::TooManyCells { max: 2 }));
    map.report(1.0, 0.0, false, 1).expect("valid");
    assert_eq!(rate(&map, 1.0, 0.0), (0.5, 2));
    let parts: Vec<_> = map.parts().collect();
    assert_eq!(Reachability::from_parts(0.5, 1, parts), Err(ReachabilityError::TooManyCells { max: 1 }));
}

#[test]
fn damaged_parts_are_refused() {
    let cell = ReachabilityCell { x: 1, y: 2 };
    let good = Attempts { count: 2, reached: 0b10, last_nanos: 7 };
    let load = |parts: Vec<_>| Reachability::from_parts(0.5, 10, parts);
    assert!(load(vec![(cell, good)]).is_ok());
    for wrong in [Attempts { count: 0, ..good }, Attempts { count: 6, ..good }, Attempts { reached: 0b100, ..good }] {
        assert_eq!(load(vec![(cell, wrong)]), Err(ReachabilityError::Damaged { cell, attempts: wrong }));
    }
    let far = ReachabilityCell { x: i32::MAX, ..cell };
    assert!(load(vec![(far, good)]).is_err());
    assert_eq!(load(vec![(cell, good), (cell, good)]), Err(ReachabilityError::Twice(cell)));
}

proptest! {
    #[test]
    fn the_last_five_reported_count(reports in prop::collection::vec((any::<bool>(), any::<i64>()), 1..20)) {
        let mut map = Reachability::default();
        for &(reached, nanos) in &reports {
            map.report(0.3, 0.3, reached, nanos).expect("valid");
        }
        let last: Vec<bool> = reports.iter().rev().take(5).map(|report| report.0).collect();
        let reached = last.iter().filter(|reached| **reached).count();
        prop_assert_eq!(rate(&map, 0.3, 0.3), (reached as f64 / last.len() as f64, last.len() as u8));
        let (_, attempts) = map.parts().next().expect("valid");
        prop_assert_eq!(Some(attempts.last_nanos), reports.iter().map(|report| report.1).max());
        let again = Reachability::from_parts(map.prior(), 10, map.parts()).expect("valid");
        prop_assert_eq!(again.parts().collect::<Vec<_>>(), map.parts().collect::<Vec<_>>());
    }
}
