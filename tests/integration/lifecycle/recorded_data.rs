//! A recorded data folder of format 1 opens, and the daemon answers as the one that wrote it did.
//!
//! `data_of_format_1` holds a map with states of every kind, a grid with two sensors, a topological map with
//! traversals, locations, visits, a checkpoint and pending observations; `answers_of_format_1.txt` holds commands and
//! what they printed. Never write the folder again: a difference means that users' data would change. Where an answer
//! changes on purpose, write that answer again, and state so in the changelog.
//!
//! Invariant: names, texts and counts are equal, numbers up to rounding.

use std::path::Path;

use tidemap_tests::{
    cli::{self, Table},
    daemon::Launch,
    disk,
};

/// Relative error of numbers, for processors that add in another order.
const ERROR_MAX: f64 = 1e-9;
/// Relative error of numbers of models that are trained while the test runs, which add up such errors.
const TRAINED_ERROR_MAX: f64 = 1e-6;

fn is_equal(found: &str, expected: &str, error_max: f64) -> bool {
    let (Ok(found_number), Ok(expected_number)) = (found.parse::<f64>(), expected.parse::<f64>()) else {
        return found == expected;
    };
    (found_number - expected_number).abs() <= error_max * expected_number.abs().max(1.0)
}

fn compare(question: &str, found: &Table, expected: &Table, error_max: f64) {
    // New columns come at the end.
    assert!(found.columns.starts_with(&expected.columns), "{question}: {:?}", found.columns);
    assert_eq!(found.rows.len(), expected.rows.len(), "{question}: {:?}", found.rows);
    for (found_row, expected_row) in found.rows.iter().zip(&expected.rows) {
        for ((column, found), expected) in expected.columns.iter().zip(found_row).zip(expected_row) {
            let is_alike = is_equal(found, expected, error_max);
            assert!(is_alike, "{question}: {column} is {found}, and was {expected}");
        }
    }
}

#[test]
fn a_recorded_folder_opens_and_answers_as_it_did() {
    let here = Path::new(env!("CARGO_MANIFEST_DIR")).join("integration/lifecycle");
    let data = tempfile::tempdir().expect("a folder");
    disk::copy_folder(&here.join("data_of_format_1"), data.path());
    // The folder has pending observations of a day that is long over: an update of them would change the answers.
    let daemon = Launch::on(data.path()).setting("update_at_midnight", false).start();
    let answers = std::fs::read_to_string(here.join("answers_of_format_1.txt")).expect("the recorded answers");
    let (mut compared, mut is_updated) = (0, false);
    for block in answers.split("$ tidemap ").filter(|block| !block.is_empty()) {
        let (question, expected) = block.split_once('\n').expect("a command and its answer");
        let found = cli::tidemap(&daemon, question.split_whitespace()).table();
        is_updated |= question.starts_with("update ");
        // Positions are trained on request.
        let is_trained_now = is_updated || question.starts_with("position ");
        let error_max = if is_trained_now { TRAINED_ERROR_MAX } else { ERROR_MAX };
        compare(question, &found, &Table::parse(expected), error_max);
        compared += 1;
    }
    assert_eq!(compared, 24);
    daemon.stop_in_order();
}
