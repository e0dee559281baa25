//! Single bad observations: each is refused with its number and its reason; its neighbours are kept.

use tidemap_client::maps::NotLearned;
use tidemap_proto::v1::{Refusal, RefusalReason};
use tidemap_tests::{
    cli,
    oracle::run_update,
    stream::{RawStream, columns, hello},
};

use super::{observations, office, states};

#[track_caller]
fn check(refusals: &[Refusal], expected: &[(u64, RefusalReason, &str)]) {
    let found: Vec<(u64, RefusalReason)> = refusals.iter().map(|r| (r.sequence, r.reason())).collect();
    let wanted: Vec<(u64, RefusalReason)> = expected.iter().map(|&(sequence, reason, _)| (sequence, reason)).collect();
    assert_eq!(found, wanted, "{refusals:?}");
    for (refusal, (.., word)) in refusals.iter().zip(expected) {
        assert!(refusal.detail.contains(word), "{word:?} is not in {refusal:?}");
        assert!(refusal.detail.chars().count() <= 200, "{refusal:?}");
    }
}

#[tokio::test(flavor = "multi_thread")]
async fn values_outside_0_to_1_are_refused_one_by_one() {
    let (_data, daemon) = office(|launch| launch).await;
    let (mut stream, _) = RawStream::open(&daemon.grpc, hello("robot", "office")).await.expect("a Welcome");
    let values =
        [0.0, f64::NAN, 1.0, f64::INFINITY, 0.5, f64::NEG_INFINITY, -0.001, 1.001, f64::MIN_POSITIVE, -0.0, 1e300];
    let rows: Vec<_> = (0..).zip(values).map(|(i, value)| (0, 1_000 + i, value)).collect();
    stream.batch(1, columns(&["door"], &rows)).await;
    let refusals = stream.acknowledged(11).await.expect("the stream goes on");
    let value = RefusalReason::Value;
    check(
        &refusals,
        &[
            (2, value, "NaN"),
            (4, value, "inf"),
            (6, value, "-inf"),
            (7, value, "-0.001"),
            (8, value, "1.001"),
            (11, value, "1000000000"),
        ],
    );
    stream.batch(12, columns(&[], &[(0, 5_000, 1.0)])).await;
    check(&stream.acknowledged(12).await.expect("the stream goes on"), &[]);
    assert_eq!(observations(&daemon).await, 6);
}

#[tokio::test(flavor = "multi_thread")]
async fn times_outside_1970_to_2262_are_refused_one_by_one() {
    let (_data, daemon) = office(|launch| launch).await;
    let (mut stream, _) = RawStream::open(&daemon.grpc, hello("robot", "office")).await.expect("a Welcome");
    // Beyond 2262 the nanoseconds wrap: that is before 1970 again.
    let times = [0, -1, 1_600_000_000_000_000_000, i64::MIN, i64::MAX, i64::MAX.wrapping_add(1)];
    let rows: Vec<_> = times.into_iter().map(|time| (0, time, 1.0)).collect();
    stream.batch(1, columns(&["door"], &rows)).await;
    let refusals = stream.acknowledged(6).await.expect("the stream goes on");
    let time = RefusalReason::Time;
    check(&refusals, &[(2, time, "-1 ns"), (4, time, "before 1970"), (6, time, "before 1970")]);
    assert_eq!(observations(&daemon).await, 3);
}

#[tokio::test(flavor = "multi_thread")]
async fn observations_ahead_of_the_clock_are_kept_and_wait() {
    let (_data, daemon) = office(|launch| launch).await;
    let (mut stream, welcome) = RawStream::open(&daemon.grpc, hello("robot", "office")).await.expect("a Welcome");
    assert_eq!(welcome.max_ahead.map(|ahead| ahead.seconds), Some(300));
    // The second one is of the year 2200.
    stream
        .batch(1, columns(&["door"], &[(0, 1_600_000_000_000_000_000, 1.0), (0, 7_258_118_400_000_000_000, 0.0)]))
        .await;
    check(&stream.acknowledged(2).await.expect("the stream goes on"), &[]);
    let client = daemon.client();
    let waiting = client.map("office").await.expect("the map").not_learned;
    assert_eq!(waiting, Some(NotLearned { observations: 1, scans: 0, is_all: true }));
    run_update(&client, "office", None).await;
    let map = client.map("office").await.expect("the map");
    assert_eq!((map.observations, map.pending_observations, map.ahead_observations), (2, 1, 1));
    assert_eq!(map.not_learned, None, "an update leaves what is ahead");
    assert_eq!(cli::tidemap(&daemon, ["map", "show", "office"]).table().column("ahead"), ["1"]);
    let nothing_new =
        cli::tidemap_reading(&daemon, ["observe", "office", "-", "--producer", "other"], "time,state,value\n");
    assert!(
        nothing_new.stderr.contains("1 observation with times ahead of the daemon's clock"),
        "{}",
        nothing_new.stderr
    );
    let model = client.describe_model("office", "door").await.expect("the door");
    assert_eq!((model.learned_observations, model.mean, model.last_value), (1, 1.0, Some(1.0)));
    // A later observation that is not in the future is applied before it.
    stream.batch(3, columns(&[], &[(0, 1_600_000_001_000_000_000, 0.25)])).await;
    stream.acknowledged(3).await.expect("the stream goes on");
    assert_eq!(client.describe_model("office", "door").await.expect("the door").last_value, Some(0.25));
}

