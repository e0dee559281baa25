//! Recordings of real places, which lie beside the repository and not in it.
//!
//! Invariant: read only.

use std::path::{Path, PathBuf};

#[path = "../../server/model/tests/recordings/folder.rs"]
mod beside;

/// The folder of a recording; `None`, with a line on stdout, where it is missing.
///
/// # Panics
/// If it is missing and `TIDEMAP_REQUIRE_DATA` is set.
#[must_use]
pub fn folder(name: &str) -> Option<PathBuf> {
    beside::recordings(name)
}

/// A day, a week and so on are counted in nanoseconds.
const SECOND_NANOS: i64 = 1_000_000_000;

/// The rows `time,state,value` of a file as nanoseconds UTC and value.
///
/// # Panics
/// If the file is not such a file.
#[must_use]
pub fn rows(file: &Path) -> Vec<(i64, f64)> {
    let mut reader = csv::Reader::from_path(file).unwrap_or_else(|error| panic!("{}: {error}", file.display()));
    let row = |record: csv::StringRecord| {
        let secs: i64 = record[0].parse().expect("a time in whole seconds");
        (secs * SECOND_NANOS, record[2].parse().expect("a value"))
    };
    reader.records().map(|record| row(record.expect("a row"))).collect()
}
