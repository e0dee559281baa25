//! Maps that are too large to enumerate: different bounds against each other, and against a plain search.

use rand::{Rng, SeedableRng, rngs::SmallRng};
use tidemap_map::{
    name::StateName,
    topology::{Edge, Extent, Roads, ShortestTimes, Topology},
};

use super::*;

/// A square grid of streets: all that run east, the first that runs north, and half of the pieces of the others.
fn city(width: u32, seed: u64) -> Topology {
    let mut random = SmallRng::seed_from_u64(seed);
    let mut topology = Topology::new();
    for node in 0..width * width {
        let id = topology.add_node(StateName::new(&format!("n{node}")).unwrap(), None, None).unwrap();
        if node % width > 0 {
            topology.link(NodeId(node - 1), id, Extent::secs(random.random_range(5.0..15.0))).unwrap();
        }
        if node >= width && (node % width == 0 || random.random()) {
            topology.link(NodeId(node - width), id, Extent::secs(random.random_range(5.0..15.0))).unwrap();
        }
    }
    topology
}

/// A rhythm of two hours, different for each edge: long compared with routes.
struct Rhythm {
    knows_bounds: bool,
}

impl Forecasts for Rhythm {
    fn at(&mut self, edge: &Edge, at_secs: f64) -> Option<EdgeForecast> {
        let swing = (std::f64::consts::TAU * at_secs / 7_200.0 + f64::from(edge.id.0)).sin();
        let duration_secs = edge.extent.secs_at(1.0) * (1.0 + 0.1 * swing);
        Some(EdgeForecast { success: 0.9 + 0.08 * swing, duration_secs, evidence: 10.0 })
    }

    fn best(&mut self, edge: &Edge, _: f64, _: f64) -> Option<EdgeBest> {
        let duration_secs = 0.9 * edge.extent.secs_at(1.0);
        self.knows_bounds.then_some(EdgeBest { success: 0.98, duration_secs })
    }
}

#[test]
fn samples_find_what_bounds_prove() {
    for seed in 0..6 {
        let map = city(10, seed);
        for objective in [Objective::Time, Objective::Blend { weight: 0.3 }, Objective::Success] {
            let options = RouteOptions { objective, alternatives: 2, ..RouteOptions::default() };
            let ask = |proof_labels, knows_bounds| {
                let work = SearchWork { proof_labels, labels_max: 1_000_000, ..SearchWork::USUAL };
                let (when, at) = (When::DepartAt(1_000.0 * seed as f64), &mut Rhythm { knows_bounds });
                plan_routes_with(&work, &map, (NodeId(0), NodeId(99)), when, &options, at, || false).unwrap()
            };
            let (proven, sampled) = (ask(usize::MAX, true), ask(0, false));
            assert_eq!(proven.certainty, Certainty::WithinResolution, "seed {seed}, {objective:?}");
            assert_eq!(sampled.certainty, Certainty::Sampled, "seed {seed}, {objective:?}");
            for (a, b) in proven.routes.iter().zip(&sampled.routes) {
                // Within a second a success changes by 7e-5.
                assert!((a.cost - b.cost).abs() < 1e-3 * a.cost, "seed {seed}, {objective:?}: {} {}", a.cost, b.cost);
            }
            assert!(proven.routes.windows(2).all(|pair| pair[0].cost <= pair[1].cost + 1e-9), "seed {seed}");
        }
    }
}

#[test]
fn what_does_not_change_with_time_has_the_shortest_way() {
    for seed in 0..4 {
        let map = city(20, seed);
        let mut still = |edge: &Edge, _: f64| {
            Some(EdgeForecast { success: 0.5, duration_secs: edge.extent.secs_at(1.0), evidence: 10.0 })
        };
        // With successes of a half and no recovery, expected times are twice the durations.
        let options = RouteOptions { objective: Objective::Time, recovery_secs: 0.0, ..RouteOptions::default() };
        let roads = Roads::new(&map, |edge| Some(edge.extent.secs_at(1.0))).unwrap();
        let mut shortest = ShortestTimes::default();
        shortest.from(&roads, 0);
        for to in [1, 57, 200, 399] {
            let when = When::DepartAt(0.0);
            let routes = plan_routes(&map, NodeId(0), NodeId(to), when, &options, &mut still, || false).unwrap();
            assert!((routes.routes[0].cost - 2.0 * shortest.secs()[to as usize]).abs() < 1e-6, "seed {seed}, to {to}");
        }
    }
}

#[test]
fn with_few_labels_a_way_is_found_and_marked_as_cut_off() {
    let map = city(20, 3);
    let ask = |labels_max| {
        let work = SearchWork { labels_max, proof_labels: 0, ..SearchWork::USUAL };
        let options = RouteOptions::default();
        let (when, at) = (When::DepartAt(0.0), &mut Rhythm { knows_bounds: false });
        plan_routes_with(&work, &map, (NodeId(0), NodeId(399)), when, &options, at, || false).unwrap()
    };
    let (all, few) = (ask(1_000_000), ask(20));
    assert_eq!((all.certainty, few.certainty), (Certainty::Sampled, Certainty::CutOff));
    let (best, found) = (all.routes[0].cost, few.routes[0].cost);
    assert!(best <= found + 1e-9 && found < 1.5 * best, "{best} {found}");
}

#[test]
fn where_nothing_fails_the_fastest_way_wins() {
    let map = city(50, 5);
    let mut sure = |edge: &Edge, _: f64| {
        Some(EdgeForecast { success: 1.0, duration_secs: edge.extent.secs_at(1.0), evidence: 10.0 })
    };
    let roads = Roads::new(&map, |edge| Some(edge.extent.secs_at(1.0))).unwrap();
    let mut shortest = ShortestTimes::default();
    shortest.from(&roads, 0);
    let (options, when) = (RouteOptions::default(), When::DepartAt(0.0));
    let routes = plan_routes(&map, NodeId(0), NodeId(2_499), when, &options, &mut sure, || false).unwrap();
    assert_eq!(routes.certainty, Certainty::Sampled);
    let route = &routes.routes[0];
    assert_eq!((route.success, route.cost), (1.0, 0.0));
    assert!((route.expected_secs - shortest.secs()[2_499]).abs() < 1e-6, "{}", route.expected_secs);
}
