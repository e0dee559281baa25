//! Losses are reported by the log, readiness, metrics, the health service and `tidemapd check`, with advice what to do,
//! and nothing hides them; and no second daemon ever writes to a folder that is in use.

use std::{fs, path::Path, time::Duration};

use serde_json::json;
use tempfile::tempdir;
use tidemap_tests::{
    cli::tidemap,
    daemon::{Daemon, Exit, Launch, Signal},
    disk,
    feed::Feed,
    herd::{Herd, Manner},
    oracle::{Oracle, run_update},
    stream::{RawStream, columns, hello},
    web::{call, request},
};
use tonic_health::pb::{HealthCheckRequest, health_check_response::ServingStatus, health_client::HealthClient};

use super::create_map;

fn get(daemon: &Daemon, path: &str) -> (u16, String) {
    let answer = request(&daemon.http, "GET", path, &[], b"");
    (answer.code, answer.text())
}

/// `tidemapd check` on a folder: its exit status and what it prints.
fn check(data: &Path, options: &[&str]) -> (Option<i32>, String) {
    let mut command = std::process::Command::new(tidemap_tests::binaries::tidemapd());
    let output = command.arg("check").args(options).arg(data).output().expect("runs");
    (output.status.code(), String::from_utf8(output.stdout).expect("text"))
}

async fn observe(daemon: &Daemon, map: &str, rows: i64) {
    let (mut stream, _) = RawStream::open(&daemon.grpc, hello("robot", map)).await.expect("a Welcome");
    let values: Vec<_> = (1..=rows).map(|i| (0, i * 60_000_000_000, f64::from(u8::from(i % 3 == 0)))).collect();
    stream.batch(1, columns(&["door"], &values)).await;
    stream.acknowledged(u64::try_from(rows).expect("small")).await.expect("taken");
}

/// A folder with the maps `office` and `home`, both updated, of which `office` has history.
async fn two_maps(data: &Path) {
    let daemon = Launch::on(data).start();
    for map in ["office", "home"] {
        create_map(&daemon, map).await;
        observe(&daemon, map, 200).await;
        run_update(&daemon.client(), map, None).await;
    }
    daemon.stop_in_order();
}

async fn health(daemon: &Daemon) -> ServingStatus {
    let mut health = HealthClient::new(daemon.client().requests());
    health.check(HealthCheckRequest::default()).await.expect("answered").into_inner().status()
}

async fn until_health(daemon: &Daemon, expected: ServingStatus) {
    for _ in 0..600 {
        if health(daemon).await == expected {
            return;
        }
        tokio::time::sleep(Duration::from_millis(100)).await;
    }
    panic!("the health service does not report {expected:?}: {}", get(daemon, "/readyz").1);
}

/// Starts a daemon on the folder. The daemon and a check must report the loss of this file everywhere.
async fn daemon_that_reports(data: &Path, file: &str) -> Daemon {
    let (status, text) = check(data, &[]);
    assert_eq!(status, Some(1), "{text}");
    assert!(text.contains(file) && text.contains("--accept-loss"), "{text}");
    let (status, repaired) = check(data, &["--repair"]);
    assert_eq!((status, repaired), (Some(1), text), "a repair loses nothing, so it hides nothing");
    let daemon = Launch::on(data).start();
    let (code, readiness) = get(&daemon, "/readyz");
    assert!(code == 503 && readiness.contains(file) && readiness.contains("tidemapd check"), "{code}: {readiness}");
    assert!(get(&daemon, "/metrics").1.contains("tidemap_lists_lost 1\n"));
    assert!(daemon.process().stderr().contains(file), "{}", daemon.process().stderr());
    until_health(&daemon, ServingStatus::NotServing).await;
    daemon
}

/// Accepts a loss; everything is ready again, and remembers it.
async fn accept(data: &Path, file: &str) {
    let (status, text) = check(data, &["--accept-loss"]);
    assert!(status == Some(0) && text.contains("accepted as lost"), "{text}");
    let (status, text) = check(data, &[]);
    assert!(status == Some(0) && text.contains("0 problems") && text.contains("accepted as lost on 20"), "{text}");
    let daemon = Launch::on(data).start();
    assert_eq!(get(&daemon, "/readyz"), (200, "ready\n".to_owned()));
    let metrics = get(&daemon, "/metrics").1;
    assert!(metrics.contains("tidemap_lists_lost 0\n") && metrics.contains("tidemap_losses_accepted 1\n"), "{metrics}");
    until_health(&daemon, ServingStatus::Serving).await;
    let log = daemon.stop_in_order();
    assert!(log.contains("accepted as lost") && log.contains(file), "{log}");
}

