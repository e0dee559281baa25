//! Results beside the best path, and refused requests.

use tidemap_map::topology::Topology;

use super::*;
use crate::testkit::street;

fn sure(_: &tidemap_map::topology::Edge, _: f64) -> Option<EdgeForecast> {
    Some(EdgeForecast { success: 0.8, duration_secs: 10.0, evidence: 9.0 })
}

fn ask(when: When, options: &RouteOptions) -> Result<RoutePlan, PlanRouteError> {
    plan_routes(&street(4), NodeId(0), NodeId(3), when, options, &mut sure, || false)
}

#[test]
fn the_figures_of_a_street_follow_from_the_formulae() {
    let options = RouteOptions { objective: Objective::Time, ..RouteOptions::default() };
    let route = ask(When::DepartAt(100.0), &options).unwrap().routes.remove(0);
    let starts: Vec<f64> = route.steps.iter().map(|step| step.start_secs).collect();
    assert_eq!(starts, [100.0, 110.0, 120.0]);
    assert_eq!(route.arrival_secs, 130.0);
    // Each edge has a quarter of a failure on average, each of 70 s.
    assert!((route.expected_secs - 3.0 * (10.0 + 0.25 * 70.0)).abs() < 1e-9);
    assert_eq!(route.cost, route.expected_secs);
    assert!((route.success - 0.512).abs() < 1e-12);
    let (edge, whole) = (route.steps[0].success_interval, route.success_interval);
    // The distribution is Beta(7.2, 1.8).
    assert!(edge.lower > 0.5 && edge.lower < 0.6 && edge.upper > 0.95 && edge.upper < 1.0, "{edge:?}");
    assert!(whole.lower < edge.lower && whole.upper < edge.upper && whole.contains(0.512), "{whole:?}");
    let success = ask(When::DepartAt(0.0), &RouteOptions::default()).unwrap().routes.remove(0);
    assert!((success.cost + 0.512_f64.ln()).abs() < 1e-9);
}

#[test]
fn who_is_there_needs_no_step() {
    let there = |when| {
        let options = RouteOptions::default();
        plan_routes(&street(2), NodeId(1), NodeId(1), when, &options, &mut sure, || false).unwrap().routes.remove(0)
    };
    let route = there(When::ArriveBy { by_secs: 70.0, earliest_secs: 0.0 });
    assert!(route.steps.is_empty() && route.success == 1.0 && route.cost == 0.0);
    assert_eq!((route.departure_secs, route.arrival_secs), (70.0, 70.0));
    assert_eq!(there(When::DepartAt(5.0)).departure_secs, 5.0);
}

#[test]
fn later_is_better_where_a_door_opens() {
    // The door from node 1 to 2 opens at 60 s: an immediate departure finds it closed.
    let door = &mut |edge: &tidemap_map::topology::Edge, at_secs: f64| {
        let is_door = edge.from == NodeId(1) && edge.to == NodeId(2);
        sure(edge, at_secs).filter(|_| !is_door || at_secs >= 60.0)
    };
    let options = RouteOptions::default();
    let mut ask = |when| plan_routes(&street(4), NodeId(0), NodeId(3), when, &options, door, || false);
    assert_eq!(ask(When::DepartAt(0.0)), Err(PlanRouteError::Unreachable { from: 0, to: 3, closed: 1 }));
    assert_eq!(ask(When::DepartAt(50.0)).unwrap().routes.len(), 1);
    let within = ask(When::DepartWithin { from_secs: 0.0, to_secs: 300.0, step_secs: 10.0 }).unwrap();
    assert_eq!(within.routes[0].departure_secs, 50.0);
}

#[test]
fn an_arrival_is_met_as_late_as_can_be() {
    let expected_secs = 3.0 * (10.0 + 0.25 * 70.0);
    let when = When::ArriveBy { by_secs: 1_000.0, earliest_secs: 0.0 };
    let route = ask(when, &RouteOptions::default()).unwrap().routes.remove(0);
    assert!((route.departure_secs - (1_000.0 - expected_secs)).abs() < 0.2, "{}", route.departure_secs);
    assert!(route.departure_secs + route.expected_secs <= 1_000.0 + 1e-9);
    let none = When::ArriveBy { by_secs: 50.0, earliest_secs: 0.0 };
    let error = PlanRouteError::TooLate { earliest_secs: 0.0, by_secs: 50.0 };
    assert_eq!(ask(none, &RouteOptions::default()), Err(error));
}

