//! Replies of the HTTP port that nobody reads, on as many connections as the port has.
//!
//! Invariant: they take a bounded part of the daemon's memory, and others are answered meanwhile. Memory is printed;
//! the asserted limits leave room for a build that is not optimised.

use std::fs;

use tidemap_tests::{
    certificates::{Authority, Validity},
    daemon::Process,
    flood::gets_without_window,
};

use super::*;

/// All connections of the HTTP port: two clients have half of them each.
const ALL: (&[Ipv4Addr], usize) = (&[SOURCES[0], SOURCES[1]], 128);
/// The growth that is allowed.
const GROWTH_KIB: u64 = 48 << 10;

fn resident_kib(process: &Process) -> u64 {
    let status = fs::read_to_string(format!("/proc/{}/status", process.pid())).expect("it runs");
    let line = status.lines().find_map(|line| line.strip_prefix("VmRSS:")).expect("its memory");
    line.trim().trim_end_matches(" kB").parse().expect("a number")
}

/// A request that is sent many times before its reply is read.
fn pipelined(head: &str, count: usize) -> Vec<u8> {
    format!("{head} HTTP/1.1\r\nHost: localhost\r\n\r\n").repeat(count).into_bytes()
}

/// The path of the page's script, if the daemon has a page.
fn script(daemon: &Daemon) -> Option<String> {
    let page = request(&daemon.http, "GET", "/", &[], b"").text();
    let begins = page.find("/assets/index-")?;
    let path: String = page[begins..].chars().take_while(|character| *character != '"').collect();
    path.ends_with(".js").then_some(path)
}

#[tokio::test(flavor = "multi_thread")]
async fn replies_that_nobody_reads_take_little_memory_and_no_time_of_others() {
    let (_work, daemon, token) = guarded(|launch| launch).await;
    let admin = client(&daemon, &token);
    let mut floods = vec![
        ("silent", Vec::new()),
        (
            "heads that do not end",
            format!("GET / HTTP/1.1\r\nHost: localhost\r\nA: {}", "a".repeat(60_000)).into_bytes(),
        ),
        ("OpenAPI", pipelined("GET /api/v1/openapi.json", 40)),
        ("metrics", pipelined("GET /metrics", 40)),
        ("health", pipelined("GET /healthz", 5_000)),
        ("OpenAPI, HTTP/2", gets_without_window("/api/v1/openapi.json", 100)),
    ];
    match script(&daemon) {
        Some(path) => floods.extend([
            ("the page's script", pipelined(&format!("GET {path}"), 40)),
            ("the page's script, HTTP/2", gets_without_window(&path, 100)),
        ]),
        None => println!("SKIPPED the page's script: this daemon was built without the page"),
    }
    let before = resident_kib(daemon.process());
    for (what, bytes) in floods {
        let flood = Flood::unread(&daemon.http, bytes, ALL);
        flood.flowing(200).await;
        work(&admin, &flood, what).await;
        let grown = resident_kib(daemon.process()).saturating_sub(before);
        println!("{what}: memory {} MiB more than {} MiB", grown / 1024, before / 1024);
        assert!(grown < GROWTH_KIB, "{what}: {grown} KiB more");
        // Somebody else is answered on the same port.
        let names =
            call(&daemon.http, "MapService/ListMaps", &[("authorization", &format!("Bearer {token}"))], &json!({}));
        assert_eq!(names.code, 200, "{what}: {}", names.text());
        assert_eq!(probe(&daemon, "/healthz"), 200, "{what}");
    }
    daemon.stop_in_order();
}

#[tokio::test(flavor = "multi_thread")]
async fn unread_replies_with_tls_take_little_memory_too() {
    let work = tempdir().expect("a folder");
    let (authority, tokens) = (Authority::new("ours"), Tokens::of(work.path()));
    let [certificate, key] = authority.sign(Validity::Years).write(work.path());
    let token = tokens.create(&["admin"], &[]);
    let daemon = Launch::on(&work.path().join("data"))
        .setting("http_listen", "0.0.0.0:0")
        .setting("tokens_file", tokens.path.display())
        .setting("tls_certificate", certificate.display())
        .setting("tls_key", key.display())
        .start();
    let admin = authority.client(&daemon, None, Some(&token));
    let address = daemon.http.replace("0.0.0.0", "127.0.0.1");
    let before = resident_kib(daemon.process());
    for (what, bytes, has_tls) in [
        ("no handshake", vec![0x16, 3, 1, 0xff, 0xff], false),
        ("silent with TLS", Vec::new(), true),
        ("OpenAPI with TLS", pipelined("GET /api/v1/openapi.json", 40), true),
    ] {
        let flood = if has_tls {
            Flood::unread_tls(&address, &authority, bytes, ALL)
        } else {
            Flood::unread(&address, bytes, ALL)
        };
        flood.flowing(200).await;
        let began = Instant::now();
        while began.elapsed() < Duration::from_secs(2) {
            admin.maps().await.expect("an answer");
        }
        let grown = resident_kib(daemon.process()).saturating_sub(before);
        println!("{what}: memory {} MiB more than {} MiB", grown / 1024, before / 1024);
        assert!(grown < GROWTH_KIB, "{what}: {grown} KiB more");
    }
    daemon.stop_in_order();
}

#[tokio::test(flavor = "multi_thread")]
async fn a_reply_that_nobody_reads_ends_and_is_reported() {
    let data = tempdir().expect("a folder");
    let daemon = Launch::on(data.path()).start();
    let mut socket = connect_from(SOURCES[0], &daemon.http).await.expect("a connection");
    socket.write_all(&pipelined("GET /api/v1/openapi.json", 40)).await.expect("requests");
    let began = Instant::now();
    while !daemon.process().stderr().contains("its client did not read it") {
        assert!(began.elapsed() < Duration::from_secs(120), "the reply does not end");
        tokio::time::sleep(Duration::from_millis(100)).await;
    }
    assert!(began.elapsed() > Duration::from_secs(15), "a slow reader is waited for");
    let metrics = request(&daemon.http, "GET", "/metrics", &[], b"").text();
    assert!(metrics.contains("tidemap_replies_ended_total{reason=\"unread\"} 1"), "{metrics}");
    daemon.stop_in_order();
}
