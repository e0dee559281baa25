//! Races on the simulated engine, sound and with a defect, and on real servers.

use std::time::Duration;

use super::*;
use crate::{
    nats::NatsEngine,
    nats_process::NatsServers,
    simulated::{EngineFaults, PlantedDefects, Simulation},
};

fn terms(lasts: Duration) -> RaceTerms {
    RaceTerms { stream: "tm_check_1".to_owned(), replicas: 3, lasts }
}

fn simulated(faults: EngineFaults, defects: PlantedDefects) -> RaceOutcome {
    let runtime = tokio::runtime::Builder::new_current_thread().enable_time().start_paused(true).build().expect("made");
    runtime.block_on(async {
        let simulation = Simulation::new(1, faults);
        simulation.plant(defects);
        let engines = (0..4).map(|number| simulation.client(&format!("writer-{number}"))).collect();
        let outcome = race(engines, &terms(Duration::from_secs(20)), std::future::pending())
            .await
            .expect("a race")
            .expect("its end");
        assert!(simulation.present("tm_check_1").is_empty(), "the stream is deleted");
        outcome
    })
}

#[test]
fn an_engine_with_a_sound_fence_gives_no_position_twice() {
    let faults = EngineFaults { chances: Vec::new(), ..EngineFaults::survivable() };
    let outcome = simulated(faults, PlantedDefects::default());
    assert!(outcome.is_sound() && outcome.acknowledged > 200 && outcome.refused > 200, "{outcome:?}");
}

#[test]
fn an_engine_that_lets_two_messages_in_at_one_position_is_found() {
    let defects = PlantedDefects { two_at_one_position: true, ..PlantedDefects::default() };
    let faults = EngineFaults { chances: Vec::new(), ..EngineFaults::survivable() };
    let outcome = simulated(faults, defects);
    assert!(outcome.twice > 0 && !outcome.is_sound(), "{outcome:?}");
}

#[test]
fn an_engine_that_forgets_what_it_has_acknowledged_is_found() {
    let chances = vec![(crate::simulated::EngineFault::Amnesia, 0.01)];
    let outcome = simulated(EngineFaults { chances, ..EngineFaults::none() }, PlantedDefects::default());
    assert!(outcome.twice + outcome.missing > 0, "{outcome:?}");
}

#[tokio::test(flavor = "multi_thread", worker_threads = 2)]
async fn real_servers_give_no_position_twice() {
    let servers = match NatsServers::start(3).await {
        Ok(servers) => servers,
        Err(reason) => return println!("SKIPPED: {reason}"),
    };
    let mut engines = Vec::new();
    for _ in 0..3 {
        engines.push(NatsEngine::connect(servers.settings()).await.expect("a connection"));
    }
    let engine = engines[0].clone();
    let outcome =
        race(engines, &terms(Duration::from_secs(2)), std::future::pending()).await.expect("a race").expect("its end");
    assert!(outcome.is_sound() && outcome.acknowledged > 0 && outcome.refused > 0, "{outcome:?}");
    let gone = engine.ends("tm_check_1").await;
    assert!(matches!(gone, Err(EngineError::Missing(_))), "{gone:?}");
}

#[tokio::test(start_paused = true)]
async fn a_race_that_is_stopped_deletes_its_stream() {
    let simulation = Simulation::new(1, EngineFaults::none());
    let stopped = sleep(Duration::from_secs(5));
    let outcome = race(vec![simulation.client("writer")], &terms(Duration::from_secs(60)), stopped).await;
    assert_eq!((outcome, simulation.present("tm_check_1")), (Ok(None), Vec::new()));
    assert!(!simulation.acknowledged().is_empty(), "it had begun");
}
