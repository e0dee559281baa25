//! Recordings of robots become maps, by the real command and daemon.
//!
//! Invariant: the expected data follows from how a recording was written, or from an independent program that has read
//! it, never from the daemon's answers.

mod learned;
mod mappings;
mod real;

use std::{f64::consts::TAU, path::PathBuf};

use tempfile::TempDir;
use tidemap_tests::{
    bag::Bag,
    cli::{self, Outcome, Table},
    daemon::{Daemon, Launch},
};

/// A Monday, UTC.
const START_NANOS: i64 = 1_736_121_600 * SECOND_NANOS;
const SECOND_NANOS: i64 = 1_000_000_000;

fn words(daemon: &Daemon, line: &str) -> Outcome {
    cli::tidemap(daemon, line.split(' '))
}

/// The counts of a topic: accepted, skipped, refused.
#[track_caller]
fn counts(table: &Table, topic: &str) -> [u64; 3] {
    let row = table.column("topic").iter().position(|name| *name == topic).expect("the topic");
    ["accepted", "skipped", "refused"].map(|name| table.column(name)[row].parse().expect("a count"))
}

/// A robot drives along the middle of a room of 6 x 4 metres whose corner is at the origin, and scans all around.
fn drive(scans: i64) -> Bag {
    let mut bag = Bag::default();
    bag.transform("/tf_static", START_NANOS, ("base", "laser"), [0.2, 0.0, 0.0]);
    for step in 0..scans {
        let time = START_NANOS + step * SECOND_NANOS;
        let x = 1.0 + step as f64 * 3.0 / scans as f64;
        bag.transform("/tf", time, ("odom", "base"), [x, 2.0, 0.0]);
        let ranges: Vec<f32> = (0..360).map(|ray| range([x + 0.2, 2.0], TAU * f64::from(ray) / 360.0) as f32).collect();
        bag.scan("/scan", time, "laser", &ranges);
        bag.bool("/kitchen/door", time, step % 2 == 0);
        bag.text("/rosout", time, "nothing");
    }
    bag
}

/// The range to the walls of the room.
fn range([x, y]: [f64; 2], angle: f64) -> f64 {
    let along = |at: f64, direction: f64, size: f64| {
        if direction > 1e-9 {
            (size - at) / direction
        } else if direction < -1e-9 {
            -at / direction
        } else {
            f64::MAX
        }
    };
    along(x, angle.cos(), 6.0).min(along(y, angle.sin(), 4.0))
}

fn started() -> (TempDir, Daemon) {
    let data = tempfile::tempdir().expect("a folder");
    let daemon = Launch::on(data.path()).start();
    (data, daemon)
}

fn written(folder: &TempDir, name: &str, bag: &Bag, bytes: usize) -> PathBuf {
    let path = folder.path().join(name);
    bag.write(&path, bytes);
    path
}

#[test]
fn a_recording_becomes_a_map_in_one_command_and_is_learned_once() {
    let (folder, daemon) = started();
    let file = written(&folder, "drive.bag", &drive(30), usize::MAX);
    let line = format!("import room {} --producer robot-1", file.display());
    let first = words(&daemon, &line);
    let table = first.table();
    assert_eq!(table.column("becomes"), ["frames", "frames", "scans", "state kitchen-door", "nothing"]);
    assert_eq!(counts(&table, "/scan"), [30, 0, 0]);
    assert_eq!(counts(&table, "/kitchen/door"), [30, 0, 0]);
    assert!(first.stderr.contains("frame \"odom\"") && first.stderr.contains("flat grid of 0.1 m"), "{}", first.stderr);
    let shown = words(&daemon, "map show room").table();
    assert_eq!((shown.number("scans"), shown.number("observations")), (30.0, 30.0));
    let occupied = walls(&daemon);
    let again = words(&daemon, &line);
    assert_eq!(counts(&again.table(), "/scan"), [0, 0, 0]);
    assert!(again.stderr.contains("sent 60 observations"), "{}", again.stderr);
    assert_eq!(words(&daemon, "map show room").table().number("scans"), 30.0);
    assert_eq!(walls(&daemon), occupied);
}

