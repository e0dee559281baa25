//! Rooms that hold one person, who is in exactly one of them: `slot` and `day` with `--exactly-one`.
//!
//! Invariant: the place of the person follows from the hour alone; the robot observes one room at a time.

use std::fmt::Write as _;

use tempfile::tempdir;
use tidemap_tests::{
    cli::{self, Outcome},
    daemon::{Daemon, Launch},
};

use super::tidemap;

/// A Monday.
const START_SECS: i64 = 1_704_067_200;
const DAY_SECS: i64 = 86_400;
const ROOMS: [&str; 3] = ["bedroom", "kitchen", "study"];

/// Where the person is at an hour.
fn room_at(hour: i64) -> &'static str {
    match hour {
        7 | 12 | 18 => "kitchen",
        8..22 => "study",
        _ => "bedroom",
    }
}

/// Four weeks of observations, one every half-hour, of the rooms in an irregular order.
fn looks() -> String {
    let mut csv = "time,state,value\n".to_owned();
    for half in 0..28 * 48 {
        let room = ROOMS[(half * 5 % 7 % 3) as usize];
        let at = START_SECS + half * 1_800;
        writeln!(csv, "{at},{room},{}", u8::from(room_at(half / 2 % 24) == room)).expect("text");
    }
    csv
}

fn observe(daemon: &Daemon, label: &str, csv: &str) {
    cli::tidemap_reading(daemon, ["observe", "flat", "-", "--producer", "robot", "--label", label], csv).table();
}

fn slot(daemon: &Daemon, secs: i64, more: &[&str]) -> Outcome {
    let at = secs.to_string();
    tidemap(daemon, ["slot", "flat", "--at", &at].into_iter().chain(more.iter().copied()))
}

#[test]
fn one_look_informs_about_all_rooms() {
    let data = tempdir().expect("a folder");
    let daemon = Launch::on(data.path()).start();
    tidemap(&daemon, ["map", "create", "flat"]).table();
    observe(&daemon, "weeks", &looks());
    tidemap(&daemon, ["update", "flat"]).table();
    let monday = START_SECS + 28 * DAY_SECS;

    // An hour after the last observation the person is as likely in the kitchen as elsewhere; an observation is worth
    // something.
    let breakfast = monday + 7 * 3_600 + 900;
    let bits = |more: &[&str]| slot(&daemon, breakfast, more).table().numbers("information_bits")[0];
    assert!(bits(&["--exactly-one"]) > 0.05);
    // The person was just seen in the kitchen, and so is nowhere else. An update has not learned it yet.
    observe(&daemon, "fresh", &format!("time,state,value\n{breakfast},kitchen,1\n"));
    assert!(bits(&["--exactly-one"]) < 0.01, "{}", bits(&["--exactly-one"]));
    assert!(bits(&["--model", "spectral"]) > 0.05, "models of single rooms do not know that");
    // The slot of a minute later has the same; its length may be given.
    assert!(bits(&["--exactly-one", "--slot", "30m"]) < 0.01);

    // The day: observations are worth most where the person moves; at night there are none.
    let args = ["day", "flat", "--date", "2024-01-29", "--strategy", "greedy", "--explore", "8", "--exactly-one"];
    let day = tidemap(&daemon, args).table();
    let (slots, rooms) = (day.numbers("slot"), day.column("location"));
    let hours: Vec<f64> = slots.iter().zip(&rooms).filter(|(_, room)| !room.is_empty()).map(|(s, _)| s / 4.0).collect();
    assert_eq!(hours.len(), 8, "{day:?}");
    assert!(hours.iter().all(|hour| (5.0..23.5).contains(hour)), "{hours:?}");
    assert_eq!(tidemap(&daemon, args).table(), day, "the same question has the same answer");

    slot(&daemon, breakfast, &["--exactly-one", "--model", "spectral"]).fails(2, &["--exactly-one", "--model"]);
    tidemap(&daemon, ["day", "flat", "--date", "2024-01-29", "--exactly-one", "--views", "1"])
        .fails(2, &["--exactly-one", "--views"]);
    tidemap(&daemon, ["location", "set", "flat", "home", "bedroom", "kitchen"]).table();
    slot(&daemon, breakfast, &["--exactly-one"]).fails(1, &["\"home\"", "2 states", "one state"]);
    tidemap(&daemon, ["location", "set", "flat", "home", "bedroom"]).table();
    slot(&daemon, breakfast, &["--exactly-one"]).fails(1, &["places", "2 to 64"]);
    daemon.stop_in_order();
}

#[test]
fn a_map_without_history_is_refused_with_the_reason() {
    let data = tempdir().expect("a folder");
    let daemon = Launch::on(data.path()).start();
    tidemap(&daemon, ["map", "create", "flat", "--retention", "none"]).table();
    observe(&daemon, "day", "time,state,value\n1704067200,kitchen,1\n1704067200,study,0\n");
    slot(&daemon, START_SECS + 60, &["--exactly-one"]).fails(1, &["flat", "retention"]);
    daemon.stop_in_order();
}
