//! Producers that will not come back: their places are free, and what they sent keeps its numbers.
//!
//! Invariant: exactly once holds whatever is forgotten, also after `kill -9` and from a checkpoint.

use tempfile::{TempDir, tempdir};
use tidemap_client::{Client, maps::NewMap};
use tidemap_proto::v1::Hello;
use tidemap_tests::{
    cli,
    daemon::{Daemon, Launch},
    oracle::run_update,
    stream::{RawStream, columns, hello},
    tokens::Tokens,
};
use tonic::Code;

/// A daemon whose maps have two places for producers.
async fn two_places() -> (TempDir, Launch, Daemon) {
    let data = tempdir().expect("a folder");
    let launch = Launch::on(data.path()).setting("max_producers_per_map", 2);
    let daemon = launch.start();
    let map = NewMap { name: "office".to_owned(), ..NewMap::default() };
    daemon.client().create_map(map).await.expect("a new map");
    (data, launch, daemon)
}

/// Sends two observations as a producer, from the first on; gives its incarnation and how many were there before.
async fn send_two(daemon: &Daemon, hello: Hello) -> (u64, u64) {
    let (mut stream, welcome) = RawStream::open(&daemon.grpc, hello).await.expect("a Welcome");
    stream.batch(1, columns(&["door"], &[(0, 1_000, 1.0), (0, 2_000, 0.0)])).await;
    stream.acknowledged(2).await.expect("durable");
    stream.close();
    assert!(stream.end().await.status.is_none(), "a stream may end in order");
    (welcome.incarnation, welcome.durable_sequence)
}

async fn observations(client: &Client) -> u64 {
    client.map("office").await.expect("the map").observations
}

async fn known(client: &Client) -> Vec<String> {
    let known = client.producers("office").await.expect("a list");
    known.into_iter().filter(|known| !known.is_forgotten).map(|known| known.producer).collect()
}

/// The error with which a stream of a producer that has no place ends.
async fn refused(daemon: &Daemon, hello: Hello) -> tonic::Status {
    RawStream::open(&daemon.grpc, hello).await.expect_err("no Welcome").error()
}

#[tokio::test(flavor = "multi_thread")]
async fn a_forgotten_producer_frees_its_place_and_keeps_its_numbers() {
    let (_data, launch, daemon) = two_places().await;
    let (incarnation, _) = send_two(&daemon, hello("gone", "office")).await;
    send_two(&daemon, hello("stays", "office")).await;
    let full = refused(&daemon, hello("new", "office")).await;
    assert!(full.code() == Code::ResourceExhausted && full.message().contains("max_producers_per_map"), "{full:?}");

    let client = daemon.client();
    let unknown = client.forget_producer("office", "nobody", None).await.expect_err("unknown");
    assert_eq!(unknown.code(), Some(Code::NotFound), "{unknown}");
    let (open, _) = RawStream::open(&daemon.grpc, hello("gone", "office")).await.expect("a Welcome");
    let streams = client.forget_producer("office", "gone", None).await.expect_err("it streams");
    assert_eq!(streams.code(), Some(Code::FailedPrecondition), "{streams}");
    drop(open);
    let forgotten = loop {
        match client.forget_producer("office", "gone", Some("")).await {
            Ok(forgotten) => break forgotten,
            Err(error) => assert_eq!(error.code(), Some(Code::FailedPrecondition), "{error}"),
        }
    };
    assert_eq!(forgotten, 1);
    assert_eq!(known(&client).await, ["stays"]);
    assert_eq!(observations(&client).await, 4, "what it sent stays");

    // The change survives a kill, and comes from a checkpoint.
    daemon.kill();
    let daemon = launch.start();
    assert_eq!(known(&daemon.client()).await, ["stays"]);
    run_update(&daemon.client(), "office", None).await;
    daemon.stop_in_order();
    let daemon = launch.start();
    assert_eq!(known(&daemon.client()).await, ["stays"]);

    // The producer comes back to the free place: as a new incarnation, behind its earlier observations.
    let old = refused(&daemon, Hello { incarnation, ..hello("gone", "office") }).await;
    assert!(old.code() == Code::Aborted && old.message().contains("was forgotten"), "{old:?}");
    let (again, durable) = send_two(&daemon, hello("gone", "office")).await;
    assert!(again > incarnation + 1 && durable == 2, "{incarnation} {again} {durable}");
    assert_eq!(observations(&daemon.client()).await, 4, "numbers that are known are no news");
    let (mut stream, _) = RawStream::open(&daemon.grpc, hello("gone", "office")).await.expect("a Welcome");
    stream.batch(3, columns(&["door"], &[(0, 3_000, 1.0)])).await;
    stream.acknowledged(3).await.expect("durable");
    assert_eq!(known(&daemon.client()).await, ["gone", "stays"]);
    let full = refused(&daemon, hello("new", "office")).await;
    assert!(full.message().contains("max_producers_per_map"), "{full:?}");
    daemon.stop_in_order();
}

#[tokio::test(flavor = "multi_thread")]
async fn the_command_line_forgets_all_labels_of_a_producer() {
    let (_data, _launch, daemon) = two_places().await;
    for label in ["one", "two"] {
        send_two(&daemon, Hello { label: label.to_owned(), ..hello("importer", "office") }).await;
    }
    let done = cli::command(&daemon.grpc, ["producer", "forget", "office", "importer"]).output().expect("tidemap runs");
    let text = String::from_utf8_lossy(&done.stdout).into_owned();
    assert!(done.status.success() && text.contains("importer") && text.contains('2'), "{text} {done:?}");
    send_two(&daemon, hello("new", "office")).await;
    assert_eq!(known(&daemon.client()).await, ["new"]);
    daemon.stop_in_order();
}

#[tokio::test(flavor = "multi_thread")]
async fn one_token_leaves_places_of_producers_to_others_also_after_a_restart() {
    let work = tempdir().expect("a folder");
    let tokens = Tokens::of(work.path());
    let [greedy, other] = [(); 2].map(|()| tokens.create(&["admin"], &[]));
    let launch = Launch::on(&work.path().join("data"))
        .setting("tokens_file", tokens.path.display())
        .setting("max_producers_per_map", 3)
        .setting("max_producers_per_client", 2);
    let mut daemon = launch.start();
    let client = |daemon: &Daemon, token: &str| Client::with_token(&daemon.grpc, token).expect("loopback");
    let map = NewMap { name: "office".to_owned(), ..NewMap::default() };
    client(&daemon, &greedy).create_map(map).await.expect("a new map");
    for label in ["one", "two"] {
        let hello = Hello { label: label.to_owned(), ..hello("robot", "office") };
        let mut stream = RawStream::open_as(&client(&daemon, &greedy), hello).await.expect("its share");
        stream.batch(1, columns(&["door"], &[(0, 1_000, 1.0)])).await;
        stream.acknowledged(1).await.expect("durable");
    }
    for _ in 0..2 {
        let hello = Hello { label: "three".to_owned(), ..hello("robot", "office") };
        let refused = RawStream::open_as(&client(&daemon, &greedy), hello).await.expect_err("its share is taken");
        assert_eq!(refused.code(), Code::ResourceExhausted, "{refused:?}");
        assert!(refused.message().contains("max_producers_per_client"), "{refused:?}");
        daemon.kill();
        daemon = launch.start();
    }
    let stream = RawStream::open_as(&client(&daemon, &other), hello("other", "office")).await;
    let mut stream = stream.expect("the place of others");
    stream.batch(1, columns(&["door"], &[(0, 1_000, 1.0)])).await;
    stream.acknowledged(1).await.expect("durable");
    daemon.stop_in_order();
}
