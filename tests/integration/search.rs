//! Topological maps and searches from outside: a flat with a person in it, files of maps, and invalid requests.
//!
//! Invariant: the expected searches follow from the person's recorded places, never from the daemon's answers.

use std::{fmt::Write as _, fs};

use tidemap_tests::{
    cli::{self, Outcome, Table},
    daemon::{Daemon, Launch},
    oracle, recordings,
};

/// Midnight of the first day.
const START_SECS: i64 = 1_451_865_600;
const DAY_SECS: i64 = 86_400;
const HOUR_SECS: i64 = 3_600;
const STEP_SECS: i64 = 300;

fn tidemap<'a>(daemon: &Daemon, args: impl IntoIterator<Item = &'a str>) -> Outcome {
    cli::tidemap(daemon, args)
}

fn search(daemon: &Daemon, map: &str, start: &str, at_secs: i64, more: &[&str]) -> Outcome {
    let at = at_secs.to_string();
    let args = ["search", map, "--start", start, "--at", &at];
    tidemap(daemon, args.into_iter().chain(more.iter().copied()))
}

fn load(daemon: &Daemon, map: &str, text: &str, more: &[&str]) -> Outcome {
    let args = ["topology", "load", map, "-"];
    cli::tidemap_reading(daemon, args.into_iter().chain(more.iter().copied()), text)
}

/// A daemon with a map.
fn started() -> (tempfile::TempDir, Launch, Daemon) {
    let data = tempfile::tempdir().expect("a folder");
    let launch = Launch::on(data.path());
    let daemon = launch.start();
    tidemap(&daemon, ["map", "create", "flat"]).table();
    (data, launch, daemon)
}

/// Expected time of a walk's order with other probabilities.
fn expected_secs(walk: &Table, probabilities: &Table) -> f64 {
    let (nodes, likely) = (probabilities.column("node"), probabilities.numbers("probability"));
    let (mut cost, mut sum) = (0.0, 0.0);
    for (node, arrival_secs) in walk.column("node").into_iter().zip(walk.numbers("arrival_secs")) {
        let at = nodes.iter().position(|other| *other == node).expect("the same nodes");
        cost += likely[at].max(1e-6) * arrival_secs;
        sum += likely[at].max(1e-6);
    }
    cost / sum
}

