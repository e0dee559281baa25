//! Recordings that are sent to the HTTP port: imported once, by those who may, and gone afterwards.
//!
//! Invariant: what is expected follows from how a recording was written.

use std::{
    fs,
    io::{BufRead as _, BufReader, Write as _},
    net::TcpStream,
    path::Path,
    thread::sleep,
    time::{Duration, Instant},
};

use serde_json::{Value, json};
use tempfile::{TempDir, tempdir};
use tidemap_tests::{
    bag::Bag,
    certificates::{Authority, Validity},
    daemon::{Daemon, Launch},
    tokens::Tokens,
    web::{Answer, call, request},
};

mod turns;

/// A Monday, UTC.
const START_NANOS: i64 = 1_736_121_600 * SECOND_NANOS;
const SECOND_NANOS: i64 = 1_000_000_000;
/// A process ends, and a folder is emptied, within this time, also on a busy machine.
const ENDED_WITHIN: Duration = Duration::from_secs(30);

const BYTES: (&str, &str) = ("content-type", "application/octet-stream");

/// A recording of a door that opens and closes each second.
fn door(messages: i64) -> Vec<u8> {
    door_that_begins(true, messages)
}

fn door_that_begins(is_open: bool, messages: i64) -> Vec<u8> {
    let mut bag = Bag::default();
    for step in 0..messages {
        bag.bool("/kitchen/door", START_NANOS + step * SECOND_NANOS, (step % 2 == 0) == is_open);
    }
    let folder = tempdir().expect("a folder");
    let path = folder.path().join("door.bag");
    bag.write(&path, usize::MAX);
    fs::read(path).expect("the bag")
}

fn started() -> (TempDir, Daemon) {
    let data = tempdir().expect("a folder");
    let daemon = Launch::on(data.path()).setting("http_write", true).start();
    (data, daemon)
}

fn send(daemon: &Daemon, path: &str, headers: &[(&str, &str)], body: &[u8]) -> Answer {
    let all: Vec<(&str, &str)> = [BYTES].into_iter().chain(headers.iter().copied()).collect();
    request(&daemon.http, "POST", &format!("/api/v1/maps/{path}"), &all, body)
}

fn check(daemon: &Daemon, path: &str, headers: &[(&str, &str)]) -> Answer {
    request(&daemon.http, "GET", &format!("/api/v1/maps/{path}"), headers, b"")
}

/// The lines of an import, as one text, and its exit status.
#[track_caller]
fn imported(answer: &Answer) -> (String, i64) {
    assert_eq!(answer.code, 200, "{}", answer.text());
    assert_eq!(answer.headers["content-type"], "application/x-ndjson");
    let objects: Vec<Value> =
        answer.text().lines().map(|line| serde_json::from_str(line).expect("an object a line")).collect();
    let (last, rest) = objects.split_last().expect("an end");
    assert_eq!(last["done"], json!(true), "{last}");
    assert!(rest.iter().any(|object| object["progress"]["seconds"].is_u64()), "{rest:?}");
    let lines: Vec<&str> = rest.iter().filter_map(|object| object["line"].as_str()).collect();
    (lines.join("\n"), last["exit"].as_i64().expect("a status"))
}

#[track_caller]
fn refused(answer: &Answer, code: u16, reason: &str, words: &[&str]) {
    let text = answer.text();
    assert_eq!((answer.code, answer.reason().as_str()), (code, reason), "{text}");
    assert!(words.iter().all(|word| text.contains(word)), "{text}");
}

fn observations(daemon: &Daemon, map: &str, headers: &[(&str, &str)]) -> u64 {
    let found = call(&daemon.http, "MapService/GetMap", headers, &json!({ "name": map }));
    assert_eq!(found.code, 200, "{}", found.text());
    found.json()["map"]["observations"].as_str().expect("a number").parse().expect("a number")
}

fn is_empty(data: &Path) -> bool {
    !data.join("uploads").exists()
}

#[track_caller]
fn eventually(what: &str, mut is_so: impl FnMut() -> bool) {
    let begun = Instant::now();
    while !is_so() {
        assert!(begun.elapsed() < ENDED_WITHIN, "not in time: {what}");
        sleep(Duration::from_millis(20));
    }
}

