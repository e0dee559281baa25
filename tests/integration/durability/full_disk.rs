//! A disk that becomes full while the daemon runs.

use std::{
    fs,
    path::Path,
    time::{Duration, Instant},
};

use tempfile::tempdir;
use tidemap_client::{maps::NewMap, observe::ProducerError};
use tidemap_tests::{
    cli,
    daemon::{Daemon, Launch},
    disk::{Unavailable, small_disk},
    feed::Feed,
    herd::{Herd, Manner},
    oracle::{Oracle, run_update},
    rounds,
    web::request,
};

use super::{PRODUCERS, create_map};

const DISK_BYTES: u64 = 24 << 20;
/// Free bytes for the daemon's log while the ballast exists.
const LEFT_BYTES: u64 = 768 << 10;

/// The index is tried again once a minute or more often; beyond this it is never opened.
const RECOVERED_WITHIN: Duration = Duration::from_secs(180);

/// Fills the disk up to `free` bytes. The daemon may be saving meanwhile: if it has taken the space that was free
/// a moment ago, the free space is measured again.
fn fill(ballast: &Path, left_bytes: u64) {
    let file = fs::File::create(ballast).expect("room for a file");
    for _ in 0..20 {
        let available = rustix::fs::fstatvfs(&file).expect("a file system");
        let bytes = (available.f_bavail * available.f_frsize).saturating_sub(left_bytes);
        match rustix::fs::fallocate(&file, rustix::fs::FallocateFlags::empty(), 0, bytes.max(1)) {
            Ok(()) => return,
            Err(rustix::io::Errno::NOSPC) => std::thread::sleep(Duration::from_millis(50)),
            Err(error) => panic!("the ballast cannot be laid: {error}"),
        }
    }
    panic!("the disk is in use all the time");
}

#[tokio::test(flavor = "multi_thread")]
async fn durability_a_full_disk_refuses_loses_nothing_and_recovers() {
    let work = tempdir().expect("a folder");
    let disk = match small_disk(&work.path().join("disk"), DISK_BYTES) {
        Ok(disk) => disk,
        Err(Unavailable(reason)) => return println!("SKIPPED: {reason}"),
    };
    let ballast = disk.folder().join("ballast");
    let launch = Launch::on(&disk.folder().join("data"));
    let daemon = launch.start();
    // A refused value in the feed is not needed here.
    let feed = Feed { refused_every: 0, ..Feed::new(11) };
    let mut oracle = Oracle::new("office", feed, 3);
    create_map(&daemon, &oracle).await;
    let gate = NewMap { name: "gate".to_owned(), ..NewMap::default() };
    daemon.client().create_map(gate).await.expect("a second map");
    let some = Manner { until: 500, ..Manner::default() };
    assert_eq!(Herd::start(&daemon.client(), &oracle, some, 1).settle(&mut oracle).await, []);
    run_update(&daemon.client(), "office", None).await;

    fill(&ballast, LEFT_BYTES);
    let all = Manner { until: 60_000, pause: Duration::ZERO, ..Manner::default() };
    let errors = Herd::start(&daemon.client(), &oracle, all, 2).settle(&mut oracle).await;
    assert!(!errors.is_empty(), "the disk did not get full");
    for error in &errors {
        assert!(matches!(error, ProducerError::Exhausted(detail) if detail.contains("disk is full")), "{error:?}");
    }
    let readiness = || request(&daemon.http, "GET", "/readyz", &[], b"");
    assert_eq!(readiness().code, 503);
    assert!(readiness().text().contains("disk is full"), "{}", readiness().text());
    // Queries still work, and all acknowledged observations are there.
    oracle.verify(&daemon, false).await.unwrap_or_else(|violation| panic!("{violation}"));
    from_the_command_line(&daemon, work.path(), &ballast);

    let errors = Herd::start(&daemon.client(), &oracle, all, 3).settle(&mut oracle).await;
    assert_eq!(errors, [], "there is space again");
    assert_eq!(readiness().code, 200, "{}", readiness().text());
    oracle.verify(&daemon, true).await.unwrap_or_else(|violation| panic!("{violation}"));
    daemon.kill();
    oracle.verify(&launch.start(), true).await.unwrap_or_else(|violation| panic!("{violation}"));
}