#[test]
fn somebody_in_a_flat_is_searched_where_she_is_at_that_time() {
    let Some(folder) = recordings::folder("aruba") else { return };
    let read = |name: &str| fs::read_to_string(folder.join(name)).expect("a recording");
    let (topology, stays) = (read("topology.txt"), read("presence_8weeks.txt"));
    let (_data, launch, daemon) = started();
    let size = load(&daemon, "flat", &topology, &[]).table();
    assert_eq!((size.number("nodes"), size.number("edges")), (9.0, 18.0));
    let shown = tidemap(&daemon, ["topology", "show", "flat"]).table();
    let rooms: Vec<String> = shown.column("node").into_iter().map(str::to_owned).collect();

    let mut rows = "time,state,value\n".to_owned();
    for stay in stays.lines() {
        let words: Vec<&str> = stay.split_whitespace().collect();
        let (from, to, room) =
            (words[0].parse::<i64>().expect("a minute"), words[1].parse::<i64>().expect("a minute"), words[2]);
        for minute in (from..to.min(4 * 7 * 24 * 60)).filter(|minute| minute % (STEP_SECS / 60) == 0) {
            for state in &rooms {
                writeln!(rows, "{},{state},{}", START_SECS + minute * 60, u8::from(state == room)).expect("memory");
            }
        }
    }
    cli::tidemap_reading(&daemon, ["observe", "flat", "-", "--producer", "robot"], &rows).table();
    tidemap(&daemon, ["update", "flat"]).table();

    // The fifth week: asleep at three, up during the day.
    let monday = START_SECS + 28 * DAY_SECS;
    let night = search(&daemon, "flat", "Center", monday + 3 * HOUR_SECS, &[]);
    assert!(night.stderr.contains("no order is better"), "{}", night.stderr);
    let night = night.table();
    assert_eq!(night.rows.len(), 9);
    assert_eq!(night.column("node")[..2], ["Center", "Master_Bedroom"], "{night:?}");
    assert_eq!(night.numbers("arrival_secs")[..2], [0.0, 15.0]);
    let evening = search(&daemon, "flat", "Center", monday + 18 * HOUR_SECS, &[]).table();
    assert!(["Living_Room", "Kitchen"].contains(&evening.column("node")[1]), "{evening:?}");

    let mut gained = 0.0;
    for hour in [0, 3, 7, 9, 12, 15, 18, 21] {
        let at = monday + hour * HOUR_SECS;
        let found = search(&daemon, "flat", "Center", at, &["--model", "spectral"]).table();
        let fixed = search(&daemon, "flat", "Center", at, &["--model", "mean"]).table();
        let (found_secs, fixed_secs) = (found.numbers("expected_secs")[0], expected_secs(&fixed, &found));
        assert!(found_secs <= fixed_secs + 1e-9, "{hour}: {found_secs} {fixed_secs}");
        assert!((expected_secs(&found, &found) - found_secs).abs() < 1e-9);
        gained += fixed_secs - found_secs;
    }
    assert!(gained > 10.0, "a fixed order takes only {gained} s longer, all times together");

    let brief = search(&daemon, "flat", "Center", monday, &["--budget", "20s"]);
    assert!(brief.stderr.contains("does not fit into the budget"), "{}", brief.stderr);
    assert!(brief.table().numbers("arrival_secs").iter().all(|&secs| secs <= 20.0));
    let sure = search(&daemon, "flat", "Center", monday + 3 * HOUR_SECS, &["--remains-below", "0.5"]).table();
    assert_eq!(sure.column("node"), ["Center", "Master_Bedroom"]);
    let later = search(&daemon, "flat", "Center", monday, &["--for-arrival"]).table();
    assert_eq!(later.rows.len(), 9);
    let trained =
        search(&daemon, "flat", "Center", monday + 3 * HOUR_SECS, &["--model", "pergam:2", "--for-arrival"]).table();
    assert_eq!(trained.column("node")[1], "Master_Bedroom");

    daemon.kill();
    let daemon = launch.start();
    oracle::settle(&daemon);
    assert_eq!(tidemap(&daemon, ["topology", "show", "flat"]).table(), shown, "a kill leaves the map");
    assert_eq!(search(&daemon, "flat", "Center", monday + 3 * HOUR_SECS, &[]).table(), night);
}

