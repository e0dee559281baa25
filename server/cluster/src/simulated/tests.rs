//! The simulated engine keeps the promises of an engine, gives the same result for the same seed, and has every fault.
//!
//! Invariant: runs under tokio's paused clock.

use std::collections::BTreeMap;

use super::*;
use crate::engine::tests::behaves;

const STREAM: &str = "tm_a";

fn bytes(text: &str) -> Bytes {
    Bytes::copy_from_slice(text.as_bytes())
}

async fn quiet() -> (Simulation, SimulatedEngine, SimulatedEngine) {
    let simulation = Simulation::new(1, EngineFaults::none());
    let (first, second) = (simulation.client("first"), simulation.client("second"));
    first.create_stream(STREAM, 3).await.expect("create");
    (simulation, first, second)
}

async fn append(engine: &SimulatedEngine, expected_last: u64, text: &str) -> Result<u64, AppendIfError> {
    engine.append_if(STREAM, expected_last, bytes(text), PATIENCE).await
}

fn contents(messages: Vec<Message>) -> Vec<Bytes> {
    messages.into_iter().map(|message| message.content).collect()
}

#[tokio::test(start_paused = true)]
async fn it_behaves_as_an_engine() {
    for seed in 0..20 {
        let faults = EngineFaults { delay: Duration::ZERO..=Duration::from_millis(50), ..EngineFaults::none() };
        let simulation = Simulation::new(seed, faults);
        behaves(simulation.client("first"), simulation.client("second"), 3).await;
    }
}

#[tokio::test(start_paused = true)]
async fn an_engine_without_a_fence_does_not_pass_the_suite() {
    let simulation = Simulation::new(1, EngineFaults::none());
    simulation.plant(PlantedDefects { ignore_expected: true, ..PlantedDefects::default() });
    let suite = tokio::spawn(behaves(simulation.client("first"), simulation.client("second"), 3));
    assert!(suite.await.is_err_and(|error| error.is_panic()));
}

/// Three clients that append for a while, each after the last message that it has seen, as a writer does.
async fn busy(seed: u64, faults: EngineFaults) -> Simulation {
    let simulation = Simulation::new(seed, faults);
    let mut writers = tokio::task::JoinSet::new();
    for name in ["a", "b", "c"] {
        let engine = simulation.client(name);
        writers.spawn(async move {
            for round in 0..40 {
                drop(engine.create_stream(STREAM, 3).await);
                if let Ok(ends) = engine.ends(STREAM).await {
                    drop(append(&engine, ends.last, &format!("{} {round}", engine.name)).await);
                }
                sleep(Duration::from_millis(20)).await;
            }
        });
    }
    writers.join_all().await;
    simulation
}

#[tokio::test(start_paused = true)]
async fn a_seed_gives_the_same_history() {
    for seed in 0..10 {
        let once = busy(seed, EngineFaults::all()).await.history();
        let again = busy(seed, EngineFaults::all()).await.history();
        assert!(once.len() > 100, "{}", once.len());
        assert_eq!(once, again, "seed {seed}");
    }
    assert_ne!(busy(1, EngineFaults::all()).await.history(), busy(2, EngineFaults::all()).await.history());
}

#[tokio::test(start_paused = true)]
async fn each_fault_occurs_over_many_seeds() {
    let mut counts = BTreeMap::new();
    for seed in 0..200 {
        for (fault, count) in busy(seed, EngineFaults::all()).await.counts() {
            *counts.entry(fault).or_insert(0) += count;
        }
    }
    for fault in EngineFault::ALL {
        assert!(counts.get(&fault).is_some_and(|&count| count >= 10), "{fault:?}: {counts:?}");
    }
}

#[tokio::test(start_paused = true)]
async fn faults_that_a_quorum_survives_lose_nothing() {
    for seed in 0..100 {
        let simulation = busy(seed, EngineFaults::survivable()).await;
        let present = simulation.present(STREAM);
        for acknowledged in simulation.acknowledged() {
            let at = usize::try_from(acknowledged.message.sequence).expect("a small number") - 1;
            assert_eq!(present.get(at), Some(&acknowledged.message), "seed {seed}");
        }
    }
}

