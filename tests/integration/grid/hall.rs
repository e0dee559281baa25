//! The grid that is learned from a robot's scans of a hall with known walls, by `tidemap-bench hall`.
//!
//! Invariant: the truth comes from the plan of the simulated hall, never from a daemon.

use serde_json::Value;
use tempfile::tempdir;
use tidemap_tests::daemon::Launch;

use crate::bench::bench;

/// Percent of the walls that have to be found, each within one cell.
const WALLS_MIN: f64 = 90.0;
/// Percent of the walls that have to be found in their own cells.
const IN_PLACE_MIN: f64 = 90.0;
/// Percent of the walls of each kind that have to be found.
const KIND_MIN: f64 = 80.0;
/// Maximum percent of the free cells that are walls.
const FALSE_WALLS_MAX: f64 = 1.0;
/// Percent of the table's cells that have to be free, and of its sides that have to be occupied.
const TABLE_MIN: f64 = 90.0;

/// The walls of each kind, in percent.
const KINDS: [&str; 8] = [
    "outer_walls_percent",
    "corridor_walls_percent",
    "room_walls_percent",
    "pillars_percent",
    "low_shelves_percent",
    "high_boards_percent",
    "dark_walls_percent",
    "shiny_walls_percent",
];

/// The figures of a hall that was scanned for this many days, and all that the measurement printed.
fn figures(days: u32) -> (impl Fn(&str) -> f64, String) {
    let folder = tempdir().expect("a folder");
    let daemon = Launch::on(folder.path()).start();
    let args = ["hall", "--days", &days.to_string(), "--stops", "16", "--output", "json"];
    let measured = bench(&daemon.grpc, &args);
    assert_eq!(measured.code, Some(0), "{}", measured.stderr);
    let rows: Value = serde_json::from_str(&measured.stdout).expect("JSON");
    daemon.stop_in_order();
    let figure = move |name: &str| rows[0][name].as_f64().unwrap_or_else(|| panic!("no {name} in {rows}"));
    (figure, measured.stderr)
}

/// The bounds that the walls miss.
fn wrong_walls(figure: impl Fn(&str) -> f64) -> Vec<String> {
    assert!(figure("wall_cells") > 1_800.0 && figure("free_cells") > 40_000.0, "the robot saw too little");
    let of_all = [("walls_percent", WALLS_MIN), ("walls_in_place_percent", IN_PLACE_MIN)];
    let bounds = KINDS.map(|kind| (kind, KIND_MIN)).into_iter().chain(of_all);
    let missing = bounds.filter(|(name, min)| figure(name) < *min);
    let mut wrong: Vec<String> =
        missing.map(|(name, min)| format!("{name} is {:.1}, below {min}", figure(name))).collect();
    let false_walls = figure("false_walls_percent");
    if false_walls > FALSE_WALLS_MAX {
        wrong.push(format!("false_walls_percent is {false_walls:.1}, above {FALSE_WALLS_MAX}"));
    }
    wrong
}

#[test]
fn grid_of_a_hall_has_its_walls_and_no_others() {
    let (figure, printed) = figures(1);
    let wrong = wrong_walls(figure);
    assert!(wrong.is_empty(), "{wrong:#?}\n{printed}");
}

#[test]
#[ignore = "takes minutes"]
fn grid_of_a_month_in_a_hall_has_its_walls_and_the_hours_of_its_table() {
    let (figure, printed) = figures(28);
    let table = ["table_free_at_night_percent", "table_at_10_percent"].map(|name| (name, figure(name)));
    let mut wrong = wrong_walls(figure);
    let wrong_hours = table.iter().filter(|(_, percent)| *percent < TABLE_MIN);
    wrong.extend(wrong_hours.map(|(name, percent)| format!("{name} is {percent:.1}, below {TABLE_MIN}")));
    assert!(wrong.is_empty(), "{wrong:#?}\n{printed}");
}