#[test]
fn what_takes_too_long_differs_from_what_cannot_be_reached() {
    let options = RouteOptions { horizon_secs: 29.0, ..RouteOptions::default() };
    let error = ask(When::DepartAt(0.0), &options).unwrap_err();
    assert_eq!(error, PlanRouteError::BeyondHorizon { from: 0, to: 3, horizon_secs: 29.0 });
    let mut closed = |_: &tidemap_map::topology::Edge, _: f64| None;
    let options = RouteOptions::default();
    let when = When::DepartAt(0.0);
    let error = plan_routes(&street(4), NodeId(0), NodeId(3), when, &options, &mut closed, || false).unwrap_err();
    assert_eq!(error, PlanRouteError::Unreachable { from: 0, to: 3, closed: 1 });
    let when_by = When::ArriveBy { by_secs: 1_000.0, earliest_secs: 0.0 };
    let error = plan_routes(&street(4), NodeId(0), NodeId(3), when_by, &options, &mut closed, || false).unwrap_err();
    assert_eq!(error, PlanRouteError::Unreachable { from: 0, to: 3, closed: 1 });
    let unknown = plan_routes(&street(4), NodeId(0), NodeId(9), when, &options, &mut sure, || false);
    assert_eq!(unknown, Err(PlanRouteError::UnknownNode(9)));
}

#[test]
fn a_search_that_ends_early_is_marked() {
    let work = SearchWork { labels_max: 1, ..SearchWork::USUAL };
    let (options, when) = (RouteOptions::default(), When::DepartAt(0.0));
    let ends = (NodeId(0), NodeId(3));
    let routes = plan_routes_with(&work, &street(4), ends, when, &options, &mut sure, || false).unwrap();
    assert_eq!((routes.certainty, routes.routes[0].steps.len()), (Certainty::CutOff, 3));
    let stopped = plan_routes(&street(4), NodeId(0), NodeId(3), when, &options, &mut sure, || true);
    assert_eq!(stopped, Err(PlanRouteError::CutOff { labels: 0 }));
}

#[test]
fn forecasts_out_of_range_name_their_edge() {
    let ask = |success: f64, duration_secs: f64, evidence: f64| {
        let mut bad = |_: &tidemap_map::topology::Edge, _: f64| Some(EdgeForecast { success, duration_secs, evidence });
        let options = RouteOptions { horizon_secs: TIME_MAX_SECS, ..RouteOptions::default() };
        let when = When::DepartAt(0.0);
        let found = plan_routes(&street(2), NodeId(0), NodeId(1), when, &options, &mut bad, || false);
        found.err().map(|error| error.to_string())
    };
    assert_eq!(ask(1.0, 1.0, 1.0), None);
    assert_eq!(ask(SUCCESS_MIN, NOMINAL_MAX_SECS, 1e-12), None);
    for success in [0.0, -0.1, 1.1, f64::NAN, f64::INFINITY] {
        let error = ask(success, 1.0, 1.0).unwrap();
        assert!(error.contains("n0/n1") && error.contains("succeeds"), "{error}");
    }
    for duration_secs in [0.0, -1.0, 1e10, f64::NAN, f64::INFINITY] {
        assert!(ask(0.5, duration_secs, 1.0).unwrap().contains("would take"));
    }
    for evidence in [0.0, -1.0, f64::NAN] {
        assert!(ask(0.5, 1.0, evidence).unwrap().contains("observations"));
    }
}

#[test]
fn options_out_of_range_are_refused() {
    let base = RouteOptions::default();
    let nan = f64::NAN;
    let bad = [
        RouteOptions { recovery_secs: -1.0, ..base },
        RouteOptions { recovery_secs: nan, ..base },
        RouteOptions { failure_cost_secs: f64::INFINITY, ..base },
        RouteOptions { objective: Objective::Blend { weight: 1.1 }, ..base },
        RouteOptions { objective: Objective::Blend { weight: nan }, ..base },
        RouteOptions { alternatives: 11, ..base },
        RouteOptions { confidence: 1.0, ..base },
        RouteOptions { confidence: 0.4, ..base },
        RouteOptions { horizon_secs: 0.0, ..base },
    ];
    for options in bad {
        let found = ask(When::DepartAt(0.0), &options);
        assert!(matches!(found, Err(PlanRouteError::Range { .. })), "{options:?}: {found:?}");
    }
    for when in [
        When::DepartAt(nan),
        When::DepartAt(1e10),
        When::DepartWithin { from_secs: 10.0, to_secs: 0.0, step_secs: 1.0 },
        When::DepartWithin { from_secs: 0.0, to_secs: 10.0, step_secs: 0.0 },
        When::ArriveBy { by_secs: nan, earliest_secs: 0.0 },
    ] {
        assert!(matches!(ask(when, &base), Err(PlanRouteError::Range { .. })), "{when:?}");
    }
    let many = When::DepartWithin { from_secs: 0.0, to_secs: 1_000.0, step_secs: 1.0 };
    assert_eq!(ask(many, &base), Err(PlanRouteError::TooManyDepartures { found: 1_001.0 }));
}

