//! The advice of the command line whether an update is worth it.
//!
//! Invariant: the expected advice follows from the rows that were sent.

use std::fmt::Write as _;

use tidemap_tests::{cli, daemon::Launch};

/// 2025-03-03, a Monday, in UTC.
const START_SECS: i64 = 1_740_960_000;

/// Rows of a door every half an hour of some days: open from eight to five, unless it is shut then and open else.
fn rows(days: std::ops::Range<i64>, is_inverted: bool) -> String {
    (days.start * 48..days.end * 48).fold("time,state,value\n".to_owned(), |mut rows, slot| {
        let is_open = (16..34).contains(&(slot % 48)) != is_inverted;
        let _ = writeln!(rows, "{},door,{}", START_SECS + slot * 1800, u8::from(is_open));
        rows
    })
}

#[test]
fn stats_distinguish_a_changed_routine_from_a_usual_day() {
    let data = tempfile::tempdir().expect("a folder");
    let daemon = Launch::on(data.path()).start();
    cli::tidemap(&daemon, ["map", "create", "office", "--time-zone", "UTC", "--clock", "simulated"]).table();
    let observe = |label: &str, rows: &str| {
        let words = ["observe", "office", "-", "--producer", "camera", "--label", label];
        cli::tidemap_reading(&daemon, words, rows).table();
    };
    let stats = || {
        let table = cli::tidemap(&daemon, ["stats", "office"]).table();
        ["pending_observations", "pending_judged", "pending_error", "usual_error", "update_gain"].map(|name| {
            let place = table.column("name").iter().position(|found| *found == name);
            table.numbers("value")[place.unwrap_or_else(|| panic!("{name} is not in {table:?}"))]
        })
    };
    observe("first", &rows(0..1, false));
    assert_eq!(stats(), [48.0, 48.0, 0.25, 0.0, 0.25], "nothing is learned, and 0.5 is predicted");

    observe("learned", &rows(1..21, false));
    cli::tidemap(&daemon, ["update", "office"]).table();
    assert_eq!(stats(), [0.0; 5], "nothing is pending");
    observe("usual", &rows(21..22, false));
    let [_, judged, error, usual, gain] = stats();
    assert!(judged == 48.0 && error < 0.1 && usual > 0.0 && gain < 0.05, "{judged} {error} {usual} {gain}");
    cli::tidemap(&daemon, ["update", "office"]).table();

    observe("changed", &rows(22..27, true));
    let [pending, judged, error, usual, gain] = stats();
    assert_eq!(pending, 240.0);
    // Every third of them.
    assert!(judged == 80.0 && error > 0.7 && (gain - (error - usual)).abs() < 1e-9, "{judged} {error} {usual} {gain}");
}
