//! Closed to strangers: TLS and tokens, from outside.

mod tls;
mod tokens;

use std::{
    io::{Read as _, Write as _},
    net::TcpStream,
    time::{Duration, Instant},
};

use tidemap_tests::daemon::Daemon;

/// A change of files takes effect within this time, with much room for a busy machine.
const NOTICED_WITHIN: Duration = Duration::from_secs(30);

/// Waits until something is so.
async fn eventually(what: &str, mut is_so: impl AsyncFnMut() -> bool) {
    let start = Instant::now();
    while !is_so().await {
        assert!(start.elapsed() < NOTICED_WITHIN, "not within {} seconds: {what}", NOTICED_WITHIN.as_secs());
        tokio::time::sleep(Duration::from_millis(50)).await;
    }
}

/// The metrics, which are served in clear on loopback.
fn metrics(daemon: &Daemon) -> String {
    let mut socket = TcpStream::connect(&daemon.http).expect("the port is open");
    socket.write_all(b"GET /metrics HTTP/1.1\r\nHost: here\r\nConnection: close\r\n\r\n").expect("a request");
    let mut text = String::new();
    socket.read_to_string(&mut text).expect("an answer");
    text
}
