//! The cells that were occupied and that a written map leaves out, and the comparison of a map with one of a ROS map
//! server.
//!
//! Invariant: what is expected follows from the points of the scans: four that are always there, a fifth by day, and a
//! nearer one by night.

use std::fs;

use serde_json::Value;
use tidemap_tests::cli::tidemap;

use super::{Home, MAP, NOON};

const NIGHT: &str = "2025-01-28T02:00:00Z";

fn json(home: &Home, words: &[&str]) -> Value {
    let rows: Value = serde_json::from_str(&home.run(&[&["--output", "json"], words].concat()).stdout).expect("JSON");
    rows[0].clone()
}

fn numbers(row: &Value, names: &[&str]) -> Vec<u64> {
    names.iter().map(|name| row[name].as_u64().unwrap_or_else(|| panic!("{name} in {row}"))).collect()
}

const ENDS: [&str; 3] = ["ever_occupied", "ever_occupied_free", "ever_occupied_unknown"];

#[test]
fn an_export_states_which_cells_it_leaves_out() {
    let home = Home::new();
    let path = home.text("map.yaml");
    // By day the nearer point is free; by night it hides the farther one, which was never seen to be free.
    for (time, free) in [(NOON, 1), (NIGHT, 0)] {
        let row = json(&home, &["export", MAP, &path, "--at", time]);
        assert_eq!(numbers(&row, &ENDS), [6, free, 0], "{time}: {row}");
        assert_eq!((row["free_up_to"].as_f64(), row["occupied_from"].as_f64()), (Some(0.25), Some(0.65)));
    }
    let shown = home.run(&["--output", "table", "export", MAP, &path, "--at", NOON]).stderr;
    let line = "6 cells were occupied at some time: 1 (17 %) of them are free in ";
    assert!(shown.contains(line) && shown.contains("map.pgm, with a probability up to 0.25"), "{shown}");

    let row = json(&home, &["export", MAP, &path, "--at", NOON, "--mask", "keepout", "--occupied", "0.4"]);
    assert_eq!((numbers(&row, &ENDS), row["occupied_from"].as_f64()), (vec![6, 1, 0], Some(0.4)));
    let row = json(&home, &["export", MAP, &path, "--at", NOON, "--mask", "speed"]);
    assert_eq!(row["ever_occupied"], Value::Null);

    let pgm = home.text("predicted.pgm");
    let row = json(&home, &["grid", "predict", MAP, "--at", NOON, "--out", &pgm]);
    assert_eq!(numbers(&row, &ENDS), [6, 1, 0]);
    let shown = home.run(&["--output", "table", "grid", "predict", MAP, "--at", NOON, "--out", &pgm]).stderr;
    assert!(shown.contains(line) && shown.contains("predicted.pgm"), "{shown}");
    let row = json(&home, &["grid", "predict", MAP, "--at", NOON, "--out", &pgm, "--pgm-mode", "raw"]);
    assert_eq!(row["ever_occupied"], Value::Null, "a file of probabilities leaves nothing out");
}

const AGREE: [&str; 6] =
    ["file_occupied", "file_found", "map_occupied", "map_found", "file_free_map_occupied", "map_free_file_occupied"];

#[test]
fn a_map_is_compared_with_one_of_a_map_server() {
    let home = Home::new();
    let (yaml, _) = home.export("ros.yaml", &["--at", NOON]);
    let path = home.text("ros.yaml");
    let compared = |words: &[&str]| json(&home, &[&["grid", "compare", MAP, &path], words].concat());
    let same = compared(&["--at", NOON]);
    assert_eq!(numbers(&same, &AGREE), [5, 5, 5, 5, 0, 0], "{same}");
    assert_eq!(numbers(&same, &["unknown_in_map", "unknown_in_file"]), [0, 0]);
    assert_eq!(same["within"].as_f64(), Some(0.5));
    let night = compared(&["--at", NIGHT]);
    assert_eq!(numbers(&night, &AGREE), [5, 5, 6, 5, 1, 0], "{night}");
    let shown = home.run(&["--output", "table", "grid", "compare", MAP, &path, "--at", NIGHT]).stdout;
    let sentence = "Of 5 occupied cells of ros.yaml, 5 (100 %) are occupied in home, within a cell (0.5 m); of 6 occupied \
                    cells of home, 5 (83 %) are occupied in ros.yaml.";
    assert!(shown.starts_with(sentence), "{shown}");

    // One cell beside its place the map still agrees, two cells beside it not.
    let settings = fs::read_to_string(&yaml).expect("the file");
    let line = settings.lines().find(|line| line.starts_with("origin:")).expect("the origin");
    let x: f64 = line["origin: [".len()..].split(',').next().and_then(|word| word.parse().ok()).expect("a number");
    let at = |origin: String| fs::write(&yaml, settings.replace(line, &format!("origin: {origin}"))).expect("written");
    let y = line.split(',').nth(1).expect("a number").trim();
    for (off, found) in [(0.5, 5), (1.0, 0)] {
        at(format!("[{}, {y}, 0.0]", x + off));
        let beside = compared(&["--at", NOON]);
        assert_eq!(numbers(&beside, &AGREE[..4]), [5, found, 5, found], "{off}: {beside}");
    }

    let fails = |words: &[&str], code, parts: &[&str]| {
        tidemap(&home.daemon, [&["grid", "compare", MAP], words].concat()).fails(code, parts);
    };
    fails(&[&path, "--frame", "odom"], 1, &["ros.yaml is in frame \"odom\"", "in frame \"map\""]);
    at("[500, 0, 0]".to_owned());
    fails(&[&path], 1, &["ros.yaml", "do not overlap", "the file covers x 500.00 to"]);
    at("[0, 0, 1.57]".to_owned());
    fails(&[&path], 1, &["ros.yaml", "yaw of origin is 1.57", "rotated grids are not supported"]);
    fails(&[&home.text("none.yaml")], 1, &["none.yaml", "No such file"]);
    fails(&[&home.text("ros.png")], 2, &["ros.png", ".yaml"]);
    fs::remove_file(home.path("ros.pgm")).expect("it is there");
    at("[0, 0, 0]".to_owned());
    fails(&[&path], 1, &["ros.pgm", "No such file"]);
}

#[test]
fn a_map_that_is_not_learned_is_not_compared() {
    let home = Home::new();
    home.export("ros.yaml", &["--at", NOON]);
    home.run(&["map", "create", "new", "--grid", "resolution=0.5,origin=-4:-4:0,flat"]);
    let path = home.text("ros.yaml");
    home.run(&["grid", "observe", "new", &path, "--at", NOON, "--producer", "r"]);
    let compare = ["grid", "compare", "new", &path];
    tidemap(&home.daemon, compare).fails(1, &["no update has learned anything of map \"new\"", "tidemap update new"]);
    let latest = json(&home, &[&compare[..], &["--model", "latest"]].concat());
    assert_eq!(numbers(&latest, &AGREE), [5, 5, 5, 5, 0, 0], "{latest}");
}
