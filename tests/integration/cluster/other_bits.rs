//! A member whose updates make other bits than the writer's is found.
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

/// How often a daemon has found that its updates make other bits.
fn divergences(daemon: &Daemon) -> u64 {
    let metrics = web::request(&daemon.http, "GET", "/metrics", &[], b"").text();
    let mut lines = metrics.lines().filter_map(|line| line.strip_prefix("tidemap_cluster_divergence_total "));
    lines.next().map_or(0, |count| count.parse().expect("a number"))
}

#[tokio::test(flavor = "multi_thread")]
async fn a_member_that_makes_other_bits_is_counted_shown_and_ends_verify_with_2() {
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
    let verified = eventually(first, "cluster verify office", |outcome| outcome.code == Some(2));
    assert!(verified.stderr.contains("generation 2 of 2 members: DIFFER"), "{verified:?}");
    assert!(verified.stderr.contains(": equal"), "the logs are equal: {verified:?}");
    let status = eventually(first, "cluster status", |outcome| outcome.code == Some(2));
    assert!(status.stderr.contains(follower), "{status:?}");
    let maps = check_json(first, "cluster maps");
    let rows = maps.as_array().expect("rows");
    let row = rows.iter().find(|row| row["member"] == follower).expect("its row");
    assert_eq!(row["equal"], false, "{row}");
    assert_eq!(divergences(members.of(follower)), 1);
    assert_eq!(divergences(first), 0, "the writer is not compared with itself");
}