#[test]
fn who_is_where_and_when_all_are_there_is_answered() {
    let (_data, _launch, daemon) = started();
    load(&daemon, "flat", FLAT, &[]).table();
    // A week: Anna sits in the office from 8 to 16 and in the kitchen else; the cup is in the kitchen from noon to
    // midnight.
    let mut rows = "time,state,value\n".to_owned();
    for hour in 0..168 {
        let (office, cup) = (u8::from((8..16).contains(&(hour % 24))), u8::from(hour % 24 >= 12));
        let time = START_SECS + hour * HOUR_SECS;
        for (state, value) in [
            ("node/office/anna", office),
            ("node/kitchen/anna", 1 - office),
            ("node/kitchen/cup", cup),
            ("node/office/cup", 0),
        ] {
            writeln!(rows, "{time},{state},{value}").expect("memory");
        }
    }
    cli::tidemap_reading(&daemon, ["observe", "flat", "-", "--producer", "robot"], &rows).table();
    tidemap(&daemon, ["update", "flat"]).table();
    let presence = |at: i64, more: &[&str]| {
        let at = at.to_string();
        let args = ["presence", "flat", "--at", &at, "--model", "histogram"];
        tidemap(&daemon, args.into_iter().chain(more.iter().copied()))
    };
    let monday = START_SECS + 7 * DAY_SECS;
    let morning = presence(monday + 10 * HOUR_SECS + 1_800, &["--object", "anna"]).table();
    assert_eq!(morning.column("node"), ["office", "kitchen"]);
    let (likely, shares) = (morning.numbers("probability"), morning.numbers("share"));
    assert!(likely[0] > 0.8 && likely[1] < 0.2, "{likely:?}");
    assert!((shares[0] - likely[0] / (likely[0] + likely[1])).abs() < 1e-5, "{shares:?}");
    let anybody = 1.0 - (1.0 - likely[0]) * (1.0 - likely[1]);
    assert!((morning.numbers("anybody")[0] - anybody).abs() < 1e-5);
    presence(monday, &["--object", "robot"]).fails(1, &["nothing was observed", "node/hall/robot"]);
    presence(monday, &["--object", "a/b"]).fails(1, &["\"a/b\""]);

    // Anna is in the kitchen with the cup from 16 to 24.
    let joint = |more: &[&str]| {
        let from = (monday + HOUR_SECS).to_string();
        let args = ["joint", "flat", "node/kitchen/anna", "node/kitchen/cup", "--model", "histogram", "--from", &from];
        tidemap(&daemon, args.into_iter().chain(more.iter().copied()))
    };
    let both = joint(&[]).table();
    assert_eq!(both.number("time"), (monday + 16 * HOUR_SECS) as f64);
    assert!(both.number("probability") > 0.5);
    assert!(joint(&["--within", "3h"]).table().rows.is_empty());
    joint(&["--threshold", "2"]).fails(1, &["threshold", "2"]);
    joint(&["--within", "9999d", "--step", "1s"]).fails(1, &["step", "at most 1000000"]);
    let unknown = ["joint", "flat", "node/kitchen/tea", "--from", "0"];
    tidemap(&daemon, unknown).fails(1, &["node/kitchen/tea"]);
}

#[test]
fn a_node_that_is_renamed_keeps_what_was_learned() {
    let (_data, launch, daemon) = started();
    load(&daemon, "flat", FLAT, &[]).table();
    let observe = |daemon: &Daemon, rows: &str, label: &str| {
        let args = ["observe", "flat", "-", "--producer", "robot", "--label", label];
        cli::tidemap_reading(daemon, args, rows).table();
    };
    let rows = seen(&[("node/hall", 0), ("kitchen", 1), ("node/kitchen/cup", 1), ("node/hall/cup", 0), ("pantry", 0)]);
    observe(&daemon, &rows, "seen");
    tidemap(&daemon, ["update", "flat"]).table();
    let before = search(&daemon, "flat", "office", START_SECS, &["--object", "cup"]).table();
    assert_eq!(before.column("node"), ["hall", "kitchen"]);
    let rename =
        |daemon: &Daemon, to: &str| tidemap(daemon, ["topology", "edit", "rename-node", "flat", "kitchen", to]);
    rename(&daemon, "pantry").fails(1, &["\"kitchen\"", "a state of that name", "another name"]);
    rename(&daemon, "scullery").table();
    let is_renamed = |daemon: &Daemon| {
        let after = search(daemon, "flat", "office", START_SECS, &["--object", "cup"]).table();
        assert_eq!(after.column("node"), ["hall", "scullery"]);
        assert_eq!(after.numbers("probability"), before.numbers("probability"));
        let at = START_SECS.to_string();
        let presence = |state: &str| tidemap(daemon, ["predict", "flat", state, "--at", &at]);
        assert!(presence("scullery").table().numbers("probability")[0] > 0.9);
        assert!(presence("node/scullery").table().numbers("probability")[0] > 0.9);
        presence("kitchen").fails(1, &["\"kitchen\""]);
    };
    is_renamed(&daemon);
    daemon.kill();
    let daemon = launch.start();
    oracle::settle(&daemon);
    is_renamed(&daemon);
    // The recording is unchanged, although the map has other names now.
    observe(&daemon, &rows, "seen");
    observe(&daemon, &seen(&[("scullery", 1)]), "later");
    is_renamed(&daemon);
}

