//! Enumeration of all simple paths, as an oracle for routes.

use rand::{Rng, SeedableRng, rngs::SmallRng};

use super::{
    worlds::{Knowing, World},
    *,
};

/// A path with its cost, from the formulae: first part, then the tie breaker.
#[derive(Clone, Debug)]
struct Way {
    edges: Vec<EdgeId>,
    cost: f64,
    expected_secs: f64,
    success: f64,
    arrival_secs: f64,
}

struct Walker<'a> {
    world: &'a World,
    options: RouteOptions,
    to: NodeId,
    departure_secs: f64,
    ways: Vec<Way>,
}

impl Walker<'_> {
    fn go(&mut self, at: NodeId, passed: &mut Vec<NodeId>, way: &Way) {
        if at == self.to {
            self.ways.push(way.clone());
            return;
        }
        passed.push(at);
        for edge in self.world.topology.leaving(at) {
            let Some(forecast) = self.world.at(edge, way.arrival_secs).filter(|_| !passed.contains(&edge.to)) else {
                continue;
            };
            let (p, d) = (forecast.success, forecast.duration_secs);
            let secs = d + (1.0 - p) / p * (d + self.options.recovery_secs);
            let doubt = -p.ln();
            let cost = match self.options.objective {
                Objective::Success => doubt,
                Objective::Time => secs,
                Objective::Blend { weight } => (1.0 - weight) * secs + weight * self.options.failure_cost_secs * doubt,
            };
            let next = Way {
                edges: [&way.edges[..], &[edge.id]].concat(),
                cost: way.cost + cost,
                expected_secs: way.expected_secs + secs,
                success: way.success * p,
                arrival_secs: way.arrival_secs + d,
            };
            if next.arrival_secs - self.departure_secs <= self.options.horizon_secs {
                self.go(edge.to, passed, &next);
            }
        }
        passed.pop();
    }
}

/// All paths, the best first.
fn ways(world: &World, from: NodeId, to: NodeId, departure_secs: f64, options: &RouteOptions) -> Vec<Way> {
    let mut walker = Walker { world, options: *options, to, departure_secs, ways: Vec::new() };
    let empty = Way { edges: Vec::new(), cost: 0.0, expected_secs: 0.0, success: 1.0, arrival_secs: departure_secs };
    walker.go(from, &mut Vec::new(), &empty);
    let close = |a: f64, b: f64| (a - b).abs() < 1e-10;
    walker.ways.sort_by(|a, b| {
        let tie = a.expected_secs.total_cmp(&b.expected_secs);
        if close(a.cost, b.cost) { tie } else { a.cost.total_cmp(&b.cost) }
    });
    walker.ways
}

fn near(a: f64, b: f64) -> bool {
    (a - b).abs() <= 1e-9 * (1.0 + b.abs())
}

/// The exact search, as far as bounds of the forecasts prove it.
const EXACT: SearchWork = SearchWork { resolution_secs: 0.0, proof_labels: usize::MAX, ..SearchWork::USUAL };

fn question(seed: u64, random: &mut SmallRng) -> (World, NodeId, NodeId, RouteOptions) {
    let world = World::random(seed);
    let count = world.topology.nodes().len() as u32;
    let from = NodeId(random.random_range(0..count));
    let to = NodeId((from.0 + random.random_range(1..count)) % count);
    let objective = [Objective::Success, Objective::Time, Objective::Blend { weight: random.random() }];
    let options = RouteOptions {
        objective: objective[random.random_range(0..3)],
        recovery_secs: if random.random() { 0.0 } else { random.random_range(0.0..100.0) },
        alternatives: random.random_range(0..=ALTERNATIVES_MAX),
        horizon_secs: if random.random_bool(0.2) { random.random_range(20.0..200.0) } else { 1e5 },
        ..RouteOptions::default()
    };
    (world, from, to, options)
}

