//! Floods: strangers who hold what they can get, and what others see of it.
//!
//! Invariant: the daemon answers clients with a token, and requests for its health, whatever strangers do. Times are
//! printed and not asserted. `TIDEMAP_FLOOD_SECS` is the duration of each flood.

use std::{
    io::{Read as _, Write as _},
    net::{Ipv4Addr, TcpStream},
    time::{Duration, Instant},
};

use serde_json::json;
use tempfile::{TempDir, tempdir};
use tidemap_client::{
    Client,
    maps::{NewMap, StateKind, StateShape},
    queries::ModelSelector,
};
use tidemap_tests::{
    daemon::{Daemon, Launch},
    flood::{Flood, call_headers, connect_from, http2_preface},
    rounds,
    tokens::Tokens,
    web::{call, request},
};
use tokio::io::{AsyncReadExt as _, AsyncWriteExt as _};
use tonic_health::pb::{HealthCheckRequest, health_client::HealthClient};

mod unread;

const SOURCES: [Ipv4Addr; 3] = [Ipv4Addr::new(127, 0, 0, 2), Ipv4Addr::new(127, 0, 0, 3), Ipv4Addr::new(127, 0, 0, 4)];

/// A daemon with tokens and a map, and the token of an admin.
async fn guarded(change: impl FnOnce(Launch) -> Launch) -> (TempDir, Daemon, String) {
    let work = tempdir().expect("a folder");
    let tokens = Tokens::of(work.path());
    let token = tokens.create(&["admin"], &[]);
    let launch = Launch::on(&work.path().join("data")).setting("tokens_file", tokens.path.display());
    let daemon = change(launch).start();
    let map = NewMap { name: "office".to_owned(), ..NewMap::default() };
    let admin = client(&daemon, &token);
    admin.create_map(map).await.expect("a new map");
    admin
        .add_state("office", "door", StateShape::Scalar(StateKind::Probability), None, None)
        .await
        .expect("a new state");
    (work, daemon, token)
}

fn client(daemon: &Daemon, token: &str) -> Client {
    Client::with_token(&daemon.grpc, token).expect("loopback needs no TLS")
}

/// Works as an admin does while a flood runs: every request is answered.
async fn work(admin: &Client, flood: &Flood, what: &str) {
    flood.flowing(20).await;
    let (began, mut times) = (Instant::now(), Vec::new());
    let lasts = Duration::from_secs(u64::from(rounds::count("TIDEMAP_FLOOD_SECS", 2)));
    while began.elapsed() < lasts {
        let begun = Instant::now();
        admin.maps().await.unwrap_or_else(|error| panic!("{what}: {error}"));
        let mut runs = admin.predict("office", vec!["door".to_owned()], vec![1, 2], ModelSelector::default());
        let run = runs.next().await.unwrap_or_else(|error| panic!("{what}: {error}"));
        assert_eq!(run.expect("a run").probabilities.len(), 2);
        times.push(begun.elapsed());
        tokio::time::sleep(Duration::from_millis(5)).await;
    }
    times.sort_unstable();
    let quantile = |part: f64| times[((times.len() - 1) as f64 * part) as usize];
    println!(
        "{what}: {} rounds; two queries of an admin: p50 {:?}, p99 {:?}",
        flood.rounds(),
        quantile(0.5),
        quantile(0.99)
    );
}

#[tokio::test(flavor = "multi_thread")]
async fn calls_without_a_token_take_no_place_of_others() {
    let (_work, daemon, token) = guarded(|launch| launch).await;
    let admin = client(&daemon, &token);
    for path in ["/grpc.health.v1.Health/Check", "/tidemap.v1.MapService/ListMaps", "/grpc.health.v1.Health/Watch"] {
        let flood = Flood::half_open_calls(&daemon.grpc, path, (&SOURCES, 2, 64));
        work(&admin, &flood, path).await;
        for asks in [&admin, &daemon.client()] {
            let mut health = HealthClient::new(asks.requests());
            health.check(HealthCheckRequest::default()).await.expect("another client gets the health");
        }
    }
    daemon.stop_in_order();
}

