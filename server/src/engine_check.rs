//! `tidemapd check-engine`: checks that the engine of a cluster has the properties on which tidemap relies.
//!
//! Invariant: the check changes nothing in the engine except a stream of its own, and deletes this stream.

use std::{process::ExitCode, time::Duration};

use anyhow::{Context as _, anyhow};
use tidemap_base::{config::Settings, random_id::random_id};
use tidemap_cluster::{
    engine::{Engine as _, EngineServer},
    nats::{NatsEngine, check},
    race::{RaceOutcome, RaceTerms, race},
};
use tidemap_ingest::cluster::nats_settings;

/// Number of writers that race, each with a connection of its own.
const WRITERS: usize = 4;
/// The exit status if the engine could not be checked, or is refused.
const UNUSABLE: u8 = 78;

const FAILED: &str = "the engine could not be checked";

/// Runs the command.
pub(crate) fn run(settings: &Settings, seconds: u64) -> ExitCode {
    let runtime = tokio::runtime::Builder::new_multi_thread().enable_all().build().context("cannot start");
    let outcome = runtime.and_then(|runtime| runtime.block_on(check_engine(settings, seconds)));
    match outcome {
        Ok(outcome) if outcome.is_sound() => ExitCode::SUCCESS,
        Ok(_) => ExitCode::FAILURE,
        Err(error) => {
            eprintln!("tidemapd: {error:#}");
            ExitCode::from(UNUSABLE)
        }
    }
}

async fn check_engine(settings: &Settings, seconds: u64) -> anyhow::Result<RaceOutcome> {
    let missing = || anyhow!("the config file has no section [cluster], which names the engine's servers");
    let section = settings.cluster.as_ref().ok_or_else(missing)?;
    let mut engines = Vec::new();
    for _ in 0..WRITERS {
        engines.push(NatsEngine::connect(nats_settings(section)).await.context(FAILED)?);
    }
    let first = &engines[0];
    for server in first.servers().await.context(FAILED)? {
        println!("{}", server_line(&server));
    }
    check(first, section.require_synced_engine).await.context("the engine cannot be used")?;
    let id = random_id().context("no random numbers")?;
    let terms = RaceTerms {
        stream: format!("tm_check_{id}"),
        replicas: section.engine_replicas,
        lasts: Duration::from_secs(seconds),
    };
    let stopped = async {
        if tokio::signal::ctrl_c().await.is_err() {
            std::future::pending::<()>().await;
        }
    };
    let outcome =
        race(engines, &terms, stopped).await.context(FAILED)?.context("stopped before the end of the race")?;
    println!("{}", outcome_line(&outcome, seconds));
    Ok(outcome)
}

fn server_line(EngineServer { name, version, syncs_always }: &EngineServer) -> String {
    let syncs = match syncs_always {
        Some(true) => "writes to its disk before it acknowledges",
        Some(false) => "acknowledges before it writes to its disk",
        None => "does not report when it writes to its disk",
    };
    format!("{name}: version {version}, {syncs}")
}

fn outcome_line(outcome: &RaceOutcome, seconds: u64) -> String {
    let RaceOutcome { acknowledged, refused, unanswered, twice, missing } = outcome;
    let found = if outcome.is_sound() {
        "no position was taken twice".to_owned()
    } else {
        format!(
            "{twice} positions were taken twice, and {missing} acknowledged appends are lost: do not use this engine"
        )
    };
    format!(
        "{WRITERS} writers in {seconds} s: {acknowledged} appends acknowledged, {refused} refused, {unanswered} \
         without a response; {found}"
    )
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_outcome_names_what_is_wrong() {
        let sound = RaceOutcome { acknowledged: 9, refused: 3, ..RaceOutcome::default() };
        assert!(outcome_line(&sound, 10).ends_with("no position was taken twice"));
        let broken = RaceOutcome { twice: 2, missing: 1, ..sound };
        assert!(outcome_line(&broken, 10).contains("2 positions were taken twice, and 1 acknowledged"));
    }
}
