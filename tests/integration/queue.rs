//! The durable queue of a robot against a real daemon: a start without a network, kill -9 of both sides, a full queue,
//! a restored backup, and everything that a producer can send.

use std::{
    io::{BufRead as _, BufReader},
    path::Path,
    process::{Command, Stdio},
    time::{Duration, Instant},
};

use rand::Rng as _;
use tempfile::tempdir;
use tidemap_client::{
    Client,
    maps::{CellBox, CellIndex, GridSpec, NewMap, StateKind, StateShape},
    observe::{
        ProducerOptions, QueueError, QueueOptions, QueuedProducer, RefusalReason, SightingReport, TraversalReport,
        occupancy::OccupancyGrid,
        scan::{Isometry3, PointCloud, RangeScan, Scan},
        tiles::{Mask, TileIndex, TileMasks},
    },
};
use tidemap_tests::{
    binaries,
    daemon::{Daemon, Launch, lasting_port},
    rounds,
};

const MAP: &str = "office";
const SECOND: i64 = 1_000_000_000;
const START: i64 = 1_767_614_400 * SECOND;
const PATIENCE: Duration = Duration::from_secs(120);

/// The address stays the same after each restart.
fn launch(data: &Path) -> Launch {
    Launch::on(data).setting("listen", format!("127.0.0.1:{}", lasting_port()))
}

fn options() -> ProducerOptions {
    ProducerOptions::new("robot", "", MAP)
}

fn opened(daemon: &Daemon, folder: &Path) -> QueuedProducer {
    QueuedProducer::open(&daemon.client(), options(), &QueueOptions::new(folder)).expect("a queue")
}

async fn history(client: &Client, state: &str) -> Vec<(i64, f64)> {
    let mut rows = client.reconstruct(MAP, state, 0, i64::MAX).await.expect("the state is there");
    let mut all = Vec::new();
    while let Some(more) = rows.next().await.expect("the daemon responds") {
        all.extend(more);
    }
    all
}

/// Waits until a condition holds.
async fn until(what: &str, goal: impl Fn() -> bool) {
    let since = Instant::now();
    while !goal() {
        assert!(since.elapsed() < PATIENCE, "not within {PATIENCE:?}: {what}");
        tokio::time::sleep(Duration::from_millis(5)).await;
    }
}

fn observed(numbers: impl Iterator<Item = i64>) -> Vec<(i64, f64)> {
    numbers.map(|number| (START + number * SECOND, (number % 2) as f64)).collect()
}

fn send(producer: &QueuedProducer, numbers: impl Iterator<Item = i64>) {
    for (time, value) in observed(numbers) {
        producer.send("door", time, value).expect("taken");
    }
}

/// Runs the program of a robot to its end, or kills it after a time; returns the lines that it wrote.
fn run_program(server: &str, folder: &Path, count: u64, kill_after: Option<Duration>) -> Vec<String> {
    let program = binaries::profile_folder().join("tidemap-queue");
    let mut command = Command::new(program);
    command.arg(server).arg(folder).arg(count.to_string()).stdout(Stdio::piped());
    let mut child = command.spawn().expect("the program of the test is built");
    let lines = BufReader::new(child.stdout.take().expect("stdout is a pipe")).lines();
    let reader = std::thread::spawn(move || lines.map_while(Result::ok).collect());
    if let Some(after) = kill_after {
        std::thread::sleep(after);
        // It may have ended.
        let _ = child.kill();
    }
    child.wait().expect("a child can be waited for");
    reader.join().expect("a reader does not panic")
}

#[tokio::test(flavor = "multi_thread")]
async fn durability_queue_counts_each_observation_once_through_kills_of_program_and_daemon() {
    const COUNT: u64 = 4_000;
    let name = "durability_queue_counts_each_observation_once_through_kills_of_program_and_daemon";
    let mut random = rounds::draws(rounds::seed(name));
    let (data, robot) = (tempdir().expect("a folder"), tempdir().expect("a folder"));
    let launch = launch(data.path());
    let daemon = launch.start();
    let server = daemon.grpc.clone();
    daemon.client().create_map(NewMap { name: MAP.to_owned(), ..NewMap::default() }).await.expect("a new map");
    let mut daemon = Some(daemon);
    let folder = robot.path().join("queue");
    let mut taken = 0;
    for _ in 0..rounds::count("TIDEMAP_KILL_ROUNDS", 6) {
        let program = {
            let (server, folder) = (server.clone(), folder.clone());
            let after = Duration::from_millis(random.random_range(50..600));
            tokio::task::spawn_blocking(move || run_program(&server, &folder, COUNT, Some(after)))
        };
        tokio::time::sleep(Duration::from_millis(random.random_range(0..400))).await;
        match daemon.take() {
            Some(running) => drop(running.kill()),
            None => daemon = Some(launch.start()),
        }
        let lines = program.await.expect("the program ends");
        let last = lines.iter().rev().find_map(|line| line.strip_prefix("taken ")?.parse().ok());
        taken = last.unwrap_or(taken);
    }
    let daemon = daemon.unwrap_or_else(|| launch.start());
    let lines = run_program(&server, &folder, COUNT, None);
    assert_eq!(lines.last().map(String::as_str), Some("durable"), "after {taken}: {lines:?}");
    let expected = observed(1..=i64::try_from(COUNT).expect("small"));
    assert_eq!(history(&daemon.client(), "door").await, expected);
}

