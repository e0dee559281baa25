//! `evaluate` with more states than models fit into the cache, and than one request takes.
//!
//! Invariant: portions give the rows of the whole.

use std::fmt::Write as _;

use tidemap_tests::{
    cli,
    daemon::{Daemon, Launch},
};

const START_SECS: i64 = 1_451_865_600;

/// Rows of states, one reading an hour each: open for `states + 2` hours of each day.
fn rows(states: usize, hours: std::ops::Range<i64>) -> String {
    let mut text = "time,state,value\n".to_owned();
    for hour in hours {
        for state in 0..states {
            let value = u8::from(hour % 24 < state as i64 % 20 + 2);
            writeln!(text, "{},door-{state},{value}", START_SECS + hour * 3_600).expect("memory");
        }
    }
    text
}

fn learned(daemon: &Daemon, text: &str) {
    cli::tidemap(daemon, ["map", "create", "home", "--time-zone", "UTC"]).table();
    cli::tidemap_reading(daemon, ["observe", "home", "-", "--producer", "r", "--label", "a"], text).table();
    cli::tidemap(daemon, ["update", "home"]).table();
}

#[test]
fn more_states_than_models_in_the_cache_are_compared() {
    let data = tempfile::tempdir().expect("a folder");
    let daemon = Launch::on(data.path()).setting("max_trained_models", 2).start();
    learned(&daemon, &rows(12, 0..240));
    let evaluate = |text: &str| {
        let args = ["evaluate", "home", "-", "--models", "histogram:24,calibrated"];
        cli::tidemap_reading(&daemon, args, text).table()
    };
    let test = rows(12, 240..288);
    let table = evaluate(&test);
    assert_eq!(table.column("state").len(), 24);
    let (states, errors) = (table.column("state"), table.numbers("mse"));
    for state in ["door-0", "door-11"] {
        let own: String = test
            .lines()
            .enumerate()
            .filter(|(line, row)| *line == 0 || row.contains(&format!(",{state},")))
            .map(|(_, row)| format!("{row}\n"))
            .collect();
        let alone = evaluate(&own).numbers("mse");
        let of_state: Vec<f64> =
            states.iter().zip(&errors).filter(|(name, _)| **name == state).map(|(_, error)| *error).collect();
        assert_eq!(of_state, alone);
        assert!(alone[0] < 0.05, "{alone:?}");
    }
}

#[test]
fn more_states_than_one_request_takes_are_compared() {
    const STATES: usize = 10_050;
    let data = tempfile::tempdir().expect("a folder");
    let daemon = Launch::on(data.path()).start();
    let text = rows(STATES, 0..1);
    learned(&daemon, &text);
    let args = ["evaluate", "home", "-", "--models", "mean"];
    let table = cli::tidemap_reading(&daemon, args, &text).table();
    let expected: Vec<String> = (0..STATES).map(|state| format!("door-{state}")).collect();
    assert_eq!(table.column("state"), expected);
    assert_eq!(table.column("n"), vec!["1"; STATES]);
}
