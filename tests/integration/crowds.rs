//! Many clients at once: silent sockets, streams, more requests than the daemon can answer, and a start with a long
//! log.
//!
//! Invariant: whatever the crowd does, the daemon answers those who behave, stays within its memory, and stops in
//! order. Times are printed and not asserted; BENCHMARKS.md has them.

use std::{
    fs,
    net::TcpStream,
    sync::Arc,
    time::{Duration, Instant},
};

use rustix::process::{Resource, Rlimit, getrlimit, setrlimit};
use tempfile::tempdir;
use tidemap_client::{
    Client,
    maps::NewMap,
    observe::{Producer, ProducerOptions},
    queries::ModelSelector,
};
use tidemap_proto::v1::GoodbyeReason;
use tidemap_tests::{
    daemon::{Daemon, Launch},
    rounds,
    stream::{RawStream, columns, hello},
};
use tokio::task::JoinSet;
use tonic::Code;

/// The most memory in a hostile test, in KiB.
const MEMORY_MAX_KIB: u64 = 512 << 10;

/// Raises the limit of descriptors as far as the system allows, also for the daemon that is started then.
fn raise_descriptors() -> u64 {
    let limit = getrlimit(Resource::Nofile);
    let raised = Rlimit { current: limit.maximum, ..limit };
    // A limit that cannot be raised stays.
    let _ = setrlimit(Resource::Nofile, raised);
    getrlimit(Resource::Nofile).current.unwrap_or(u64::MAX)
}

/// The peak of resident memory so far, in KiB.
fn peak_kib(daemon: &Daemon) -> u64 {
    let status = fs::read_to_string(format!("/proc/{}/status", daemon.process().pid())).expect("a process");
    let line = status.lines().find_map(|line| line.strip_prefix("VmHWM:")).expect("its peak");
    line.trim().trim_end_matches(" kB").parse().expect("a number")
}

fn check_memory(daemon: &Daemon, what: &str) {
    let peak = peak_kib(daemon);
    println!("{what}: peak of resident memory {} MiB", peak / 1024);
    assert!(peak <= MEMORY_MAX_KIB, "{what}: {peak} KiB");
}

async fn office(launch: &Launch) -> Daemon {
    let daemon = launch.start();
    let map = NewMap { name: "office".to_owned(), ..NewMap::default() };
    daemon.client().create_map(map).await.expect("a new map");
    daemon
}

/// The time below which this part of the times lies.
fn quantile(times: &mut [Duration], part: f64) -> Duration {
    times.sort_unstable();
    let last = times.len().saturating_sub(1);
    times.get(((last as f64) * part).ceil() as usize).copied().unwrap_or_default()
}

#[tokio::test(flavor = "multi_thread")]
async fn silent_sockets_keep_no_good_client_out() {
    let descriptors = raise_descriptors();
    let count = if descriptors > 5_000 { 2_000 } else { 300 };
    let data = tempdir().expect("a folder");
    let daemon = office(&Launch::on(data.path())).await;
    let held: Vec<TcpStream> = (0..count).map(|_| TcpStream::connect(&daemon.grpc).expect("a connection")).collect();
    let start = Instant::now();
    let client = Client::new(&daemon.grpc).expect("an address");
    client.maps().await.expect("a good client is served");
    println!("{} silent sockets: a good client is served after {:?}", held.len(), start.elapsed());
    check_memory(&daemon, "silent sockets");
    daemon.stop_in_order();
}

#[tokio::test(flavor = "multi_thread")]
async fn a_thousand_streams_are_acknowledged_and_end_in_order() {
    let count = if raise_descriptors() > 5_000 { 1_000 } else { 100 };
    let data = tempdir().expect("a folder");
    let daemon = office(&Launch::on(data.path())).await;
    let mut opening = JoinSet::new();
    for number in 0..count {
        let address = daemon.grpc.clone();
        opening.spawn(async move {
            let (mut stream, _) =
                RawStream::open(&address, hello(&format!("robot-{number}"), "office")).await.expect("open");
            let mut times = Vec::new();
            for round in 0..5_u64 {
                let (rows, first) = ([(0, i64::try_from(round).expect("small") * 1_000, 1.0); 10], round * 10 + 1);
                let sent = Instant::now();
                let names: &[&str] = if round == 0 { &["door"] } else { &[] };
                stream.batch(first, columns(names, &rows)).await;
                stream.acknowledged(first + 9).await.expect("durable");
                times.push(sent.elapsed());
                // About half of what the daemon can take.
                tokio::time::sleep(Duration::from_millis(400)).await;
            }
            (stream, times)
        });
    }
    let (mut streams, mut times) = (Vec::new(), Vec::new());
    while let Some(opened) = opening.join_next().await {
        let (stream, of_stream) = opened.unwrap_or_else(|error| panic!("{error}\n{}", daemon.process().stderr()));
        streams.push(stream);
        times.extend(of_stream);
    }
    println!(
        "{count} streams: acknowledgement p50 {:?}, p99 {:?}",
        quantile(&mut times, 0.5),
        quantile(&mut times, 0.99)
    );
    assert_eq!(daemon.client().map("office").await.expect("the map").observations, count * 50);
    check_memory(&daemon, "streams");
    let start = Instant::now();
    let stopping = tokio::task::spawn_blocking(move || daemon.stop_in_order());
    for stream in &mut streams {
        let goodbye = stream.end().await.goodbye.expect("a stream that is open is told goodbye");
        assert_eq!((goodbye.reason(), goodbye.durable_sequence), (GoodbyeReason::Shutdown, 50));
    }
    let log = stopping.await.expect("stopped");
    println!("clean stop with {count} open streams: {:?}", start.elapsed());
    assert!(!log.contains("panicked"), "{log}");
}

