//! States whose sensor is known, queried as an operator does: the evidence of a reading, after an update and a restart
//! too, and what is refused.

use std::fmt::Write as _;

use tempfile::tempdir;
use tidemap_tests::{
    cli::{tidemap, tidemap_reading},
    daemon::{Daemon, Launch},
};

/// Monday 2023-01-02.
const START_SECS: i64 = 1_672_617_600;
const HIT: f64 = 0.9;
const FALSE_ALARM: f64 = 0.05;
/// Seconds in which an untrained belief falls to 1/e: a rise and a fall an hour.
const FORGETS_SECS: f64 = 1800.0;

fn observe(daemon: &Daemon, state: &str, readings: &[(i64, u8)]) {
    let rows = readings.iter().fold("time,state,value\n".to_owned(), |mut text, (secs, value)| {
        let _ = writeln!(text, "{},{state},{value}", START_SECS + secs);
        text
    });
    let label = format!("{state}-{}", readings[0].0);
    tidemap_reading(daemon, ["observe", "home", "-", "--producer", "robot", "--label", &label], &rows).table();
}

fn predict(daemon: &Daemon, state: &str, secs: i64) -> f64 {
    let at = (START_SECS + secs).to_string();
    let arguments = ["predict", "home", state, "--at", &at, "--model", "auto"];
    tidemap(daemon, arguments).table().numbers("probability")[0]
}

/// The probability of 1 after a reading, from that before it.
fn after(before: f64, is_one: bool) -> f64 {
    let (if_one, if_zero) = if is_one { (HIT, FALSE_ALARM) } else { (1.0 - HIT, 1.0 - FALSE_ALARM) };
    before * if_one / (before * if_one + (1.0 - before) * if_zero)
}

#[test]
fn a_reading_of_a_known_sensor_has_the_weight_of_the_rule_of_bayes() {
    let data = tempdir().expect("a folder");
    let daemon = Launch::on(data.path()).start();
    tidemap(&daemon, ["map", "create", "home", "--time-zone", "UTC", "--clock", "simulated"]).table();
    let add = ["state", "add", "home", "door", "--hit", "0.9", "--false-alarm", "0.05"];
    let added = tidemap(&daemon, add).table();
    assert_eq!((added.numbers("hit"), added.numbers("false_alarm")), (vec![HIT], vec![FALSE_ALARM]));
    tidemap(&daemon, ["state", "add", "home", "plain"]).table();
    for state in ["door", "plain"] {
        observe(&daemon, state, &[(0, 1)]);
    }
    let near = |found: f64, one: f64| {
        let expected = one * HIT + (1.0 - one) * FALSE_ALARM;
        assert!((found - expected).abs() < 1e-9, "{found}, not {expected}");
    };
    let one = after(0.5, true);
    near(predict(&daemon, "door", 0), one);
    assert_eq!(predict(&daemon, "plain", 0), 1.0, "nothing is known about its sensor");
    tidemap(&daemon, ["update", "home"]).table();
    near(predict(&daemon, "door", 0), one);
    daemon.stop_in_order();

    let daemon = Launch::on(data.path()).start();
    near(predict(&daemon, "door", 0), one);
    // A contrary reading ten minutes later counts less than it would alone.
    observe(&daemon, "door", &[(600, 0)]);
    let before = 0.5 + (one - 0.5) * (-600.0 / FORGETS_SECS).exp();
    near(predict(&daemon, "door", 600), after(before, false));
    let listed = tidemap(&daemon, ["state", "list", "home"]).table();
    assert_eq!(listed.column("hit"), ["0.9", ""]);
    assert_eq!(listed.column("false_alarm"), ["0.05", ""]);
}

#[test]
fn what_is_no_sensor_of_the_state_is_refused() {
    let data = tempdir().expect("a folder");
    let daemon = Launch::on(data.path()).start();
    tidemap(&daemon, ["map", "create", "home", "--time-zone", "UTC"]).table();
    let add = |more: &[&str]| tidemap(&daemon, ["state", "add", "home", "door"].iter().chain(more).copied());
    let rule = "0 <= false alarm < hit <= 1";
    for wrong in [
        ["--hit", "0.3", "--false-alarm", "0.3"],
        ["--hit", "0.2", "--false-alarm", "0.3"],
        ["--hit", "NaN", "--false-alarm", "0.3"],
        ["--hit", "0.9", "--false-alarm", "NaN"],
        ["--hit", "1.5", "--false-alarm", "0.3"],
    ] {
        add(&wrong).fails(2, &[rule]);
    }
    add(&["--false-alarm", "1"]).fails(2, &[rule]);
    add(&["--hit", "often"]).fails(2, &["--hit"]);
    add(&["--kind", "continuous", "--hit", "0.9"]).fails(2, &["--kind probability", "continuous"]);
    assert!(tidemap(&daemon, ["state", "list", "home"]).table().rows.is_empty());

    add(&["--hit", "0.9"]).table();
    add(&["--hit", "0.9", "--false-alarm", "0"]).table();
    add(&[]).table();
    add(&["--hit", "0.8"]).fails(1, &["\"door\"", "hit 0.9", "hit 0.8", "never changes"]);
    tidemap(&daemon, ["state", "add", "home", "gate"]).table();
    tidemap(&daemon, ["state", "add", "home", "gate", "--hit", "0.8"]).fails(1, &["no stated sensor"]);
}
