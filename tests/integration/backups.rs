//! Backups of a daemon that serves: who may request one, where it goes, and those that the daemon makes by itself.
//!
//! Invariant: nothing outside of the folder of backups is ever written, whoever requests it.

use std::{
    fs,
    os::unix::fs::{MetadataExt as _, symlink},
    path::{Path, PathBuf},
    time::{Duration, Instant},
};

use serde_json::json;
use tempfile::tempdir;
use tidemap_client::{
    Client,
    maps::NewMap,
    observe::{Producer, ProducerOptions},
    updates::{JobCause, JobState},
};
use tidemap_tests::{
    daemon::{Daemon, Launch},
    tokens::Tokens,
    web,
};
use tonic::Code;

/// Automatic actions of the daemon happen within this time, with much room for a busy machine.
const HAPPENS_WITHIN: Duration = Duration::from_secs(120);

async fn eventually(what: &str, mut is_so: impl AsyncFnMut() -> bool) {
    let start = Instant::now();
    while !is_so().await {
        assert!(start.elapsed() < HAPPENS_WITHIN, "not within {} seconds: {what}", HAPPENS_WITHIN.as_secs());
        tokio::time::sleep(Duration::from_millis(100)).await;
    }
}

async fn map_with_observations(client: &Client, count: i64) {
    client.create_map(NewMap { name: "office".to_owned(), ..NewMap::default() }).await.expect("a new map");
    observe(client, "robot", count).await;
    let job = client.run_update("office", None).await.expect("an update");
    eventually("the update", async || client.job(job.id).await.expect("the job").has_ended()).await;
}

async fn observe(client: &Client, producer: &str, count: i64) {
    let mut producer = Producer::open(client, ProducerOptions::new(producer, "", "office")).await.expect("open");
    for number in 0..count {
        producer.send("door", 1_700_000_000_000_000_000 + number * 60_000_000_000, 1.0).await.expect("sent");
    }
    producer.close().await.expect("durable");
}

fn metric(daemon: &Daemon, name: &str) -> Option<f64> {
    let text = web::request(&daemon.http, "GET", "/metrics", &[], b"").text();
    text.lines().find_map(|line| line.strip_prefix(name)?.strip_prefix(' ')?.parse().ok())
}

#[tokio::test(flavor = "multi_thread")]
async fn a_backup_needs_a_token_for_all_maps_and_stays_in_its_folder() {
    let work = tempdir().expect("a folder");
    let (saved, elsewhere) = (work.path().join("saved"), work.path().join("elsewhere"));
    fs::create_dir_all(&elsewhere).expect("made");
    let tokens = Tokens::of(work.path());
    let (all, of_one) = (tokens.create(&["admin"], &[]), tokens.create(&["admin"], &["office"]));
    let launch = Launch::on(&work.path().join("data")).setting("tokens_file", tokens.path.display());
    let client = |daemon: &Daemon, token: &str| Client::with_token(&daemon.grpc, token).expect("loopback");

    let daemon = launch.start();
    map_with_observations(&client(&daemon, &all), 3).await;
    let path = elsewhere.join("x").display().to_string();
    let refused = client(&daemon, &of_one).create_backup(&path).await.expect_err("one map only");
    assert!(refused.code() == Some(Code::PermissionDenied) && refused.to_string().contains("all maps"), "{refused}");
    let refused = client(&daemon, &all).create_backup(&path).await.expect_err("no folder is set");
    assert_eq!(refused.code(), Some(Code::FailedPrecondition));
    assert!(refused.to_string().contains("backup_dir"), "{refused}");
    daemon.stop_in_order();

    let daemon = launch.setting("backup_dir", saved.display()).start();
    let admin = client(&daemon, &all);
    let inside = saved.join("b/c").display().to_string();
    for path in ["a", inside.as_str()] {
        assert_eq!(admin.create_backup(path).await.expect(path).maps, 1);
        assert!(saved.join(path).join("MANIFEST").is_file());
    }
    symlink(&elsewhere, saved.join("link")).expect("a link");
    let inside_and_out = format!("{}/../elsewhere/x", saved.display());
    for path in [path.as_str(), "../elsewhere/x", "a/../../elsewhere/x", "link", "link/x", "", ".", &inside_and_out] {
        let refused = admin.create_backup(path).await.expect_err(path);
        assert_eq!(refused.code(), Some(Code::InvalidArgument), "{path:?}: {refused}");
        assert!(refused.to_string().contains(&saved.display().to_string()), "{path:?}: {refused}");
    }
    assert_eq!(fs::read_dir(&elsewhere).expect("readable").count(), 0, "nothing was written there");
    let refused = client(&daemon, &of_one).create_backup("d").await.expect_err("one map only");
    assert_eq!(refused.code(), Some(Code::PermissionDenied));
    daemon.stop_in_order();
}