/// One prediction of many times; how long it took, and whether it was refused.
async fn predict(client: Client, times: Arc<Vec<i64>>) -> (Duration, bool) {
    let start = Instant::now();
    let mut runs = client.predict("office", vec!["door".to_owned()], times.to_vec(), ModelSelector::default());
    let mut predicted = 0;
    loop {
        match runs.next().await {
            Ok(Some(run)) => predicted += run.probabilities.len(),
            Ok(None) => break,
            Err(error) => {
                assert_eq!(error.code(), Some(Code::ResourceExhausted), "{error}");
                return (start.elapsed(), true);
            }
        }
    }
    assert_eq!(predicted, times.len());
    (start.elapsed(), false)
}

#[tokio::test(flavor = "multi_thread")]
async fn overload_refuses_and_goes_on() {
    raise_descriptors();
    let data = tempdir().expect("a folder");
    let daemon = office(&Launch::on(data.path())).await;
    let mut producer =
        Producer::open(&daemon.client(), ProducerOptions::new("robot", "", "office")).await.expect("open");
    for hour in 0..500_i64 {
        producer.send("door", hour * 3_600_000_000_000, f64::from(u8::from(hour % 24 > 8))).await.expect("sent");
    }
    producer.flush().await.expect("durable");
    tidemap_tests::oracle::run_update(&daemon.client(), "office", None).await;
    let times = Arc::new((0..20_000).map(|minute| minute * 60_000_000_000_i64).collect::<Vec<_>>());
    let clients: Vec<Client> = (0..8).map(|_| daemon.client()).collect();
    // The capacity of the daemon: eight clients, each with one request after the other.
    let (began, mut running) = (Instant::now(), JoinSet::new());
    for client in &clients {
        let (client, times) = (client.clone(), Arc::clone(&times));
        running.spawn(async move {
            let mut done = 0_u32;
            while began.elapsed() < Duration::from_secs(2) {
                predict(client.clone(), Arc::clone(&times)).await;
                done += 1;
            }
            done
        });
    }
    let done: u32 = running.join_all().await.into_iter().sum();
    let rate = f64::from(done) / began.elapsed().as_secs_f64();
    // Three times as many, whether or not earlier ones have ended.
    let (mut sent, mut running, began) = (0_u32, JoinSet::new(), Instant::now());
    while began.elapsed() < Duration::from_secs(4) {
        while f64::from(sent) < began.elapsed().as_secs_f64() * rate * 3.0 {
            running.spawn(predict(clients[sent as usize % clients.len()].clone(), Arc::clone(&times)));
            sent += 1;
        }
        // The observations go on meanwhile.
        producer.send("door", i64::from(sent) * 1_000, 1.0).await.expect("sent");
        producer.flush().await.expect("durable");
        tokio::time::sleep(Duration::from_millis(2)).await;
    }
    let (mut accepted, mut refused) = (Vec::new(), Vec::new());
    for (time, is_refused) in running.join_all().await {
        if is_refused {
            refused.push(time);
        } else {
            accepted.push(time);
        };
    }
    println!(
        "{rate:.0} requests a second, then three times as many: {} accepted, p50 {:?}, p99 {:?}; {} refused, p99 {:?}",
        accepted.len(),
        quantile(&mut accepted, 0.5),
        quantile(&mut accepted, 0.99),
        refused.len(),
        quantile(&mut refused, 0.99)
    );
    assert!(!accepted.is_empty() && !refused.is_empty(), "it was no overload");
    check_memory(&daemon, "overload");
    predict(daemon.client(), times).await;
    daemon.stop_in_order();
}

#[tokio::test(flavor = "multi_thread")]
async fn a_start_after_a_kill_with_a_long_log_serves_everything() {
    let count = i64::from(rounds::count("TIDEMAP_LONG_LOG", 50_000));
    let data = tempdir().expect("a folder");
    let launch = Launch::on(data.path());
    let daemon = office(&launch).await;
    let mut producer =
        Producer::open(&daemon.client(), ProducerOptions::new("robot", "", "office")).await.expect("open");
    for second in 0..count {
        let name = ["door", "gate", "lift", "window"][usize::try_from(second % 4).expect("small")];
        producer.send(name, second * 1_000_000_000, f64::from(u8::from(second % 3 == 0))).await.expect("sent");
    }
    producer.flush().await.expect("durable");
    daemon.kill();
    let start = Instant::now();
    let daemon = launch.start();
    let ports = start.elapsed();
    assert_eq!(daemon.client().map("office").await.expect("the map").observations, count.unsigned_abs());
    println!(
        "{count} observations in the log, kill -9: ports open after {ports:?}, all answers after {:?}",
        start.elapsed()
    );
    check_memory(&daemon, "a long log");
    daemon.stop_in_order();
}
