//! The ensemble of a map, asked as an operator does: what it says of hours without looks, of the next year, after a
//! restart, and what is refused.

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
fn hours_that_nobody_looked_at_stay_unknown_also_after_a_restart() {
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
fn an_ensemble_is_for_named_probabilities_and_left_out_of_others() {
    let data = tempdir().expect("a folder");
    let daemon = Launch::on(data.path()).start();
    tidemap(&daemon, ["map", "create", "plain", "--time-zone", "UTC", "--models", "histogram"]).table();
    tidemap(&daemon, ["state", "add", "plain", "heat", "--kind", "continuous"]).table();
    learn(&daemon, "plain", &rows("door", (0..48).map(|hour| (hour * HOUR_SECS, hour % 24 > 8))));
    let at = (START_SECS + 3 * DAY_SECS).to_string();
    let asked = |state: &str| tidemap(&daemon, ["predict", "plain", state, "--at", at.as_str(), "--model", "ensemble"]);
    // A state of a map without ensembles is predicted by what was chosen, and the answer says so.
    assert_ne!(asked("door").table().column("model"), ["ensemble"]);
    asked("heat").fails(1, &["ensemble", "heat", "probabilities"]);
    let evaluated =
        tidemap_reading(&daemon, ["evaluate", "plain", "-", "--models", "mean,ensemble"], &rows("heat", [(0, true)]));
    assert!(evaluated.stderr.contains("ensemble is left out of heat"), "{}", evaluated.stderr);
}
