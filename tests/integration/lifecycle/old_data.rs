//! A data folder that an earlier build wrote opens, and the daemon answers as that build did.
//!
//! `data_of_0_1` holds a map with states of every kind, a grid with two sensors, a topological map with traversals, a
//! checkpoint and pending observations; `answers_of_0_1.txt` holds commands and what they printed. Never write these
//! files again: a difference means that users' data would change.
//!
//! Invariant: names, texts and counts are equal, numbers up to rounding. The bounds of intervals may differ by the
//! error of an approximated quantile. After an update of this build, `auto` may answer otherwise: models with similar
//! errors now answer together, and slow rhythms are used sooner. The edge between Hall and Lab was never read at the
//! hours asked for: there its histogram now leaves the answer to the spectral model, and routes follow. The model of
//! positions is trained on request, and now finds its rhythms among the periods of the map.

use std::path::Path;

use tidemap_tests::{
    cli::{self, Table},
    daemon::Launch,
    disk,
};

/// Relative error of numbers, for processors that add in another order.
const ERROR_MAX: f64 = 1e-9;
/// Error of the bounds of intervals: the earlier build took them from points whose distance was 3 % of p (1 - p).
const BOUND_ERROR_MAX: f64 = 5e-3;
/// What a question begins with whose model now has other candidate periods, and the error of its numbers.
const REFITTED: (&str, f64) = ("position ", 0.05);
/// Columns that depend on the models that an update of this build lets answer.
const OF_AUTO: [&str; 7] = ["order", "mse_before", "mse", "probability", "lower", "upper", "entropy_bits"];
/// An edge whose histogram has no readings at the hours asked for.
const UNREAD: [&str; 2] = ["Hall", "Lab"];
/// Columns that depend on that edge.
const OF_UNREAD: [&str; 4] = ["probability", "lower", "upper", "entropy_bits"];

fn is_equal(question: &str, column: &str, found: &str, expected: &str) -> bool {
    let (Ok(found_number), Ok(expected_number)) = (found.parse::<f64>(), expected.parse::<f64>()) else {
        return found == expected;
    };
    let error_max = match column {
        _ if question.starts_with(REFITTED.0) => REFITTED.1,
        "lower" | "upper" => BOUND_ERROR_MAX,
        _ => ERROR_MAX,
    };
    (found_number - expected_number).abs() <= error_max * expected_number.abs().max(1.0)
}

fn compare(question: &str, found: &Table, expected: &Table, is_updated: bool) {
    // New columns come at the end.
    assert!(found.columns.starts_with(&expected.columns), "{question}: {:?}", found.columns);
    assert_eq!(found.rows.len(), expected.rows.len(), "{question}: {:?}", found.rows);
    let has_both = |row: &Vec<String>| UNREAD.iter().all(|end| row.iter().any(|cell| cell == end));
    // A route's expected time is that of all its edges.
    let passes_unread = expected.rows.iter().any(has_both);
    for (found_row, expected_row) in found.rows.iter().zip(&expected.rows) {
        let is_unread =
            has_both(expected_row) || expected_row.iter().any(|cell| *cell == format!("edge/{}", UNREAD.join("/")));
        for ((column, found), expected) in found.columns.iter().zip(found_row).zip(expected_row) {
            let column = column.as_str();
            let is_alike = is_updated && OF_AUTO.contains(&column)
                || is_unread && OF_UNREAD.contains(&column)
                || passes_unread && column == "expected_secs"
                || is_equal(question, column, found, expected);
            assert!(is_alike, "{question}: {column} is {found}, and was {expected}");
        }
    }
}

#[test]
fn a_folder_of_an_earlier_build_opens_and_answers_alike() {
    let here = Path::new(env!("CARGO_MANIFEST_DIR")).join("integration/lifecycle");
    let data = tempfile::tempdir().expect("a folder");
    disk::copy_folder(&here.join("data_of_0_1"), data.path());
    // The folder has pending observations of a day that is long over: an update of them would change the answers.
    let daemon = Launch::on(data.path()).setting("update_at_midnight", false).start();
    let answers = std::fs::read_to_string(here.join("answers_of_0_1.txt")).expect("the recorded answers");
    let (mut compared, mut is_updated) = (0, false);
    for block in answers.split("$ tidemap ").filter(|block| !block.is_empty()) {
        let (question, expected) = block.split_once('\n').expect("a command and its answer");
        let found = cli::tidemap(&daemon, question.split_whitespace()).table();
        is_updated |= question.starts_with("update ");
        compare(question, &found, &Table::parse(expected), is_updated);
        compared += 1;
    }
    assert_eq!(compared, 21);
    daemon.stop_in_order();
}
