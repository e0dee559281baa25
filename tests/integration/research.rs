//! `tidemap-research`, as a user runs it: without a daemon, with a table and a folder of results.
//!
//! Invariant: the habits are those of the first two weeks, which take a second.

use std::{fs, path::Path, process::Command};

use tempfile::tempdir;
use tidemap_tests::{
    binaries,
    cli::{Outcome, Table},
};

fn research(folder: &Path, args: &[&str]) -> Outcome {
    let output = Command::new(binaries::tidemap_research()).args(args).current_dir(folder).output();
    let output = output.expect("tidemap-research can be started");
    let text = |bytes: Vec<u8>| String::from_utf8(bytes).expect("output is text");
    Outcome { code: output.status.code(), stdout: text(output.stdout), stderr: text(output.stderr) }
}

fn habits(folder: &Path, args: &[&str]) -> Outcome {
    research(folder, &[&["habits"], args].concat())
}

#[test]
fn a_wrong_command_line_and_a_wrong_protocol_are_usage_errors() {
    let folder = tempdir().expect("a folder");
    research(folder.path(), &["door.txt"]).fails(2, &["neither a protocol"]);
    research(folder.path(), &["door.yaml"]).fails(1, &["door.yaml"]);
    fs::write(folder.path().join("door.yaml"), "models: 3\n").expect("a protocol");
    research(folder.path(), &["door.yaml"]).fails(2, &["door.yaml", "line 1"]);
    let json = research(folder.path(), &["--output", "json", "habits", "--habits", "new-bar"]);
    let rows: serde_json::Value = serde_json::from_str(&json.stdout).expect("JSON");
    assert_eq!(rows[0]["habit"], "new-bar", "{rows}");
}

#[test]
fn new_habits_are_scored_beside_baselines_and_by_what_their_intervals_hold() {
    let folder = tempdir().expect("a folder");
    let outcome = habits(folder.path(), &["--habits", "new-office,new-bar", "--seeds", "1"]);
    let table = outcome.table();
    assert_eq!(table.column("habit"), ["new-office", "new-bar", "all"]);
    for level in ["50", "80", "90", "95"] {
        let (held, claimed) = (table.numbers(&format!("coverage_{level}")), table.numbers(&format!("mass_{level}")));
        assert!(held.iter().chain(&claimed).all(|share| (0.0..=1.0).contains(share)), "{table:?}");
        let level: f64 = level.parse().expect("a number");
        assert!(claimed.iter().all(|&share| share > level / 100.0 - 1e-6), "an interval holds its level: {table:?}");
    }
    // The last row has the means of those above.
    for column in ["mse", "mse_of_best", "log_loss", "log_loss_of_best"] {
        let numbers = table.numbers(column);
        assert!((numbers[2] - (numbers[0] + numbers[1]) / 2.0).abs() < 1e-9, "{column}: {numbers:?}");
    }

    let results = folder.path().join("habits-results");
    let file = |name: &str| fs::read_to_string(results.join(name)).expect("a file of results");
    assert_eq!(file("results.csv"), outcome.stdout);
    let errors = Table::parse(&file("errors.csv"));
    let names = errors.column("prediction");
    assert_eq!((names.len(), names[0], names[6]), (14, "auto", "truth"));
    // `auto` against the best of the tables, as the row states.
    let mse = errors.numbers("mse");
    let best = mse[1..6].iter().copied().fold(f64::INFINITY, f64::min);
    assert!((table.numbers("mse_of_best")[0] - (mse[0] / best - 1.0)).abs() < 1e-9, "{errors:?}");
    assert!(mse[6] < mse[0], "nobody predicts better than the habit itself: {errors:?}");
}

#[test]
fn another_seed_is_another_world_and_an_unknown_habit_is_refused() {
    let folder = tempdir().expect("a folder");
    let of_seed =
        |seed: &str| habits(folder.path(), &["--habits", "new-bar", "--first-seed", seed, "--out", seed]).table();
    let (first, again, other) = (of_seed("0"), of_seed("0"), of_seed("1"));
    assert_eq!(first, again);
    assert_ne!(first, other);
    habits(folder.path(), &["--habits", "bar,tavern"]).fails(2, &["tavern", "new-bar", "office"]);
}
