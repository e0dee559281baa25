//! A race for the positions of a stream, which shows whether an engine lets two writers append after the same message.
//!
//! Invariant: only what the engine has acknowledged counts. The stream is the race's own and is deleted at its end.

#[cfg(test)]
mod tests;

use std::{
    collections::{BTreeMap, BTreeSet},
    time::Duration,
};

use bytes::Bytes;
use tokio::{
    task::JoinSet,
    time::{Instant, sleep},
};

use crate::engine::{AppendIfError, Engine, EngineError};

/// Time limit of one append.
const PATIENCE: Duration = Duration::from_millis(500);
/// Pause after an error that may pass.
const PAUSE: Duration = Duration::from_millis(50);
/// Number of attempts to delete the stream.
const DELETIONS: usize = 3;
/// Bytes that are read at once.
const READ_BYTES: usize = 1 << 20;
/// Time limit for reading the messages again: a new leader may have to be elected.
const READ_WITHIN: Duration = Duration::from_secs(30);

/// Settings of a race.
#[derive(Clone, Debug)]
pub struct RaceTerms {
    /// Name of the stream, which nobody else uses.
    pub stream: String,
    /// Servers that hold it.
    pub replicas: usize,
    /// Time for which the writers append.
    pub lasts: Duration,
}

/// The result of a race.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct RaceOutcome {
    /// Appends that were acknowledged.
    pub acknowledged: u64,
    /// Appends that were refused, because another writer was first.
    pub refused: u64,
    /// Appends without a reply. They may be in the stream.
    pub unanswered: u64,
    /// Positions that the engine gave to two writers: it acknowledged to both that their message follows the same
    /// message, or has the same number.
    pub twice: u64,
    /// Acknowledged messages that the stream does not have at their number.
    pub missing: u64,
}

impl RaceOutcome {
    /// Whether the engine has kept its promise.
    #[must_use]
    pub fn is_sound(&self) -> bool {
        self.twice == 0 && self.missing == 0
    }
}

/// An append that was acknowledged.
#[derive(Clone, Debug)]
struct RaceAppend {
    expected: u64,
    sequence: u64,
    content: Bytes,
}

#[derive(Default)]
struct RaceWriter {
    appends: Vec<RaceAppend>,
    refused: u64,
    unanswered: u64,
}

/// Lets writers, each with an engine of its own, append to a new stream as fast as they can. `None`: the race was
/// `stopped` before its end.
///
/// # Errors
/// The stream could not be created or read, or the engine refuses appends.
pub async fn race<E: Engine>(
    engines: Vec<E>,
    terms: &RaceTerms,
    stopped: impl Future<Output = ()> + Send,
) -> Result<Option<RaceOutcome>, EngineError> {
    let Some(engine) = engines.first().cloned() else { return Ok(None) };
    let outcome = tokio::select! {
        outcome = run(&engine, engines, terms) => outcome.map(Some),
        () = stopped => Ok(None),
    };
    if let Err(error) = delete(&engine, &terms.stream).await {
        // The result of the race is valid all the same.
        tracing::warn!(stream = terms.stream, %error, "the stream of the check is not deleted");
    }
    outcome
}

async fn delete<E: Engine>(engine: &E, stream: &str) -> Result<(), EngineError> {
    let mut deleted = engine.delete_stream(stream).await;
    for _ in 1..DELETIONS {
        if deleted.is_ok() {
            break;
        }
        sleep(PATIENCE).await;
        deleted = engine.delete_stream(stream).await;
    }
    deleted
}

async fn run<E: Engine>(engine: &E, engines: Vec<E>, terms: &RaceTerms) -> Result<RaceOutcome, EngineError> {
    engine.create_stream(&terms.stream, terms.replicas).await?;
    let until = Instant::now() + terms.lasts;
    let mut writers = JoinSet::new();
    for (number, engine) in engines.into_iter().enumerate() {
        writers.spawn(write(engine, terms.stream.clone(), number, until));
    }
    let (mut outcome, mut appends) = (RaceOutcome::default(), Vec::new());
    while let Some(writer) = writers.join_next().await {
        let writer = writer.map_err(|error| EngineError::Refused(format!("a writer of the race: {error}")))??;
        outcome.refused += writer.refused;
        outcome.unanswered += writer.unanswered;
        appends.extend(writer.appends);
    }
    outcome.acknowledged = appends.len() as u64;
    outcome.twice = taken_twice(&appends);
    outcome.missing = missing(engine, &terms.stream, appends).await?;
    Ok(outcome)
}

/// Appends after the last message that this writer has seen, until the time is over.
async fn write<E: Engine>(engine: E, stream: String, number: usize, until: Instant) -> Result<RaceWriter, EngineError> {
    let mut writer = RaceWriter::default();
    let mut expected = None;
    let mut attempts = 0_u64;
    while Instant::now() < until {
        let last = match expected {
            Some(last) => last,
            None => match engine.ends(&stream).await {
                Ok(ends) => ends.last,
                Err(error) => {
                    pass(error).await?;
                    continue;
                }
            },
        };
        attempts += 1;
        let content = Bytes::from(format!("writer {number}, append {attempts}"));
        expected = None;
        match engine.append_if(&stream, last, content.clone(), PATIENCE).await {
            Ok(sequence) => {
                writer.appends.push(RaceAppend { expected: last, sequence, content });
                expected = Some(sequence);
            }
            Err(AppendIfError::NotExpected) => writer.refused += 1,
            Err(AppendIfError::Engine(error)) => {
                writer.unanswered += u64::from(matches!(error, EngineError::Unknown(_)));
                pass(error).await?;
            }
        }
    }
    Ok(writer)
}

/// Waits after an error that may pass; returns the other errors.
async fn pass(error: EngineError) -> Result<(), EngineError> {
    match error {
        EngineError::Unknown(_) | EngineError::Unavailable(_) => {
            sleep(PAUSE).await;
            Ok(())
        }
        error => Err(error),
    }
}

/// Number of appends that were acknowledged at a position that another append has too.
fn taken_twice(appends: &[RaceAppend]) -> u64 {
    let (mut befores, mut sequences) = (BTreeSet::new(), BTreeSet::new());
    let is_second = |append: &&RaceAppend| !befores.insert(append.expected) | !sequences.insert(append.sequence);
    appends.iter().filter(is_second).count() as u64
}

/// Number of acknowledged messages that the stream does not have at their number.
async fn missing<E: Engine>(engine: &E, stream: &str, appends: Vec<RaceAppend>) -> Result<u64, EngineError> {
    let mut acknowledged: BTreeMap<u64, Vec<Bytes>> = BTreeMap::new();
    for append in appends {
        acknowledged.entry(append.sequence).or_default().push(append.content);
    }
    let Some(&last) = acknowledged.keys().last() else { return Ok(0) };
    let (mut next, begun) = (1, Instant::now());
    while next <= last {
        let messages = match engine.read_from(stream, next, READ_BYTES, PATIENCE).await {
            Ok(messages) => messages,
            Err(error) => {
                pass(error).await?;
                Vec::new()
            }
        };
        for message in messages {
            if let Some(contents) = acknowledged.get_mut(&message.sequence) {
                contents.retain(|content| *content != message.content);
            }
            next = message.sequence + 1;
        }
        if begun.elapsed() > READ_WITHIN {
            if engine.ends(stream).await?.last < last {
                break;
            }
            return Err(EngineError::Unavailable(format!("message {next} of {last} cannot be read")));
        }
    }
    Ok(acknowledged.values().map(|contents| contents.len() as u64).sum())
}
