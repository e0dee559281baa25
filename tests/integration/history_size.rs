//! The size of the history of a door that is read every second, as the command line reports it.
//!
//! Invariant: the expected sizes follow from the rows that were sent and from the length of the files.

use std::{fmt::Write as _, fs};

use tidemap_tests::{cli, daemon::Launch};

/// 2025-03-03, a Monday, in UTC.
const START_SECS: i64 = 1_740_960_000;
const SECONDS: i64 = 2 * 86_400;

#[test]
fn stats_show_how_many_bits_of_history_a_reading_takes() {
    let data = tempfile::tempdir().expect("a folder");
    let launch = Launch::on(data.path());
    let daemon = launch.start();
    cli::tidemap(&daemon, ["map", "create", "office", "--time-zone", "UTC", "--clock", "simulated"]).table();
    let is_open = |second: i64| (28_800..63_000).contains(&(second % 86_400));
    let rows = (0..SECONDS).fold("time,state,value\n".to_owned(), |mut rows, second| {
        let _ = writeln!(rows, "{},door,{}", START_SECS + second, u8::from(is_open(second)));
        rows
    });
    cli::tidemap_reading(&daemon, ["observe", "office", "-", "--producer", "camera"], &rows).table();
    let number = |daemon: &_, name: &str| -> f64 {
        let table = cli::tidemap(daemon, ["stats", "office"]).table();
        let place = table.column("name").iter().position(|found| *found == name);
        table.numbers("value")[place.unwrap_or_else(|| panic!("{name} is not in {table:?}"))]
    };
    assert_eq!(number(&daemon, "state_history_compression_ratio"), 0.0, "nothing is learned");
    cli::tidemap(&daemon, ["update", "office"]).table();
    drop(daemon.stop());

    let daemon = launch.start();
    let folder = data.path().join("maps/00000001/history");
    let files = fs::read_dir(folder).expect("a folder").map(|file| file.and_then(|file| file.metadata()));
    let names = |length: u64, file: std::io::Result<fs::Metadata>| length + file.expect("a file").len();
    let bytes = files.fold(0, names);
    let bits_each = SECONDS as f64 / (8.0 * bytes as f64);
    println!("{bytes} bytes, 1 : {bits_each:.0}");
    assert!((number(&daemon, "state_history_compression_ratio") - bits_each).abs() < 1e-6);
    // With headers and tables, not a byte for a hundred readings.
    assert!(bytes < 300, "{bytes} bytes");
    let to = (START_SECS + SECONDS).to_string();
    let words = ["reconstruct", "office", "door", "--from", &START_SECS.to_string(), "--to", &to];
    let values = cli::tidemap(&daemon, words).table().numbers("value");
    let expected: Vec<f64> = (0..SECONDS).map(|second| f64::from(u8::from(is_open(second)))).collect();
    assert!(values == expected, "{} values come back", values.len());
}
