//! The behaviour that every engine must have. Each engine's own tests run this suite on it.
//!
//! Invariant: the suite requires nothing that the trait does not promise. It never waits for a fixed time, only with a
//! patience.

mod patient;

use std::{collections::BTreeMap, time::Duration};

use bytes::Bytes;
use tokio::{
    task::JoinSet,
    time::{Instant, sleep},
};

use self::patient::Patient;
use super::{AppendIfError, Bucket, Engine, EngineError, KeyEntry, Message, SetError};

/// Longer than any call of the suite takes on a loaded machine.
const PATIENCE: Duration = Duration::from_secs(20);

fn bytes(text: &str) -> Bytes {
    Bytes::copy_from_slice(text.as_bytes())
}

fn message(sequence: u64, text: &str) -> Message {
    Message { sequence, content: bytes(text) }
}

/// Runs the whole suite. `first` and `second` are two clients of one engine, which holds nothing yet.
pub(crate) async fn behaves<E: Engine>(first: E, second: E, replicas: usize) {
    let (first, second) = (Patient(first), Patient(second));
    what_does_not_exist_is_missing(&first).await;
    first.create_buckets(replicas).await.expect("create the buckets");
    first.create_buckets(replicas).await.expect("create the buckets again");
    for stream in ["tm_ends", "tm_read", "tm_follow", "tm_purge", "tm_race"] {
        first.create_stream(stream, replicas).await.expect("create a stream");
    }
    first.create_stream("tm_ends", replicas).await.expect("create a stream that exists");
    an_append_takes_place_after_the_expected_message(&first, &second).await;
    messages_are_read_by_number_and_in_order(&first, &second).await;
    a_follower_gets_each_message_once_and_in_order(&first, &second).await;
    what_is_purged_is_gone_and_numbers_go_on(&first).await;
    of_concurrent_appends_one_takes_a_number(&first, &second).await;
    keys_are_set_under_their_revision(&first, &second).await;
    a_counter_of_many_writers_counts_all(&first, &second).await;
    a_deleted_stream_begins_anew(&first, replicas).await;
    let health = first.health("tm_read").await.expect("health");
    assert_eq!((health.replicas, health.followers.len() + 1), (replicas, replicas), "{health:?}");
    assert!(health.leader.is_some() && health.bytes > 0, "{health:?}");
    let servers = first.servers().await.expect("servers");
    assert!(servers.iter().all(|server| !server.version.is_empty()) && !servers.is_empty(), "{servers:?}");
}

async fn what_does_not_exist_is_missing<E: Engine>(engine: &E) {
    let missing = |error: EngineError| assert!(matches!(error, EngineError::Missing(_)), "{error:?}");
    missing(engine.ends("tm_none").await.expect_err("no stream"));
    missing(engine.read("tm_none", 1).await.expect_err("no stream"));
    missing(engine.read_from("tm_none", 1, 1 << 20, PATIENCE).await.expect_err("no stream"));
    missing(engine.purge_before("tm_none", 1).await.expect_err("no stream"));
    missing(engine.health("tm_none").await.expect_err("no stream"));
    match engine.append_if("tm_none", 0, bytes("a"), PATIENCE).await {
        Err(AppendIfError::Engine(error)) => missing(error),
        outcome => panic!("{outcome:?}"),
    }
    missing(engine.get(Bucket::Maps, "a").await.expect_err("no bucket"));
    missing(engine.list(Bucket::Maps).await.expect_err("no bucket"));
    missing(engine.set(Bucket::Maps, "a", bytes("1")).await.expect_err("no bucket"));
    assert_eq!(engine.delete_stream("tm_none").await, Ok(()));
}

async fn an_append_takes_place_after_the_expected_message<E: Engine>(first: &E, second: &E) {
    let ends = first.ends("tm_ends").await.expect("ends");
    assert_eq!((ends.first, ends.last), (1, 0));
    assert_eq!(first.append_if("tm_ends", 1, bytes("x"), PATIENCE).await, Err(AppendIfError::NotExpected));
    assert_eq!(first.append_if("tm_ends", 0, bytes("a"), PATIENCE).await, Ok(1));
    assert_eq!(second.append_if("tm_ends", 0, bytes("x"), PATIENCE).await, Err(AppendIfError::NotExpected));
    assert_eq!(second.append_if("tm_ends", 1, bytes("b"), PATIENCE).await, Ok(2));
    let ends = first.ends("tm_ends").await.expect("ends");
    assert_eq!((ends.first, ends.last), (1, 2));
}

