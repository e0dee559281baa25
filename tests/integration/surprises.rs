//! Unusual observations stay so after the night in which they were learned, wherever the map is read from.

use std::fmt::Write as _;

use tempfile::tempdir;
use tidemap_tests::{
    cli::{Table, tidemap, tidemap_reading},
    daemon::{Daemon, Launch},
};

/// Monday 2025-01-06.
const START_SECS: i64 = 1_736_121_600;
const DAY_SECS: i64 = 86_400;
const DOORS: i64 = 40;
/// The door that was left open, from Friday of the fourth week, 18:00, for 42 hours.
const OPEN: i64 = 17;
const OPEN_FROM: i64 = START_SECS + 25 * DAY_SECS + 18 * 3600;
const OPEN_SECS: i64 = 42 * 3600;

/// Forty doors every half-hour: open from nine to five on working days, each with exceptions of its own.
fn doors(days: std::ops::Range<i64>) -> String {
    let mut text = "time,state,value\n".to_owned();
    for time in (days.start * DAY_SECS..days.end * DAY_SECS).step_by(1800) {
        let is_work = time / DAY_SECS % 7 < 5 && (9..17).contains(&(time / 3600 % 24));
        for door in 0..DOORS {
            let is_exception = (time / 1800 * 31 + door * 17) % 211 == 0;
            let is_left_open = door == OPEN && (OPEN_FROM..OPEN_FROM + OPEN_SECS).contains(&(START_SECS + time));
            let is_open = is_left_open || is_work != is_exception;
            let _ = writeln!(text, "{},door-{door},{}", START_SECS + time, u8::from(is_open));
        }
    }
    text
}

fn observe(daemon: &Daemon, days: std::ops::Range<i64>) {
    let label = format!("days-{}", days.start);
    let sent =
        tidemap_reading(daemon, ["observe", "home", "-", "--producer", "robot", "--label", &label], &doors(days));
    sent.table();
}

fn update(daemon: &Daemon, day: i64) {
    let until = (START_SECS + day * DAY_SECS).to_string();
    tidemap(daemon, ["update", "home", "--until", until.as_str()]).table();
}

/// The unusual runs of the last days.
fn unusual(daemon: &Daemon, args: &[&str]) -> Table {
    let (from, to) = ((START_SECS + 24 * DAY_SECS).to_string(), (START_SECS + 28 * DAY_SECS).to_string());
    tidemap(daemon, ["anomalies", "home", "--from", &from, "--to", &to].iter().chain(args)).table()
}

/// Checks that the door which was left open is the first, as one run.
fn check_open_door(found: &Table, when: &str) {
    assert_eq!(found.columns, ["state", "first", "last", "observations", "value", "probability", "surprise_bits"]);
    let column = |name| found.numbers(name);
    assert_eq!(found.column("state")[0], format!("door-{OPEN}"), "{when}: {:?}", found.rows);
    let (first, last) = (OPEN_FROM as f64, (OPEN_FROM + OPEN_SECS - 1800) as f64);
    assert_eq!((column("first")[0], column("last")[0]), (first, last), "{when}: {:?}", found.rows[0]);
    assert!(column("observations")[0] >= 70.0 && column("value")[0] == 1.0, "{when}: {:?}", found.rows[0]);
    assert!(column("probability")[0] <= 0.1, "{when}: {:?}", found.rows[0]);
    let bits = column("surprise_bits");
    assert!(bits.len() == 1 || bits[0] > 5.0 * bits[1], "{when}: {bits:?}");
}

#[test]
fn a_door_left_open_is_the_first_surprise_before_and_after_the_nights_that_learn_it() {
    let data = tempdir().expect("a folder");
    let daemon = Launch::on(data.path()).start();
    tidemap(&daemon, ["map", "create", "home", "--time-zone", "UTC", "--retention", "none"]).table();
    observe(&daemon, 0..25);
    (1..=25).for_each(|day| update(&daemon, day));
    observe(&daemon, 25..28);
    check_open_door(&unusual(&daemon, &["--confidence", "0.9"]), "pending");
    for day in 26..=28 {
        update(&daemon, day);
        check_open_door(&unusual(&daemon, &["--confidence", "0.9"]), &format!("learned until day {day}"));
    }
    let learned = unusual(&daemon, &["--confidence", "0.9"]);
    // A request for one state lists its runs alone.
    let one = format!("door-{OPEN}");
    let of_one = unusual(&daemon, &[&one, "--confidence", "0.9"]);
    assert!(of_one.rows.iter().all(|row| row[0] == one) && of_one.rows[0] == learned.rows[0]);
    assert_eq!(unusual(&daemon, &["--confidence", "0.9", "--top", "1"]).rows, learned.rows[..1]);
    let certain = unusual(&daemon, &["--confidence", "0.99"]);
    assert!(certain.rows.iter().all(|row| learned.rows.contains(row)));
    tidemap(&daemon, ["anomalies", "home", "nobody", "--from", "0", "--to", "9"]).fails(1, &["nobody", "door-"]);

    // The runs are durable.
    daemon.stop_in_order();
    let again = Launch::on(data.path()).start();
    assert_eq!(unusual(&again, &["--confidence", "0.9"]), learned, "after a restart");
    again.kill();
    let after = Launch::on(data.path()).start();
    assert_eq!(unusual(&after, &["--confidence", "0.9"]), learned, "after a crash");
}

#[test]
fn what_was_unusual_of_erased_observations_is_erased() {
    let data = tempdir().expect("a folder");
    let daemon = Launch::on(data.path()).start();
    tidemap(&daemon, ["map", "create", "home", "--time-zone", "UTC"]).table();
    observe(&daemon, 0..28);
    update(&daemon, 28);
    let open = format!("door-{OPEN}");
    let rows = |args: &[&str]| unusual(&daemon, &[args, &["--confidence", "0.9"]].concat()).rows;
    check_open_door(&unusual(&daemon, &["--confidence", "0.9"]), "learned at once");
    // An interval of one door.
    let (from, to) = (OPEN_FROM.to_string(), (OPEN_FROM + OPEN_SECS).to_string());
    let erase = ["erase", "home", "--producer", "robot", "--state", &open, "--from", &from, "--to", &to];
    tidemap(&daemon, erase).table();
    let left = rows(&[&open]);
    let is_left = |row: &Vec<String>| row[1].parse::<f64>().is_ok_and(|first| (OPEN_FROM as f64..).contains(&first));
    let within = left
        .iter()
        .filter(|row| is_left(row) && row[2].parse::<f64>().is_ok_and(|last| last < (OPEN_FROM + OPEN_SECS) as f64));
    assert_eq!(within.count(), 0, "{left:?}");
    // A door as a whole.
    let others = rows(&["door-3"]);
    assert!(!others.is_empty());
    tidemap(&daemon, ["erase", "home", "--state", "door-3"]).table();
    tidemap(&daemon, ["anomalies", "home", "door-3", "--from", "0", "--to", "9"]).fails(1, &["door-3"]);
    assert!(rows(&[]).iter().all(|row| row[0] != "door-3"));
}