#[tokio::test(flavor = "multi_thread")]
async fn a_lost_list_of_maps_is_reported_until_the_loss_is_accepted() {
    let data = tempdir().expect("a folder");
    two_maps(data.path()).await;
    fs::remove_file(data.path().join("MAPS")).expect("removable");
    fs::remove_dir_all(data.path().join("maps/00000002")).expect("removable");
    let daemon = daemon_that_reports(data.path(), "MAPS").await;
    let reply = call(&daemon.http, "MapService/GetMap", &[], &json!({ "name": "home" }));
    assert!(reply.text().contains("DATA_LOSS") && reply.text().contains("MAPS"), "{}", reply.text());
    tidemap(&daemon, ["map", "create", "home"]).fails(1, &["MAPS"]);
    assert!(daemon.client().map("office").await.is_ok(), "what is there is served");
    observe(&daemon, "office", 200).await;
    daemon.stop_in_order();
    accept(data.path(), "MAPS").await;
}

#[tokio::test(flavor = "multi_thread")]
async fn a_lost_list_of_history_is_reported_until_the_loss_is_accepted() {
    let data = tempdir().expect("a folder");
    two_maps(data.path()).await;
    let history = data.path().join("maps/00000001/history");
    fs::remove_dir_all(&history).expect("removable");
    fs::remove_file(history.with_file_name("HISTORY")).expect("removable");
    let daemon = daemon_that_reports(data.path(), "maps/00000001/HISTORY").await;
    let times = json!({ "map": "office", "state": "door", "fromTime": "1970-01-01T00:00:00Z", "toTime": "1970-01-02T00:00:00Z" });
    let reply = call(&daemon.http, "QueryService/Reconstruct", &[], &times);
    assert!(reply.text().contains("DATA_LOSS"), "{}", reply.text());
    daemon.stop_in_order();
    accept(data.path(), "maps/00000001/HISTORY").await;
}

#[tokio::test(flavor = "multi_thread")]
async fn a_lost_end_of_a_log_sets_the_map_aside_until_the_loss_is_accepted() {
    let data = tempdir().expect("a folder");
    two_maps(data.path()).await;
    let newest = data.path().join("maps/00000001/log/NEWEST");
    fs::remove_file(&newest).expect("removable");
    let (status, text) = check(data.path(), &["--repair"]);
    assert!(status == Some(1) && text.contains("NEWEST") && text.contains("--accept-loss"), "{text}");
    let daemon = Launch::on(data.path()).start();
    let (_, readiness) = get(&daemon, "/readyz");
    assert!(readiness.contains("map number 1 is unavailable") && readiness.contains("NEWEST"), "{readiness}");
    assert!(get(&daemon, "/metrics").1.contains("tidemap_maps_unavailable 1\n"));
    let reply = call(&daemon.http, "MapService/GetMap", &[], &json!({ "name": "office" }));
    assert!(reply.text().contains("DATA_LOSS"), "{}", reply.text());
    assert!(daemon.client().map("home").await.is_ok());
    let log = daemon.stop_in_order();
    assert!(log.contains("map unavailable") && log.contains("NEWEST") && !newest.exists(), "{log}");
    accept(data.path(), "maps/00000001/log/NEWEST").await;
}

#[tokio::test(flavor = "multi_thread")]
async fn a_missing_checkpoint_index_or_list_of_checkpoints_loses_nothing_and_is_reported() {
    let data = tempdir().expect("a folder");
    two_maps(data.path()).await;
    let sound = check(data.path(), &[]);
    assert_eq!(sound.0, Some(0), "{}", sound.1);
    let folder = data.path().join("maps/00000001");
    let checkpoint =
        fs::read_dir(folder.join("checkpoints")).expect("readable").next().expect("one").expect("an entry");
    fs::remove_file(checkpoint.path()).expect("removable");
    fs::remove_dir_all(data.path().join("index")).expect("removable");
    let name = checkpoint.file_name().into_string().expect("text");
    let (status, text) = check(data.path(), &[]);
    assert!(status == Some(1) && text.contains(&name) && text.contains("index: it is missing"), "{text}");
    assert!(text.contains("nothing is lost") && !text.contains("--accept-loss"), "{text}");
    let daemon = Launch::on(data.path()).start();
    let (code, readiness) = get(&daemon, "/readyz");
    assert!(code == 200 && readiness.contains(&name), "{code}: {readiness}");
    assert!(get(&daemon, "/metrics").1.contains("tidemap_damaged_files 1\n"));
    run_update(&daemon.client(), "office", None).await;
    let log = daemon.stop_in_order();
    assert!(log.contains(&name), "{log}");
    fs::remove_file(folder.join("CHECKPOINTS")).expect("removable");
    let (status, text) = check(data.path(), &["--repair"]);
    assert!(status == Some(0) && text.contains("CHECKPOINTS") && text.contains("repaired"), "{text}");
    assert_eq!(check(data.path(), &[]).0, Some(0));
}

/// The output of a daemon that ends because its storage is no longer its own.
fn ended_for(exit: &Exit, words: &[&str]) {
    assert_eq!(exit.code(), Some(74), "{exit}");
    for word in words {
        assert!(exit.stderr.contains(word), "{word:?} is not in {exit}");
    }
    assert!(!exit.stderr.contains("panicked"), "{exit}");
}