#[tokio::test(flavor = "multi_thread")]
async fn durability_a_disk_that_gets_full_again_and_again_loses_nothing() {
    let seed = rounds::seed("durability_a_disk_that_gets_full_again_and_again_loses_nothing");
    let work = tempdir().expect("a folder");
    let disk = match small_disk(&work.path().join("disk"), DISK_BYTES) {
        Ok(disk) => disk,
        Err(Unavailable(reason)) => return println!("SKIPPED: {reason}"),
    };
    let ballast = disk.folder().join("ballast");
    let launch = Launch::on(&disk.folder().join("data")).setting("segment_bytes", 1 << 16);
    let mut daemon = launch.start();
    let mut oracle = Oracle::new("office", Feed::new(seed), PRODUCERS);
    create_map(&daemon, &oracle).await;
    for round in 0..rounds::count("TIDEMAP_FULL_ROUNDS", 24) {
        fill(&ballast, 48 << 10);
        // Some are refused while others were just accepted: their producers must not be mixed up.
        let manner = Manner { pause: Duration::from_millis(1), ..Manner::default() };
        let errors = Herd::start(&daemon.client(), &oracle, manner, seed ^ u64::from(round)).settle(&mut oracle).await;
        assert_eq!(errors.len(), PRODUCERS, "round {round}");
        fs::remove_file(&ballast).expect("the ballast");
        let what = |violation| panic!("round {round}: {violation}");
        oracle.verify(&daemon, false).await.unwrap_or_else(what);
        if round % 2 == 1 {
            daemon.kill();
            daemon = launch.start();
            oracle.verify(&daemon, true).await.unwrap_or_else(what);
        }
    }
}

/// The figure of the index, as Prometheus reads it.
fn is_index_unavailable(daemon: &Daemon) -> bool {
    let metrics = request(&daemon.http, "GET", "/metrics", &[], b"").text();
    let value = metrics.lines().find_map(|line| line.strip_prefix("tidemap_index_unavailable "));
    value.expect("a figure of the index") == "1"
}

#[tokio::test(flavor = "multi_thread")]
async fn durability_a_start_on_a_full_disk_keeps_the_index_and_opens_it_when_there_is_room() {
    let work = tempdir().expect("a folder");
    let disk = match small_disk(&work.path().join("disk"), DISK_BYTES) {
        Ok(disk) => disk,
        Err(Unavailable(reason)) => return println!("SKIPPED: {reason}"),
    };
    let (ballast, data) = (disk.folder().join("ballast"), disk.folder().join("data"));
    let launch = Launch::on(&data);
    let daemon = launch.start();
    let mut oracle = Oracle::new("office", Feed::new(17), PRODUCERS);
    create_map(&daemon, &oracle).await;
    let some = Manner { until: 500, ..Manner::default() };
    assert_eq!(Herd::start(&daemon.client(), &oracle, some, 1).settle(&mut oracle).await, []);
    run_update(&daemon.client(), "office", None).await;
    daemon.stop_in_order();

    fill(&ballast, 0);
    let daemon = launch.start();
    assert!(!data.join("index.damaged-1").exists(), "a sound index is set aside:\n{}", daemon.process().stderr());
    assert!(daemon.process().stderr().contains("continuing without the index"), "{}", daemon.process().stderr());
    let readiness = request(&daemon.http, "GET", "/readyz", &[], b"");
    assert_eq!(readiness.code, 200, "{}", readiness.text());
    assert!(readiness.text().contains("the index cannot be used: No space left"), "{}", readiness.text());
    assert!(is_index_unavailable(&daemon));
    // The map is served from its checkpoint and its log.
    oracle.verify(&daemon, true).await.unwrap_or_else(|violation| panic!("{violation}"));

    fs::remove_file(&ballast).expect("the ballast");
    let since = Instant::now();
    while is_index_unavailable(&daemon) {
        assert!(since.elapsed() < RECOVERED_WITHIN, "the index is not opened:\n{}", daemon.process().stderr());
        std::thread::sleep(Duration::from_millis(200));
    }
    assert!(!data.join("index.damaged-1").exists(), "{}", daemon.process().stderr());
    let readiness = request(&daemon.http, "GET", "/readyz", &[], b"").text();
    assert!(!readiness.contains("index"), "{readiness}");
    daemon.stop_in_order();
    let daemon = launch.start();
    assert!(!daemon.process().stderr().contains("rebuilt the index"), "{}", daemon.process().stderr());
    oracle.verify(&daemon, true).await.unwrap_or_else(|violation| panic!("{violation}"));
}

/// A command fails while the disk is full; repeated as it is, it continues when the disk is not full. Frees the disk.
fn from_the_command_line(daemon: &Daemon, work: &Path, ballast: &Path) {
    const ROWS: u32 = 100_000;
    let file = work.join("more.csv");
    let rows: String =
        (0..ROWS).map(|i| format!("{},gate,0.{:06}\n", 1_600_000_000 + i * 7, i * 7 % 999_983)).collect();
    fs::write(&file, format!("time,state,value\n{rows}")).expect("a file");
    let observe = || cli::tidemap(daemon, ["observe".as_ref(), "gate".as_ref(), file.as_os_str()]);
    observe().fails(1, &["disk is full"]);
    fs::remove_file(ballast).expect("the ballast");
    let result = observe().table();
    assert_eq!(result.number("read"), f64::from(ROWS));
    assert_eq!(result.number("refused"), 0.0);
    assert_eq!(result.number("accepted") + result.number("duplicate"), f64::from(ROWS));
}