#[track_caller]
fn check(routes: &RoutePlan, ways: &[Way], options: &RouteOptions, what: &str) {
    assert_eq!(routes.routes.len(), ways.len().min(1 + options.alternatives), "{what}");
    assert_eq!(routes.certainty, Certainty::Proven, "{what}");
    for (rank, (route, way)) in routes.routes.iter().zip(ways).enumerate() {
        let what = format!("{what}, rank {rank}: {route:?} and {way:?}");
        assert!(near(route.cost, way.cost), "{what}");
        if options.objective == Objective::Success {
            assert!(near(route.expected_secs, way.expected_secs), "{what}");
        }
        // Any path of the same cost is valid, but with its own figures.
        let edges: Vec<EdgeId> = route.steps.iter().map(|step| step.edge).collect();
        let own = ways.iter().find(|way| way.edges == edges).unwrap_or_else(|| panic!("no such way: {what}"));
        assert!(near(route.expected_secs, own.expected_secs), "{what}");
        assert!(near(route.success, own.success), "{what}");
        assert!(near(route.arrival_secs, own.arrival_secs), "{what}");
        assert!(route.success_interval.lower <= route.success_interval.upper, "{what}");
    }
    let mut all: Vec<Vec<EdgeId>> =
        routes.routes.iter().map(|route| route.steps.iter().map(|step| step.edge).collect()).collect();
    all.sort();
    all.dedup();
    assert_eq!(all.len(), routes.routes.len(), "{what}: a route comes twice");
}

#[test]
fn routes_are_the_best_of_all_simple_ways_in_order() {
    let mut random = SmallRng::seed_from_u64(1);
    let (mut found, mut none) = (0, 0);
    for seed in 0..1_500 {
        let (world, from, to, options) = question(seed, &mut random);
        let departure_secs = random.random_range(-1e3..1e3);
        let ways = ways(&world, from, to, departure_secs, &options);
        let when = When::DepartAt(departure_secs);
        let plain = plan_routes_with(
            &EXACT,
            &world.topology,
            (from, to),
            when,
            &options,
            &mut |edge: &_, at| world.at(edge, at),
            || false,
        );
        let knowing =
            plan_routes_with(&EXACT, &world.topology, (from, to), when, &options, &mut Knowing(&world), || false);
        for (routes, how) in [(plain, "plain"), (knowing, "knowing")] {
            match routes {
                Ok(routes) => {
                    check(&routes, &ways, &options, &format!("seed {seed}, {how}"));
                    found += 1;
                }
                Err(PlanRouteError::Unreachable { .. } | PlanRouteError::BeyondHorizon { .. }) if ways.is_empty() => {
                    none += 1;
                }
                Err(error) => panic!("seed {seed}: {error}"),
            }
        }
    }
    assert!(found > 1_000 && none > 50, "{found} found, {none} not");
}

#[test]
fn the_best_departure_of_a_window_is_the_first_of_the_best_ones() {
    let mut random = SmallRng::seed_from_u64(2);
    for seed in 0..300 {
        let (world, from, to, options) = question(seed, &mut random);
        let options = RouteOptions { alternatives: 0, ..options };
        let (from_secs, step_secs): (f64, f64) = (random.random_range(0.0..100.0), random.random_range(1.0..30.0));
        let to_secs: f64 = from_secs + random.random_range(0.0..400.0);
        let mut best: Option<(f64, Way)> = None;
        for step in 0..=((to_secs - from_secs) / step_secs).floor() as usize {
            let secs = from_secs + step as f64 * step_secs;
            let Some(way) = ways(&world, from, to, secs, &options).into_iter().next() else { continue };
            let better = best.as_ref().is_none_or(|(_, best)| {
                let tie = (way.cost - best.cost).abs() < 1e-10;
                if tie { way.expected_secs < best.expected_secs - 1e-9 } else { way.cost < best.cost }
            });
            if better {
                best = Some((secs, way));
            }
        }
        let when = When::DepartWithin { from_secs, to_secs, step_secs };
        let routes =
            plan_routes_with(&EXACT, &world.topology, (from, to), when, &options, &mut Knowing(&world), || false);
        match (routes, best) {
            (Ok(routes), Some((secs, way))) => {
                let route = &routes.routes[0];
                assert!(near(route.cost, way.cost), "seed {seed}: {route:?} and {way:?}");
                if options.objective == Objective::Success {
                    assert!(near(route.departure_secs, secs), "seed {seed}: {route:?} and {way:?} at {secs}");
                }
            }
            (Err(_), None) => {}
            (routes, best) => panic!("seed {seed}: {routes:?} and {best:?}"),
        }
    }
}

