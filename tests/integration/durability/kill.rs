//! kill -9 at random moments: while producers stream, while updates run and are saved, while the daemon starts.

use std::{path::Path, time::Duration};

use rand::{Rng as _, rngs::SmallRng};
use tempfile::tempdir;
use tidemap_client::{Client, observe::ProducerError};
use tidemap_tests::{
    daemon::{Daemon, Launch, lasting_port},
    feed::Feed,
    herd::{Herd, Manner},
    oracle::{Oracle, Violation},
    rounds,
    stored_kinds::{self, StoredKinds},
};
use tokio::task::JoinHandle;

use super::{PRODUCERS, create_map};

/// Small segments, so that kills also hit the change from one segment to the next.
fn launch(data: &Path) -> Launch {
    Launch::on(data).setting("segment_bytes", 1 << 16)
}

/// The parameters of rounds of kills.
#[derive(Clone, Copy)]
pub(crate) struct Rounds {
    pub count: u32,
    /// Whether data time is announced and updates are requested all the time.
    pub updates: bool,
}

/// Streams and kills, round after round. Each round begins with a check of the data that the round before left.
pub(crate) async fn rounds_of_kills(launch: &Launch, rounds: Rounds, seed: u64) -> Result<(), Violation> {
    let mut random = rounds::draws(seed);
    let mut oracle = Oracle::new("office", Feed::new(seed), PRODUCERS);
    create_map(&launch.start(), &oracle).await;
    for round in 0..rounds.count {
        let daemon = launch.start();
        // Without an update the next start has no checkpoint.
        oracle.verify(&daemon, random.random()).await?;
        let manner = Manner { nightly: rounds.updates, ..Manner::default() };
        let herd = Herd::start(&daemon.client(), &oracle, manner, seed ^ u64::from(round));
        let updates = rounds.updates.then(|| ask_for_updates(daemon.client(), oracle.map.clone()));
        herd.flowing().await;
        tokio::time::sleep(Duration::from_millis(random.random_range(0..1_200))).await;
        let exit = daemon.kill();
        assert!(!exit.stderr.contains("panicked"), "{exit}");
        herd.settle(&mut oracle).await;
        if let Some(updates) = updates {
            updates.abort();
        }
        let acknowledged: u64 = oracle.marks.iter().map(|mark| mark.acknowledged).sum();
        println!("round {round}: {acknowledged} acknowledged so far");
    }
    let daemon = launch.start();
    oracle.verify(&daemon, true).await?;
    let log = daemon.stop_in_order();
    assert!(!log.contains("panicked"), "{log}");
    oracle.verify(&launch.start(), true).await
}

/// Updates one after the other, so that a kill hits one, or the saving of one.
fn ask_for_updates(client: Client, map: String) -> JoinHandle<()> {
    tokio::spawn(async move {
        while let Ok(job) = client.run_update(&map, None).await {
            let Ok(mut watch) = client.watch_job(job.id).await else { return };
            while let Ok(Some(_)) = watch.next().await {}
        }
    })
}

#[tokio::test(flavor = "multi_thread")]
async fn durability_kill_while_producers_stream() {
    let seed = rounds::seed("durability_kill_while_producers_stream");
    let data = tempdir().expect("a folder");
    let rounds = Rounds { count: rounds::count("TIDEMAP_KILL_ROUNDS", 5), updates: false };
    let result = rounds_of_kills(&launch(data.path()), rounds, seed).await;
    result.unwrap_or_else(|violation| panic!("{violation}"));
}

#[tokio::test(flavor = "multi_thread")]
async fn durability_kill_while_updates_run_and_are_saved() {
    let seed = rounds::seed("durability_kill_while_updates_run_and_are_saved");
    let data = tempdir().expect("a folder");
    let rounds = Rounds { count: rounds::count("TIDEMAP_KILL_ROUNDS", 5), updates: true };
    let result = rounds_of_kills(&launch(data.path()), rounds, seed).await;
    result.unwrap_or_else(|violation| panic!("{violation}"));
}

