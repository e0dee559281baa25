//! The metrics of `/metrics` of the members of a cluster.
//!
//! Invariant: skipped with the reason where there is no nats-server. Every deadline only detects hangs.

use super::*;

/// The value of a series; `None`: it is not there.
pub(super) fn value(daemon: &Daemon, series: &str) -> Option<f64> {
    let text = tidemap_tests::web::request(&daemon.http, "GET", "/metrics", &[], b"").text();
    text.lines().find_map(|line| line.strip_prefix(series)?.strip_prefix(' ')?.parse().ok())
}

async fn until_value(daemon: &Daemon, series: &str, expected: f64) {
    until(series, async || value(daemon, series), |value| *value == Some(expected)).await;
}

#[tokio::test(flavor = "multi_thread")]
async fn metrics_show_who_writes_who_is_gone_and_that_the_engine_is_silent() {
    let mut engine = match NatsServers::start(1).await {
        Ok(engine) => engine,
        Err(reason) => return println!("SKIPPED: {reason}"),
    };
    let work = tempdir().expect("a folder");
    let mut members = Members(
        ["north", "east"]
            .map(|name| (name, start_with(work.path(), name, (&engine, 1), "engine_replicas = 1\n")))
            .into(),
    );
    tidemap(members.first(), ["map", "create", "office"]).table();
    let is_held_by_both = |outcome: &Outcome| {
        writer(outcome).is_some() && tidemap_tests::cli::Table::parse(&outcome.stdout).rows.len() == 2
    };
    let held = eventually(members.first(), "cluster maps", is_held_by_both);
    let writer = writer(&held).expect("a writer");
    let follower = if writer == "north" { "east" } else { "north" };
    for (name, written) in [(writer.as_str(), 1.0), (follower, 0.0)] {
        until_value(members.of(name), "tidemap_cluster_maps", 1.0).await;
        until_value(members.of(name), "tidemap_cluster_maps_written", written).await;
        until_value(members.of(name), "tidemap_cluster_maps_followed", 1.0 - written).await;
        until_value(members.of(name), "tidemap_cluster_takeovers_total", written).await;
        until_value(members.of(name), "tidemap_cluster_members{state=\"alive\"}", 2.0).await;
        assert_eq!(value(members.of(name), "tidemap_cluster_members{state=\"gone\"}"), Some(0.0));
        assert_eq!(value(members.of(name), "tidemap_cluster_engine_unavailable"), Some(0.0));
    }
    // Only the writer appends, and the follower passes on what it is sent.
    let sent = tidemap(members.of(follower), ["observe", "office", &day(work.path(), 0), "--producer", "robot-1"]);
    assert_eq!(sent.table().number("accepted"), 144.0);
    assert!(value(members.of(follower), "tidemap_cluster_passed_requests_total") >= Some(1.0));
    assert_eq!(value(members.of(&writer), "tidemap_cluster_passed_requests_total"), Some(0.0));
    assert!(value(members.of(&writer), "tidemap_cluster_append_seconds_count") >= Some(1.0));
    assert_eq!(value(members.of(follower), "tidemap_cluster_append_seconds_count"), Some(0.0));
    until_value(members.of(follower), "tidemap_cluster_lag_records", 0.0).await;
    let contact_age = value(members.of(follower), "tidemap_cluster_heard_age_seconds");
    assert!(contact_age.is_some_and(f64::is_finite), "{contact_age:?}");

    // The follower takes the map, and is then left without the other one, and without the engine.
    let line = format!("cluster move office {follower}");
    eventually(members.of(follower), &line, |outcome| outcome.code == Some(0));
    until_value(members.of(&writer), "tidemap_cluster_depositions_total", 1.0).await;
    until_value(members.of(follower), "tidemap_cluster_takeovers_total", 1.0).await;
    members.take(&writer).kill();
    until_value(members.of(follower), "tidemap_cluster_members{state=\"gone\"}", 1.0).await;
    engine.kill(0);
    until_value(members.of(follower), "tidemap_cluster_engine_unavailable", 1.0).await;
    let ages = async || value(members.of(follower), "tidemap_cluster_heard_age_seconds");
    until("age", ages, |age| *age > Some(10.0)).await;
}
