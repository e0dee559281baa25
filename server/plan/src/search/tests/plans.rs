//! The contents of plans, refused input, and stop rules.

use tidemap_map::{
    name::StateName,
    topology::{Extent, Roads, Topology},
};

use super::*;
use crate::search::{SearchLimits, order::search_with};

/// A hall with three rooms: `near` at 5 s, `far` at 20 s, and `closet` behind `far`.
fn flat() -> (Topology, [NodeId; 4]) {
    let mut flat = Topology::new();
    let nodes =
        ["hall", "near", "far", "closet"].map(|name| flat.add_node(StateName::new(name).unwrap(), None, None).unwrap());
    for (a, b, secs) in [(0, 1, 5.0), (0, 2, 20.0), (2, 3, 2.0)] {
        flat.link(nodes[a], nodes[b], Extent::secs(secs)).unwrap();
    }
    (flat, nodes)
}

fn roads(topology: &Topology) -> Roads {
    Roads::new(topology, |edge| edge.extent.nominal_secs).unwrap()
}

fn plan(
    topology: &Topology,
    probabilities: &[(NodeId, f64)],
    options: &SearchOptions,
) -> Result<SearchPlan, SearchError> {
    let goals: Vec<Goal> = probabilities.iter().map(|&(node, probability)| Goal { node, probability }).collect();
    search(&roads(topology), NodeId(0), &goals, options, || false)
}

fn steps(plan: &SearchPlan) -> Vec<(u32, f64)> {
    plan.steps.iter().map(|step| (step.node.0, step.arrival_secs)).collect()
}

#[test]
fn rooms_that_are_passed_are_searched_and_the_walk_lists_all_of_them() {
    let (flat, [hall, near, far, closet]) = flat();
    let likely = [(hall, 0.1), (near, 0.1), (far, 0.0), (closet, 0.8)];
    let plan = plan(&flat, &likely, &SearchOptions::default()).unwrap();
    assert_eq!(steps(&plan), [(0, 0.0), (2, 20.0), (3, 22.0), (1, 49.0)]);
    let walk: Vec<(u32, f64)> = plan.walk.iter().map(|passage| (passage.node.0, passage.arrival_secs)).collect();
    assert_eq!(walk, [(0, 0.0), (2, 20.0), (3, 22.0), (2, 24.0), (0, 44.0), (1, 49.0)]);
    assert!((plan.expected_secs - (0.8 * 22.0 + 0.1 * 49.0)).abs() < 1e-4, "{}", plan.expected_secs);
    assert!(plan.optimal && plan.remains == 0.0 && plan.stopped.is_none());
}

#[test]
fn impossible_rooms_come_last_and_the_near_ones_of_them_first() {
    let (flat, [hall, near, far, closet]) = flat();
    let likely = [(hall, 0.0), (near, 0.0), (far, 1.0), (closet, 0.0)];
    assert_eq!(
        steps(&plan(&flat, &likely, &SearchOptions::default()).unwrap()),
        [(0, 0.0), (2, 20.0), (3, 22.0), (1, 49.0)]
    );
    let nowhere = [(hall, 0.0), (near, 0.0), (far, 0.0), (closet, 0.0)];
    let plan = plan(&flat, &nowhere, &SearchOptions::default()).unwrap();
    assert_eq!(steps(&plan), [(0, 0.0), (1, 5.0), (2, 30.0), (3, 32.0)]);
    assert_eq!(plan.remains, 0.0);
}

#[test]
fn a_room_whose_look_takes_long_is_passed_first_and_searched_later() {
    let (mut flat, [hall, _, far, closet]) = flat();
    flat.set_node(far, None, Some(100.0)).unwrap();
    let likely = [(hall, 0.0), (far, 0.1), (closet, 0.9)];
    let plan = plan(&flat, &likely, &SearchOptions::default()).unwrap();
    assert_eq!(steps(&plan), [(0, 0.0), (3, 22.0), (2, 24.0)]);
    let passed: Vec<u32> = plan.walk.iter().map(|passage| passage.node.0).collect();
    assert_eq!(passed, [0, 2, 3, 2]);
}