#[tokio::test(flavor = "multi_thread")]
async fn a_robot_that_starts_without_a_network_sends_everything_later() {
    let (data, robot) = (tempdir().expect("a folder"), tempdir().expect("a folder"));
    let launch = launch(data.path());
    let server = {
        let daemon = launch.start();
        daemon.client().create_map(NewMap { name: MAP.to_owned(), ..NewMap::default() }).await.expect("a new map");
        daemon.grpc.clone()
    };
    let client = Client::new(&server).expect("an address");
    let open = || QueuedProducer::open(&client, options(), &QueueOptions::new(robot.path())).expect("a queue");
    let producer = open();
    send(&producer, 1..51);
    until("an error", || producer.state().error.is_some()).await;
    let state = producer.state();
    assert_eq!((state.connected, state.waiting, state.oldest_waiting_nanos), (false, 50, Some(START + SECOND)));
    let refused = producer.flush(Duration::from_millis(10)).await;
    assert_eq!(refused, Err(QueueError::StillWaiting { waiting: 50, waited_secs: 0 }));
    producer.close().await.expect("on the disk");
    assert_eq!(producer.send("door", START, 1.0), Err(QueueError::Closed));
    // The next run of the program, with the daemon.
    let producer = open();
    send(&producer, 51..101);
    assert_eq!(producer.state().waiting, 100);
    let daemon = launch.start();
    assert_eq!(producer.flush(PATIENCE).await, Ok(100));
    assert_eq!(history(&daemon.client(), "door").await, observed(1..101));
    let state = producer.state();
    assert_eq!((state.waiting, state.refused, state.lost, state.error), (0, 0, 0, None));
}

#[tokio::test(flavor = "multi_thread")]
async fn everything_that_a_producer_sends_can_be_queued() {
    let (data, robot) = (tempdir().expect("a folder"), tempdir().expect("a folder"));
    let daemon = launch(data.path()).start();
    let client = daemon.client();
    let map = NewMap { name: MAP.to_owned(), grid: Some(GridSpec::new(0.1)), ..NewMap::default() };
    client.create_map(map).await.expect("a new map");
    client.add_categorical(MAP, "room", &["empty".to_owned(), "full".to_owned()]).await.expect("a new state");
    let producer = opened(&daemon, robot.path());
    let at = |second: i64| START + second * SECOND;
    producer.send("door", at(0), 1.0).expect("taken");
    producer.send_label("room", at(1), "empty").expect("taken");
    producer.send_position("anna", at(2), &[1.0, 2.0]).expect("taken");
    let tile = (TileIndex { x: 0, y: 0, z: 0 }, TileMasks::clipped(Mask([3; 8]), Mask([1; 8])));
    producer.send_scan(at(3), Scan::Tiles(vec![tile])).expect("taken");
    let shown = CellBox { min: CellIndex { x: 0, y: 0, z: 0 }, max: CellIndex { x: 8, y: 8, z: 8 } };
    producer.send_scan(at(4), Scan::Map { tiles: vec![tile], shown }).expect("taken");
    let cloud = PointCloud { xyz_m: vec![0.5, 0.5, 0.1], max_range_m: 5.0, ..PointCloud::default() };
    producer.send_scan(at(5), Scan::Cloud(cloud)).expect("taken");
    let ranges = RangeScan { ranges_m: vec![1.0], max_range_m: 5.0, ..RangeScan::default() };
    producer.send_scan(at(6), Scan::Ranges(ranges)).expect("taken");
    let occupancy = OccupancyGrid { pose: Isometry3::identity(), resolution_m: 0.3, width: 2, cells: vec![0, 1] };
    producer.send_grid(at(7), &occupancy).expect("taken");
    // The map has no such edge, and no such place: the daemon refuses them under their numbers.
    let (from, to) = ("hall".to_owned(), "lab".to_owned());
    let driven = TraversalReport { from, to, start_nanos: at(8), end_nanos: at(9), ..TraversalReport::default() };
    producer.send_traversal(&driven).expect("taken");
    let sighting = SightingReport { place: "moon".to_owned(), time_nanos: at(10), ..SightingReport::default() };
    producer.send_sighting(&sighting).expect("taken");
    assert_eq!(producer.send("door", at(11), 0.0), Ok(11));
    assert_eq!(producer.flush(PATIENCE).await, Ok(11));
    let refusals = producer.take_refusals();
    assert_eq!(refusals.iter().map(|one| one.sequence).collect::<Vec<_>>(), [9, 10], "{refusals:?}");
    let state = producer.state();
    assert_eq!((state.refused, state.unsendable, state.durable), (2, 0, 11), "{state:?}");
    let found = client.map(MAP).await.expect("the map");
    assert_eq!(found.grid_summary.map(|summary| summary.scans), Some(5));
    assert_eq!(history(&client, "door").await, [(at(0), 1.0), (at(11), 0.0)]);
}

