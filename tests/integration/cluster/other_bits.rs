//! A member whose updates make other bits than the writer's is found, and takes a copy of the writer's map.
//!
//! The fault is planted in the member's newest checkpoint, with valid checksums: that is what arithmetic that differs
//! between machines leaves behind.

use tidemap_store::{Store, StoreOptions};
use tidemap_tests::web;

use super::*;

/// Changes one number of the newest checkpoint of the only map in a folder.
fn change_checkpoint(data: &Path) {
    let store = Store::open(data, StoreOptions::default()).expect("a store");
    let (map, spec) = store.maps().pop().expect("a map");
    let mut snapshot = store.open_map(map, &spec).expect("opens").snapshot.expect("a checkpoint");
    snapshot.states[0].observations += 1;
    store.save(map, &snapshot).expect("saved");
    store.close();
}

/// Number of updates of a daemon that made other bits, as the daemon has counted them.
fn divergences(daemon: &Daemon) -> u64 {
    let metrics = web::request(&daemon.http, "GET", "/metrics", &[], b"").text();
    let mut lines = metrics.lines().filter_map(|line| line.strip_prefix("tidemap_cluster_divergence_total "));
    lines.next().map_or(0, |count| count.parse().expect("a number"))
}

#[tokio::test(flavor = "multi_thread")]
async fn a_member_that_makes_other_bits_is_counted_and_takes_a_copy_of_the_writers_map() {
    let engine = match NatsServers::start(1).await {
        Ok(engine) => engine,
        Err(reason) => return println!("SKIPPED: {reason}"),
    };
    let work = tempdir().expect("a folder");
    let folder = work.path();
    let begin = |name: &'static str| (name, start_with(folder, name, (&engine, 1), "engine_replicas = 1\n"));
    let mut members = Members(["north", "west"].map(begin).into());
    tidemap(members.first(), ["map", "create", "office"]).table();
    eventually(members.first(), "cluster maps", |outcome| {
        outcome.code == Some(0) && tidemap_tests::cli::Table::parse(&outcome.stdout).rows.len() == 2
    });
    members.learn(folder, 0);
    tidemap(members.first(), ["cluster", "verify", "office"]).table();
    let held = tidemap(members.first(), ["cluster", "maps"]);
    let follower =
        ["north", "west"].into_iter().find(|name| writer(&held).as_deref() != Some(name)).expect("a follower");
    members.take(follower).stop_in_order();
    change_checkpoint(&folder.join(follower));
    members.0.push(begin(follower));

    let first = members.first();
    let sent = tidemap(first, ["observe", "office", &day(folder, 1), "--producer", "robot-1"]).table();
    assert_eq!(sent.number("accepted"), 144.0);
    assert_eq!(tidemap(first, ["update", "office"]).table().rows.len(), 1);
    eventually(first, "cluster maps", |_| divergences(members.of(follower)) == 1);
    assert_eq!(divergences(first), 0, "the writer is not compared with itself");
    // The follower's old map is set aside.
    let is_replaced = |_: &Outcome| {
        let maps = fs::read_dir(folder.join(follower).join("maps")).expect("a folder of maps");
        maps.flatten().any(|entry| entry.file_name().to_string_lossy().ends_with(".replaced-1"))
    };
    eventually(first, "cluster maps", is_replaced);
    eventually(first, "cluster verify office", |outcome| outcome.code == Some(0));
    // From then on the follower makes the writer's bits.
    members.learn(folder, 2);
    assert_eq!(divergences(members.of(follower)), 1);
}