#[tokio::test(start_paused = true)]
async fn a_lost_request_has_no_effect_and_a_lost_reply_has_it() {
    let (simulation, first, second) = quiet().await;
    simulation.fault_next("first", EngineFault::RequestLost);
    let before = Instant::now();
    let outcome = append(&first, 0, "a").await;
    assert!(matches!(outcome, Err(AppendIfError::Engine(EngineError::Unknown(_)))), "{outcome:?}");
    assert_eq!(before.elapsed(), PATIENCE);
    assert_eq!(second.ends(STREAM).await.expect("ends").last, 0);
    simulation.fault_next("first", EngineFault::ReplyLost);
    let outcome = append(&first, 0, "a").await;
    assert!(matches!(outcome, Err(AppendIfError::Engine(EngineError::Unknown(_)))), "{outcome:?}");
    assert_eq!(contents(simulation.present(STREAM)), [bytes("a")]);
    assert_eq!(append(&first, 0, "a").await, Err(AppendIfError::NotExpected));
    assert_eq!(simulation.acknowledged(), []);
}

#[tokio::test(start_paused = true)]
async fn a_late_request_has_its_effect_after_its_sender_has_given_up() {
    let (simulation, first, second) = quiet().await;
    simulation.fault_next("first", EngineFault::Late);
    let outcome = append(&first, 0, "a").await;
    assert!(matches!(outcome, Err(AppendIfError::Engine(EngineError::Unknown(_)))), "{outcome:?}");
    assert_eq!(simulation.present(STREAM), []);
    sleep(3 * PATIENCE).await;
    assert_eq!(second.read(STREAM, 1).await, Ok(Some(Message { sequence: 1, content: bytes("a") })));
}

#[tokio::test(start_paused = true)]
async fn without_a_leader_or_a_quorum_nothing_is_done() {
    let (simulation, first, _) = quiet().await;
    simulation.no_leader(Duration::from_secs(5));
    assert!(matches!(first.ends(STREAM).await, Err(EngineError::Unavailable(_))));
    assert_eq!(first.health(STREAM).await.expect("health").leader, None);
    sleep(Duration::from_secs(5)).await;
    assert_eq!(append(&first, 0, "a").await, Ok(1));
    // A single server may stop, but two of them must not.
    for server in 0..3 {
        simulation.stop_server(server);
        sleep(Duration::from_secs(10)).await;
        assert_eq!(append(&first, 1 + server as u64, "b").await, Ok(2 + server as u64));
        simulation.stop_server((server + 1) % 3);
        let outcome = append(&first, 2 + server as u64, "x").await;
        assert!(matches!(outcome, Err(AppendIfError::Engine(EngineError::Unavailable(_)))), "{outcome:?}");
        simulation.start_server(server);
        simulation.start_server((server + 1) % 3);
        sleep(Duration::from_secs(10)).await;
    }
    assert_eq!(simulation.present(STREAM).len(), 4);
}

#[tokio::test(start_paused = true)]
async fn one_client_is_cut_off_and_the_others_go_on() {
    let (simulation, first, second) = quiet().await;
    simulation.cut_off("first");
    for _ in 0..10 {
        let outcome = append(&first, 0, "x").await;
        assert!(
            matches!(outcome, Err(AppendIfError::Engine(EngineError::Unknown(_) | EngineError::Unavailable(_)))),
            "{outcome:?}"
        );
    }
    assert_eq!(append(&second, 0, "a").await, Ok(1));
    simulation.join("first");
    assert_eq!(append(&first, 1, "b").await, Ok(2));
}

#[tokio::test(start_paused = true)]
async fn a_frozen_client_makes_no_call_until_it_is_thawed() {
    let (simulation, first, second) = quiet().await;
    simulation.freeze("first");
    let frozen = tokio::spawn(async move { append(&first, 0, "late").await });
    sleep(Duration::from_secs(60)).await;
    assert!(!frozen.is_finished());
    assert_eq!(append(&second, 0, "a").await, Ok(1));
    simulation.thaw("first");
    assert_eq!(frozen.await.expect("the task"), Err(AppendIfError::NotExpected));
}