#[tokio::test(flavor = "multi_thread")]
async fn without_tokens_and_folder_a_program_of_this_machine_names_any_absolute_folder() {
    let work = tempdir().expect("a folder");
    let daemon = Launch::on(&work.path().join("data")).setting("http_write", true).start();
    let path = work.path().join("saved").display().to_string();
    daemon.client().create_backup(&path).await.expect("made");
    let refused = daemon.client().create_backup("saved").await.expect_err("not absolute");
    assert!(refused.code() == Some(Code::InvalidArgument) && refused.to_string().contains("backup_dir"), "{refused}");
    let over_http = web::call(&daemon.http, "MaintenanceService/CreateBackup", &[], &json!({ "path": path }));
    assert_eq!(over_http.code, 200, "{}", over_http.text());
    daemon.stop_in_order();
}

/// The names of the scheduled backups that are complete, oldest first.
fn complete(folder: &Path) -> Vec<String> {
    let entries = fs::read_dir(folder).into_iter().flatten().flatten();
    let mut names: Vec<String> = entries.filter_map(|entry| entry.file_name().into_string().ok()).collect();
    names.retain(|name| name.starts_with("auto-"));
    names.sort();
    names
}

/// The checkpoints in a backup of one map.
fn checkpoints(backup: &Path) -> Vec<PathBuf> {
    let entries = fs::read_dir(backup.join("maps/00000001/checkpoints")).expect("readable");
    entries.map(|entry| entry.expect("an entry").path()).collect()
}