/// Checks that the walls of the room are occupied and its middle is free; returns the number of occupied cells.
fn walls(daemon: &Daemon) -> usize {
    words(daemon, "update room").table();
    let out = tempfile::tempdir().expect("a folder");
    let file = out.path().join("cells.csv");
    words(daemon, &format!("grid predict room --at 2025-01-06T00:00:10Z --out {}", file.display())).table();
    let cells = Table::parse(&std::fs::read_to_string(&file).expect("cells"));
    let (x, y, p) = (cells.numbers("x"), cells.numbers("y"), cells.numbers("probability"));
    let mut occupied = 0;
    for ((x, y), p) in x.into_iter().zip(y).zip(p) {
        let wall = x.min(6.0 - x).min(y).min(4.0 - y).abs();
        if p > 0.5 {
            occupied += 1;
            assert!(wall < 0.11, "{x}, {y} is occupied and no wall");
        } else {
            assert!(wall > -0.11, "{x}, {y} is free and outside of the room");
        }
    }
    assert!(occupied > 150, "{occupied} cells of walls of 20 m");
    occupied
}

#[test]
fn an_import_that_was_cut_short_goes_on_where_it_stopped() {
    let (folder, daemon) = started();
    let bag = drive(40);
    let part = written(&folder, "part.bag", &bag, bag.len() / 2);
    let line = |file: &PathBuf| format!("import room {} --producer robot-1 --label monday", file.display());
    let cut = words(&daemon, &line(&part));
    let cut_table = cut.table();
    assert!(cut.stderr.contains("part.bag: ") && cut.stderr.contains("the part before is taken"), "{}", cut.stderr);
    let [scans, ..] = counts(&cut_table, "/scan");
    assert!((10..40).contains(&scans), "{scans}");
    let whole = written(&folder, "whole.bag", &bag, usize::MAX);
    let table = words(&daemon, &line(&whole)).table();
    assert_eq!(counts(&table, "/scan"), [40 - scans, 0, 0]);
    assert_eq!(words(&daemon, "map show room").table().number("scans"), 40.0);
    let other = written(&folder, "other.bag", &drive(41), usize::MAX);
    let refused = words(&daemon, &line(&other));
    refused.fails(1, &["other.bag differs from the data that robot-1 sent as monday", "--label monday-2"]);
    assert_eq!(words(&daemon, "map show room").table().number("scans"), 40.0);
}

#[test]
fn scans_without_a_place_are_counted_and_named() {
    let (folder, daemon) = started();
    let mut bag = Bag::default();
    for step in 0..10 {
        let time = START_NANOS + step * SECOND_NANOS;
        bag.scan("/scan", time, "laser", &[1.0; 90]);
    }
    let file = written(&folder, "bare.bag", &bag, usize::MAX);
    let line = format!("import still {} --producer robot-1", file.display());
    words(&daemon, &line).fails(1, &["the position of \"laser\" of /scan", "--frame laser"]);
    words(&daemon, "map show still").fails(1, &["still"]);
    let placed = words(&daemon, &format!("{line} --frame laser"));
    assert_eq!(counts(&placed.table(), "/scan"), [10, 0, 0]);
    bag.transform("/tf", START_NANOS + 2 * SECOND_NANOS, ("odom", "laser"), [0.0; 3]);
    bag.transform("/tf", START_NANOS + 7 * SECOND_NANOS, ("odom", "laser"), [0.0; 3]);
    let file = written(&folder, "moving.bag", &bag, usize::MAX);
    let moving = words(&daemon, &format!("import moving {} --producer robot-1", file.display()));
    assert_eq!(counts(&moving.table(), "/scan"), [6, 4, 0]);
    for why in ["before the first transform from \"odom\" to \"laser\"", "after the last transform"] {
        assert!(moving.stderr.contains(why), "{}", moving.stderr);
    }
}

#[test]
fn one_scan_in_each_period_is_taken_if_that_is_requested() {
    let (folder, daemon) = started();
    let file = written(&folder, "drive.bag", &drive(30), usize::MAX);
    let thinned = words(&daemon, &format!("import room {} --producer robot-1 --period 10s", file.display()));
    assert_eq!(counts(&thinned.table(), "/scan"), [3, 27, 0]);
    assert_eq!(counts(&thinned.table(), "/kitchen/door"), [30, 0, 0], "states are taken all");
}

