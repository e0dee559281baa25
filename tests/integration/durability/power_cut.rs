//! Power cuts: a copy of the daemon's disk without the data that the kernel has not yet written.

use std::time::Duration;

use rand::Rng as _;
use tempfile::tempdir;
use tidemap_tests::{
    daemon::{Launch, Signal},
    disk::{CutDisk, Unavailable},
    feed::Feed,
    herd::{Herd, Manner},
    oracle::{Oracle, Violation, run_update},
    rounds,
};

use super::{PRODUCERS, create_map};

/// Attempts to take a copy during which nothing is written.
const CUTS_MAX: u32 = 10;

/// One power cut under a daemon that eight producers stream to. `Ok(false)`: no copy was clean.
pub(crate) async fn power_cut(
    launch: impl Fn(&std::path::Path) -> Launch,
    seed: u64,
) -> Result<Result<bool, Violation>, Unavailable> {
    let mut random = rounds::draws(seed);
    let folder = tempdir().expect("a folder");
    let disk = CutDisk::new(folder.path())?;
    let mut oracle = Oracle::new("office", Feed::new(seed), PRODUCERS);
    let launch_here = launch(&disk.folder().join("data"));
    let mut daemon = launch_here.start();
    create_map(&daemon, &oracle).await;
    if random.random() {
        // An earlier run, so that the cut also hits older data.
        let manner = Manner { until: random.random_range(1..2_000), ..Manner::default() };
        Herd::start(&daemon.client(), &oracle, manner, seed ^ 1).settle(&mut oracle).await;
        run_update(&daemon.client(), &oracle.map, None).await;
        daemon.stop_in_order();
        daemon = launch_here.start();
    }
    let herd = Herd::start(&daemon.client(), &oracle, Manner { nightly: random.random(), ..Manner::default() }, seed);
    herd.flowing().await;
    if random.random() {
        run_update(&daemon.client(), &oracle.map, None).await;
    }
    tokio::time::sleep(Duration::from_millis(random.random_range(0..2_000))).await;
    daemon.process().signal(Signal::STOP);
    // Data that the daemon gave to the disk arrives. Acknowledgements on their way arrive too, and count.
    tokio::time::sleep(Duration::from_millis(200)).await;
    let Some(cut) = disk.cut() else {
        daemon.kill();
        return Ok(Ok(false));
    };
    daemon.kill();
    herd.settle(&mut oracle).await;
    let found = match launch(&cut.folder().join("data")).try_start() {
        Ok(found) => found,
        Err(exit) => panic!("after a power cut the daemon does not start: {exit}"),
    };
    let result = oracle.verify(&found, true).await;
    let log = found.stop_in_order();
    assert!(!log.contains("panicked"), "{log}");
    Ok(result.map(|()| true))
}

/// `count` clean cuts, or the first violation.
pub(crate) async fn power_cuts(
    launch: impl Fn(&std::path::Path) -> Launch,
    count: u32,
    seed: u64,
) -> Result<Result<(), Violation>, Unavailable> {
    let mut clean = 0;
    for attempt in 0..count + CUTS_MAX {
        match power_cut(&launch, seed ^ u64::from(attempt) << 40).await? {
            Ok(true) => clean += 1,
            Ok(false) => println!("cut {attempt}: something was still written; once more"),
            Err(violation) => return Ok(Err(violation)),
        }
        if clean == count {
            return Ok(Ok(()));
        }
    }
    panic!("{clean} of {count} cuts were clean");
}

#[tokio::test(flavor = "multi_thread")]
async fn durability_power_cuts_lose_nothing_acknowledged() {
    let seed = rounds::seed("durability_power_cuts_lose_nothing_acknowledged");
    let count = rounds::count("TIDEMAP_POWERCUT_ROUNDS", 2);
    match power_cuts(|data| Launch::on(data).setting("segment_bytes", 1 << 17), count, seed).await {
        Ok(result) => result.unwrap_or_else(|violation| panic!("{violation}")),
        Err(Unavailable(reason)) => println!("SKIPPED: {reason}"),
    }
}