#[tokio::test(start_paused = true)]
async fn a_full_stream_takes_nothing_until_it_has_room() {
    let (simulation, first, _) = quiet().await;
    simulation.fill(STREAM);
    let outcome = append(&first, 0, "x").await;
    assert!(matches!(outcome, Err(AppendIfError::Engine(EngineError::Full(_)))), "{outcome:?}");
    simulation.make_room(STREAM);
    assert_eq!(append(&first, 0, "a").await, Ok(1));
}

#[tokio::test(start_paused = true)]
async fn amnesia_takes_acknowledged_messages_and_gives_their_numbers_again() {
    let (simulation, first, second) = quiet().await;
    for (last, text) in ["a", "b", "c"].into_iter().enumerate() {
        assert_eq!(append(&first, last as u64, text).await, Ok(last as u64 + 1));
    }
    simulation.forget(STREAM, 2);
    assert_eq!(second.ends(STREAM).await.expect("ends").last, 1);
    assert_eq!(append(&first, 3, "d").await, Err(AppendIfError::NotExpected));
    assert_eq!(append(&second, 1, "other").await, Ok(2));
    assert_eq!(contents(simulation.present(STREAM)), [bytes("a"), bytes("other")]);
    let acknowledged: Vec<_> = simulation.acknowledged().into_iter().map(|one| one.message.sequence).collect();
    assert_eq!(acknowledged, [1, 2, 3, 2]);
}

#[tokio::test(start_paused = true)]
async fn a_split_acknowledges_on_both_sides_and_keeps_one() {
    let (simulation, first, second) = quiet().await;
    assert_eq!(append(&first, 0, "a").await, Ok(1));
    simulation.split(STREAM, "first");
    assert_eq!(append(&first, 1, "mine").await, Ok(2));
    assert_eq!(append(&second, 1, "theirs").await, Ok(2));
    assert_eq!(append(&second, 2, "more").await, Ok(3));
    assert_eq!(first.ends(STREAM).await.expect("ends").last, 2);
    simulation.unite(STREAM);
    assert_eq!(append(&first, 2, "mine").await, Err(AppendIfError::NotExpected));
    assert_eq!(first.read(STREAM, 2).await.expect("read").expect("a message").content, bytes("theirs"));
}

#[tokio::test(start_paused = true)]
async fn planted_defects_show() {
    let (simulation, first, second) = quiet().await;
    simulation.plant(PlantedDefects { ignore_expected: true, ..PlantedDefects::default() });
    assert_eq!(append(&first, 0, "a").await, Ok(1));
    assert_eq!(append(&second, 0, "b").await, Ok(2));
    simulation.plant(PlantedDefects { stale_reads: true, ..PlantedDefects::default() });
    assert_eq!(append(&first, 2, "c").await, Ok(3));
    assert!(second.ends(STREAM).await.expect("ends").last < 3);
    assert_eq!(second.read(STREAM, 3).await, Ok(None));
    simulation.plant(PlantedDefects::default());
    assert_eq!(second.ends(STREAM).await.expect("ends").last, 3);
}

#[tokio::test(start_paused = true)]
async fn who_waits_gets_a_message_when_it_is_appended() {
    let (_, first, second) = quiet().await;
    let started = Instant::now();
    let waiting = tokio::spawn(async move {
        let messages = second.read_from(STREAM, 1, 1 << 20, Duration::from_secs(60)).await.expect("read");
        (messages, started.elapsed())
    });
    sleep(Duration::from_secs(10)).await;
    assert_eq!(append(&first, 0, "a").await, Ok(1));
    let (messages, after) = waiting.await.expect("the task");
    assert_eq!(contents(messages), [bytes("a")]);
    assert!(after < Duration::from_millis(10_020), "{after:?}");
}