/// A megabyte of objects, each of which takes many times its text in memory.
fn many_objects() -> String {
    format!("{{\"map\":\"office\",\"viewpoints\":[{}{{}}]}}", "{},".repeat(330_000))
}

#[tokio::test(flavor = "multi_thread")]
async fn large_json_delays_nobody_with_and_without_a_token() {
    let (_work, daemon, token) = guarded(|launch| launch).await;
    let (admin, body) = (client(&daemon, &token), many_objects());
    let path = "/api/v1/ExplorationService/EvaluateViews";
    let flood = Flood::posts(&daemon.http, path, "", body.as_bytes(), (&SOURCES, 33));
    work(&admin, &flood, "strangers").await;
    let answers = flood.answers();
    // A client whose connection was full may have got that code.
    assert!(answers.contains(&401) && answers.iter().all(|code| matches!(code, 401 | 503)), "{answers:?}");
    drop(flood);
    let header = format!("Authorization: Bearer {token}\r\n");
    let flood = Flood::posts(&daemon.http, path, &header, body.as_bytes(), (&SOURCES[..1], 50));
    work(&admin, &flood, "one client with a token").await;
    let answers = flood.answers();
    assert!(answers.contains(&429), "what goes beyond its share is refused: {answers:?}");
    assert!(answers.iter().all(|code| (400..=503).contains(code)), "{answers:?}");
    drop(flood);
    let log = daemon.stop_in_order();
    let line = log.lines().find(|line| line.contains("a request was refused")).expect("refusals are logged");
    assert!(line.contains("NO_TOKEN") && line.contains("127.0.0."), "{line}");
    assert!(log.lines().filter(|line| line.contains("a request was refused")).count() < 100, "at a bounded rate");
}

#[tokio::test(flavor = "multi_thread")]
async fn a_stranger_is_refused_before_anything_is_read() {
    let (_work, daemon, _) = guarded(|launch| launch).await;
    for path in ["/api/v1/MapService/ListMaps", "/tidemap.v1.MapService/ListMaps"] {
        let kind = if path.starts_with("/api") { "application/json" } else { "application/grpc-web+proto" };
        let mut socket = TcpStream::connect(&daemon.http).expect("the port is open");
        let head =
            format!("POST {path} HTTP/1.1\r\nHost: a\r\nContent-Type: {kind}\r\nContent-Length: 1000000\r\n\r\n");
        socket.write_all(head.as_bytes()).expect("a request");
        socket.set_read_timeout(Some(Duration::from_secs(20))).expect("a timeout");
        let mut answer = [0; 1024];
        let length = socket.read(&mut answer).expect("an answer comes without the body");
        let answer = String::from_utf8_lossy(&answer[..length]);
        assert!(answer.contains(" 401 ") || answer.contains("grpc-status: 16"), "{path}: {answer}");
    }
    daemon.stop_in_order();
}

#[tokio::test(flavor = "multi_thread")]
async fn connections_of_which_every_request_was_refused_make_room() {
    const MAX: usize = 16;
    let (_work, daemon, token) = guarded(|launch| launch.setting("max_connections", MAX)).await;
    let kept = client(&daemon, &token);
    kept.maps().await.expect("an answer");
    let mut held = Vec::new();
    for number in 0..2 * MAX {
        let mut socket = connect_from(SOURCES[number % 2], &daemon.grpc).await.expect("a connection");
        let call = call_headers(1, "/tidemap.v1.MapService/ListMaps", true);
        socket.write_all(&[http2_preface(), call].concat()).await.expect("a call");
        // The bytes are its settings and its answer.
        let mut seen = Vec::new();
        while !seen.windows(11).any(|bytes| bytes == b"grpc-status") && !seen.contains(&16) {
            let mut bytes = [0; 512];
            let length = socket.read(&mut bytes).await.expect("an answer");
            assert_ne!(length, 0, "the newest connection is served");
            seen.extend_from_slice(&bytes[..length]);
        }
        held.push(socket);
    }
    client(&daemon, &token).maps().await.expect("a newcomer comes in");
    kept.maps().await.expect("a client that was served stays");
    daemon.stop_in_order();
}