async fn messages_are_read_by_number_and_in_order<E: Engine>(first: &E, second: &E) {
    let large = "m".repeat(400_000);
    for sequence in 0..4 {
        let content = bytes(&format!("{sequence}{large}"));
        assert_eq!(first.append_if("tm_read", sequence, content, PATIENCE).await, Ok(sequence + 1));
    }
    assert_eq!(second.read("tm_read", 3).await, Ok(Some(message(3, &format!("2{large}")))));
    assert_eq!(second.read("tm_read", 5).await, Ok(None));
    // A read returns a message alone if it is larger than the limit of the read.
    let one = second.read_from("tm_read", 2, 1, PATIENCE).await.expect("read");
    assert_eq!(one, [message(2, &format!("1{large}"))]);
    let mut all = Vec::new();
    while all.len() < 4 {
        let next = all.len() as u64 + 1;
        let some = second.read_from("tm_read", next, 900_000, PATIENCE).await.expect("read");
        assert!(!some.is_empty() && some.len() <= 2, "{}", some.len());
        all.extend(some);
    }
    assert_eq!(all.iter().map(|message| message.sequence).collect::<Vec<_>>(), [1, 2, 3, 4]);
    let none = second.read_from("tm_read", 5, 1 << 20, Duration::from_millis(200)).await;
    assert_eq!(none, Ok(Vec::new()));
}

async fn a_follower_gets_each_message_once_and_in_order<E: Engine>(first: &E, second: &E) {
    const COUNT: u64 = 300;
    let follower = second.clone();
    let following = tokio::spawn(async move {
        let mut next = 1;
        while next <= COUNT {
            for message in follower.read_from("tm_follow", next, 1 << 20, PATIENCE).await.expect("read") {
                assert_eq!(message, self::message(next, &format!("{next}")));
                next += 1;
            }
        }
    });
    for sequence in 1..=COUNT {
        let content = bytes(&format!("{sequence}"));
        assert_eq!(first.append_if("tm_follow", sequence - 1, content, PATIENCE).await, Ok(sequence));
    }
    following.await.expect("the follower");
    // A follower may go back and read the same messages again.
    let again = second.read_from("tm_follow", COUNT - 1, 1 << 20, PATIENCE).await.expect("read");
    assert_eq!(again.first().map(|message| message.sequence), Some(COUNT - 1));
}

async fn what_is_purged_is_gone_and_numbers_go_on<E: Engine>(engine: &E) {
    for sequence in 0..5 {
        assert_eq!(engine.append_if("tm_purge", sequence, bytes("a"), PATIENCE).await, Ok(sequence + 1));
    }
    engine.purge_before("tm_purge", 4).await.expect("purge");
    let ends = engine.ends("tm_purge").await.expect("ends");
    assert_eq!((ends.first, ends.last), (4, 5));
    assert_eq!(engine.read("tm_purge", 3).await, Ok(None));
    assert_eq!(engine.read("tm_purge", 4).await, Ok(Some(message(4, "a"))));
    // A read does not return the messages behind a gap.
    let gap = engine.read_from("tm_purge", 2, 1 << 20, Duration::from_millis(300)).await;
    assert_eq!(gap, Ok(Vec::new()));
    engine.purge_before("tm_purge", 2).await.expect("purge what is gone");
    engine.purge_before("tm_purge", 6).await.expect("purge all");
    let ends = engine.ends("tm_purge").await.expect("ends");
    assert_eq!((ends.first, ends.last), (6, 5));
    assert_eq!(engine.append_if("tm_purge", 5, bytes("b"), PATIENCE).await, Ok(6));
}

async fn of_concurrent_appends_one_takes_a_number<E: Engine>(first: &E, second: &E) {
    const EACH: usize = 25;
    let mut writers = JoinSet::new();
    for writer in 0..4 {
        let engine = if writer % 2 == 0 { first.clone() } else { second.clone() };
        writers.spawn(async move {
            let mut taken = Vec::new();
            while taken.len() < EACH {
                let last = engine.ends("tm_race").await.expect("ends").last;
                let content = format!("{writer} after {last}");
                match engine.append_if("tm_race", last, bytes(&content), PATIENCE).await {
                    Ok(sequence) => taken.push((sequence, content)),
                    Err(AppendIfError::NotExpected) => {}
                    Err(error) => panic!("{error:?}"),
                }
            }
            taken
        });
    }
    let taken: Vec<(u64, String)> = writers.join_all().await.into_iter().flatten().collect();
    let by_number: BTreeMap<u64, String> = taken.iter().cloned().collect();
    assert_eq!(by_number.len(), taken.len(), "a number was given twice");
    assert_eq!(by_number.keys().copied().collect::<Vec<_>>(), (1..=4 * EACH as u64).collect::<Vec<_>>());
    for (sequence, content) in by_number {
        assert_eq!(first.read("tm_race", sequence).await, Ok(Some(message(sequence, &content))));
    }
}