const FLAT: &str = "node hall\nnode kitchen\nnode office\nlink hall kitchen 10\nlink hall office 30\n";

/// Rows that place a person, or an object of a kind, at one node.
fn seen(states: &[(&str, u8)]) -> String {
    let mut rows = "time,state,value\n".to_owned();
    for hour in 0..48 {
        for (state, value) in states {
            writeln!(rows, "{},{state},{value}", START_SECS + hour * HOUR_SECS).expect("memory");
        }
    }
    rows
}

#[test]
fn a_topological_map_is_edited_and_kept() {
    let (data, launch, daemon) = started();
    load(&daemon, "flat", FLAT, &[]).table();
    let edit =
        |daemon: &Daemon, args: &[&str]| tidemap(daemon, ["topology", "edit"].into_iter().chain(args.iter().copied()));
    edit(&daemon, &["rename-node", "flat", "kitchen", "scullery"]).table();
    edit(&daemon, &["add-node", "flat", "attic", "--position", "1,2", "--dwell", "5"]).table();
    let size = edit(&daemon, &["link", "flat", "attic", "hall", "40"]).table();
    assert_eq!((size.number("nodes"), size.number("edges")), (4.0, 6.0));
    edit(&daemon, &["set-link", "flat", "hall", "office", "--length", "7.5"]).table();
    edit(&daemon, &["unlink", "flat", "hall", "scullery", "--one-way"]).table();
    edit(&daemon, &["remove-node", "flat", "office"]).table();
    let nodes = tidemap(&daemon, ["topology", "show", "flat"]).table();
    assert_eq!((nodes.column("node"), nodes.column("id")), (vec!["hall", "scullery", "attic"], vec!["0", "1", "3"]));
    let edges = tidemap(&daemon, ["topology", "show", "flat", "--edges"]).table();
    assert_eq!(edges.column("from"), ["scullery", "attic", "hall"]);
    daemon.kill();
    let daemon = launch.start();
    assert_eq!(tidemap(&daemon, ["topology", "show", "flat"]).table(), nodes);
    assert_eq!(tidemap(&daemon, ["topology", "show", "flat", "--edges"]).table(), edges);
    // Loaded again, a name keeps its number; nodes that are not named are removed.
    load(&daemon, "flat", "node attic\nnode cellar\nlink attic cellar 3\n", &[]).table();
    let nodes = tidemap(&daemon, ["topology", "show", "flat"]).table();
    assert_eq!((nodes.column("node"), nodes.column("id")), (vec!["attic", "cellar"], vec!["3", "4"]));
    let size = load(&daemon, "flat", "node hall\nlink attic hall 2\n", &["--add"]).table();
    assert_eq!((size.number("nodes"), size.number("edges")), (3.0, 4.0));

    // A file as robots' own tools write it; a checkpoint keeps it, too.
    let yaml = data.path().join("flat.yaml");
    let node = |name: &str, to: &str, x: f64| {
        format!(
            "- meta: {{map: flat, node: {name}, pointset: flat}}\n  node:\n    name: {name}\n    edges:\n    - {{action: \
             move_base, edge_id: {name}_{to}, node: {to}}}\n    pose:\n      position: {{x: {x}, y: 0.0, z: 0.0}}\n      \
             orientation: {{w: 1.0, x: 0.0, y: 0.0, z: 0.0}}\n"
        )
    };
    fs::write(&yaml, node("hall", "kitchen", 1.0) + &node("kitchen", "hall", 4.0)).expect("a file");
    tidemap(&daemon, ["topology", "load", "flat", yaml.to_str().expect("text")]).table();
    let edges = tidemap(&daemon, ["topology", "show", "flat", "--edges"]).table();
    assert_eq!((edges.numbers("length_m"), edges.column("action")), (vec![3.0, 3.0], vec!["move_base"; 2]));
    let rows = seen(&[("hall", 0), ("kitchen", 1)]);
    cli::tidemap_reading(&daemon, ["observe", "flat", "-", "--producer", "robot"], &rows).table();
    tidemap(&daemon, ["update", "flat"]).table();
    let walk = search(&daemon, "flat", "hall", START_SECS, &[]).table();
    assert_eq!((walk.column("node"), walk.numbers("arrival_secs")), (vec!["hall", "kitchen"], vec![0.0, 6.0]));
    daemon.stop_in_order();
    let daemon = launch.start();
    assert_eq!(search(&daemon, "flat", "hall", START_SECS, &[]).table(), walk);
}

