//! Streams that are silent: a client that hangs gives its key to the next one within seconds, one that is there keeps
//! it, and one that sends nothing for long makes room when there are too many.

use std::{
    io::Write as _,
    process::Stdio,
    sync::{
        Arc,
        atomic::{AtomicBool, Ordering},
    },
    time::Duration,
};

use rustix::process::{Pid, Signal, kill_process};
use tempfile::{TempDir, tempdir};
use tidemap_client::{
    Client,
    observe::{Producer, ProducerError, ProducerOptions},
};
use tidemap_proto::v1::{GoodbyeReason, Hello};
use tidemap_tests::{
    cli,
    daemon::{Daemon, Launch},
    stream::{RawStream, columns, hello},
};
use tokio::{
    io::{AsyncReadExt as _, AsyncWriteExt as _},
    net::{TcpListener, TcpStream},
};
use tonic::Code;

use super::create_map;

async fn office(change: impl FnOnce(Launch) -> Launch) -> (TempDir, Daemon) {
    let data = tempdir().expect("a folder");
    let daemon = change(Launch::on(data.path())).start();
    create_map(&daemon, "office").await;
    (data, daemon)
}

async fn observations(daemon: &Daemon) -> u64 {
    daemon.client().map("office").await.expect("the map").observations
}

/// A producer that is refused at once if another one has its key.
async fn impatient(client: &Client) -> Result<Producer, ProducerError> {
    let options = ProducerOptions { key_patience: Duration::ZERO, ..ProducerOptions::new("robot", "", "office") };
    Producer::open(client, options).await
}

/// A way to the daemon that hangs while the flag is set: bytes are neither lost nor passed on, and nothing is closed.
async fn hanging_way(daemon: &Daemon) -> (Client, Arc<AtomicBool>) {
    let listener = TcpListener::bind("127.0.0.1:0").await.expect("a port");
    let client = Client::new(&listener.local_addr().expect("an address").to_string()).expect("an address");
    let (to, hangs) = (daemon.grpc.clone(), Arc::new(AtomicBool::new(false)));
    let is_hanging = Arc::clone(&hangs);
    tokio::spawn(async move {
        while let Ok((near, _)) = listener.accept().await {
            let far = TcpStream::connect(&to).await.expect("the daemon");
            let ((near_in, near_out), (far_in, far_out)) = (near.into_split(), far.into_split());
            for (mut from, mut into) in [(near_in, far_out), (far_in, near_out)] {
                let is_hanging = Arc::clone(&is_hanging);
                tokio::spawn(async move {
                    let mut bytes = [0; 4096];
                    while let Ok(length @ 1..) = from.read(&mut bytes).await {
                        while is_hanging.load(Ordering::SeqCst) {
                            tokio::time::sleep(Duration::from_millis(5)).await;
                        }
                        if into.write_all(&bytes[..length]).await.is_err() {
                            return;
                        }
                    }
                });
            }
        }
    });
    (client, hangs)
}

#[tokio::test(flavor = "multi_thread")]
async fn a_robot_that_restarts_takes_over_from_a_connection_that_hangs() {
    let (_data, daemon) = office(|launch| launch).await;
    let (way, hangs) = hanging_way(&daemon).await;
    let mut old = impatient(&way).await.expect("the first");
    old.send("door", 1_000, 1.0).await.expect("sent");
    old.flush().await.expect("durable");
    // While the old stream replies, it keeps its key.
    let refused = impatient(&daemon.client()).await.expect_err("in use");
    assert!(matches!(&refused, ProducerError::KeyInUse(text) if text.contains("robot")), "{refused}");
    old.send("door", 2_000, 1.0).await.expect("sent");
    old.flush().await.expect("the old one is not harmed by that");

    // The last reply of the old stream counts for a moment.
    tokio::time::sleep(Duration::from_millis(200)).await;
    hangs.store(true, Ordering::SeqCst);
    // Observations that are on the way when the connection hangs come too late.
    old.send("door", 3_000, 1.0).await.expect("sent");
    let mut new = impatient(&daemon.client()).await.expect("the old one does not respond");
    assert_eq!(new.progress().durable_sequence, 2);
    new.send("door", 4_000, 0.0).await.expect("sent");
    new.flush().await.expect("durable");
    hangs.store(false, Ordering::SeqCst);
    let ended = old.flush().await.expect_err("taken over");
    assert!(matches!(&ended, ProducerError::Superseded(text) if text.contains("took over")), "{ended}");
    new.send("door", 5_000, 0.0).await.expect("sent");
    new.close().await.expect("durable");
    assert_eq!(observations(&daemon).await, 4, "each exactly once, and nothing of the old one after the takeover");
    daemon.stop_in_order();
}

