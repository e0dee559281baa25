//! Starting, stopping and refusing: what an operator sees of the daemon.

mod connections;
mod damage;
mod losses;
mod ports;
mod recorded_data;
mod settings;
mod silent_streams;
mod texts;

use std::{fs, net::TcpStream};

use tempfile::tempdir;
use tidemap_client::maps::NewMap;
use tidemap_proto::v1::{GoodbyeReason, observe_response::Message};
use tidemap_tests::{
    daemon::{Daemon, Launch},
    disk,
    feed::Feed,
    herd::{Herd, Manner},
    oracle::Oracle,
    stream::{RawStream, columns, hello},
};

async fn create_map(daemon: &Daemon, name: &str) {
    let map = NewMap { name: name.to_owned(), ..NewMap::default() };
    daemon.client().create_map(map).await.expect("a new map");
}

#[tokio::test(flavor = "multi_thread")]
async fn a_stop_is_orderly_whatever_clients_do() {
    let data = tempdir().expect("a folder");
    let launch = Launch::on(data.path());
    let daemon = launch.start();
    create_map(&daemon, "office").await;
    let mut oracle = Oracle::new("office", Feed::new(1), 4);

    let silent = TcpStream::connect(&daemon.grpc).expect("the port is open");
    let mute = RawStream::silent(&daemon.grpc).await.expect("a stream without a Hello");
    let (mut idle, _) = RawStream::open(&daemon.grpc, hello("idle", "office")).await.expect("a Welcome");
    let herd = Herd::start(&daemon.client(), &oracle, Manner::default(), 1);
    herd.flowing().await;

    let log = daemon.stop_in_order();
    assert!(!log.contains("panicked"), "{log}");
    let ended = idle.end().await;
    let goodbye = ended.goodbye.expect("a stream that is open is told goodbye");
    assert_eq!(goodbye.reason(), GoodbyeReason::Shutdown);
    drop((silent, mute));
    let errors = herd.settle(&mut oracle).await;
    assert_eq!(errors.len(), 4, "the import was under way");
    assert!(oracle.marks.iter().any(|mark| mark.acknowledged > 0));

    let daemon = launch.start();
    oracle.verify(&daemon, true).await.unwrap_or_else(|violation| panic!("{violation}"));
    daemon.stop_in_order();
}

#[test]
fn a_stop_right_after_the_start_waits_for_nobody() {
    let data = tempdir().expect("a folder");
    for _ in 0..8 {
        // Stopped before its ports have served anything.
        let log = Launch::on(data.path()).start().stop_in_order();
        assert!(log.contains("stopped") && !log.contains("are cut"), "nobody is connected: {log}");
    }
}

#[tokio::test(flavor = "multi_thread")]
async fn a_stop_acknowledges_what_was_taken_before() {
    let data = tempdir().expect("a folder");
    let launch = Launch::on(data.path());
    let daemon = launch.start();
    create_map(&daemon, "office").await;
    let (mut stream, _) = RawStream::open(&daemon.grpc, hello("robot", "office")).await.expect("a Welcome");
    stream.batch(1, columns(&["door"], &[(0, 1_000, 1.0), (0, 2_000, 0.0)])).await;
    let acknowledged = stream.acknowledged(2).await.expect("both are taken");
    assert_eq!(acknowledged, []);
    daemon.stop_in_order();
    let daemon = launch.start();
    let (_, welcome) = RawStream::open(&daemon.grpc, hello("robot", "office")).await.expect("a Welcome");
    assert_eq!(welcome.durable_sequence, 2);
    assert_eq!(daemon.client().map("office").await.expect("the map").observations, 2);
}

#[tokio::test(flavor = "multi_thread")]
async fn the_store_keeps_its_identity_and_incarnations_go_up() {
    let data = tempdir().expect("a folder");
    let launch = Launch::on(data.path());
    let daemon = launch.start();
    create_map(&daemon, "office").await;
    let (mut stream, first) = RawStream::open(&daemon.grpc, hello("robot", "office")).await.expect("a Welcome");
    stream.batch(1, columns(&["door"], &[(0, 1_000, 1.0)])).await;
    stream.acknowledged(1).await.expect("taken");
    daemon.kill();
    let daemon = launch.start();
    let (_, second) = RawStream::open(&daemon.grpc, hello("robot", "office")).await.expect("a Welcome");
    assert_eq!(first.store_id, second.store_id);
    assert_eq!(first.store_id.len(), 32);
    assert!(second.incarnation > first.incarnation, "{} after {}", second.incarnation, first.incarnation);
}