#[tokio::test(flavor = "multi_thread")]
async fn durability_kill_while_labels_changes_sightings_tasks_and_plans_are_stored() {
    let seed = rounds::seed("durability_kill_while_labels_changes_sightings_tasks_and_plans_are_stored");
    let mut random = rounds::draws(seed);
    let (data, sound) = (tempdir().expect("a folder"), tempdir().expect("a folder"));
    let (launch, reference) = (launch(data.path()), Launch::on(sound.path()).start());
    let mut daemon = launch.start();
    StoredKinds::create(&reference);
    let mut kinds = StoredKinds::create(&daemon);
    for round in 0..rounds::count("TIDEMAP_KILL_ROUNDS", 5) {
        let before = kinds.acknowledged();
        let senders = kinds.start(&daemon.client(), u64::MAX);
        let updates = ask_for_updates(daemon.client(), stored_kinds::MAP.to_owned());
        tokio::time::sleep(Duration::from_millis(random.random_range(300..1_500))).await;
        let exit = daemon.kill();
        assert!(!exit.stderr.contains("panicked"), "{exit}");
        kinds.settle(senders).await;
        updates.abort();
        let acknowledged = kinds.acknowledged();
        println!("round {round}: {acknowledged:?} acknowledged");
        assert!(acknowledged.iter().sum::<u64>() > before.iter().sum(), "round {round}: nothing was acknowledged");
        daemon = launch.start();
        kinds.verify(&daemon, &reference).await.unwrap_or_else(|violation| panic!("round {round}: {violation}"));
    }
    let log = daemon.stop_in_order();
    assert!(!log.contains("panicked"), "{log}");
    kinds.verify(&launch.start(), &reference).await.unwrap_or_else(|violation| panic!("{violation}"));
}

/// Starts the daemon and kills it before it is ready.
fn kill_while_starting(launch: &Launch, random: &mut SmallRng) {
    let process = launch.spawn();
    std::thread::sleep(Duration::from_millis(random.random_range(0..400)));
    let exit = process.kill();
    assert!(!exit.stderr.contains("panicked"), "{exit}");
}

#[tokio::test(flavor = "multi_thread")]
async fn durability_kill_while_the_daemon_starts() {
    let seed = rounds::seed("durability_kill_while_the_daemon_starts");
    let mut random = rounds::draws(seed);
    let data = tempdir().expect("a folder");
    let launch = launch(data.path());
    // The first start creates the folder.
    for _ in 0..3 {
        kill_while_starting(&launch, &mut random);
    }
    let mut oracle = Oracle::new("office", Feed::new(seed), PRODUCERS);
    let mut daemon = launch.start();
    create_map(&daemon, &oracle).await;
    for round in 0..rounds::count("TIDEMAP_KILL_ROUNDS", 5).div_ceil(2) {
        let manner = Manner { nightly: random.random(), ..Manner::default() };
        let herd = Herd::start(&daemon.client(), &oracle, manner, seed ^ u64::from(round));
        herd.flowing().await;
        tokio::time::sleep(Duration::from_millis(300)).await;
        daemon.kill();
        herd.settle(&mut oracle).await;
        for _ in 0..4 {
            kill_while_starting(&launch, &mut random);
        }
        daemon = launch.start();
        oracle.verify(&daemon, random.random()).await.unwrap_or_else(|violation| panic!("{violation}"));
    }
}

async fn restarted(launch: &Launch, daemon: Daemon) -> Daemon {
    daemon.kill();
    tokio::time::sleep(Duration::from_millis(100)).await;
    launch.start()
}

#[tokio::test(flavor = "multi_thread")]
async fn durability_producers_reconnect_by_themselves_and_lose_nothing() {
    let seed = rounds::seed("durability_producers_reconnect_by_themselves_and_lose_nothing");
    let mut random = rounds::draws(seed);
    let data = tempdir().expect("a folder");
    // The address stays the same after each restart.
    let launch = launch(data.path()).setting("listen", format!("127.0.0.1:{}", lasting_port()));
    let mut daemon = launch.start();
    let mut oracle = Oracle::new("office", Feed::new(seed), PRODUCERS);
    create_map(&daemon, &oracle).await;
    let until = 3_000 + 600 * u64::from(rounds::count("TIDEMAP_KILL_ROUNDS", 5));
    let patience = Duration::from_secs(120);
    let manner = Manner { nightly: true, patience, until, pause: Duration::from_millis(40) };
    let herd = Herd::start(&daemon.client(), &oracle, manner, seed);
    herd.flowing().await;
    for _ in 0..rounds::count("TIDEMAP_KILL_ROUNDS", 5) {
        tokio::time::sleep(Duration::from_millis(random.random_range(50..700))).await;
        daemon = restarted(&launch, daemon).await;
    }
    let errors: Vec<ProducerError> = herd.settle(&mut oracle).await;
    assert_eq!(errors, [], "a producer gave up");
    for mark in &oracle.marks {
        assert_eq!((mark.acknowledged, mark.sent), (until, until));
    }
    oracle.verify(&daemon, true).await.unwrap_or_else(|violation| panic!("{violation}"));
    oracle.verify(&restarted(&launch, daemon).await, true).await.unwrap_or_else(|violation| panic!("{violation}"));
}
