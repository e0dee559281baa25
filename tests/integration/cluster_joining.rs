//! A daemon that joins a cluster whose logs were shortened, and one that was away for long: both have the map of the
//! others.
//!
//! Invariant: skipped with the reason where there is no nats-server. Every deadline only detects what hangs.

use std::{fmt::Write as _, fs, path::Path, time::Instant};

use tempfile::tempdir;
use tidemap_cluster::nats_process::NatsServers;
use tidemap_proto::v1::{self, peer_service_client::PeerServiceClient};
use tidemap_tests::{
    cli::{Outcome, Table, tidemap},
    daemon::Daemon,
};
use tonic::{Code, Request};

use crate::cluster::{Members, POLL, WITHIN, eventually, start_with, writer};

/// States of the map, each observed once a minute.
const STATES: i64 = 120;
/// Bytes below which a log was shortened, of which the engine keeps about 1 MiB.
const SHORT: u64 = 5 << 19;

fn begin(folder: &Path, name: &'static str, engine: &NatsServers) -> (&'static str, Daemon) {
    (name, start_with(folder, name, (engine, 3), "keep_log_mib = 1\n"))
}

/// Observations of a day, which hardly can be packed: about 1 MB.
fn busy_day(folder: &Path, number: i64) -> String {
    let mut rows = String::from("time,state,value\n");
    for minute in 0..1440 {
        for state in 0..STATES {
            let value = ((number * 1440 + minute) * STATES + state) * 7_919 % 1_000_003;
            let time = 1_451_865_600 + number * 86_400 + minute * 60;
            writeln!(rows, "{time},state-{state},{}", value as f64 / 1_000_003.0).expect("a text takes text");
        }
    }
    let file = folder.join(format!("busy-{number}.csv"));
    fs::write(&file, rows).expect("a file");
    file.display().to_string()
}

/// Sends days to the writer, and learns each of them there.
fn learn(members: &Members, folder: &Path, days: std::ops::Range<i64>) {
    let found = eventually(members.first(), "cluster maps", |outcome| writer(outcome).is_some());
    let writer = members.of(&writer(&found).expect("a writer"));
    for number in days {
        let sent = tidemap(writer, ["observe", "office", &busy_day(folder, number), "--producer", "robot-1"]).table();
        assert_eq!(sent.number("accepted"), (1440 * STATES) as f64, "each day is new");
        assert_eq!(tidemap(writer, ["update", "office"]).table().rows.len(), STATES as usize);
    }
}

/// Whether so many members have equal logs and, where `learned`, have learned the same.
fn are_equal(outcome: &Outcome, members: usize, learned: bool) -> bool {
    let equal = format!("of {members} members");
    let is_printed = |word: &str| {
        let mut lines = outcome.stderr.lines();
        lines.any(|line| line.starts_with(word) && line.contains(&equal) && line.ends_with(": equal"))
    };
    outcome.code == Some(0) && is_printed("logs") && (!learned || is_printed("generation"))
}

/// Waits until the engine keeps little of the log of the map.
async fn until_shortened(members: &Members) {
    let (client, begun) = (members.first().client(), Instant::now());
    loop {
        // The daemon may be away for a moment.
        let maps = client.cluster_status(true).await.map(|status| status.maps).unwrap_or_default();
        let bytes = maps.first().and_then(|map| map.log.as_ref()).map_or(u64::MAX, |log| log.bytes);
        if bytes < SHORT {
            return;
        }
        assert!(begun.elapsed() < WITHIN, "the engine keeps {bytes} bytes");
        tokio::time::sleep(POLL).await;
    }
}

fn holders(outcome: &Outcome) -> usize {
    if outcome.code == Some(0) { Table::parse(&outcome.stdout).rows.len() } else { 0 }
}

#[tokio::test(flavor = "multi_thread")]
async fn a_daemon_without_the_log_takes_a_copy_of_the_map() {
    let engine = match NatsServers::start(3).await {
        Ok(engine) => engine,
        Err(reason) => return println!("SKIPPED: {reason}"),
    };
    let work = tempdir().expect("a folder");
    let folder = work.path();
    let mut members = Members(["north", "east"].map(|name| begin(folder, name, &engine)).into());
    tidemap(members.first(), ["map", "create", "office"]).table();
    eventually(members.first(), "cluster maps", |outcome| holders(outcome) == 2);
    learn(&members, folder, 0..8);
    eventually(members.first(), "cluster verify office", |outcome| are_equal(outcome, 2, true));
    until_shortened(&members).await;

    members.0.push(begin(folder, "west", &engine));
    eventually(members.first(), "cluster maps", |outcome| holders(outcome) == 3);
    eventually(members.first(), "cluster verify office", |outcome| are_equal(outcome, 3, false));
    learn(&members, folder, 8..9);
    eventually(members.first(), "cluster verify office", |outcome| are_equal(outcome, 3, true));

    // While it is away, the log goes on and is shortened beyond what it has.
    let west = members.take("west");
    assert!(west.stop_in_order().contains("a copy of another daemon's map is in place"), "it has read the log");
    learn(&members, folder, 9..17);
    until_shortened(&members).await;
    members.0.push(begin(folder, "west", &engine));
    let maps = folder.join("west/maps");
    let is_replaced = |_: &Outcome| {
        let entries = fs::read_dir(&maps).expect("there").map(|entry| entry.expect("one").file_name());
        entries.filter(|name| name.to_string_lossy().ends_with(".replaced-1")).count() == 1
    };
    eventually(members.first(), "cluster maps", is_replaced);
    eventually(members.first(), "cluster maps", |outcome| holders(outcome) == 3);
    learn(&members, folder, 17..18);
    eventually(members.first(), "cluster verify office", |outcome| are_equal(outcome, 3, true));

    // Nobody else gets a copy.
    let address = format!("http://{}", members.first().grpc);
    let mut stranger = PeerServiceClient::connect(address).await.expect("connects");
    let mut with_token = Request::new(v1::FetchMapRequest { uid: 1 });
    with_token.metadata_mut().insert("authorization", "Bearer 00".parse().expect("text"));
    for request in [Request::new(v1::FetchMapRequest { uid: 1 }), with_token] {
        assert_eq!(stranger.fetch_map(request).await.expect_err("refused").code(), Code::Unauthenticated);
    }
}