/// The code of the answer to a probe on a connection of its own.
fn probe(daemon: &Daemon, path: &str) -> u16 {
    request(&daemon.http, "GET", path, &[], b"").code
}

#[tokio::test(flavor = "multi_thread")]
async fn slow_requests_do_not_blind_the_http_port() {
    let data = tempdir().expect("a folder");
    let daemon = Launch::on(data.path()).start();
    let mut slow = Vec::new();
    // Connections whose request has not arrived yet make room, so that it takes some more than the limit.
    for number in 0.. {
        if number >= 256 && daemon.process().stderr().contains("a connection was refused") {
            break;
        }
        assert!(number < 5_000, "no connection was refused");
        let mut socket = connect_from(SOURCES[number % 2], &daemon.http).await.expect("a connection");
        let head = "POST /api/v1/MapService/ListMaps HTTP/1.1\r\nHost: 127.0.0.1\r\nContent-Type: application/json\r\n\
                    Content-Length: 100\r\n\r\n{";
        // A refused connection is closed.
        let _ = socket.write_all(head.as_bytes()).await;
        slow.push(socket);
    }
    assert_eq!([probe(&daemon, "/healthz"), probe(&daemon, "/readyz")], [200, 200]);
    // These connections end after some seconds, whether or not more bytes come.
    let mut late = 0;
    for socket in &mut slow {
        let mut answer = [0; 1024];
        let Ok(length @ 1..) = socket.read(&mut answer).await else { continue };
        let answer = String::from_utf8_lossy(&answer[..length]);
        // A connection that made room has broken off; one that was refused came into the reserve, or after too many.
        assert!([" 408 ", " 413 ", " 429 ", " 503 "].iter().any(|code| answer.contains(code)), "{answer}");
        late += usize::from(answer.contains(" 408 "));
    }
    assert!(late > 100, "{late} requests were late");
    // Requests that have just ended still count for a moment.
    while call(&daemon.http, "MapService/ListMaps", &[], &json!({})).code != 200 {
        tokio::time::sleep(Duration::from_millis(50)).await;
    }
    let mut answer = request(&daemon.http, "GET", "/metrics", &[], b"");
    while answer.code != 200 {
        tokio::time::sleep(Duration::from_millis(50)).await;
        answer = request(&daemon.http, "GET", "/metrics", &[], b"");
    }
    let metrics = answer.text();
    let of_port = |name: &str, port: &str| {
        let label = format!("{name}{{port=\"{port}\"}} ");
        let line = metrics.lines().find_map(|line| line.strip_prefix(&label));
        line.map_or(0.0, |number| number.parse::<f64>().expect("a number"))
    };
    assert!(of_port("tidemap_connections_refused", "http") > 0.0, "{metrics}");
    assert!(of_port("tidemap_connections", "http") > 0.0, "{metrics}");
    let log = daemon.stop_in_order();
    assert!(log.contains("a connection was refused"), "{log}");
}

#[tokio::test(flavor = "multi_thread")]
async fn idle_connections_of_the_http_port_make_room() {
    let data = tempdir().expect("a folder");
    let daemon = Launch::on(data.path()).start();
    let mut idle = Vec::new();
    for number in 0..300 {
        let mut socket = connect_from(SOURCES[number % 2], &daemon.http).await.expect("a connection");
        socket.write_all(b"GET /healthz HTTP/1.1\r\nHost: 127.0.0.1\r\n\r\n").await.expect("a request");
        let mut answer = [0; 512];
        let length = socket.read(&mut answer).await.expect("an answer");
        assert!(String::from_utf8_lossy(&answer[..length]).contains(" 200 "), "connection {number}");
        idle.push(socket);
    }
    let names = call(&daemon.http, "MapService/ListMaps", &[], &json!({}));
    assert_eq!(names.code, 200, "{}", names.text());
    daemon.stop_in_order();
}