#[test]
fn what_is_searched_may_be_of_a_kind() {
    let (_data, _launch, daemon) = started();
    load(&daemon, "flat", FLAT, &[]).table();
    let rows = seen(&[("hall", 0), ("kitchen", 1), ("office", 0), ("node/kitchen/Anna", 0), ("node/office/Anna", 1)]);
    cli::tidemap_reading(&daemon, ["observe", "flat", "-", "--producer", "robot"], &rows).table();
    tidemap(&daemon, ["update", "flat"]).table();
    let anybody = search(&daemon, "flat", "hall", START_SECS, &[]).table();
    assert_eq!(anybody.column("node"), ["hall", "kitchen", "office"]);
    let anna = search(&daemon, "flat", "hall", START_SECS, &["--object", "Anna"]);
    assert!(anna.stderr.contains("never observed: hall"), "{}", anna.stderr);
    assert_eq!(anna.table().column("node"), ["office", "kitchen"]);
    search(&daemon, "flat", "hall", START_SECS, &["--object", "Bert"]).fails(1, &["node/hall/Bert"]);
    search(&daemon, "flat", "hall", START_SECS, &["--object", "a/b"]).fails(1, &["object", "'/'"]);
}

#[test]
fn what_cannot_be_is_refused_by_name() {
    let (_data, _launch, daemon) = started();
    search(&daemon, "flat", "hall", START_SECS, &[]).fails(1, &["no nodes", "topological map"]);
    load(&daemon, "flat", FLAT, &[]).table();
    let shown = tidemap(&daemon, ["topology", "show", "flat", "--edges"]).table();
    for (text, words) in [
        ("node a\nnode b\nlink a b -5\n", ["a/b", "-5 s"]),
        ("node a\nnode b\nlink a b 0\n", ["a/b", "0 s"]),
        ("node a\nnode b\nlink a b NaN\n", ["a/b", "NaN s"]),
        ("node a\nnode b\nlink a b soon\n", ["line 3", "\"soon\""]),
        ("node a\nlink a a 5\n", ["\"a\"", "leads to itself"]),
        ("node a\nnode a\n", ["\"a\"", "exists already"]),
        ("node a\nlink a c 5\n", ["no node", "\"c\""]),
        ("node a\nnode b\nlink a b 5\nlink b a 6\n", ["b/a", "exists already"]),
        ("node a/b\n", ["\"a/b\"", "'/'"]),
        ("knot a\n", ["line 1", "\"knot a\""]),
    ] {
        load(&daemon, "flat", text, &[]).fails(1, &words);
    }
    load(&daemon, "flat", "", &[]).fails(2, &["no nodes"]);
    load(&daemon, "attic", FLAT, &[]).fails(1, &["\"attic\" does not exist"]);
    load(&daemon, "flat", "node hall\n", &["--add"]).fails(1, &["\"hall\" exists already"]);
    let edit = |args: &[&str]| tidemap(&daemon, ["topology", "edit"].into_iter().chain(args.iter().copied()));
    edit(&["remove-node", "flat", "attic"]).fails(1, &["no node \"attic\""]);
    edit(&["rename-node", "flat", "hall", "office"]).fails(1, &["\"office\" exists already"]);
    edit(&["link", "flat", "kitchen", "office", "-3"]).fails(1, &["kitchen/office", "-3 s"]);
    edit(&["link", "flat", "kitchen", "kitchen", "3"]).fails(1, &["leads to itself"]);
    edit(&["unlink", "flat", "kitchen", "office"]).fails(1, &["no edge kitchen/office"]);
    edit(&["add-node", "flat", "far", "--position", "1e9,0"]).fails(1, &["\"far\"", "1000000000"]);
    edit(&["link", "flat", "kitchen", "office"]).fails(2, &["SECONDS"]);
    assert_eq!(tidemap(&daemon, ["topology", "show", "flat", "--edges"]).table(), shown, "nothing of it was taken");

    search(&daemon, "flat", "attic", START_SECS, &[]).fails(1, &["no node \"attic\"", "hall, kitchen, office"]);
    search(&daemon, "flat", "hall", START_SECS, &[]).fails(1, &["nothing was observed", "\"hall\""]);
    let observe = |rows: &str, label: &str| {
        let args = ["observe", "flat", "-", "--producer", "robot", "--label", label];
        cli::tidemap_reading(&daemon, args, rows).table();
        tidemap(&daemon, ["update", "flat"]).table();
    };
    observe(&seen(&[("hall", 0), ("kitchen", 0)]), "nobody");
    search(&daemon, "flat", "hall", START_SECS, &["--model", "mean"])
        .fails(1, &["cannot be found", "2 observed nodes"]);
    load(&daemon, "flat", "node island\n", &["--add"]).table();
    observe(&seen(&[("island", 1)]), "island");
    let left = search(&daemon, "flat", "hall", START_SECS, &["--model", "mean"]);
    assert!(left.stderr.contains("no way leads to: island") && left.stderr.contains("100.00 %"), "{}", left.stderr);
    assert_eq!(left.table().column("node"), ["hall", "kitchen"]);
    edit(&["add-node", "flat", "reef"]).table();
    search(&daemon, "flat", "reef", START_SECS, &[]).fails(1, &["\"reef\"", "no route"]);
    for (option, value) in
        [("--floor", "0"), ("--remains-below", "1.5"), ("--cost-per-second", "-1"), ("--speed", "-1")]
    {
        search(&daemon, "flat", "hall", START_SECS, &[option, value]).fails(1, &[value]);
    }
    search(&daemon, "flat", "hall", START_SECS, &["--plan-within", "61s"]).fails(1, &["plan_within", "61 s"]);
}