#[test]
fn a_look_at_the_start_that_takes_time_may_come_later() {
    let (mut flat, [hall, near, ..]) = flat();
    flat.set_node(hall, None, Some(60.0)).unwrap();
    let likely = plan(&flat, &[(hall, 0.1), (near, 0.9)], &SearchOptions::default()).unwrap();
    assert_eq!(steps(&likely), [(1, 5.0), (0, 10.0)]);
    let unlikely = plan(&flat, &[(hall, 0.99), (near, 0.01)], &SearchOptions::default()).unwrap();
    assert_eq!(steps(&unlikely), [(0, 0.0), (1, 65.0)]);
}

#[test]
fn what_cannot_be_reached_is_reported() {
    let (mut flat, [_, near, far, closet]) = flat();
    let island = flat.add_node(StateName::new("island").unwrap(), None, None).unwrap();
    let found = plan(&flat, &[(near, 0.3), (island, 0.1)], &SearchOptions::default()).unwrap();
    assert_eq!(found.unreachable, [Goal { node: island, probability: 0.1 }]);
    assert!((found.remains - 0.25).abs() < 1e-12 && found.optimal);
    let none = plan(&flat, &[(island, 0.1)], &SearchOptions::default());
    assert_eq!(none, Err(SearchError::Unreachable { start: 0 }));

    // There is an edge into the closet, and none out of it; this also holds for the other trap.
    let back = flat.edge_between(closet, far, None).unwrap().id;
    flat.remove_edge(back).unwrap();
    let out = flat.edge_between(near, NodeId(0), None).unwrap().id;
    flat.remove_edge(out).unwrap();
    let trapped = plan(&flat, &[(near, 0.3), (far, 0.3), (closet, 0.2)], &SearchOptions::default()).unwrap();
    assert_eq!(steps(&trapped), [(2, 20.0), (1, 45.0)]);
    assert_eq!(trapped.unreachable, [Goal { node: closet, probability: 0.2 }]);
    assert!(!trapped.optimal && (trapped.remains - 0.25).abs() < 1e-12);
}

#[test]
fn what_is_wrong_is_named() {
    let (flat, [hall, near, ..]) = flat();
    let refused = |goals: &[(NodeId, f64)], options: SearchOptions| plan(&flat, goals, &options).unwrap_err();
    assert_eq!(refused(&[], SearchOptions::default()), SearchError::NoGoals);
    assert_eq!(refused(&[(NodeId(9), 0.1)], SearchOptions::default()), SearchError::UnknownNode(9));
    assert_eq!(
        refused(&[(near, 0.1), (hall, 0.1), (near, 0.1)], SearchOptions::default()),
        SearchError::DuplicateGoal(1)
    );
    for bad in [-0.1, 1.1, f64::NAN, f64::INFINITY] {
        assert!(matches!(refused(&[(near, bad)], SearchOptions::default()), SearchError::Probability { node: 1, .. }));
        let stop = Stop { remains_below: Some(bad), ..Stop::default() };
        assert!(matches!(
            refused(&[(near, 0.1)], SearchOptions { stop, ..SearchOptions::default() }),
            SearchError::Stop(_)
        ));
    }
    for floor in [0.0, -1.0, 2.0, f64::NAN] {
        assert!(matches!(
            refused(&[(near, 0.1)], SearchOptions { floor, ..SearchOptions::default() }),
            SearchError::Floor(_)
        ));
    }
    for cost in [-1.0, f64::NAN, f64::INFINITY] {
        let stop = Stop { cost_per_sec: Some(cost), ..Stop::default() };
        assert!(matches!(
            refused(&[(near, 0.1)], SearchOptions { stop, ..SearchOptions::default() }),
            SearchError::Stop(_)
        ));
    }
}

#[test]
fn a_search_of_a_hundred_thousand_places_is_refused_before_anything_is_computed() {
    let map = Map::random(Shape::Tree, 3_000, false, 1);
    let roads = map.roads();
    let many: Vec<Goal> = (0..100_000).map(|node| Goal { node: NodeId(node), probability: 0.1 }).collect();
    let exact = SearchOptions { effort: Effort::Exact, ..SearchOptions::default() };
    let refused = search(&roads, map.start(), &many, &exact, || false).unwrap_err();
    assert_eq!(refused, SearchError::TooManyForExact { found: 100_000 });
    assert!(refused.to_string().contains("at most 40"), "{refused}");
    let refused = search(&roads, map.start(), &many, &SearchOptions::default(), || false).unwrap_err();
    assert_eq!(refused, SearchError::TooMany { found: 100_000, max: GOALS_MAX });
    // A few places of a large map.
    let few = search(&roads, map.start(), &goals(&map)[2_990..], &exact, || false).unwrap();
    assert!(few.optimal && few.steps.len() == 10);
}