/// Waits until the list of maps equals `expected`, because the list may be slightly out of date.
async fn listed<E: Engine, const N: usize>(engine: &E, expected: [(&str, &str, u64); N]) {
    let entry =
        |(key, value, revision): (&str, &str, u64)| (key.to_owned(), KeyEntry { value: bytes(value), revision });
    let expected = expected.map(entry);
    let deadline = Instant::now() + PATIENCE;
    loop {
        let mut list = engine.list(Bucket::Maps).await.expect("list");
        list.sort_by(|a, b| a.0.cmp(&b.0));
        if list == expected || Instant::now() > deadline {
            return assert_eq!(list, expected);
        }
        sleep(Duration::from_millis(10)).await;
    }
}

async fn keys_are_set_under_their_revision<E: Engine>(first: &E, second: &E) {
    assert_eq!(first.get(Bucket::Maps, "a").await, Ok(None));
    let created = first.set_if(Bucket::Maps, "a", 0, bytes("1")).await.expect("create");
    assert_eq!(second.set_if(Bucket::Maps, "a", 0, bytes("x")).await, Err(SetError::NotExpected));
    assert_eq!(second.set_if(Bucket::Maps, "a", created + 1, bytes("x")).await, Err(SetError::NotExpected));
    let changed = second.set_if(Bucket::Maps, "a", created, bytes("2")).await.expect("change");
    assert!(changed > created);
    let entry = first.get(Bucket::Maps, "a").await.expect("get").expect("an entry");
    assert_eq!((entry.value, entry.revision), (bytes("2"), changed));
    let other = first.set(Bucket::Maps, "b.c", bytes("3")).await.expect("set");
    assert!(other > changed);
    // Buckets do not see each other's keys.
    assert_eq!(first.get(Bucket::Members, "a").await, Ok(None));
    assert_eq!(first.list(Bucket::Members).await, Ok(Vec::new()));
    listed(first, [("a", "2", changed), ("b.c", "3", other)]).await;
    assert_eq!(first.delete_if(Bucket::Maps, "a", created).await, Err(SetError::NotExpected));
    assert_eq!(first.delete_if(Bucket::Maps, "a", changed).await, Ok(()));
    assert_eq!(second.get(Bucket::Maps, "a").await, Ok(None));
    assert_eq!(second.set_if(Bucket::Maps, "a", changed, bytes("x")).await, Err(SetError::NotExpected));
    listed(second, [("b.c", "3", other)]).await;
    // A key that was deleted does not exist, and may be created.
    let created = second.set_if(Bucket::Maps, "a", 0, bytes("4")).await.expect("create again");
    assert!(created > changed);
}

async fn a_counter_of_many_writers_counts_all<E: Engine>(first: &E, second: &E) {
    const EACH: u64 = 20;
    let mut writers = JoinSet::new();
    for writer in 0..4 {
        let engine = if writer % 2 == 0 { first.clone() } else { second.clone() };
        writers.spawn(async move {
            let mut counted = 0;
            while counted < EACH {
                let entry = engine.get(Bucket::Writers, "counter").await.expect("get");
                let (count, revision) = entry.map_or((0, 0), |entry| {
                    let count = std::str::from_utf8(&entry.value).expect("text").parse().expect("a number");
                    (count, entry.revision)
                });
                let value = bytes(&format!("{}", count + 1_u64));
                match engine.set_if(Bucket::Writers, "counter", revision, value).await {
                    Ok(_) => counted += 1,
                    Err(SetError::NotExpected) => {}
                    Err(error) => panic!("{error:?}"),
                }
            }
        });
    }
    writers.join_all().await;
    let entry = first.get(Bucket::Writers, "counter").await.expect("get").expect("a counter");
    assert_eq!(entry.value, bytes("80"));
}

async fn a_deleted_stream_begins_anew<E: Engine>(engine: &E, replicas: usize) {
    engine.delete_stream("tm_ends").await.expect("delete");
    assert!(matches!(engine.ends("tm_ends").await, Err(EngineError::Missing(_))));
    engine.create_stream("tm_ends", replicas).await.expect("create");
    assert_eq!(engine.append_if("tm_ends", 0, bytes("c"), PATIENCE).await, Ok(1));
}