#[test]
fn a_dearer_way_is_kept_where_the_cheaper_one_has_passed_what_follows() {
    // Node 2 can be reached from 0 through 1, or directly in the same time with less success; the edge from node 1 to
    // the goal, 3, is good only from 25 s on.
    let mut topology = Topology::new();
    let nodes: Vec<NodeId> = (0..4)
        .map(|node| {
            topology.add_node(tidemap_map::name::StateName::new(&format!("n{node}")).unwrap(), None, None).unwrap()
        })
        .collect();
    for (from, to) in [(0, 1), (1, 2), (0, 2), (2, 1), (1, 3), (2, 3)] {
        topology.add_edge(nodes[from], nodes[to], None, tidemap_map::topology::Extent::secs(10.0)).unwrap();
    }
    let mut at = |edge: &tidemap_map::topology::Edge, at_secs: f64| {
        let (success, duration_secs) = match (edge.from.0, edge.to.0) {
            (0, 2) => (0.8, 20.0),
            (1, 3) if at_secs < 25.0 => (0.01, 10.0),
            (1, 3) => (1.0, 10.0),
            (2, 3) => (0.05, 10.0),
            _ => (0.9, 10.0),
        };
        Some(EdgeForecast { success, duration_secs, evidence: 5.0 })
    };
    for (proof_labels, samples) in [(usize::MAX, 4), (0, 9), (5_000, 4)] {
        let work = SearchWork { proof_labels, samples, ..SearchWork::USUAL };
        let (options, when, ends) = (RouteOptions::default(), When::DepartAt(0.0), (nodes[0], nodes[3]));
        let routes = plan_routes_with(&work, &topology, ends, when, &options, &mut at, || false).unwrap();
        let way: Vec<u32> = routes.routes[0].steps.iter().map(|step| step.to.0).collect();
        assert_eq!(way, [2, 1, 3], "{work:?}");
    }
}

/// Two ways from node 0 to node 3: through node 1, where people walk until 100 s, and through node 2, which is longer.
struct Crowded;

impl Forecasts for Crowded {
    fn at(&mut self, edge: &tidemap_map::topology::Edge, at_secs: f64) -> Option<EdgeForecast> {
        let is_long = edge.from == NodeId(2) || edge.to == NodeId(2);
        sure(edge, at_secs)
            .map(|forecast| EdgeForecast { duration_secs: if is_long { 13.0 } else { 10.0 }, ..forecast })
    }

    fn encounters(&mut self, edge: &tidemap_map::topology::Edge, at_secs: f64, duration_secs: f64) -> f64 {
        let is_crowded = at_secs < 100.0 && (edge.from == NodeId(1) || edge.to == NodeId(1));
        if is_crowded { duration_secs / 10.0 } else { 0.0 }
    }
}

#[test]
fn an_arrival_counts_the_encounters_of_its_departure() {
    let work = SearchWork { proof_labels: 0, ..SearchWork::USUAL };
    let options = RouteOptions {
        objective: Objective::Time,
        encounter_cost_secs: 0.5,
        recovery_secs: 0.0,
        ..RouteOptions::default()
    };
    let topology = street(3);
    // Two edges of 10 s with a quarter of a failure each: the robot leaves at 32 s, at which bounds were sampled.
    let when = When::ArriveBy { by_secs: 57.0, earliest_secs: 0.0 };
    let crowded = |departure: When| {
        let ends = (NodeId(0), NodeId(2));
        let plan = departure::plan_routes_with(&work, &topology, ends, departure, &options, &mut Crowded, || false);
        plan.unwrap().routes.remove(0)
    };
    let arriving = crowded(when);
    let departing = crowded(When::DepartAt(arriving.departure_secs));
    assert_eq!((arriving.encounters, arriving.cost), (departing.encounters, departing.cost));
    assert!(arriving.encounters > 1.9 && arriving.cost > arriving.expected_secs + 0.9, "{arriving:?}");
}

#[test]
fn a_route_avoids_people_where_that_is_worth_the_time() {
    let mut topology = Topology::new();
    for name in ["a", "b", "c", "d"] {
        topology.add_node(tidemap_map::name::StateName::new(name).unwrap(), None, None).unwrap();
    }
    for (one, other) in [(0, 1), (1, 3), (0, 2), (2, 3)] {
        topology.link(NodeId(one), NodeId(other), tidemap_map::topology::Extent::secs(10.0)).unwrap();
    }
    let ask = |departure: f64, encounter_cost_secs: f64, objective: Objective| {
        let options = RouteOptions { objective, encounter_cost_secs, ..RouteOptions::default() };
        let plan =
            plan_routes(&topology, NodeId(0), NodeId(3), When::DepartAt(departure), &options, &mut Crowded, || false);
        let route = plan.unwrap().routes.remove(0);
        (route.steps[0].to.0, route.encounters, route.cost - route.expected_secs)
    };
    assert_eq!(ask(0.0, 0.0, Objective::Time), (1, 2.0, 0.0), "encounters do not matter");
    assert_eq!(
        ask(0.0, 1.0, Objective::Time),
        (1, 2.0, 2.0),
        "two encounters are worth 2 s, and the detour takes 7.5 s"
    );
    assert_eq!(ask(0.0, 10.0, Objective::Time), (2, 0.0, 0.0));
    assert_eq!(ask(100.0, 10.0, Objective::Time), (1, 0.0, 0.0), "nobody is there any more");
    assert_eq!(ask(0.0, 10.0, Objective::Success).0, 2, "both ways succeed alike");
    let wrong = RouteOptions { encounter_cost_secs: f64::NAN, ..RouteOptions::default() };
    assert!(matches!(self::ask(When::DepartAt(0.0), &wrong), Err(PlanRouteError::Range { .. })));
}
