//! The ensemble of a map, queried as an operator does: its predictions for hours without observations, for the next
//! year and after a restart, and what is refused.

use std::fmt::Write as _;

use tempfile::tempdir;
use tidemap_tests::{
    cli::{Table, tidemap, tidemap_reading},
    daemon::{Daemon, Launch},
};

/// Monday 2023-01-02.
const START_SECS: i64 = 1_672_617_600;
const DAY_SECS: i64 = 86_400;
const HOUR_SECS: i64 = 3_600;

/// Rows of a state from (seconds after the start, value).
fn rows(state: &str, readings: impl IntoIterator<Item = (i64, bool)>) -> String {
    readings.into_iter().fold("time,state,value\n".to_owned(), |mut text, (secs, value)| {
        let _ = writeln!(text, "{},{state},{}", START_SECS + secs, u8::from(value));
        text
    })
}

fn learn(daemon: &Daemon, map: &str, rows: &str) {
    tidemap_reading(daemon, ["observe", map, "-", "--producer", "robot"], rows).table();
    tidemap(daemon, ["update", map]).table();
}

/// Predictions with intervals of 0.9 at some seconds after the start.
fn predict(daemon: &Daemon, map: &str, state: &str, secs: &[i64]) -> Table {
    let times: Vec<String> = secs.iter().map(|secs| (START_SECS + secs).to_string()).collect();
    tidemap(daemon, ["predict", map, state, "--at", &times.join(","), "--interval", "0.9"]).table()
}

#[test]
fn hours_that_nobody_observed_stay_unknown_also_after_a_restart() {
    let data = tempdir().expect("a folder");
    let daemon = Launch::on(data.path()).start();
    tidemap(&daemon, ["map", "create", "home", "--time-zone", "UTC"]).table();
    // Six weeks of visits at 8, 12 and 16 h: shut, open, shut.
    let visits = [(8, false), (12, true), (16, false)];
    let day = |day: i64| visits.map(|(hour, open)| (day * DAY_SECS + hour * HOUR_SECS + 600, open));
    learn(&daemon, "home", &rows("door", (0..42).flat_map(day)));
    let hours = [4, 20, 8, 12].map(|hour| 43 * DAY_SECS + hour * HOUR_SECS + 600);
    let before = predict(&daemon, "home", "door", &hours);
    assert_eq!(before.column("model"), ["ensemble"; 4]);
    let (open, entropy, lower, upper) = (
        before.numbers("probability"),
        before.numbers("entropy_bits"),
        before.numbers("lower"),
        before.numbers("upper"),
    );
    for unseen in [0, 1] {
        assert!((open[unseen] - 1.0 / 3.0).abs() < 0.1 && entropy[unseen] >= 0.85, "{before:?}");
        assert!(upper[unseen] - lower[unseen] > 0.8, "{before:?}");
    }
    assert!(open[2] < 0.05 && open[3] > 0.95, "{before:?}");
    daemon.stop_in_order();
    let daemon = Launch::on(data.path()).start();
    let after = predict(&daemon, "home", "door", &hours);
    assert_eq!(after.column("probability"), before.column("probability"));
    assert_eq!(after.column("lower"), before.column("lower"));
}

#[test]
fn a_half_year_is_predicted_for_the_year_after() {
    let data = tempdir().expect("a folder");
    let daemon = Launch::on(data.path()).start();
    tidemap(&daemon, ["map", "create", "site", "--time-zone", "UTC"]).table();
    let open = |day: i64| day % 365 < 182;
    let looks = (0..800).flat_map(|day| (0..8).map(move |look| (day * DAY_SECS + look * 3 * HOUR_SECS, open(day))));
    learn(&daemon, "site", &rows("gate", looks));
    let days: Vec<i64> = (801..1165).step_by(4).collect();
    let noons: Vec<i64> = days.iter().map(|day| day * DAY_SECS + 12 * HOUR_SECS).collect();
    let predicted = predict(&daemon, "site", "gate", &noons).numbers("probability");
    let wrong = days.iter().zip(&predicted).filter(|&(&day, &p)| (p >= 0.5) != open(day)).count();
    assert!(wrong * 100 <= 9 * days.len(), "{wrong} of {} days are wrong", days.len());
    assert!(predicted.iter().all(|p| (0.001..=0.999).contains(p)));
}

#[test]
fn a_map_without_ensembles_answers_by_what_was_chosen() {
    let data = tempdir().expect("a folder");
    let daemon = Launch::on(data.path()).start();
    tidemap(&daemon, ["map", "create", "plain", "--time-zone", "UTC", "--models", "histogram"]).table();
    tidemap(&daemon, ["state", "add", "plain", "heat", "--kind", "continuous"]).table();
    learn(&daemon, "plain", &rows("door", (0..48).map(|hour| (hour * HOUR_SECS, hour % 24 > 8))));
    let at = (START_SECS + 3 * DAY_SECS).to_string();
    let predicted =
        |state: &str| tidemap(&daemon, ["predict", "plain", state, "--at", at.as_str(), "--model", "ensemble"]);
    // The reply names another model.
    for state in ["door", "heat"] {
        assert_ne!(predicted(state).table().column("model"), ["ensemble"]);
    }
}

#[test]
fn a_temperature_is_known_less_well_far_ahead_also_after_a_restart() {
    let data = tempdir().expect("a folder");
    let daemon = Launch::on(data.path()).start();
    tidemap(&daemon, ["map", "create", "home", "--time-zone", "UTC"]).table();
    tidemap(&daemon, ["state", "add", "home", "heat", "--kind", "continuous"]).table();
    // The heat is three degrees higher by day than at night, and weather comes and goes.
    let heat = |secs: i64| {
        let days = secs as f64 / DAY_SECS as f64;
        20.0 - 3.0 * (std::f64::consts::TAU * days).cos() + 4.0 * (days / 3.7).sin() + 2.0 * (days / 1.9).sin()
    };
    let mut readings = "time,state,value\n".to_owned();
    for secs in (0..60 * DAY_SECS).step_by(1800) {
        let _ = writeln!(readings, "{},heat,{:.2}", START_SECS + secs, heat(secs));
    }
    learn(&daemon, "home", &readings);
    let ask = |daemon: &Daemon| {
        let secs: Vec<i64> = [60, 69, 100].iter().map(|day| day * DAY_SECS + 3 * HOUR_SECS).collect();
        let answer = predict(daemon, "home", "heat", &secs);
        assert_eq!(answer.column("model"), ["ensemble"; 3]);
        (answer.numbers("probability"), answer.numbers("lower"), answer.numbers("upper"))
    };
    let before = ask(&daemon);
    let (value, lower, upper) = &before;
    assert!((value[0] - heat(60 * DAY_SECS + 3 * HOUR_SECS)).abs() < 2.0, "{before:?}");
    let widths: Vec<f64> = lower.iter().zip(upper).map(|(lower, upper)| upper - lower).collect();
    assert!(widths[0] < 8.0 && widths.is_sorted(), "{before:?}");
    assert!(widths.iter().zip(value).zip(lower).all(|((width, value), lower)| value > lower && value - lower < *width));
    daemon.stop_in_order();
    let daemon = Launch::on(data.path()).start();
    assert_eq!(ask(&daemon), before);
}