#[tokio::test(flavor = "multi_thread")]
async fn a_record_that_cannot_be_sent_uses_its_number_and_is_counted() {
    let (data, robot) = (tempdir().expect("a folder"), tempdir().expect("a folder"));
    let daemon = launch(data.path()).start();
    daemon.client().create_map(NewMap { name: MAP.to_owned(), ..NewMap::default() }).await.expect("a new map");
    let of_kind = |kind| ProducerOptions { kind: Some(StateShape::Scalar(kind)), ..options() };
    let queue = QueueOptions::new(robot.path());
    let producer = QueuedProducer::open(&daemon.client(), of_kind(StateKind::Probability), &queue).expect("a queue");
    send(&producer, 1..2);
    // The map has no grid.
    let occupancy = OccupancyGrid { pose: Isometry3::identity(), resolution_m: 0.3, width: 2, cells: vec![0, 1] };
    producer.send_grid(START + 2 * SECOND, &occupancy).expect("taken");
    send(&producer, 3..4);
    assert_eq!(producer.flush(PATIENCE).await, Ok(3));
    let state = producer.state();
    assert_eq!((state.unsendable, state.refused_by_reason), (1, vec![(Some(RefusalReason::StateName), 1)]));
    assert!(state.last_unsendable.contains("no grid"), "{}", state.last_unsendable);
    assert_eq!(history(&daemon.client(), "door").await, observed([1, 3].into_iter()));
}

#[tokio::test(flavor = "multi_thread")]
async fn a_full_queue_keeps_the_oldest_and_refuses_the_newest() {
    let (data, robot) = (tempdir().expect("a folder"), tempdir().expect("a folder"));
    let launch = launch(data.path());
    let daemon = launch.start();
    daemon.client().create_map(NewMap { name: MAP.to_owned(), ..NewMap::default() }).await.expect("a new map");
    let client = daemon.client();
    drop(daemon.kill());
    let queue = QueueOptions { bytes_max: 1_000, ..QueueOptions::new(robot.path()) };
    let producer = QueuedProducer::open(&client, options(), &queue).expect("a queue");
    let mut taken = 0;
    let full = loop {
        let next = taken + 1;
        match producer.send("door", START + next * SECOND, (next % 2) as f64) {
            Ok(_) => taken = next,
            Err(error) => break error,
        }
    };
    assert!(matches!(full, QueueError::Full { bytes_max: 1_000, .. }), "{full}");
    assert!(taken > 10, "{taken}");
    let state = producer.state();
    assert_eq!((state.not_taken, state.bytes_max), (1, 1_000));
    let daemon = launch.start();
    assert_eq!(producer.flush(PATIENCE).await, Ok(u64::try_from(taken).expect("small")));
    // There is room again.
    until("room", || producer.send("door", START + (taken + 1) * SECOND, ((taken + 1) % 2) as f64).is_ok()).await;
    producer.flush(PATIENCE).await.expect("durable");
    assert_eq!(history(&daemon.client(), "door").await, observed(1..taken + 2));
}

#[tokio::test(flavor = "multi_thread")]
async fn a_restored_backup_is_counted_and_sending_goes_on() {
    let (data, robot) = (tempdir().expect("a folder"), tempdir().expect("a folder"));
    let launch = launch(data.path());
    let daemon = launch.start();
    let create = async |daemon: &Daemon| {
        let map = NewMap { name: MAP.to_owned(), ..NewMap::default() };
        daemon.client().create_map(map).await.expect("a new map");
    };
    create(&daemon).await;
    let client = daemon.client();
    // Small files, so that acknowledged ones are removed.
    let queue = QueueOptions { bytes_max: 1_000, ..QueueOptions::new(robot.path()) };
    let producer = QueuedProducer::open(&client, options(), &queue).expect("a queue");
    for number in 1..41 {
        send(&producer, number..number + 1);
        producer.flush(PATIENCE).await.expect("durable");
    }
    // Everything that the daemon had is gone.
    drop(daemon.kill());
    std::fs::remove_dir_all(data.path()).expect("removed");
    let daemon = launch.start();
    create(&daemon).await;
    producer.retry_now();
    send(&producer, 41..44);
    until("a loss", || producer.state().lost > 0).await;
    producer.flush(PATIENCE).await.expect("durable");
    let lost = i64::try_from(producer.state().lost).expect("small");
    assert!(lost < 41, "{lost}");
    assert_eq!(history(&daemon.client(), "door").await, observed(lost + 1..44));
}
