//! A backup that a kill cuts off: the folder keeps the earlier backup, and the next one completes.

use std::path::Path;

use tempfile::tempdir;
use tidemap_client::observe::{Producer, ProducerOptions};
use tidemap_tests::{
    daemon::{Daemon, Launch},
    feed::Feed,
    oracle::{Oracle, run_update},
};

use super::{can_trace, create_map, strace};

async fn observe(daemon: &Daemon, count: i64) {
    let options = ProducerOptions::new("robot", "", "office");
    let mut producer = Producer::open(&daemon.client(), options).await.expect("open");
    for number in 0..count {
        producer.send("door", 1_700_000_000_000_000_000 + number * 60_000_000_000, 1.0).await.expect("sent");
    }
    producer.close().await.expect("durable");
}

/// The observations in a restored backup.
async fn restored(backup: &Path, work: &Path, what: &str) -> u64 {
    let to = work.join("restored");
    let exit =
        Launch::bare().args(["backup".as_ref(), "restore".as_ref(), backup.as_os_str(), to.as_os_str()]).spawn().exit();
    assert_eq!(exit.code(), Some(0), "{what}: {exit}");
    let daemon = Launch::on(&to).start();
    let found = daemon.client().map("office").await.expect("the map").observations;
    daemon.stop_in_order();
    std::fs::remove_dir_all(&to).expect("a copy can be removed");
    found
}

#[tokio::test(flavor = "multi_thread")]
async fn durability_a_backup_that_a_kill_cuts_off_keeps_the_earlier_one() {
    if let Err(reason) = can_trace() {
        return println!("SKIPPED: {reason}");
    }
    let work = tempdir().expect("a folder");
    let (data, backup) = (work.path().join("data"), work.path().join("backup"));
    let launch = Launch::on(&data).setting("segment_bytes", 1 << 16);
    let daemon = launch.start();
    create_map(&daemon, &Oracle::new("office", Feed::new(1), 1)).await;
    observe(&daemon, 1_000).await;
    run_update(&daemon.client(), "office", None).await;
    let folder = backup.display().to_string();
    daemon.client().create_backup(&folder).await.expect("made");
    daemon.stop_in_order();
    let (mut kept, mut total, mut cut_off) = (1_000, 1_000, 0);
    // The daemon itself renames and syncs when it starts: some of the numbers are reached before the backup begins.
    for (round, number) in (0..10).zip([1, 2, 3, 4, 6, 8, 10, 12, 16, 20]) {
        let daemon = launch.start();
        observe(&daemon, 200).await;
        run_update(&daemon.client(), "office", None).await;
        daemon.stop_in_order();
        total += 200;
        let call = ["/^rename", "fsync"][round % 2];
        let inject = format!("inject={call}:signal=KILL:when={number}");
        let what = format!("killed at {call} number {number}");
        let traced =
            launch.clone().under(strace(Path::new("/dev/null"), &["-e", &format!("trace={call}"), "-e", &inject]));
        if let Ok(daemon) = traced.try_start() {
            match daemon.client().create_backup(&folder).await {
                Ok(_) => kept = total,
                Err(_) => cut_off += 1,
            }
            daemon.kill();
        }
        let found = restored(&backup, work.path(), &what).await;
        assert!((kept..=total).contains(&found), "{what}: {found} of {kept} to {total} observations");
    }
    println!("{cut_off} of 10 backups were cut off");
    assert!(cut_off > 0, "the calls or their numbers are wrong");
    let daemon = launch.start();
    daemon.client().create_backup(&folder).await.expect("the next one completes");
    assert_eq!(daemon.client().map("office").await.expect("the map").observations, total);
    daemon.stop_in_order();
    assert_eq!(restored(&backup, work.path(), "the next one").await, total);
}
