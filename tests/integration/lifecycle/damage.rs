//! Damage under a running daemon: it is found in the background, reported by readiness, metrics and the replies that
//! need the file, and stops nothing.

use std::{
    fs,
    path::{Path, PathBuf},
    process::Command,
    time::Duration,
};

use serde_json::json;
use tempfile::tempdir;
use tidemap_tests::{
    binaries::tidemapd,
    daemon::{Daemon, Launch},
    disk,
    stream::{RawStream, columns, hello},
    web::{call, request},
};

use super::create_map;

fn get(daemon: &Daemon, path: &str) -> (u16, String) {
    let answer = request(&daemon.http, "GET", path, &[], b"");
    (answer.code, answer.text())
}

/// Waits until readiness reports these words, or no longer does.
async fn until_reported(daemon: &Daemon, words: &str, is_reported: bool) -> String {
    for _ in 0..600 {
        let (code, text) = get(daemon, "/readyz");
        assert_eq!(code, 200, "it goes on serving: {text}");
        if text.contains(words) == is_reported {
            return text;
        }
        tokio::time::sleep(Duration::from_millis(100)).await;
    }
    panic!("/readyz: {}, and {words:?} expected: {is_reported}", get(daemon, "/readyz").1)
}

/// The first history file; the save that writes it follows the update.
async fn history_file(data: &Path) -> PathBuf {
    for _ in 0..600 {
        let names = fs::read_dir(data.join("maps/00000001/history")).into_iter().flatten();
        let paths = names.map(|entry| entry.expect("an entry").path());
        if let Some(file) = paths.filter(|path| path.extension().is_some_and(|extension| extension == "tmh")).min() {
            return file;
        }
        tokio::time::sleep(Duration::from_millis(100)).await;
    }
    panic!("no history was saved")
}

/// A daemon whose map `office` has a door that was observed 200 times, and learned.
async fn with_history(data: &Path) -> Daemon {
    let daemon = Launch::on(data).setting("scrub_every_secs", 1).start();
    create_map(&daemon, "office").await;
    let (mut stream, _) = RawStream::open(&daemon.grpc, hello("robot", "office")).await.expect("a Welcome");
    let rows: Vec<_> = (1..=200).map(|i| (0, i * 60_000_000_000, f64::from(u8::from(i % 3 == 0)))).collect();
    stream.batch(1, columns(&["door"], &rows)).await;
    stream.acknowledged(200).await.expect("taken");
    daemon.client().run_update("office", None).await.expect("an update");
    daemon
}

#[tokio::test(flavor = "multi_thread")]
async fn a_byte_that_flips_under_a_running_daemon_is_reported_and_stops_nothing() {
    let data = tempdir().expect("a folder");
    let daemon = with_history(data.path()).await;
    let file = history_file(data.path()).await;
    let sound = fs::read(&file).expect("readable");
    let mut flipped = sound.clone();
    flipped[sound.len() / 2] ^= 4;
    fs::write(&file, &flipped).expect("writable");
    let name = file.file_name().and_then(|name| name.to_str()).expect("text");
    let text = until_reported(&daemon, name, true).await;
    assert!(text.contains("is damaged"), "{text}");
    assert!(!text.contains(data.path().to_str().expect("text")), "no paths of the machine: {text}");
    assert!(get(&daemon, "/metrics").1.contains("tidemap_damaged_files 1"));
    // Observations and predictions go on.
    let (mut stream, _) = RawStream::open(&daemon.grpc, hello("other", "office")).await.expect("a Welcome");
    stream.batch(1, columns(&["door"], &[(0, 1_000, 1.0)])).await;
    stream.acknowledged(1).await.expect("taken");
    fs::write(&file, &sound).expect("writable");
    until_reported(&daemon, name, false).await;
    assert!(get(&daemon, "/metrics").1.contains("tidemap_damaged_files 0"));
}