#[tokio::test(flavor = "multi_thread")]
async fn scheduled_backups_share_what_is_equal_old_ones_go_and_any_can_be_restored() {
    let work = tempdir().expect("a folder");
    let (data, saved) = (work.path().join("data"), work.path().join("saved/deep"));
    // A backup of this daemon that was cut off is completed.
    fs::create_dir_all(saved.join("auto.part/maps")).expect("made");
    let launch = Launch::on(&data).setting("backup_dir", saved.display()).setting("backups_kept", 2);
    let daemon = launch.clone().setting("backup_every_secs", 1).start();
    let client = daemon.client();
    map_with_observations(&client, 100).await;
    let made = async || {
        let jobs = client.jobs().await.expect("jobs");
        let backups = jobs.into_iter().filter(|job| job.cause == JobCause::Backup);
        backups.inspect(|job| assert_eq!((job.map.as_str(), job.error.as_str()), ("", ""))).collect::<Vec<_>>()
    };
    let done = async || made().await.iter().filter(|job| job.state == JobState::Done).count();
    let before = done().await;
    // Old ones go, and what the newest has in common with the one before is on the disk once.
    eventually("three backups", async || done().await >= before + 3).await;
    let shared = |name: &String| {
        checkpoints(&saved.join(name)).iter().any(|file| file.metadata().is_ok_and(|found| found.nlink() > 1))
    };
    eventually("old backups go", async || {
        let names = complete(&saved);
        names.len() == 2 && names.iter().all(shared)
    })
    .await;
    assert!(metric(&daemon, "tidemap_backup_age_seconds").is_some_and(|age| age < 120.0));
    assert_eq!(metric(&daemon, "tidemap_backup_interval_seconds"), Some(1.0));
    assert!(metric(&daemon, "tidemap_backups_total").is_some_and(|count| count >= 3.0));
    daemon.stop_in_order();

    let names = complete(&saved);
    for (number, name) in names.iter().enumerate() {
        let restored = work.path().join(format!("restored-{number}"));
        let (from, to) = (saved.join(name), restored.as_os_str().to_owned());
        let exit = Launch::bare().args(["backup".into(), "restore".into(), from.into_os_string(), to]).spawn().exit();
        assert_eq!(exit.code(), Some(0), "{name}: {exit}");
        let daemon = Launch::on(&restored).start();
        assert_eq!(daemon.client().map("office").await.expect("the map").observations, 100, "{name}");
        daemon.stop_in_order();
    }

    // After a restart the newest backup still counts, so that none is due; files that others put there stay.
    fs::create_dir(saved.join("auto-of-somebody")).expect("made");
    let daemon = launch.setting("backup_every_secs", 100_000).start();
    assert!(metric(&daemon, "tidemap_backup_age_seconds").is_some_and(|age| age < 3_000.0));
    tokio::time::sleep(Duration::from_secs(2)).await;
    assert!(daemon.client().jobs().await.expect("jobs").is_empty());
    assert_eq!(complete(&saved).len(), 3);
    daemon.stop_in_order();

    // Backups of another data folder stay, also one that was cut off in the middle of such.
    fs::create_dir_all(saved.join("auto.part")).expect("made");
    fs::copy(saved.join(&names[1]).join("MANIFEST"), saved.join("auto.part/MANIFEST")).expect("copied");
    let other = Launch::on(&work.path().join("other")).setting("backup_dir", saved.display());
    let daemon = other.setting("backups_kept", 1).setting("backup_every_secs", 1).start();
    eventually("backups of the other", async || metric(&daemon, "tidemap_backups_total") >= Some(3.0)).await;
    daemon.stop_in_order();
    let now = complete(&saved);
    assert!(names.iter().chain(["auto-of-somebody".to_owned()].iter()).all(|name| now.contains(name)), "{now:?}");
    assert!((4..=5).contains(&now.len()), "one of its own, or two: {now:?}");
}

#[tokio::test(flavor = "multi_thread")]
async fn a_scheduled_backup_that_fails_is_reported_and_the_daemon_serves() {
    let work = tempdir().expect("a folder");
    let tokens = Tokens::of(work.path());
    let (all, of_one) = (tokens.create(&["admin"], &[]), tokens.create(&["operator"], &["office"]));
    let no_folder = work.path().join("file");
    fs::write(&no_folder, "in the way").expect("written");
    let launch = Launch::on(&work.path().join("data")).setting("tokens_file", tokens.path.display());
    let daemon = launch.setting("backup_dir", no_folder.display()).setting("backup_every_secs", 3_600).start();
    let client = |token: &str| Client::with_token(&daemon.grpc, token).expect("loopback");
    map_with_observations(&client(&all), 3).await;
    let admin = client(&all);
    let backup = async || admin.jobs().await.expect("jobs").into_iter().find(|job| job.cause == JobCause::Backup);
    eventually("the failure", async || backup().await.is_some_and(|job| job.state == JobState::Failed)).await;
    let failed = backup().await.expect("the job");
    assert!(failed.error.contains("write file: "), "{}", failed.error);
    let seen = client(&of_one).jobs().await.expect("jobs");
    assert!(seen.iter().all(|job| job.map == "office"), "a job of the daemon is not for a token of one map: {seen:?}");
    assert_eq!(client(&of_one).job(failed.id).await.expect_err("unknown to it").code(), Some(Code::NotFound));
    assert_eq!(metric(&daemon, "tidemap_backup_failures_total"), Some(1.0));
    assert_eq!(metric(&daemon, "tidemap_update_failures_total"), Some(0.0));
    assert_eq!(metric(&daemon, "tidemap_backup_age_seconds"), Some(f64::INFINITY), "there is none");
    observe(&client(&all), "robot-2", 3).await;
    assert!(daemon.stop_in_order().contains("the scheduled backup was not made"));
}
