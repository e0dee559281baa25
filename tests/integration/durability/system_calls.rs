//! kill -9 at chosen system calls: just before a write, a sync, a rename or a removal takes place.

use std::path::Path;

use rand::{Rng as _, seq::IndexedRandom as _};
use tempfile::tempdir;
use tidemap_tests::{
    daemon::{Daemon, Launch},
    feed::Feed,
    oracle::{Mark, Oracle, producer_name},
    rounds,
    stream::{RawStream, feed_columns, hello},
};

use super::{can_trace, strace};

/// Calls that change the disk, and about how many of them one thread makes in a run.
const CALLS: [(&str, u32); 8] = [
    ("write", 60),
    ("pwrite64", 6),
    ("fdatasync", 25),
    ("fsync", 12),
    ("sync_file_range", 6),
    ("/^rename", 4),
    ("/^mkdir", 8),
    ("/^unlink", 3),
];
const BATCHES: u64 = 15;
const MAP: &str = "office";

/// The acknowledged steps of a run.
#[derive(Default)]
struct Reached {
    created: bool,
    killed: bool,
}

/// Creates a map, observes, updates, observes, stops, until the daemon is killed. Records the acknowledgements.
async fn run(daemon: Daemon, oracle: &mut Oracle) -> Reached {
    let client = daemon.client();
    let map = tidemap_client::maps::NewMap { name: MAP.to_owned(), ..tidemap_client::maps::NewMap::default() };
    let created = client.create_map(map).await.is_ok();
    if created {
        observe(&daemon, oracle).await;
        if let Ok(job) = client.run_update(MAP, None).await
            && let Ok(mut watch) = client.watch_job(job.id).await
        {
            while let Ok(Some(_)) = watch.next().await {}
        }
        observe(&daemon, oracle).await;
    }
    // Some calls are made only during the stop, and some numbers are never reached.
    Reached { created, killed: daemon.stop().code().is_none() }
}

async fn observe(daemon: &Daemon, oracle: &mut Oracle) {
    let Ok((mut stream, welcome)) = RawStream::open(&daemon.grpc, hello(&producer_name(0), MAP)).await else { return };
    let mark = &mut oracle.marks[0];
    for batch in 0..BATCHES {
        let first = welcome.durable_sequence + 1 + batch * 10;
        let observations: Vec<_> = (first..first + 10).map(|sequence| oracle.feed.observation(0, sequence)).collect();
        mark.sent = first + 9;
        stream.batch(first, feed_columns(&observations, oracle.feed.states, batch == 0)).await;
        match stream.acknowledged(mark.sent).await {
            Ok(_) => mark.acknowledged = mark.sent,
            Err(_) => return,
        }
    }
    stream.close();
    stream.end().await;
}

#[tokio::test(flavor = "multi_thread")]
async fn durability_kill_at_chosen_system_calls() {
    if let Err(reason) = can_trace() {
        return println!("SKIPPED: {reason}");
    }
    let seed = rounds::seed("durability_kill_at_chosen_system_calls");
    let mut random = rounds::draws(seed);
    let (mut killed, mut acknowledged) = (0, 0);
    let count = rounds::count("TIDEMAP_CALL_KILLS", 24);
    for round in 0..count {
        let (call, max_number) = CALLS[round as usize % CALLS.len()];
        // Early calls are chosen more often, because each of them does something different.
        let max_number = *[max_number, max_number.div_ceil(4)].choose(&mut random).expect("two of them");
        let number = random.random_range(1..=max_number);
        let inject = format!("inject={call}:signal=KILL:when={number}");
        let what = format!("killed at {call} number {number}");
        let data = tempdir().expect("a folder");
        let launch = Launch::on(data.path()).setting("segment_bytes", 1 << 16);
        let mut oracle = Oracle::new(MAP, Feed::new(seed ^ u64::from(round)), 1);
        oracle.marks[0] = Mark::default();
        let traced =
            launch.clone().under(strace(Path::new("/dev/null"), &["-e", &format!("trace={call}"), "-e", &inject]));
        let reached = match traced.try_start() {
            Ok(daemon) => run(daemon, &mut oracle).await,
            Err(exit) => {
                assert_eq!(exit.code(), None, "{what}: {exit}");
                Reached { created: false, killed: true }
            }
        };
        killed += u32::from(reached.killed);
        check(&launch, &what, reached.created, &mut oracle).await;
        acknowledged += u32::from(oracle.marks[0].acknowledged > 0);
    }
    println!("{killed} of {count} runs were killed, {acknowledged} had acknowledged something");
    assert!(killed >= count / 3 && acknowledged > 0, "the calls or their numbers are wrong");
}

/// The daemon starts without help and has all acknowledged observations.
async fn check(launch: &Launch, what: &str, created: bool, oracle: &mut Oracle) {
    let daemon = launch.try_start().unwrap_or_else(|exit| panic!("{what}, the daemon does not start: {exit}"));
    let maps = daemon.client().maps().await.expect("the daemon responds");
    if created || !maps.is_empty() {
        oracle.verify(&daemon, true).await.unwrap_or_else(|violation| panic!("{what}: {violation}"));
    }
    let log = daemon.stop_in_order();
    assert!(!log.contains("panicked"), "{what}: {log}");
}