#[tokio::test(flavor = "multi_thread")]
async fn a_reply_that_lacks_a_history_file_is_data_loss_with_the_interval() {
    let data = tempdir().expect("a folder");
    let daemon = with_history(data.path()).await;
    let file = history_file(data.path()).await;
    let times = json!({ "map": "office", "state": "door", "fromTime": "1970-01-01T00:00:00Z", "toTime": "1970-01-02T00:00:00Z" });
    let reconstruct = || call(&daemon.http, "QueryService/Reconstruct", &[], &times);
    assert!(!reconstruct().text().contains("error"), "{}", reconstruct().text());
    fs::remove_file(&file).expect("removable");
    // Until the save has ended, the observations are still in memory.
    let mut lacking = reconstruct();
    for _ in 0..600 {
        if !lacking.reason().is_empty() {
            break;
        }
        tokio::time::sleep(Duration::from_millis(100)).await;
        lacking = reconstruct();
    }
    // The reply is a stream, whose status comes first.
    assert_eq!(lacking.reason(), "HISTORY_MISSING", "{}", lacking.text());
    assert!(
        lacking.text().contains("DATA_LOSS") && lacking.text().contains("from 60 to 12000 s"),
        "{}",
        lacking.text()
    );
    assert!(!lacking.text().contains(data.path().to_str().expect("text")), "{}", lacking.text());
}

#[tokio::test(flavor = "multi_thread")]
async fn an_error_repeats_no_long_value() {
    let data = tempdir().expect("a folder");
    let daemon = Launch::on(data.path()).start();
    let answer = call(&daemon.http, "MapService/GetMap", &[], &json!({ "name": "x".repeat(50_000) }));
    assert!(answer.code == 404 || answer.code == 400, "{}", answer.text());
    assert!(answer.body.len() < 10_000, "{} bytes", answer.body.len());
}

#[tokio::test(flavor = "multi_thread")]
async fn a_job_whose_generation_cannot_be_saved_reports_it() {
    let data = tempdir().expect("a folder");
    let daemon = Launch::on(data.path()).start();
    create_map(&daemon, "office").await;
    let (mut stream, _) = RawStream::open(&daemon.grpc, hello("robot", "office")).await.expect("a Welcome");
    stream.batch(1, columns(&["door"], &[(0, 1_000, 1.0), (0, 2_000, 0.0)])).await;
    stream.acknowledged(2).await.expect("taken");
    let folder = data.path().join("maps/00000001/checkpoints");
    fs::rename(&folder, data.path().join("aside")).expect("renamed");
    fs::write(&folder, "no folder").expect("a file");
    let client = daemon.client();
    let id = client.run_update("office", None).await.expect("an update").id;
    let mut job = None;
    for _ in 0..600 {
        job = client.jobs().await.expect("jobs").into_iter().find(|job| job.id == id);
        if job.as_ref().is_some_and(|job| !job.save_error.is_empty()) {
            break;
        }
        tokio::time::sleep(Duration::from_millis(100)).await;
    }
    let job = job.expect("known");
    assert!(job.has_ended() && job.error.is_empty() && job.update.generation == 1, "{job:?}");
    assert!(job.save_error.contains("checkpoints"), "{job:?}");
    let readiness = request(&daemon.http, "GET", "/readyz", &[], b"");
    assert_eq!(readiness.code, 503, "{}", readiness.text());
}

/// Maps that a check of a folder finds fault with, and what it prints.
fn checked(data: &Path) -> (Vec<String>, String) {
    let output = Command::new(tidemapd()).arg("check").arg(data).output().expect("runs");
    let text = String::from_utf8_lossy(&output.stdout).into_owned();
    let maps = text.lines().filter_map(|line| line.strip_prefix("maps/")?.get(..8).map(str::to_owned));
    let maps: Vec<String> = maps.collect();
    assert_eq!(output.status.success(), maps.is_empty(), "{text}");
    (maps, text)
}

#[tokio::test(flavor = "multi_thread")]
async fn a_check_finds_each_map_that_a_start_sets_aside_and_no_other() {
    let here = Path::new(env!("CARGO_MANIFEST_DIR"));
    // The events of the first folder fit no map in part: their layouts are tested, not their sense.
    for (folder, unavailable) in [
        ("../server/store/src/tests/golden/format-1", vec!["00000001"]),
        ("integration/lifecycle/data_of_format_1", vec![]),
    ] {
        let data = tempdir().expect("a folder");
        disk::copy_folder(&here.join(folder), data.path());
        // A loss that was accepted is no finding.
        let _ = fs::remove_file(data.path().join("LOSSES"));
        let (found, text) = checked(data.path());
        assert_eq!(found, unavailable, "{folder}: {text}");
        assert!(found.is_empty() || text.contains("does not fit the map"), "{folder}: {text}");
        let daemon = Launch::on(data.path()).setting("update_at_midnight", false).start();
        let set_aside = daemon.client().all_maps().await.expect("listed").1;
        assert_eq!(set_aside.len(), unavailable.len(), "{folder}: {set_aside:?}");
        daemon.stop_in_order();
    }
}