#[test]
fn a_recording_is_imported_once_and_its_file_is_gone() {
    let (data, daemon) = started();
    let checked = check(&daemon, "flat/recordings/door.bag?bytes=1000", &[]);
    assert_eq!((checked.code, &checked.json()["mapExists"]), (200, &json!(false)), "{}", checked.text());
    let (printed, exit) = imported(&send(&daemon, "flat/recordings/door.bag", &[], &door(40)));
    assert_eq!(exit, 0, "{printed}");
    assert!(printed.contains("map \"flat\" is created") && printed.contains("state kitchen-door"), "{printed}");
    assert_eq!(observations(&daemon, "flat", &[]), 40);
    assert!(is_empty(data.path()), "before the end is told");
    assert_eq!(check(&daemon, "flat/recordings/door.bag", &[]).json()["mapExists"], json!(true));

    let (printed, exit) = imported(&send(&daemon, "flat/recordings/door.bag", &[], &door(40)));
    assert_eq!((exit, observations(&daemon, "flat", &[])), (0, 40), "{printed}");
    let (printed, exit) = imported(&send(&daemon, "flat/recordings/door.bag", &[], &door_that_begins(false, 40)));
    assert_eq!((exit, observations(&daemon, "flat", &[])), (1, 40), "{printed}");
    assert!(printed.contains("door.bag differs from the data that upload sent as upload/door.bag"), "{printed}");
    let (printed, exit) = imported(&send(&daemon, "flat/recordings/door.bag?producer=robot-7", &[], &door(10)));
    assert_eq!((exit, observations(&daemon, "flat", &[])), (0, 50), "{printed}");
    assert!(is_empty(data.path()));
    daemon.stop_in_order();
}

#[test]
fn a_map_learns_a_recording_when_it_is_imported() {
    let (_data, daemon) = started();
    let waiting = || {
        let found = call(&daemon.http, "MapService/GetMap", &[], &json!({ "name": "flat" }));
        found.json()["map"]["notLearned"].clone()
    };
    let (printed, exit) = imported(&send(&daemon, "flat/recordings/first.bag?update=false", &[], &door(40)));
    assert_eq!((exit, printed.contains("learned")), (0, false), "{printed}");
    assert_eq!(waiting(), json!({ "observations": "40", "scans": "0", "all": true }));
    let (printed, exit) = imported(&send(&daemon, "flat/recordings/second.bag", &[], &door(10)));
    assert_eq!(exit, 0, "{printed}");
    assert!(printed.contains("map \"flat\" has learned 50 observations, in "), "{printed}");
    assert_eq!(waiting(), Value::Null);
    let wrong = send(&daemon, "flat/recordings/third.bag?update=maybe", &[], &door(10));
    refused(&wrong, 400, "INVALID_FIELD", &["update", "true or false"]);
}

#[test]
fn what_is_no_recording_is_an_error_and_makes_no_map() {
    let (data, daemon) = started();
    let (printed, exit) = imported(&send(&daemon, "flat/recordings/noise.bag", &[], &[7; 5000]));
    assert_eq!(exit, 1, "{printed}");
    assert!(
        printed.contains("noise.bag: this is no recording") && !printed.contains(data.path().to_str().expect("text"))
    );
    let cut = &door(40)[..3000];
    let (printed, exit) = imported(&send(&daemon, "flat/recordings/cut.bag", &[], cut));
    assert_eq!(exit, 1, "{printed}");
    assert_eq!(call(&daemon.http, "MapService/GetMap", &[], &json!({ "name": "flat" })).code, 404);
    refused(&send(&daemon, "flat/recordings/none.bag", &[], b""), 400, "EMPTY", &["no bytes"]);
    refused(&send(&daemon, "Flat/recordings/a.bag", &[], b"a"), 400, "INVALID_FIELD", &["Flat"]);
    for name in ["..", "%2e%2e", "a%2f..", "...", "a%0ab", "%00"] {
        refused(&send(&daemon, &format!("flat/recordings/{name}"), &[], b"a"), 400, "INVALID_FIELD", &["name"]);
    }
    let long = format!("flat/recordings/{}.bag", "x".repeat(200));
    refused(&send(&daemon, &long, &[], b"a"), 400, "INVALID_FIELD", &["204 bytes", "120"]);
    let plain = request(&daemon.http, "POST", "/api/v1/maps/flat/recordings/a.bag", &[], b"a");
    refused(&plain, 415, "MEDIA_TYPE", &["application/octet-stream"]);
    refused(
        &check(&daemon, "flat/recordings/a.bag?size=1", &[]),
        400,
        "INVALID_FIELD",
        &["size", "producer, update, bytes"],
    );
    refused(&check(&daemon, "flat/recordings/a.bag?bytes=many", &[]), 400, "INVALID_FIELD", &["bytes"]);
    let evil = [("origin", "https://evil.example")];
    refused(&send(&daemon, "flat/recordings/a.bag", &evil, b"a"), 403, "FOREIGN_REQUEST", &[]);
    assert!(is_empty(data.path()));
    // A name with folders is that of its last part.
    let (_, exit) = imported(&send(&daemon, "flat/recordings/..%2f..%2f-door.bag", &[], &door(4)));
    assert_eq!((exit, observations(&daemon, "flat", &[])), (0, 4));
    assert!(!data.path().join("-door.bag").exists());
    daemon.stop_in_order();
}

