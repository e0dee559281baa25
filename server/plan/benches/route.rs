//! Times routes and policies on maps of streets, with forecasts that change through the day.
//!
//! `cargo bench -p tidemap-plan --bench route`: routes between far corners of each map, the fastest of some repetitions
//! of each request, the median and the slowest request, and the certainty of the results. A forecast evaluates two
//! cosines for the success and two for the duration, as spectral models of order 2 do.
#![allow(clippy::unwrap_used)]
#![allow(dead_code, reason = "the maps are shared with other benchmarks, which use more of them")]

#[path = "../src/testkit.rs"]
mod testkit;

use std::time::{Duration, Instant};

use testkit::{Map, Shape};
use tidemap_map::topology::{Edge, NodeId, Topology};
use tidemap_plan::policy::{PolicyObjective, PolicyOptions, solve_policy};
use tidemap_plan::route::{EdgeBest, EdgeForecast, Forecasts, Objective, RouteOptions, RoutePlan, When, plan_routes};

/// Forecasts by a daily and a half-daily rhythm of each edge, with or without bounds.
struct Rhythms {
    knows_bounds: bool,
}

impl Rhythms {
    /// Mean, amplitude and phases of an edge's success, in that order.
    fn of(edge: &Edge) -> (f64, f64, f64) {
        let number = f64::from(edge.id.0.wrapping_mul(2_654_435_761) >> 8) / f64::from(1_u32 << 24);
        let other = f64::from(edge.id.0.wrapping_mul(40_503).wrapping_mul(2_654_435_761) >> 8) / f64::from(1_u32 << 24);
        // One edge in five is a door with a rhythm, the others are nearly always passable.
        if number < 0.2 { (0.75, 0.2, other * 6.0) } else { (0.98, 0.015, other * 6.0) }
    }
}

impl Forecasts for Rhythms {
    fn at(&mut self, edge: &Edge, at_secs: f64) -> Option<EdgeForecast> {
        let (mean, swing, phase) = Rhythms::of(edge);
        let day = std::f64::consts::TAU * at_secs / 86_400.0;
        let success = mean + swing * (0.7 * (day + phase).cos() + 0.3 * (2.0 * day + phase).cos());
        let busy = 1.0 + 0.2 * (0.6 * (day - phase).cos() + 0.4 * (2.0 * day - phase).cos());
        Some(EdgeForecast { success, duration_secs: edge.extent.secs_at(1.0) * busy, evidence: 40.0 })
    }

    fn best(&mut self, edge: &Edge, _: f64, _: f64) -> Option<EdgeBest> {
        let (mean, swing, _) = Rhythms::of(edge);
        let duration_secs = 0.8 * edge.extent.secs_at(1.0);
        self.knows_bounds.then_some(EdgeBest { success: mean + swing, duration_secs })
    }
}

/// The fastest of some repetitions, at most for about a second.
fn fastest<T>(mut run: impl FnMut() -> T, repetitions: usize) -> (Duration, T) {
    let begun = Instant::now();
    let mut best: Option<(Duration, T)> = None;
    for _ in 0..repetitions {
        let start = Instant::now();
        let found = run();
        let took = start.elapsed();
        if best.as_ref().is_none_or(|(least, _)| took < *least) {
            best = Some((took, found));
        }
        if begun.elapsed() > Duration::from_secs(1) {
            break;
        }
    }
    best.expect("at least one repetition")
}

fn row(name: &str, nodes: usize, mut answers: Vec<(Duration, RoutePlan)>) {
    answers.sort_by_key(|(took, _)| *took);
    let (median, slowest) = (answers[answers.len() / 2].0, answers[answers.len() - 1].0);
    let labels = answers.iter().map(|(_, routes)| routes.labels).max().unwrap_or(0);
    let forecasts = answers.iter().map(|(_, routes)| routes.forecasts).max().unwrap_or(0);
    let worst = answers.iter().map(|(_, routes)| routes.certainty).max().unwrap();
    println!(
        "{name:32} {nodes:6} {:>10} {:>10} {labels:8} {forecasts:9} {worst:?}",
        format!("{median:.2?}"),
        format!("{slowest:.2?}")
    );
}

fn routes(topology: &Topology, nodes: usize) {
    let options = RouteOptions::default();
    let blend = Objective::Blend { weight: 0.5 };
    let depart = |hour: f64| When::DepartAt(3_600.0 * hour);
    let window =
        |hour: f64| When::DepartWithin { from_secs: 3_600.0 * hour, to_secs: 3_600.0 * (hour + 2.0), step_secs: 900.0 };
    let arrive = |hour: f64| When::ArriveBy { by_secs: 3_600.0 * (hour + 2.0), earliest_secs: 0.0 };
    type At<'a> = &'a dyn Fn(f64) -> When;
    let cases: [(&str, RouteOptions, At, bool); 8] = [
        ("success", options, &depart, false),
        ("time", RouteOptions { objective: Objective::Time, ..options }, &depart, false),
        ("blend", RouteOptions { objective: blend, ..options }, &depart, false),
        ("success, bounds known", options, &depart, true),
        ("time, bounds known", RouteOptions { objective: Objective::Time, ..options }, &depart, true),
        (
            "time, 3 alternatives",
            RouteOptions { objective: Objective::Time, alternatives: 3, ..options },
            &depart,
            false,
        ),
        ("time, 9 departures", RouteOptions { objective: Objective::Time, ..options }, &window, false),
        ("time, arrival", RouteOptions { objective: Objective::Time, ..options }, &arrive, false),
    ];
    for (name, options, when, knows_bounds) in cases {
        let answers = (0..4)
            .map(|question| {
                let (from, to) = match question % 2 {
                    0 => (NodeId(0), NodeId(nodes as u32 - 1)),
                    _ => (NodeId(nodes as u32 / 7), NodeId(nodes as u32 - 1 - nodes as u32 / 5)),
                };
                let when = when(3.0 + 4.0 * f64::from(question));
                let mut rhythms = Rhythms { knows_bounds };
                fastest(|| plan_routes(topology, from, to, when, &options, &mut rhythms, || false).unwrap(), 5)
            })
            .collect();
        row(name, nodes, answers);
    }
}

fn policies() {
    println!("\n{:32} {:>6} {:>10}", "policies", "nodes", "fastest");
    for (nodes, slots) in [(100, 96), (1_000, 96)] {
        let map = Map::random(Shape::Streets, nodes, false, 7);
        for objective in [PolicyObjective::Reach, PolicyObjective::Time] {
            let slot_secs = 86_400.0 / slots as f64;
            let options = PolicyOptions { objective, slot_secs, slots, ..PolicyOptions::default() };
            let mut rhythms = Rhythms { knows_bounds: false };
            let target = NodeId(nodes as u32 - 1);
            let solve = || solve_policy(&map.topology, target, &options, &mut rhythms, || false).unwrap();
            let (took, _) = fastest(solve, 5);
            println!("{:32} {nodes:6} {:>10}", format!("{objective:?}, {slots} slots"), format!("{took:.2?}"));
        }
    }
}

fn main() {
    println!(
        "{:32} {:>6} {:>10} {:>10} {:>8} {:>9} certainty",
        "routes", "nodes", "median", "slowest", "labels", "forecasts"
    );
    for nodes in [100, 1_000, 10_000] {
        let map = Map::random(Shape::Streets, nodes, false, 7);
        routes(&map.topology, nodes);
    }
    policies();
}