#[tokio::test(flavor = "multi_thread")]
async fn a_second_daemon_is_refused_also_where_the_lock_was_removed_under_load() {
    let data = tempdir().expect("a folder");
    let launch = Launch::on(data.path());
    let first = launch.start();
    let mut oracle = Oracle::new("office", Feed::new(3), 4);
    create_map(&first, "office").await;
    let herd = Herd::start(&first.client(), &oracle, Manner::default(), 1);
    herd.flowing().await;
    // Stopped, so that it cannot notice before the second one has tried.
    first.process().signal(Signal::STOP);
    fs::remove_file(data.path().join("LOCK")).expect("removable");
    let second = launch.try_start().expect_err("the folder is in use");
    assert_eq!(second.code(), Some(73), "{second}");
    first.process().signal(Signal::CONT);
    ended_for(&first.exit(), &["LOCK", "removed or replaced"]);
    assert_eq!(herd.settle(&mut oracle).await.len(), 4, "a producer did not notice");
    let names = disk::files(data.path());
    assert!(names.iter().all(|name| !name.starts_with("index.damaged-1")), "{names:?}");
    let daemon = launch.start();
    oracle.verify(&daemon, true).await.unwrap_or_else(|violation| panic!("{violation}"));
}

#[tokio::test(flavor = "multi_thread")]
async fn a_log_that_is_cut_under_load_or_in_silence_ends_the_daemon() {
    for is_loaded in [true, false] {
        let data = tempdir().expect("a folder");
        let daemon = Launch::on(data.path()).start();
        let mut oracle = Oracle::new("office", Feed::new(4), 2);
        create_map(&daemon, "office").await;
        let herd = is_loaded.then(|| Herd::start(&daemon.client(), &oracle, Manner::default(), 1));
        match &herd {
            Some(herd) => herd.flowing().await,
            None => observe(&daemon, "office", 10).await,
        }
        let log = data.path().join("maps/00000001/log/00000000000000000001.log");
        let file = fs::OpenOptions::new().write(true).open(log).expect("writable");
        file.set_len(file.metadata().expect("known").len() / 2).expect("cut");
        ended_for(&daemon.exit(), &["00000000000000000001.log", "cut or written to by somebody else"]);
        if let Some(herd) = herd {
            assert_eq!(herd.settle(&mut oracle).await.len(), 2, "a producer did not notice");
        }
    }
}

#[tokio::test(flavor = "multi_thread")]
async fn an_empty_folder_in_the_place_of_the_expected_one_is_refused() {
    let work = tempdir().expect("a folder");
    let data = work.path().join("data");
    let daemon = Launch::on(&data).start();
    create_map(&daemon, "office").await;
    let log = daemon.stop_in_order();
    let id = log.split("expect_store_id = \\\"").nth(1).or_else(|| log.split("expect_store_id = \"").nth(1));
    let id = id.and_then(|rest| rest.get(..32)).unwrap_or_else(|| panic!("the log has the id of a new folder: {log}"));
    assert!(check(&data, &[]).1.contains(id));
    let expecting = Launch::on(&data).setting("expect_store_id", id);
    let log = expecting.start().stop_in_order();
    assert!(!log.contains("new data folder"), "{log}");
    // The disk is not mounted.
    fs::rename(&data, work.path().join("elsewhere")).expect("renamed");
    fs::create_dir(&data).expect("created");
    let exit = expecting.try_start().expect_err("the folder is empty");
    assert_eq!(exit.code(), Some(65), "{exit}");
    assert!(exit.stderr.contains(id) && exit.stderr.contains("mounted"), "{exit}");
    assert_eq!(fs::read_dir(&data).expect("readable").count(), 0);
    // Another folder.
    Launch::on(&data).start().stop_in_order();
    assert_eq!(expecting.try_start().expect_err("another folder").code(), Some(65));
}

#[tokio::test(flavor = "multi_thread")]
async fn a_recorded_folder_is_sound_for_a_check_and_can_be_restored() {
    let work = tempdir().expect("a folder");
    let [recorded, restored] = ["recorded", "restored"].map(|name| work.path().join(name));
    let here = Path::new(env!("CARGO_MANIFEST_DIR")).join("integration/lifecycle/data_of_format_1");
    disk::copy_folder(&here, &recorded);
    let (status, text) = check(&recorded, &[]);
    assert_eq!(status, Some(0), "{text}");
    let words = ["backup".as_ref(), "restore".as_ref(), recorded.as_os_str(), restored.as_os_str()];
    let exit = Launch::bare().args(words).spawn().exit();
    assert_eq!(exit.code(), Some(0), "{exit}");
    let daemon = Launch::on(&restored).setting("update_at_midnight", false).start();
    assert!(!daemon.client().all_maps().await.expect("listed").0.is_empty());
    daemon.stop_in_order();
    let (status, text) = check(&restored, &[]);
    assert_eq!(status, Some(0), "{text}");
}
