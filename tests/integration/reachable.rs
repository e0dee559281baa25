//! The nodes that a robot reaches from a node, against all ways that there are.
//!
//! Invariant: the expected list follows from the edges as `topology predict` lists them, by trying every way.

use std::{collections::BTreeMap, fmt::Write as _};

use tidemap_tests::{
    cli::{Table, tidemap, tidemap_reading},
    daemon::Launch,
};

/// 2025-03-03, a Monday, in UTC.
const START_SECS: i64 = 1_740_960_000;
const AT: &str = "2025-03-10T12:00:00Z";
const RECOVERY_SECS: f64 = 60.0;
/// Edges both ways with their seconds, and of ten attempts how many fail.
const LINKS: [(&str, &str, i64, i64); 7] = [
    ("Dock", "Lab", 24, 1),
    ("Lab", "Store", 24, 0),
    ("Lobby", "Office", 24, 3),
    ("Office", "Kitchen", 24, 0),
    ("Dock", "Lobby", 30, 2),
    ("Store", "Kitchen", 30, 5),
    ("Lab", "Office", 20, 8),
];

fn topology() -> String {
    let mut text = "node Shed\nedge Shed Dock 40\n".to_owned();
    for node in LINKS.iter().flat_map(|(from, to, ..)| [from, to]) {
        let line = format!("node {node}\n");
        if !text.contains(&line) {
            text.push_str(&line);
        }
    }
    LINKS.iter().fold(text, |text, (from, to, secs, _)| format!("{text}link {from} {to} {secs}\n"))
}

fn traversals() -> String {
    let mut rows = "from,to,start,end,success,reason\n".to_owned();
    for hour in 0..150 {
        for (minute, (from, to, secs, failing)) in (0..).zip(LINKS) {
            let start = START_SECS + hour * 3600 + minute * 60;
            let is_passed = (hour * 7 + minute) % 10 >= failing;
            for (from, to, start) in [(from, to, start), (to, from, start + 1800)] {
                let _ = writeln!(rows, "{from},{to},{start},{},{is_passed},", start + secs);
            }
        }
    }
    rows
}

/// The best way to each node from one, by all ways without a node twice: success, expected seconds, edges.
fn best_ways(edges: &Table, from: &str) -> BTreeMap<String, (f64, f64, usize)> {
    fn go(
        edges: &[(&str, &str, f64, f64)],
        passed: &mut Vec<String>,
        so_far: (f64, f64),
        best: &mut BTreeMap<String, (f64, f64, usize)>,
    ) {
        let here = passed.last().expect("a node").clone();
        let known = best.entry(here.clone()).or_insert((0.0, f64::INFINITY, 0));
        if so_far.0 > known.0 {
            *known = (so_far.0, so_far.1, passed.len() - 1);
        }
        for (from, to, success, secs) in edges {
            if *from == here && !passed.iter().any(|node| node == to) {
                passed.push((*to).to_owned());
                // Each failed attempt takes its own time and the recovery, and there are (1 - p) / p of them.
                let expected = secs + (1.0 - success) / success * (secs + RECOVERY_SECS);
                go(edges, passed, (so_far.0 * success, so_far.1 + expected), best);
                passed.pop();
            }
        }
    }
    let (probability, secs) = (edges.numbers("probability"), edges.numbers("duration_secs"));
    let ends = edges.column("from").into_iter().zip(edges.column("to"));
    let numbers = probability.into_iter().zip(secs);
    let edges: Vec<_> = ends.zip(numbers).map(|((from, to), (success, secs))| (from, to, success, secs)).collect();
    let mut best = BTreeMap::new();
    go(&edges, &mut vec![from.to_owned()], (1.0, 0.0), &mut best);
    best
}

#[test]
fn the_best_way_to_each_node_is_listed_the_most_certain_first() {
    let data = tempfile::tempdir().expect("a folder");
    let daemon = Launch::on(data.path()).start();
    tidemap(&daemon, ["map", "create", "flat", "--time-zone", "UTC", "--clock", "simulated"]).table();
    tidemap_reading(&daemon, ["topology", "load", "flat", "-"], &topology()).table();
    tidemap_reading(&daemon, ["traverse", "flat", "-", "--producer", "robot"], &traversals()).table();
    tidemap(&daemon, ["update", "flat"]).table();

    // A model that is the same at all times, so that an edge is as good when the robot gets there.
    let edges = tidemap(&daemon, ["topology", "predict", "flat", "--at", AT, "--model", "mean"]).table();
    let expected = best_ways(&edges, "Lab");
    let reached = tidemap(&daemon, ["topology", "reachable", "flat", "Lab", "--at", AT, "--model", "mean"]).table();
    let (names, probability) = (reached.column("node"), reached.numbers("probability"));
    assert_eq!(names.len(), 7, "{reached:?}");
    assert_eq!((names[0], probability[0]), ("Lab", 1.0), "{reached:?}");
    assert!(probability.is_sorted_by(|one, other| one >= other), "{reached:?}");
    // The shed has an edge out of it, and none into it.
    assert_eq!(reached.rows[6], ["Shed", "0", "", "", "", "0"]);
    let (seconds, counts) = (reached.column("expected_secs"), reached.numbers("edges"));
    for index in 0..6 {
        let (success, secs, count) = expected[names[index]];
        let found: f64 = seconds[index].parse().expect("a number");
        assert!((probability[index] - success).abs() < 1e-6, "{}: {success} of {reached:?}", names[index]);
        assert!((found - secs).abs() < 1e-3 * secs.max(1.0), "{}: {secs} s of {reached:?}", names[index]);
        assert_eq!(counts[index], count as f64, "{}: {reached:?}", names[index]);
    }
    // The door between Lab and Office fails so often that the way around it is safer.
    assert!(expected["Office"].2 > 1, "{expected:?}");

    let named = ["topology", "reachable", "flat", "Shed", "Lab", "Office", "Lab", "--at", AT, "--model", "mean"];
    let named = tidemap(&daemon, named).table();
    let mut names = named.column("node");
    names.sort_unstable();
    assert_eq!(names, ["Lab", "Office"], "each once");
}

#[test]
fn unknown_nodes_and_too_many_are_refused() {
    let data = tempfile::tempdir().expect("a folder");
    let daemon = Launch::on(data.path()).start();
    tidemap(&daemon, ["map", "create", "flat"]).table();
    tidemap(&daemon, ["topology", "reachable", "flat", "Lab", "--at", AT]).fails(1, &["has no nodes"]);
    let nodes = (0..201).fold(String::new(), |text, node| format!("{text}node n{node}\n"));
    tidemap_reading(&daemon, ["topology", "load", "flat", "-"], &nodes).table();
    tidemap(&daemon, ["topology", "reachable", "flat", "n0", "--at", AT]).fails(2, &["201", "200"]);
    tidemap(&daemon, ["topology", "reachable", "flat", "Lab", "n1", "--at", AT]).fails(1, &["Lab"]);
    let far = tidemap(&daemon, ["topology", "reachable", "flat", "n0", "n1", "--at", AT]).table();
    assert_eq!(far.numbers("probability"), [0.0]);
}