#[tokio::test(flavor = "multi_thread")]
async fn names_that_are_no_names_are_refused_and_the_others_kept() {
    let (_data, daemon) = office(|launch| launch).await;
    let (mut stream, _) = RawStream::open(&daemon.grpc, hello("robot", "office")).await.expect("a Welcome");
    let long = "x".repeat(129);
    let longest = "ü".repeat(128);
    let names = [
        "door",
        "",
        &long,
        "a\nb",
        "tab\t",
        "zero\0",
        "edge/a/b",
        "u\u{308}ber",
        "\u{202e}rtl",
        "Küche 2",
        &longest,
        "../up",
        "Door",
    ];
    let rows: Vec<_> = (0..13).map(|i| (i, 1_000 + i64::from(i), 1.0)).collect();
    stream.batch(1, columns(&names, &rows)).await;
    let refusals = stream.acknowledged(13).await.expect("the stream goes on");
    let name = RefusalReason::StateName;
    check(
        &refusals,
        &[
            (2, name, "empty"),
            (3, name, "129"),
            (4, name, "U+000A"),
            (5, name, "U+0009"),
            (6, name, "U+0000"),
            (7, name, "edge/a/b"),
            (8, name, "NFC"),
            (9, name, "U+202E"),
            (12, name, "../up"),
        ],
    );
    assert_eq!(states(&daemon).await, ["door", "Küche 2", &longest, "Door"]);
    // An invalid name keeps its index, so the later names keep theirs.
    stream.batch(14, columns(&["gate"], &[(13, 2_000, 1.0), (99, 2_001, 1.0), (1, 2_002, 1.0), (9, 2_003, 0.0)])).await;
    let refusals = stream.acknowledged(17).await.expect("the stream goes on");
    check(&refusals, &[(15, RefusalReason::StateIndex, "99"), (16, name, "empty")]);
    let (states, _) = daemon.client().states("office", "").await.expect("the map");
    let counts: Vec<(&str, u64)> = states.iter().map(|state| (state.name.as_str(), state.observations)).collect();
    assert_eq!(counts, [("door", 1), ("Küche 2", 2), (&longest, 1), ("Door", 1), ("gate", 1)]);
}

#[tokio::test(flavor = "multi_thread")]
async fn a_map_takes_as_many_states_as_it_may_and_no_more() {
    let (_data, daemon) = office(|launch| launch.setting("max_states_per_map", 3)).await;
    let (mut first, _) = RawStream::open(&daemon.grpc, hello("first", "office")).await.expect("a Welcome");
    first.batch(1, columns(&["a", "b"], &[(0, 1_000, 1.0), (1, 1_001, 1.0)])).await;
    check(&first.acknowledged(2).await.expect("room"), &[]);
    let (mut second, _) = RawStream::open(&daemon.grpc, hello("second", "office")).await.expect("a Welcome");
    second.batch(1, columns(&["c", "d", "a"], &[(0, 2_000, 1.0), (1, 2_001, 1.0), (2, 2_002, 0.0)])).await;
    let refusals = second.acknowledged(3).await.expect("the stream goes on");
    check(&refusals, &[(2, RefusalReason::StateLimit, "max_states_per_map")]);
    assert!(refusals[0].detail.contains("\"d\""), "{refusals:?}");
    assert_eq!(states(&daemon).await, ["a", "b", "c"]);
    // Existing states stay usable for all producers.
    first.batch(3, columns(&[], &[(1, 3_000, 0.0)])).await;
    check(&first.acknowledged(3).await.expect("room"), &[]);
    assert_eq!(observations(&daemon).await, 5);
}

#[tokio::test(flavor = "multi_thread")]
async fn what_was_refused_stays_refused_after_a_restart() {
    let (data, daemon) = office(|launch| launch).await;
    let (mut stream, _) = RawStream::open(&daemon.grpc, hello("robot", "office")).await.expect("a Welcome");
    stream.batch(1, columns(&["door"], &[(0, 1_000, 1.0), (0, 1_001, 2.0), (0, 1_002, 0.0)])).await;
    stream.acknowledged(3).await.expect("the stream goes on");
    daemon.kill();
    let daemon = tidemap_tests::daemon::Launch::on(data.path()).start();
    let (mut stream, welcome) = RawStream::open(&daemon.grpc, hello("robot", "office")).await.expect("a Welcome");
    assert_eq!(welcome.durable_sequence, 3, "a refused observation uses up its number");
    stream.batch(4, columns(&["door"], &[(0, 1_003, 1.0)])).await;
    check(&stream.acknowledged(4).await.expect("the stream goes on"), &[]);
    assert_eq!(observations(&daemon).await, 3);
}
