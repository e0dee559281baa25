//! A disk that cannot be synced: after the first error its content is unknown.

use std::{ffi::OsString, fs, path::Path};

use tempfile::tempdir;
use tidemap_proto::v1::GoodbyeReason;
use tidemap_tests::{
    daemon::Launch,
    feed::Feed,
    herd::{Herd, Manner},
    oracle::{Mark, Oracle, producer_name},
    stream::{RawStream, feed_columns, hello},
};
use tokio::task::JoinSet;

use super::{can_trace, create_map, strace};

/// strace before a daemon: the calls of fdatasync that `when` names fail; all of them are written to a file.
fn failing(when: &str, calls: &Path) -> Vec<OsString> {
    strace(calls, &["-e", "trace=fdatasync", "-e", &format!("inject=fdatasync:error=EIO:when={when}")])
}

#[tokio::test(flavor = "multi_thread")]
async fn durability_after_a_failed_sync_nothing_is_acknowledged_and_the_daemon_ends() {
    if let Err(reason) = can_trace() {
        return println!("SKIPPED: {reason}");
    }
    let data = tempdir().expect("a folder");
    let launch = Launch::on(data.path());
    let mut oracle = Oracle::new("office", Feed::new(5), 4);
    create_map(&launch.start(), &oracle).await;

    // Fails once and then works again: the daemon must not treat the error as resolved.
    for when in ["25", "40+"] {
        let daemon = launch.clone().under(failing(when, Path::new("/dev/null"))).start();
        let before: u64 = oracle.marks.iter().map(|mark| mark.acknowledged).sum();
        let herd = Herd::start(&daemon.client(), &oracle, Manner::default(), 1);
        let exit = daemon.exit();
        assert_eq!(exit.code(), Some(74), "{when}: {exit}");
        for word in ["storage failed", ".log", "Input/output error"] {
            assert!(exit.stderr.contains(word), "{when}: {word:?} is not in {exit}");
        }
        assert!(!exit.stderr.contains("panicked"), "{exit}");
        assert_eq!(herd.settle(&mut oracle).await.len(), 4, "{when}: a producer did not notice");
        let after: u64 = oracle.marks.iter().map(|mark| mark.acknowledged).sum();
        assert!(after > before, "{when}: nothing was acknowledged before the error, so nothing was tested");

        let daemon = launch.start();
        oracle.verify(&daemon, true).await.unwrap_or_else(|violation| panic!("{when}: {violation}"));
        daemon.stop_in_order();
    }
}

#[tokio::test(flavor = "multi_thread")]
async fn durability_every_open_stream_receives_the_reason_before_the_daemon_ends() {
    if let Err(reason) = can_trace() {
        return println!("SKIPPED: {reason}");
    }
    let data = tempdir().expect("a folder");
    let oracle = Oracle::new("office", Feed::new(8), 16);
    create_map(&Launch::on(data.path()).start(), &oracle).await;
    let daemon = Launch::on(data.path()).under(failing("60", Path::new("/dev/null"))).start();
    let mut streams = JoinSet::new();
    for index in 0..16 {
        let (address, map, feed) = (daemon.grpc.clone(), oracle.map.clone(), oracle.feed);
        streams.spawn(async move {
            let opened = RawStream::open(&address, hello(&producer_name(index), &map)).await;
            let (mut stream, _) = opened.expect("a Welcome");
            let id = u32::try_from(index).expect("small");
            // Some batches are always on their way.
            for next in 1.. {
                stream.batch(next, feed_columns(&[feed.observation(id, next)], feed.states, next == 1)).await;
                if next > 4
                    && let Err(ended) = stream.acknowledged(next - 4).await
                {
                    return ended;
                }
            }
            unreachable!("the disk fails")
        });
    }
    assert_eq!(daemon.exit().code(), Some(74));
    while let Some(ended) = streams.join_next().await {
        let ended = ended.expect("a stream");
        let reason = ended.goodbye.as_ref().map(|goodbye| goodbye.reason());
        // A client that had nothing under way at that moment receives that the daemon stops.
        assert!(matches!(reason, Some(GoodbyeReason::Storage | GoodbyeReason::Shutdown)), "{ended:?}");
    }
}

#[tokio::test(flavor = "multi_thread")]
async fn durability_every_acknowledgement_has_its_sync() {
    if let Err(reason) = can_trace() {
        return println!("SKIPPED: {reason}");
    }
    let work = tempdir().expect("a folder");
    let (data, calls) = (work.path().join("data"), work.path().join("calls"));
    let mut oracle = Oracle::new("office", Feed::new(6), 1);
    create_map(&Launch::on(&data).start(), &oracle).await;

    let daemon = Launch::on(&data).under(failing("20", &calls)).start();
    let opened = RawStream::open(&daemon.grpc, hello(&producer_name(0), &oracle.map)).await;
    let (mut stream, _) = opened.expect("a Welcome");
    let mut acknowledged = 0;
    // One batch is sent at a time, so that no two share a sync.
    let ended = loop {
        let next = acknowledged + 1;
        stream.batch(next, feed_columns(&[oracle.feed.observation(0, next)], oracle.feed.states, next == 1)).await;
        match stream.acknowledged(next).await {
            Ok(_) => acknowledged = next,
            Err(ended) => break ended,
        }
    };
    assert_eq!(ended.goodbye.as_ref().map(|goodbye| goodbye.reason()), Some(GoodbyeReason::Storage), "{ended:?}");
    assert_eq!(daemon.exit().code(), Some(74));
    let calls = fs::read_to_string(&calls).expect("strace wrote down the calls");
    let good = calls.lines().filter(|line| line.trim_end().ends_with("= 0")).count() as u64;
    let bad = calls.lines().filter(|line| line.contains("EIO")).count();
    assert_eq!(bad, 1, "one call failed, and none was made after it: {calls}");
    assert!((1..=good).contains(&acknowledged), "{acknowledged} acknowledgements, {good} good syncs: {calls}");

    oracle.marks[0] = Mark { acknowledged, sent: acknowledged + 1 };
    let daemon = Launch::on(&data).start();
    oracle.verify(&daemon, true).await.unwrap_or_else(|violation| panic!("{violation}"));
}