#[test]
fn a_departure_for_an_arrival_is_in_time_and_no_later_step_is() {
    let mut random = SmallRng::seed_from_u64(3);
    let mut found = 0;
    for seed in 0..400 {
        let (world, from, to, options) = question(seed, &mut random);
        let step_secs = random.random_range(5.0..50.0);
        let options = RouteOptions { alternatives: 0, ..options };
        let work = SearchWork { arrival_step_secs: step_secs, ..EXACT };
        let by_secs = random.random_range(500.0..1_000.0);
        let earliest_secs: f64 = random.random_range(0.0..by_secs);
        let first_secs = earliest_secs.max(by_secs - options.horizon_secs);
        let expected = |secs: f64| Some(ways(&world, from, to, secs, &options).first()?.expected_secs);
        let is_in_time = |secs: f64| expected(secs).is_some_and(|expected| secs + expected <= by_secs + 1e-7);
        let steps = (1..1_000).map(|step| (by_secs - f64::from(step) * step_secs).max(first_secs));
        let naive = steps.clone().find(|&secs| is_in_time(secs));
        let when = When::ArriveBy { by_secs, earliest_secs };
        let routes =
            plan_routes_with(&work, &world.topology, (from, to), when, &options, &mut Knowing(&world), || false);
        match (routes, naive) {
            (Ok(routes), Some(naive)) => {
                let route = &routes.routes[0];
                assert!(is_in_time(route.departure_secs), "seed {seed}: {route:?}");
                assert!(route.departure_secs >= naive - 1e-7, "seed {seed}: {route:?} and {naive}");
                assert!(route.departure_secs <= naive + step_secs + 1e-7, "seed {seed}: {route:?} and {naive}");
                found += 1;
            }
            (Err(_), None) => {}
            (routes, naive) => panic!("seed {seed}: {routes:?} and {naive:?}"),
        }
    }
    assert!(found > 100, "{found}");
}

#[test]
fn sampled_bounds_and_a_resolution_change_little() {
    let mut random = SmallRng::seed_from_u64(4);
    let (mut same, mut all) = (0, 0);
    for seed in 0..500 {
        let (mut world, from, to, options) = question(seed, &mut random);
        // The forecasts change slowly, as over a day.
        world.stretch_secs = 600.0;
        let options = RouteOptions { alternatives: 0, horizon_secs: 1e5, ..options };
        let Some(best) = ways(&world, from, to, 0.0, &options).into_iter().next() else { continue };
        let exactly_sampled = SearchWork { proof_labels: 0, samples: 8, ..EXACT };
        for work in [exactly_sampled, SearchWork::USUAL, SearchWork { resolution_secs: 1.0, ..EXACT }] {
            let at = &mut |edge: &_, at| world.at(edge, at);
            let (ends, when) = ((from, to), When::DepartAt(0.0));
            let routes = plan_routes_with(&work, &world.topology, ends, when, &options, at, || false).unwrap();
            assert!(routes.certainty <= Certainty::Sampled, "seed {seed}");
            assert_eq!(routes.certainty == Certainty::Sampled, work.proof_labels == 0, "seed {seed}");
            all += 1;
            same += usize::from(near(routes.routes[0].cost, best.cost));
        }
    }
    assert!(all > 500 && same * 100 >= all * 99, "{same} of {all}");
}