#[test]
fn where_nobody_may_write_nothing_is_taken() {
    let data = tempdir().expect("a folder");
    fs::create_dir_all(data.path().join("uploads/recording")).expect("a folder");
    fs::write(data.path().join("uploads/recording/old.bag"), "left behind").expect("a file");
    let daemon = Launch::on(data.path()).start();
    assert!(is_empty(data.path()), "what an earlier daemon left is removed at the start");
    for answer in [check(&daemon, "flat/recordings/a.bag", &[]), send(&daemon, "flat/recordings/a.bag", &[], &door(4))]
    {
        refused(&answer, 403, "READ_ONLY", &["http_write"]);
    }
    assert!(is_empty(data.path()));
    daemon.stop_in_order();
}

#[test]
fn a_token_imports_into_its_maps_as_its_producers() {
    let work = tempdir().expect("a folder");
    let tokens = Tokens::of(work.path());
    let [admin, observer, planner] = ["admin", "observer", "planner"].map(|role| tokens.create(&[role], &["flat*"]));
    let made = tokens.run(&["create", "--role", "observer", "--producer", "robot-*"]);
    let robot = String::from_utf8(made.stdout).expect("text").trim().to_owned();
    // The gRPC port wants a certificate of each client: the import needs none, and the token decides.
    let authority = Authority::new("tests");
    let [certificate, key] = authority.sign(Validity::Years).write(work.path());
    let ca = work.path().join("clients.pem");
    fs::write(&ca, authority.pem()).expect("written");
    let data = work.path().join("data");
    let daemon = Launch::on(&data)
        .setting("tokens_file", tokens.path.display())
        .setting("tls_certificate", certificate.display())
        .setting("tls_key", key.display())
        .setting("tls_client_ca", ca.display())
        .start();
    let held = |token: &str| format!("Bearer {token}");
    let (admin, observer, planner, robot) = (held(&admin), held(&observer), held(&planner), held(&robot));
    let bag = door(12);
    let as_one = |path: &str, token: &str| send(&daemon, path, &[("authorization", token)], &bag);
    let path = "flat/recordings/door.bag";
    refused(&send(&daemon, path, &[], &bag), 401, "NO_TOKEN", &["token"]);
    refused(&as_one(path, "Bearer tm_wrong"), 401, "UNKNOWN_TOKEN", &[]);
    refused(&as_one(path, &planner), 403, "NEEDS_ROLE", &["observer"]);
    refused(&as_one(path, &observer), 403, "NEEDS_ROLE", &["map flat does not exist", "admin"]);
    refused(&as_one("other/recordings/door.bag", &admin), 403, "NOT_FOR_MAP", &["other"]);
    let (printed, exit) = imported(&as_one(path, &admin));
    assert_eq!((exit, observations(&daemon, "flat", &[("authorization", &admin)])), (0, 12), "{printed}");
    let (printed, exit) = imported(&as_one("flat/recordings/again.bag", &observer));
    assert_eq!((exit, observations(&daemon, "flat", &[("authorization", &admin)])), (0, 24), "{printed}");
    refused(&as_one(path, &robot), 403, "NOT_FOR_PRODUCER", &["upload"]);
    let (printed, exit) = imported(&as_one("flat/recordings/door.bag?producer=robot-7", &robot));
    assert_eq!((exit, observations(&daemon, "flat", &[("authorization", &admin)])), (0, 36), "{printed}");
    assert!(is_empty(&data));
    let log = daemon.stop_in_order();
    let secret = admin.rsplit('_').next().expect("a secret");
    assert!(!log.contains(secret), "no token is in the log");
}