#[test]
fn a_hundred_thousand_nodes_are_kept_and_not_searched_exactly() {
    let (_data, launch, daemon) = started();
    let mut text = String::new();
    for node in 0..100_000 {
        writeln!(text, "node n{node}").expect("memory");
    }
    for node in 1..100_000 {
        writeln!(text, "link n{} n{node} 5", (node - 1) / 10).expect("memory");
    }
    let size = load(&daemon, "flat", &text, &[]).table();
    assert_eq!((size.number("nodes"), size.number("edges")), (100_000.0, 199_998.0));
    load(&daemon, "flat", "node more\n", &["--add"]).fails(1, &["100000 nodes"]);
    let states: Vec<(String, u8)> = (0..60).map(|node| (format!("n{}", node * 7), u8::from(node == 3))).collect();
    let states: Vec<(&str, u8)> = states.iter().map(|(state, value)| (state.as_str(), *value)).collect();
    cli::tidemap_reading(&daemon, ["observe", "flat", "-", "--producer", "robot"], &seen(&states)).table();
    tidemap(&daemon, ["update", "flat"]).table();
    search(&daemon, "flat", "n0", START_SECS, &["--effort", "exact"]).fails(1, &["60 places", "40"]);
    let good = search(&daemon, "flat", "n0", START_SECS, &[]);
    assert!(good.stderr.contains("99940 in all"), "{}", good.stderr);
    let good = good.table();
    assert_eq!(good.rows.len(), 60);
    let place = good.column("node").iter().position(|node| *node == "n21").expect("looked at");
    assert!(place < 6, "{place}");
    daemon.kill();
    let daemon = launch.start();
    let nodes = tidemap(&daemon, ["topology", "show", "flat"]).table();
    assert_eq!(nodes.rows.len(), 100_000);
}