#[tokio::test(flavor = "multi_thread")]
async fn a_second_daemon_on_the_same_data_is_refused_and_harms_nothing() {
    let data = tempdir().expect("a folder");
    let launch = Launch::on(data.path());
    let first = launch.start();
    create_map(&first, "office").await;
    let (mut stream, _) = RawStream::open(&first.grpc, hello("robot", "office")).await.expect("a Welcome");
    stream.batch(1, columns(&["door"], &[(0, 1_000, 1.0)])).await;
    stream.acknowledged(1).await.expect("taken");

    let exit = launch.try_start().expect_err("the data is in use");
    assert_eq!(exit.code(), Some(73), "{exit}");
    let pid = format!("pid {}", first.process().pid());
    assert!(exit.stderr.contains(&pid), "{pid} is not in {exit}");

    stream.batch(2, columns(&[], &[(0, 2_000, 0.0)])).await;
    stream.acknowledged(2).await.expect("the first daemon goes on");
    first.stop_in_order();
    let again = launch.start();
    assert_eq!(again.client().map("office").await.expect("the map").observations, 2);
}

#[tokio::test(flavor = "multi_thread")]
async fn data_of_a_newer_format_is_refused_and_left_alone() {
    let data = tempdir().expect("a folder");
    let launch = Launch::on(data.path());
    let daemon = launch.start();
    create_map(&daemon, "office").await;
    daemon.stop_in_order();

    let manifest = data.path().join("MANIFEST");
    let text = fs::read_to_string(&manifest).expect("a manifest");
    let body = text.replacen("format 1\n", "format 2\n", 1);
    let body = body.split("crc32c ").next().expect("a body");
    let newer = format!("{body}crc32c {:08x}\n", crc32c::crc32c(body.as_bytes()));
    assert_ne!(newer, text);
    fs::write(&manifest, newer).expect("the manifest can be written");

    let before = disk::contents(data.path());
    let exit = launch.try_start().expect_err("the format is newer");
    assert_eq!(exit.code(), Some(65), "{exit}");
    for word in ["format 2", "MANIFEST", "newer version"] {
        assert!(exit.stderr.contains(word), "{word:?} is not in {exit}");
    }
    assert_eq!(disk::contents(data.path()), before);

    fs::write(&manifest, text).expect("the manifest can be written");
    let daemon = launch.start();
    assert!(daemon.client().map("office").await.is_ok(), "the data is as it was");
}

#[tokio::test(flavor = "multi_thread")]
async fn maps_without_their_manifest_are_refused_and_left_alone() {
    let data = tempdir().expect("a folder");
    let launch = Launch::on(data.path());
    launch.start().stop_in_order();
    fs::remove_file(data.path().join("MANIFEST")).expect("a manifest");
    let before = disk::contents(data.path());
    let exit = launch.try_start().expect_err("nobody knows the format");
    assert_eq!(exit.code(), Some(65), "{exit}");
    assert!(exit.stderr.contains("MANIFEST"), "{exit}");
    assert_eq!(disk::contents(data.path()), before);
}

#[tokio::test(flavor = "multi_thread")]
async fn deleting_a_map_ends_its_streams_and_leaves_the_others_alone() {
    let data = tempdir().expect("a folder");
    let launch = Launch::on(data.path());
    let daemon = launch.start();
    for map in ["office", "lab"] {
        create_map(&daemon, map).await;
    }
    let (mut doomed, _) = RawStream::open(&daemon.grpc, hello("robot", "office")).await.expect("a Welcome");
    let (mut other, _) = RawStream::open(&daemon.grpc, hello("robot", "lab")).await.expect("a Welcome");
    daemon.client().delete_map("office").await.expect("the map is there");
    let ended = doomed.end().await;
    assert_eq!(ended.goodbye.as_ref().map(|goodbye| goodbye.reason()), Some(GoodbyeReason::MapDeleted), "{ended:?}");
    assert_eq!(ended.error().code(), tonic::Code::NotFound);
    other.batch(1, columns(&["door"], &[(0, 1_000, 1.0)])).await;
    assert!(matches!(other.reply().await, Ok(Message::Ack(ack)) if ack.durable_sequence == 1));
    daemon.kill();
    let daemon = launch.start();
    let maps: Vec<String> = daemon.client().maps().await.expect("maps").into_iter().map(|map| map.name).collect();
    assert_eq!(maps, ["lab"]);
}