#[test]
fn a_search_that_is_cut_short_has_a_bound_of_its_quality() {
    for shape in [Shape::Complete, Shape::Streets] {
        let map = Map::random(shape, 22, false, 77);
        let (roads, goals) = (map.roads(), goals(&map));
        let best = search(&roads, map.start(), &goals, &SearchOptions::default(), || false).unwrap();
        assert!(best.optimal);
        let mut calls = 0;
        for limit in [0, 1, 20, 400] {
            let until = || {
                calls += 1;
                calls > limit
            };
            let cut = search(&roads, map.start(), &goals, &SearchOptions::default(), until).unwrap();
            assert_eq!(cut.steps.len(), 22);
            assert!(cut.lower_bound_secs > 0.0 && cut.lower_bound_secs <= best.expected_secs * (1.0 + 1e-9));
            assert!(cut.expected_secs >= best.expected_secs * (1.0 - 1e-9));
        }
        let limits = SearchLimits { states_max: 50, ..SearchLimits::USUAL };
        let options = SearchOptions::default();
        let few = search_with(limits, &roads, map.start(), &goals, &options, || false).unwrap();
        assert!(!few.optimal && few.lower_bound_secs <= best.expected_secs && few.states <= 100, "{}", few.states);
    }
}

#[test]
fn a_large_map_is_searched_well_and_the_same_for_a_seed() {
    let map = Map::random(Shape::Complete, 120, false, 5);
    let (roads, goals) = (map.roads(), goals(&map));
    let found = |rounds_max, seed| {
        let limits = SearchLimits { rounds_max, ..SearchLimits::USUAL };
        let options = SearchOptions { seed, ..SearchOptions::default() };
        search_with(limits, &roads, map.start(), &goals, &options, || false).unwrap()
    };
    let (none, some, again) = (found(0, 1), found(2_000, 1), found(2_000, 1));
    assert_eq!(some, again);
    assert!(some.expected_secs < 0.99 * none.expected_secs, "{} {}", some.expected_secs, none.expected_secs);
    assert!(!some.optimal && some.lower_bound_secs > 0.0 && some.lower_bound_secs < some.expected_secs);
    let other = found(2_000, 2);
    assert!((other.expected_secs / some.expected_secs - 1.0).abs() < 0.05);
}

#[test]
fn a_longer_search_is_never_worse_and_leaves_what_a_shorter_one_is_stuck_in() {
    let map = Map::random(Shape::Random, 100, false, 8);
    let (roads, goals) = (map.roads(), goals(&map));
    let found = |rounds_max, seed| {
        let limits = SearchLimits { rounds_max, ..SearchLimits::USUAL };
        let options = SearchOptions { seed, ..SearchOptions::default() };
        search_with(limits, &roads, map.start(), &goals, &options, || false).unwrap().expected_secs
    };
    let better = (0..2).filter(|&seed| {
        let (short, long) = (found(2_000, seed), found(6_000, seed));
        assert!(long <= short, "seed {seed}: {long} {short}");
        long < short * 0.999
    });
    assert!(better.count() >= 1);
}

#[test]
fn a_good_order_of_few_places_is_the_best() {
    for (shape, seed) in [(Shape::Tree, 1), (Shape::Streets, 2), (Shape::Complete, 3), (Shape::Random, 4)] {
        let map = Map::random(shape, 22, false, seed);
        let (roads, goals) = (map.roads(), goals(&map));
        let found = |effort| {
            let options = SearchOptions { effort, ..SearchOptions::default() };
            search(&roads, map.start(), &goals, &options, || false).unwrap()
        };
        let (best, good) = (found(Effort::Exact), found(Effort::Heuristic));
        assert!(best.optimal && !good.optimal);
        let over = good.expected_secs / best.expected_secs - 1.0;
        assert!(over.abs() < 1e-9, "{shape:?}: {over}");
    }
}

