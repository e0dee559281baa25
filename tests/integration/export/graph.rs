//! Graphs for Nav2's route server.
//!
//! Invariant: files are read as the loader of the route server reads them: it takes `id`, `startid`, `endid`, `cost`
//! and `overridable` of the properties, and refuses an edge whose nodes are missing.

use std::{
    collections::{BTreeMap, BTreeSet},
    fs,
    path::Path,
};

use serde_json::Value;
use tidemap_tests::cli::tidemap;

use super::{Home, MAP, NOON};

const RECOVERY_SECS: f64 = 60.0;

/// A graph: numbers of nodes by name, and of each edge by name its number, its ends, and its cost.
#[derive(Debug, PartialEq)]
struct Graph {
    nodes: BTreeMap<String, u16>,
    edges: BTreeMap<String, (u16, u16, u16, f64)>,
}

fn load(path: &Path) -> Graph {
    let file: Value = serde_json::from_str(&fs::read_to_string(path).expect("the file")).expect("JSON");
    let mut graph = Graph { nodes: BTreeMap::new(), edges: BTreeMap::new() };
    let mut numbers = BTreeSet::new();
    for feature in file["features"].as_array().expect("features") {
        let properties = &feature["properties"];
        let number = |name: &str| {
            let number = properties[name].as_u64().unwrap_or_else(|| panic!("{name}: {feature}"));
            u16::try_from(number).expect("a number that a goal of the route server can name")
        };
        let name = properties["metadata"]["name"].as_str().expect("a name").to_owned();
        assert!(numbers.insert(number("id")), "{feature}: twice");
        match feature["geometry"]["type"].as_str() {
            Some("Point") => assert!(graph.nodes.insert(name, number("id")).is_none()),
            Some("MultiLineString") => {
                let ends = (number("startid"), number("endid"));
                assert!([ends.0, ends.1].iter().all(|end| graph.nodes.values().any(|node| node == end)), "{feature}");
                assert_eq!(properties["overridable"], false, "else the cost does not count");
                let cost = properties["cost"].as_f64().expect("a cost");
                graph.edges.insert(name, (number("id"), ends.0, ends.1, cost));
            }
            other => panic!("{other:?}"),
        }
    }
    graph
}

#[test]
fn a_graph_has_the_expected_seconds_of_each_edge_at_its_time() {
    let home = Home::new();
    let forecast = |at: &str| {
        let table = home.run(&["topology", "predict", MAP, "--at", at]).table();
        let ends = table.column("from").into_iter().zip(table.column("to"));
        let names: Vec<String> = ends.map(|(from, to)| format!("{from}/{to}")).collect();
        let numbers = table.numbers("probability").into_iter().zip(table.numbers("duration_secs"));
        let expected = numbers.map(|(success, secs)| secs + (1.0 - success) / success * (secs + RECOVERY_SECS));
        names.into_iter().zip(expected).collect::<BTreeMap<_, _>>()
    };
    let (path, counts) = home.export("noon.geojson", &["--at", NOON]);
    let noon = load(&path);
    // The attic has no position.
    assert_eq!((noon.nodes.len(), noon.edges.len()), (3, 6));
    assert_eq!(counts, BTreeMap::from([("edges".to_owned(), 6.0), ("nodes".to_owned(), 3.0)]));
    let night_at = "2025-01-28T02:00:00Z";
    let night = load(&home.export("night.geojson", &["--at", night_at]).0);
    for (at, graph) in [(NOON, &noon), (night_at, &night)] {
        let forecast = forecast(at);
        for (name, (_, _, _, cost)) in &graph.edges {
            assert!((cost / forecast[name] - 1.0).abs() < 1e-9, "{name} at {at}: {cost} for {}", forecast[name]);
        }
    }
    // The way from Lab to Shop is closed at night.
    assert!(night.edges["Lab/Shop"].3 > 10.0 * noon.edges["Lab/Shop"].3, "{noon:?} {night:?}");
    let outcome = tidemap(&home.daemon, ["export", MAP, &home.text("noon.geojson"), "--at", NOON]);
    assert!(outcome.stderr.contains("1 nodes without a position"), "{}", outcome.stderr);
}

#[test]
fn numbers_stay_when_the_topological_map_changes() {
    let home = Home::new();
    let before = load(&home.export("graph.geojson", &["--at", NOON]).0);
    home.run(&["topology", "edit", "add-node", MAP, "Aaa", "--position", "-1,-1"]);
    home.run(&["topology", "edit", "link", MAP, "Aaa", "Hall", "12"]);
    home.run(&["topology", "edit", "remove-node", MAP, "Lab"]);
    home.run(&["topology", "edit", "rename-node", MAP, "Shop", "Store"]);
    home.run(&["topology", "edit", "set-node", MAP, "Attic", "--position", "-1,2"]);
    home.run(&["no-go", "add", MAP, "pit", "-0.6,-0.6:-0.4,-0.6:-0.4,-0.4:-0.6,-0.4"]);
    let after = load(&home.export("graph.geojson", &["--at", NOON]).0);
    assert_eq!(after.nodes["Hall"], before.nodes["Hall"]);
    assert_eq!(after.nodes["Store"], before.nodes["Shop"]);
    assert_eq!(after.edges["Store/Hall"].0, before.edges["Shop/Hall"].0);
    let old: BTreeSet<u16> = before.nodes.values().copied().chain(before.edges.values().map(|edge| edge.0)).collect();
    assert!(!old.contains(&after.nodes["Aaa"]) && !old.contains(&after.edges["Attic/Hall"].0));
    // The pit lies between Hall and Aaa.
    let edges: Vec<&str> = after.edges.keys().map(String::as_str).collect();
    assert_eq!(edges, ["Attic/Hall", "Hall/Attic", "Hall/Store", "Store/Hall"]);
}