#[tokio::test(flavor = "multi_thread")]
async fn a_robot_that_restarts_takes_over_from_a_process_that_is_stopped() {
    let (_data, daemon) = office(|launch| launch).await;
    let mut command = cli::command(&daemon.grpc, ["observe", "office", "-", "--producer", "robot", "--label", ""]);
    let mut old = command.stdin(Stdio::piped()).stdout(Stdio::null()).stderr(Stdio::piped()).spawn().expect("started");
    let mut rows = old.stdin.take().expect("a pipe");
    rows.write_all(b"time,state,value\n2025-01-06T08:57:10Z,door,1\n").expect("written");
    let producers = async || daemon.client().producers("office").await.expect("a list");
    while !producers().await.iter().any(|producer| producer.is_connected) {
        tokio::time::sleep(Duration::from_millis(20)).await;
    }
    let pid = Pid::from_raw(i32::try_from(old.id()).expect("a number")).expect("a number");
    kill_process(pid, Signal::STOP).expect("stopped");
    // The last reply of the old stream counts for a moment.
    tokio::time::sleep(Duration::from_millis(200)).await;
    let mut new = impatient(&daemon.client()).await.expect("the old one does not respond");
    let before = new.progress().durable_sequence;
    new.send("door", 1_736_200_000_000_000_000, 0.0).await.expect("sent");
    new.close().await.expect("durable");
    kill_process(pid, Signal::CONT).expect("continued");
    // The old one may have ended already.
    let _ = rows.write_all(b"2025-01-06T09:57:10Z,door,1\n");
    drop(rows);
    let ended = old.wait_with_output().expect("ended");
    let text = String::from_utf8_lossy(&ended.stderr);
    assert!(!ended.status.success() && text.contains("took over"), "{text}");
    assert_eq!(observations(&daemon).await, before + 1);
    daemon.stop_in_order();
}

#[tokio::test(flavor = "multi_thread")]
async fn a_stream_that_does_not_answer_receives_the_reason_of_its_end() {
    let (_data, daemon) = office(|launch| launch).await;
    let announced = || Hello { answers_probes: true, ..hello("robot", "office") };
    let (mut old, _) = RawStream::open(&daemon.grpc, announced()).await.expect("a Welcome");
    old.batch(1, columns(&["door"], &[(0, 1_000, 1.0)])).await;
    old.acknowledged(1).await.expect("taken");
    let (mut new, welcome) = RawStream::open(&daemon.grpc, hello("robot", "office")).await.expect("a Welcome");
    assert_eq!((welcome.incarnation, welcome.durable_sequence), (2, 1));
    old.batch(2, columns(&[], &[(0, 2_000, 1.0)])).await;
    let ended = old.end().await;
    let goodbye = ended.goodbye.clone().expect("a Goodbye");
    assert_eq!((goodbye.reason(), goodbye.durable_sequence), (GoodbyeReason::Superseded, 1));
    let status = ended.error();
    assert_eq!(status.code(), Code::Aborted);
    assert!(status.message().contains("did not respond"), "{status:?}");
    new.batch(2, columns(&["door"], &[(0, 3_000, 0.0)])).await;
    new.acknowledged(2).await.expect("taken");
    // The new one announced nothing: who comes now has to wait for its end.
    let refused = RawStream::open(&daemon.grpc, hello("robot", "office")).await.expect_err("in use");
    assert_eq!(refused.error().code(), Code::AlreadyExists);
    assert_eq!(observations(&daemon).await, 2);
    daemon.stop_in_order();
}

#[tokio::test(flavor = "multi_thread")]
async fn the_stream_that_was_silent_for_longest_makes_room() {
    let (_data, daemon) = office(|launch| launch.setting("max_streams", 2).setting("stream_idle_secs", 2)).await;
    let mut producer =
        Producer::open(&daemon.client(), ProducerOptions::new("slow", "", "office")).await.expect("open");
    producer.send("door", 1_000, 1.0).await.expect("sent");
    producer.flush().await.expect("durable");
    let (mut raw, _) = RawStream::open(&daemon.grpc, hello("raw", "office")).await.expect("a Welcome");
    let refused = RawStream::open(&daemon.grpc, hello("third", "office")).await.expect_err("both are active");
    let status = refused.error();
    assert!(status.code() == Code::ResourceExhausted && status.message().contains("max_streams"), "{status:?}");

    let mut later = 0;
    let (mut third, _) = loop {
        later += 1;
        raw.batch(later, columns(if later == 1 { &["raw"] } else { &[] }, &[(0, 1_000, 1.0)])).await;
        raw.acknowledged(later).await.expect("one that sends stays");
        match RawStream::open(&daemon.grpc, hello("third", "office")).await {
            Ok(opened) => break opened,
            Err(_) => tokio::time::sleep(Duration::from_millis(200)).await,
        }
    };
    // The producer has made room, and needs it again: the raw stream is the next to go.
    tokio::time::sleep(Duration::from_millis(2_500)).await;
    third.batch(1, columns(&["third"], &[(0, 1_000, 1.0)])).await;
    third.acknowledged(1).await.expect("it stays");
    producer.send("door", 2_000, 1.0).await.expect("sent");
    producer.flush().await.expect("it comes back by itself");
    let ended = raw.end().await;
    assert!(ended.goodbye.is_none(), "{ended:?}");
    let status = ended.error();
    assert_eq!(status.code(), Code::Unavailable);
    assert!(status.message().contains("silent") && status.message().contains("stream_idle_secs"), "{status:?}");
    assert_eq!(observations(&daemon).await, later + 3);
    daemon.stop_in_order();
}
