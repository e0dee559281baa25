//! The building has the documented obstacles, and a robot that learns fails less often in it.

use tidemap_map::topology::{Edge, Topology};

use super::{building::Building, *};

const HOUR: f64 = 3_600.0;

fn building(seed: u64) -> Building {
    let load = building::load().expect("valid names");
    Building::new(seed, Topology::new().edited(&load).expect("a building"))
}

fn edge(building: &Building, from: &str, to: &str) -> Edge {
    let id = |name| building.topology().node_named(name).expect("a node").id;
    building.topology().edge_between(id(from), id(to), None).expect("an edge").clone()
}

/// The share of attempts that fail from one time to another, in seconds, over a hundred days of a kind.
fn failing(from: &str, to: &str, secs: Range<f64>, is_day: impl Fn(usize) -> bool) -> f64 {
    let building = building(3);
    let edge = edge(&building, from, to);
    let times = (0..140).filter(|day| is_day(*day)).flat_map(|day| {
        (0..20).map(move |part| day as f64 * DAY_SECS + secs.start + (secs.end - secs.start) * f64::from(part) / 20.0)
    });
    let failed: Vec<bool> = times.map(|time| building.attempt(&edge, time).reason.is_some()).collect();
    failed.iter().filter(|&&failed| failed).count() as f64 / failed.len() as f64
}

#[test]
fn the_door_is_shut_at_night_and_the_corridor_blocked_at_noon() {
    let (any, weekday) = (|_| true, |day: usize| day % 7 < 5);
    for (from, to) in [("s2", "n2"), ("n2", "s2")] {
        assert_eq!(failing(from, to, 20.0 * HOUR..30.5 * HOUR, any), 1.0);
        assert!(failing(from, to, 6.5 * HOUR..20.0 * HOUR, any) < 0.04);
    }
    let noon = 11.5 * HOUR..13.5 * HOUR;
    assert!((failing("s4", "s3", noon.clone(), weekday) - 0.8).abs() < 0.05);
    assert!(failing("s3", "s4", noon.clone(), |day| day % 7 > 4) < 0.04);
    assert!(failing("s3", "s4", 13.5 * HOUR..35.5 * HOUR, weekday) < 0.04);
    let elsewhere = failing("lobby", "n0", 0.0..DAY_SECS, any);
    assert!((0.005..0.03).contains(&elsewhere), "{elsewhere}");
}

#[test]
fn what_is_true_is_how_often_it_happens() {
    let building = building(7);
    for (from, to) in [("s2", "n2"), ("s3", "s4"), ("dock", "n0")] {
        let edge = edge(&building, from, to);
        let times: Vec<f64> = (0..70 * 24 * 12).map(|slot| f64::from(slot) * 300.0 + 7.0).collect();
        let passed = times.iter().filter(|&&time| building.attempt(&edge, time).reason.is_none()).count();
        let expected: f64 = times.iter().map(|&time| building.truth(&edge, time).0).sum();
        assert!((passed as f64 - expected).abs() < 0.01 * times.len() as f64, "{from}/{to}: {passed}, {expected}");
    }
}

#[test]
fn robots_that_learn_fail_less_often_than_those_that_take_the_shortest_way() {
    let outcome = run(&RoutesProtocol { seeds: 2, first_seed: 0, weeks: 3, tasks: 24 }, &|_, _| {}).expect("robots");
    let late =
        |kind: RobotKind| outcome.courses.iter().find(|course| course.kind == kind).map(|c| outcome.of_shortest(c));
    let [tidemap, oracle] = [RobotKind::TidemapEnsemble, RobotKind::Oracle].map(|kind| late(kind).expect("a robot"));
    assert!(tidemap < 0.6, "{tidemap} of the failures on shortest ways");
    assert!(oracle < tidemap + 0.05, "knowing the truth: {oracle} of the failures, tidemap {tidemap}");
    let tasks: Vec<u64> = outcome.courses.iter().flat_map(|course| &course.seeds).flatten().map(|w| w.tasks).collect();
    assert!(tasks.iter().all(|&tasks| tasks == 168), "the same tasks for all: {tasks:?}");
}

#[test]
fn a_trend_is_the_slope_of_a_straight_line() {
    let weeks = |failures: [u64; 4]| failures.map(|failures| Week { tasks: 10, failures, secs: 5.0 }).to_vec();
    let falling = RobotCourse { kind: RobotKind::Tidemap, seeds: vec![weeks([9, 7, 5, 3]), weeks([4, 4, 4, 4])] };
    assert_eq!(falling.slopes(0..4), [-2.0, 0.0]);
    assert_eq!(falling.slopes(1..2), [0.0, 0.0]);
    let outcome = RouteComparison { courses: vec![falling.clone()], weeks: 4 };
    let trend = outcome.trend(&falling, 0..4);
    assert_eq!((trend.slope, trend.p_value, trend.falling), (-1.0, None, 1));
    assert_eq!(outcome.late(), 2..4);
    assert!((falling.failures_per_task(0..1).mean - 0.65).abs() < 1e-12);
}
