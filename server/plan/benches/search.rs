//! Times the search for the best order, and measures the quality of a heuristic order after a second.
//!
//! `cargo bench -p tidemap-plan --bench search`: complete requests, shortest times included, on random maps: for each
//! map the fastest of some repetitions, over the maps the median and the slowest, and the mean processor time of all
//! runs. `-- large [SECONDS]` instead: maps of 200 nodes, at most the given seconds of processor time (1), five seeds,
//! against the best known costs in `search/best.txt`. `-- long SECONDS RUNS [SEED OF THE MAP]` creates these costs
//! again: one line per run, the best of as many seeds as fit.
#![allow(clippy::unwrap_used)]

#[path = "../src/testkit.rs"]
#[allow(dead_code, reason = "the tests use more of it")]
mod testkit;

use std::time::{Duration, Instant};

use testkit::{Map, Shape};
use tidemap_plan::search::{Effort, Goal, SearchOptions, SearchPlan, search};

/// Maps of 200 nodes: shape and seed.
const LARGE: [(Shape, u64); 6] = [
    (Shape::Complete, 1),
    (Shape::Complete, 2),
    (Shape::Streets, 3),
    (Shape::Streets, 4),
    (Shape::Tree, 5),
    (Shape::Random, 6),
];

fn goals(map: &Map) -> Vec<Goal> {
    map.goals.iter().map(|&(node, probability)| Goal { node, probability }).collect()
}

/// Processor time of this thread, independent of the load; a few milliseconds late.
fn processor_time() -> Duration {
    let text = std::fs::read_to_string("/proc/thread-self/schedstat").unwrap_or_default();
    Duration::from_nanos(text.split(' ').next().and_then(|nanos| nanos.parse().ok()).unwrap_or(0))
}

/// The fastest of some repetitions, within a time limit.
fn fastest(mut run: impl FnMut() -> SearchPlan, repetitions: usize) -> (Duration, SearchPlan) {
    let mut best: Option<(Duration, SearchPlan)> = None;
    let begun = Instant::now();
    for _ in 0..repetitions {
        let start = Instant::now();
        let plan = run();
        let took = start.elapsed();
        if best.as_ref().is_none_or(|(least, _)| took < *least) {
            best = Some((took, plan));
        }
        if begun.elapsed() > Duration::from_secs(2) {
            break;
        }
    }
    best.expect("at least one repetition")
}

fn exact() {
    println!(
        "{:10} {:>5} {:>12} {:>12} {:>12} {:>9} {:>10} proven",
        "shape", "nodes", "median", "slowest", "mean CPU", "states", "most"
    );
    for (count, maps, repetitions) in [(11, 41, 200), (20, 41, 25), (25, 21, 5), (30, 11, 1)] {
        for shape in [Shape::Tree, Shape::Streets, Shape::Complete] {
            let mut times = Vec::new();
            let mut states = Vec::new();
            let (mut proven, mut runs) = (0, 0);
            let begun = processor_time();
            for seed in 0..maps {
                let map = Map::random(shape, count, false, 1_000 * count as u64 + seed);
                let (roads, goals) = (map.roads(), goals(&map));
                let options = SearchOptions::default();
                let plan = || {
                    runs += 1;
                    search(&roads, map.start(), &goals, &options, || false).unwrap()
                };
                let (took, plan) = fastest(plan, repetitions);
                times.push(took);
                states.push(plan.states);
                proven += usize::from(plan.optimal);
            }
            let mean = (processor_time() - begun) / runs;
            times.sort();
            states.sort();
            println!(
                "{:10} {count:5} {:>12} {:>12} {:>12} {:9} {:10} {proven} of {maps}",
                format!("{shape:?}"),
                format!("{:.3?}", times[times.len() / 2]),
                format!("{:.3?}", times[times.len() - 1]),
                format!("{mean:.3?}"),
                states[states.len() / 2],
                states[states.len() - 1],
            );
        }
    }
}

fn heuristic(map: &Map, seed: u64, budget: Duration) -> SearchPlan {
    let options = SearchOptions { effort: Effort::Heuristic, seed, ..SearchOptions::default() };
    let (start, mut calls) = (processor_time(), 0_u64);
    let until = || {
        calls += 1;
        calls.is_multiple_of(32) && processor_time() - start >= budget
    };
    search(&map.roads(), map.start(), &goals(map), &options, until).unwrap()
}

/// Lines `shape seed expected_secs`.
fn best_known(shape: Shape, seed: u64) -> Option<f64> {
    let wanted = format!("{shape:?} {seed} ");
    include_str!("search/best.txt").lines().find_map(|line| line.strip_prefix(&wanted)?.trim().parse().ok())
}

fn large(secs: u64) {
    for (shape, seed) in LARGE {
        let map = Map::random(shape, 200, false, seed);
        let mut found: Vec<f64> =
            (0..5).map(|run| heuristic(&map, 100 + run, Duration::from_secs(secs)).expected_secs).collect();
        found.sort_by(f64::total_cmp);
        let best = best_known(shape, seed).unwrap_or(f64::NAN);
        let over = |secs: f64| 100.0 * (secs / best - 1.0);
        println!(
            "{shape:?} {seed}: best known {best:.4}; after {secs} s, of 5 seeds: best {:+.2} %, median {:+.2} %, worst {:+.2} %",
            over(found[0]),
            over(found[2]),
            over(found[4])
        );
    }
}

fn long(secs: u64, runs: u64, only: u64) {
    for (shape, seed) in LARGE.into_iter().filter(|&(_, seed)| only == 0 || seed == only) {
        let map = Map::random(shape, 200, false, seed);
        for run in 0..runs {
            let (start, budget) = (processor_time(), Duration::from_secs(secs));
            let mut found = f64::INFINITY;
            for seed in (run << 32).. {
                let Some(left) = budget.checked_sub(processor_time() - start) else { break };
                found = found.min(heuristic(&map, seed, left).expected_secs);
            }
            println!("{shape:?} {seed} {found} in {secs} s, run {run}");
        }
    }
}

fn main() {
    let arguments: Vec<String> = std::env::args().skip(1).filter(|argument| argument != "--bench").collect();
    let number = |at: usize, or: u64| arguments.get(at).and_then(|number| number.parse().ok()).unwrap_or(or);
    match arguments.first().map(String::as_str) {
        Some("large") => large(number(1, 1)),
        Some("long") => long(number(1, 600), number(2, 10), number(3, 0)),
        _ => exact(),
    }
}