#[test]
fn what_cannot_be_imported_is_an_error_with_advice() {
    let (folder, daemon) = started();
    let file = |name: &str, bytes: &[u8]| {
        let path = folder.path().join(name);
        std::fs::write(&path, bytes).expect("a file");
        path.display().to_string()
    };
    let old = file("old.bag", b"#ROSRECORD V1.2\n");
    let table = file("rows.csv", b"time,state,value\n1,door,1\n");
    let broken = file("mapping.yaml", b"states: {/door.data: {state: door, kinds: count}}\n");
    let absent = file("absent.yaml", b"states: {/window.data: window}\n");
    let mut bag = Bag::default();
    bag.bool("/door", START_NANOS, true);
    let door = written(&folder, "door.bag", &bag, usize::MAX).display().to_string();
    let mut nothing = Bag::default();
    nothing.text("/rosout", START_NANOS, "nothing");
    let nothing = written(&folder, "nothing.bag", &nothing, usize::MAX).display().to_string();
    for (line, code, parts) in [
        (format!("import home {old}"), 1, &["old.bag", "ROSRECORD V1.2", "rosbag fix"][..]),
        (format!("import home {table}"), 1, &["rows.csv", "tidemap observe"]),
        (format!("import home {}", folder.path().join("none.mcap").display()), 1, &["none.mcap"]),
        (format!("import home {}", folder.path().display()), 2, &["metadata.yaml", "rosbag2"]),
        (format!("import home {door} --mapping {broken}"), 1, &["mapping.yaml", "kinds"]),
        (format!("import home {door} --mapping {absent}"), 2, &["\"/window\"", "/door"]),
        (format!("import home {door} --topics /window"), 2, &["\"/window\"", "/door"]),
        (format!("import home {door} --frame map"), 2, &["no frame \"map\""]),
        (format!("import home {nothing}"), 1, &["/rosout: nothing is made of std_msgs/String", "--mapping"]),
    ] {
        words(&daemon, &line).fails(code, parts);
    }
    words(&daemon, "map show home").fails(1, &["home"]);
}

#[test]
fn names_of_a_recording_do_not_steer_the_terminal() {
    let folder = tempfile::tempdir().expect("a folder");
    let mut bag = Bag::default();
    let names = ["/door\u{1b}]0;owned\u{7}", "/dr\u{202e}oo", "/door\u{9b}2J", "/door\nerror: all is lost"];
    for name in names {
        bag.bool(name, START_NANOS, true);
        bag.text(&format!("{name}/words"), START_NANOS, "nothing");
    }
    let file = written(&folder, "strange.bag", &bag, usize::MAX).display().to_string();
    for format in ["table", "json", "csv"] {
        let args = ["--output", format, "import", "room", &file, "--list"];
        let output = cli::command("127.0.0.1:1", args).output().expect("the command");
        let [shown, stderr] = [&output.stdout, &output.stderr].map(|bytes| String::from_utf8_lossy(bytes).into_owned());
        let is_raw = |text: &str| text.contains(['\u{1b}', '\u{7}', '\u{202e}', '\u{9b}']);
        assert!(stderr.contains(r"/door\u{1b}]0;owned\u{7}") && !is_raw(&stderr), "{stderr:?}");
        assert!(!stderr.lines().any(|line| line.starts_with("error: all is lost")), "{stderr:?}");
        // Programs get CSV as it is; JSON has escapes of its own.
        assert_eq!(is_raw(&shown), format == "csv", "{format}: {shown:?}");
        if format == "json" {
            let rows: serde_json::Value = serde_json::from_str(&shown).expect("JSON");
            let topics: Vec<&str> =
                rows.as_array().expect("rows").iter().filter_map(|row| row["topic"].as_str()).collect();
            assert!(names.iter().all(|name| topics.contains(name)), "{topics:?}");
        }
    }
}

#[test]
fn a_list_needs_no_daemon_and_sends_nothing() {
    let folder = tempfile::tempdir().expect("a folder");
    let file = written(&folder, "drive.bag", &drive(3), usize::MAX);
    let mut command = cli::command("127.0.0.1:1", ["import", "room", &file.display().to_string(), "--list"]);
    let output = command.output().expect("the command");
    assert!(output.status.success(), "{output:?}");
    let table = Table::parse(&String::from_utf8_lossy(&output.stdout));
    assert_eq!(table.column("topic"), ["/tf_static", "/tf", "/scan", "/kitchen/door", "/rosout"]);
    assert_eq!(table.column("messages"), ["1", "3", "3", "3", "3"]);
    assert_eq!(table.column("accepted"), [""; 5]);
}