#[test]
fn a_search_ends_where_little_remains_or_it_is_not_worth_it() {
    let (flat, [hall, near, far, closet]) = flat();
    let likely = [(hall, 0.5), (near, 0.3), (far, 0.15), (closet, 0.05)];
    let stopped = |stop: Stop| plan(&flat, &likely, &SearchOptions { stop, ..SearchOptions::default() }).unwrap();
    let unlikely = stopped(Stop { remains_below: Some(0.25), ..Stop::default() });
    assert_eq!(steps(&unlikely), [(0, 0.0), (1, 5.0)]);
    assert_eq!(unlikely.walk.len(), 2);
    assert!((unlikely.remains - 0.2).abs() < 1e-12);
    assert_eq!(unlikely.stopped, Some(StopReason::Unlikely));
    // The gain of the last 0.2 takes 25 s and more. At a cost of 0.02 a second, 0.3 at 5 s is worth it, 0.15 at 30 s is
    // not.
    let dear = stopped(Stop { cost_per_sec: Some(0.05), ..Stop::default() });
    assert_eq!((steps(&dear), dear.stopped), (vec![(0, 0.0), (1, 5.0)], Some(StopReason::NotWorthIt)));
    let cheap = stopped(Stop { cost_per_sec: Some(0.0), ..Stop::default() });
    assert_eq!((cheap.steps.len(), cheap.stopped), (4, None));
    let nothing = stopped(Stop { remains_below: Some(1.0), cost_per_sec: Some(1e9), within_secs: None });
    assert!(nothing.steps.len() <= 1);
    let brief = stopped(Stop { within_secs: Some(5.0), ..Stop::default() });
    assert_eq!((steps(&brief), brief.stopped), (vec![(0, 0.0), (1, 5.0)], Some(StopReason::OutOfTime)));
    let unhurried = stopped(Stop { within_secs: Some(1e6), ..Stop::default() });
    assert_eq!((unhurried.steps.len(), unhurried.stopped), (4, None));
    let never = plan(
        &flat,
        &likely,
        &SearchOptions { stop: Stop { within_secs: Some(-1.0), ..Stop::default() }, ..SearchOptions::default() },
    );
    assert_eq!(never, Err(SearchError::Stop(StopError::Within(-1.0))));
}

#[test]
fn joint_probabilities_of_persons_and_objects() {
    assert!((anyone([0.5, 0.5]) - 0.75).abs() < 1e-12);
    assert_eq!(anyone([]), 0.0);
    let days = [[0.9, 0.5], [0.8, 0.6], [0.8, 0.9], [1.0, 1.0]];
    let joint = next_above(days, 0.5).unwrap().unwrap();
    assert_eq!(joint.index, 2);
    assert!((joint.probability - 0.72).abs() < 1e-12);
    assert_eq!(next_above(days, 1.0), Ok(None));
    assert!(matches!(next_above([[0.5, f64::NAN]], 0.1), Err(PolicyError::Probability(_))));
    assert_eq!(next_above(days, 2.0), Err(PolicyError::Threshold(2.0)));
}

#[test]
fn a_room_that_fills_later_is_visited_later() {
    let (flat, [hall, near, far, _]) = flat();
    let nodes = [hall, near, far];
    // The target is certainly at `near`, but only after 40 s.
    let probability = |node: NodeId, secs: f64| match node {
        node if node == near => f64::from(u8::from(secs >= 40.0)),
        node if node == far => 0.5,
        _ => 0.0,
    };
    let changing =
        search_changing(&roads(&flat), hall, &nodes, probability, &SearchOptions::default(), || false).unwrap();
    assert_eq!(steps(&changing), [(0, 0.0), (2, 20.0), (1, 45.0)]);
    assert_eq!(changing.steps[2].probability, 1.0);
    assert!(!changing.optimal);
    let invalid = search_changing(&roads(&flat), hall, &nodes, |_, secs| secs, &SearchOptions::default(), || false);
    assert!(matches!(invalid, Err(SearchError::Probability { .. })));
}

#[test]
fn probabilities_that_do_not_change_give_the_best_order() {
    for seed in 0..20 {
        let map = Map::random(Shape::Streets, 9, false, seed);
        let (roads, goals) = (map.roads(), goals(&map));
        let nodes: Vec<NodeId> = goals.iter().map(|goal| goal.node).collect();
        let probability = |node: NodeId, _| goals[node.0 as usize].probability;
        let best = search(&roads, map.start(), &goals, &SearchOptions::default(), || false).unwrap();
        let changing =
            search_changing(&roads, map.start(), &nodes, probability, &SearchOptions::default(), || false).unwrap();
        assert!((changing.expected_secs - best.expected_secs).abs() < 1e-4 * best.expected_secs, "seed {seed}");
    }
}