#[test]
fn a_file_beyond_the_limit_is_refused_and_0_takes_none() {
    let data = tempdir().expect("a folder");
    let bag = door(40);
    let at_most =
        |bytes: usize| Launch::on(data.path()).setting("http_write", true).setting("max_upload_bytes", bytes).start();
    let daemon = at_most(bag.len() - 1);
    let path = "flat/recordings/door.bag";
    refused(&send(&daemon, path, &[], &bag), 413, "LIMIT", &["max_upload_bytes", "tidemap import"]);
    let address = format!("{path}?bytes={}", bag.len());
    refused(&check(&daemon, &address, &[]), 413, "LIMIT", &["max_upload_bytes"]);
    let huge = check(&daemon, &format!("{path}?bytes={}", u64::MAX), &[]);
    refused(&huge, 413, "LIMIT", &["max_upload_bytes"]);
    // Without an announced length, the file is counted as it comes.
    let mut socket = chunked(&daemon, path);
    for part in bag.chunks(1000) {
        let _ = write!(socket, "{:x}\r\n", part.len()).and_then(|()| socket.write_all(part));
        let _ = socket.write_all(b"\r\n");
    }
    let mut first = String::new();
    BufReader::new(socket).read_line(&mut first).expect("an answer");
    assert!(first.contains(" 413 "), "{first}");
    eventually("the file is gone", || is_empty(data.path()));
    daemon.stop_in_order();
    let daemon = at_most(0);
    refused(&send(&daemon, path, &[], &bag), 501, "UPLOADS_OFF", &["max_upload_bytes", "tidemap import"]);
    daemon.stop_in_order();
    let daemon = at_most(bag.len());
    assert_eq!(imported(&send(&daemon, path, &[], &bag)).1, 0);
    daemon.stop_in_order();
}

/// A connection that has begun to send a file in chunks.
fn chunked(daemon: &Daemon, path: &str) -> TcpStream {
    let mut socket = TcpStream::connect(&daemon.http).expect("the port is open");
    let (name, media) = BYTES;
    let host = &daemon.http;
    write!(
        socket,
        "POST /api/v1/maps/{path} HTTP/1.1\r\nHost: {host}\r\n{name}: {media}\r\nTransfer-Encoding: chunked\r\n\r\n"
    )
    .expect("a request");
    socket
}

/// Sends a file whole, and reads its answer until the import runs.
fn running(daemon: &Daemon, path: &str, bag: &[u8]) -> BufReader<TcpStream> {
    let mut socket = chunked(daemon, path);
    write!(socket, "{:x}\r\n", bag.len()).expect("a part");
    socket.write_all(bag).expect("all");
    socket.write_all(b"\r\n0\r\n\r\n").expect("the end");
    let mut answer = BufReader::new(socket);
    let mut line = String::new();
    while !line.contains("progress") {
        line.clear();
        assert!(answer.read_line(&mut line).expect("more") > 0, "it runs");
    }
    answer
}

#[test]
fn one_import_at_a_time_and_who_leaves_makes_room() {
    let (data, daemon) = started();
    let path = "flat/recordings/door.bag";
    let mut first = chunked(&daemon, path);
    first.write_all(b"5\r\n#ROSB\r\n").expect("a part");
    let file = data.path().join("uploads/0/recording/door.bag");
    eventually("the file arrives", || file.exists());
    for answer in [check(&daemon, path, &[]), send(&daemon, path, &[], &door(4))] {
        refused(&answer, 429, "BUSY", &["another recording is being imported into this map"]);
    }
    drop(first);
    eventually("the file is gone", || is_empty(data.path()));
    assert_eq!(imported(&send(&daemon, path, &[], &door(4))).1, 0);

    // A client that leaves while the import runs stops it; the same file again goes on.
    let large = door(60_000);
    let answer = running(&daemon, "large/recordings/door.bag", &large);
    drop(answer);
    eventually("the file is gone", || is_empty(data.path()));
    eventually("it is told", || daemon.process().stderr().contains("the import of a recording was stopped"));
    let (printed, exit) = imported(&send(&daemon, "large/recordings/door.bag", &[], &large));
    assert_eq!((exit, observations(&daemon, "large", &[])), (0, 60_000), "{printed}");
    daemon.stop_in_order();
}

#[test]
fn a_daemon_that_stops_ends_its_import() {
    let (data, daemon) = started();
    let large = door(60_000);
    let answer = running(&daemon, "large/recordings/door.bag", &large);
    let stopped = std::thread::spawn(move || daemon.stop_in_order());
    let rest: Vec<String> = answer.lines().map_while(Result::ok).collect();
    assert!(rest.iter().any(|line| line.contains("STOPPING")), "{rest:?}");
    stopped.join().expect("in order");
    assert!(is_empty(data.path()));
}
