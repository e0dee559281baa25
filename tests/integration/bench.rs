//! `tidemap-bench`, as a user runs it.
//!
//! Invariant: a measurement leaves no map behind.

use std::process::Command;

use serde_json::Value;
use tempfile::tempdir;
use tidemap_tests::{
    binaries,
    cli::{Outcome, tidemap},
    daemon::Launch,
};

/// Runs a measurement.
pub(crate) fn bench(server: &str, args: &[&str]) -> Outcome {
    let output = Command::new(binaries::tidemap_bench()).args(["--server", server]).args(args).output();
    let output = output.expect("tidemap-bench can be started");
    let text = |bytes: Vec<u8>| String::from_utf8(bytes).expect("output is text");
    Outcome { code: output.status.code(), stdout: text(output.stdout), stderr: text(output.stderr) }
}

#[test]
fn a_short_measurement_has_its_figures_and_leaves_no_map() {
    let folder = tempdir().expect("a folder");
    let daemon = Launch::on(folder.path()).start();
    let args = ["observe", "--observations", "1000", "--streams", "1", "--states", "4", "--output", "json"];
    let measured = bench(&daemon.grpc, &args);
    assert_eq!(measured.code, Some(0), "{}", measured.stderr);
    let rows: Value = serde_json::from_str(&measured.stdout).expect("JSON");
    assert!(rows[0]["observations_per_sec"].as_f64().is_some_and(|rate| rate > 0.0), "{rows}");
    assert!(rows[0].get("fdatasync_p50_secs").is_some(), "{rows}");
    assert_eq!(tidemap(&daemon, ["map", "list"]).table().rows.len(), 0);
    daemon.stop_in_order();
}

#[test]
fn a_wrong_command_line_and_a_missing_daemon_have_their_exit_status() {
    bench("http://127.0.0.1:1", &["sing"]).fails(2, &["sing"]);
    bench("no address at all", &["predict"]).fails(2, &["no address"]);
    bench("http://127.0.0.1:1", &["predict"]).fails(1, &["127.0.0.1:1"]);
    bench("http://127.0.0.1:1", &["predict", "--output", "json"]).fails(1, &["{\"error\":", "\"UNAVAILABLE\""]);
}
