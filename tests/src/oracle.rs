//! The data that a daemon must hold, given its acknowledgements.
//!
//! Invariant: computed only from the feed and the daemon's own sequence numbers. A daemon may hold more than it
//! acknowledged, complete and in order, never less, and nothing twice.

use std::{
    collections::BTreeMap,
    fmt,
    time::{Duration, Instant},
};

use tidemap_client::{
    Client,
    queries::{ModelKind, ModelSelector},
    updates::JobState,
};
use tonic::Code;

use crate::{
    daemon::Daemon,
    feed::{Feed, state_name},
    stream::{Ended, RawStream, hello},
};

/// A daemon that has space again welcomes producers within this time.
const WELCOME_WITHIN: Duration = Duration::from_secs(30);

/// A violation of a daemon's promises.
#[derive(Clone, Debug, PartialEq)]
pub enum Violation {
    /// Acknowledged observations are missing.
    Lost {
        /// The producer.
        producer: String,
        /// Last acknowledged sequence number.
        acknowledged: u64,
        /// Last sequence number that it holds.
        durable: u64,
    },
    /// The daemon holds observations that were never sent.
    Foreign {
        /// The producer.
        producer: String,
        /// Last sequence number sent.
        sent: u64,
        /// Last sequence number that it holds.
        durable: u64,
    },
    /// The map itself is gone.
    MapGone(String),
    /// An answer differs from the one that follows from its data.
    Differs {
        /// The question.
        what: String,
        /// The expected answer.
        expected: String,
        /// The answer.
        found: String,
    },
}

impl Violation {
    /// Whether acknowledged observations are missing.
    #[must_use]
    pub fn is_loss(&self) -> bool {
        matches!(self, Self::Lost { .. } | Self::MapGone(_))
    }
}

impl fmt::Display for Violation {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        match self {
            Self::Lost { producer, acknowledged, durable } => {
                write!(f, "LOST: {producer} was told that {acknowledged} is durable, and {durable} is")
            }
            Self::Foreign { producer, sent, durable } => {
                write!(f, "FOREIGN: {producer} sent up to {sent}, and {durable} is durable")
            }
            Self::MapGone(map) => write!(f, "LOST: map {map:?} is gone"),
            Self::Differs { what, expected, found } => {
                write!(f, "DIFFERS: {what} should be {expected} and is {found}")
            }
        }
    }
}

fn same<T: PartialEq + fmt::Debug>(what: impl FnOnce() -> String, expected: &T, found: &T) -> Result<(), Violation> {
    if expected == found {
        return Ok(());
    }
    Err(Violation::Differs { what: what(), expected: format!("{expected:?}"), found: format!("{found:?}") })
}

fn near(what: impl FnOnce() -> String, expected: f64, found: f64) -> Result<(), Violation> {
    if (expected - found).abs() <= 1e-9 {
        return Ok(());
    }
    Err(Violation::Differs { what: what(), expected: expected.to_string(), found: found.to_string() })
}

/// The sequence numbers of one producer.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct Mark {
    /// The last acknowledged sequence number.
    pub acknowledged: u64,
    /// The last sequence number handed over, perhaps never sent.
    pub sent: u64,
}

/// The expected content of one state.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
struct StateExpectation {
    observations: u64,
    sum: f64,
    last: Option<(i64, f64)>,
}

/// One map that is fed by a feed.
#[derive(Clone, Debug)]
pub struct Oracle {
    /// Name of the map.
    pub map: String,
    /// The feed of the map.
    pub feed: Feed,
    /// The marks by producer.
    pub marks: Vec<Mark>,
}

/// Name of a producer.
#[must_use]
pub fn producer_name(producer: usize) -> String {
    format!("robot-{producer}")
}

impl Oracle {
    /// Nothing is sent yet.
    #[must_use]
    pub fn new(map: &str, feed: Feed, producers: usize) -> Self {
        Self { map: map.to_owned(), feed, marks: vec![Mark::default(); producers] }
    }

    /// Checksum over a producer's observations, as `observation.proto` defines it.
    #[must_use]
    pub fn content_crc(&self, producer: u32, durable: u64) -> u32 {
        (1..=durable).fold(0, |crc, sequence| {
            let o = self.feed.observation(producer, sequence);
            let crc = crc32c::crc32c_append(crc, state_name(o.state).as_bytes());
            let crc = crc32c::crc32c_append(crc, &o.time_nanos.to_le_bytes());
            crc32c::crc32c_append(crc, &o.value.to_le_bytes())
        })
    }

    /// Compares all answers of a daemon with the expected ones, and records its sequence numbers as acknowledged. With
    /// `update`, it must run an update first.
    ///
    /// # Errors
    /// The first violation.
    ///
    /// # Panics
    /// If the daemon does not answer.
    pub async fn verify(&mut self, daemon: &Daemon, update: bool) -> Result<(), Violation> {
        let mut durable = Vec::new();
        for (producer, mark) in self.marks.iter().enumerate() {
            durable.push(self.verify_producer(daemon, producer, *mark).await?);
        }
        let expected = self.states(&durable);
        self.verify_map(&daemon.client(), &expected, update).await?;
        for (mark, durable) in self.marks.iter_mut().zip(durable) {
            *mark = Mark { acknowledged: durable, sent: mark.sent };
        }
        Ok(())
    }

    async fn verify_producer(&self, daemon: &Daemon, producer: usize, mark: Mark) -> Result<u64, Violation> {
        let name = producer_name(producer);
        let began = Instant::now();
        let opened = loop {
            let opened = RawStream::open(&daemon.grpc, hello(&name, &self.map)).await;
            // After a full disk no stream is welcome until all that was under way is answered.
            let is_full = |ended: &Ended| ended.status.as_ref().is_some_and(|it| it.code() == Code::ResourceExhausted);
            if !opened.as_ref().is_err_and(is_full) || began.elapsed() > WELCOME_WITHIN {
                break opened;
            }
            tokio::time::sleep(Duration::from_millis(20)).await;
        };
        let (mut stream, welcome) = match opened {
            Ok(opened) => opened,
            Err(ended) => {
                let status = ended.error();
                assert_eq!(status.code(), Code::NotFound, "the daemon does not welcome {name}: {status:?}");
                return Err(Violation::MapGone(self.map.clone()));
            }
        };
        // The key is free again once the daemon has answered.
        stream.close();
        stream.end().await;
        let durable = welcome.durable_sequence;
        if durable < mark.acknowledged {
            return Err(Violation::Lost { producer: name, acknowledged: mark.acknowledged, durable });
        }
        if durable > mark.sent {
            return Err(Violation::Foreign { producer: name, sent: mark.sent, durable });
        }
        let id = u32::try_from(producer).expect("a small number");
        same(|| format!("the checksum of {name}"), &self.content_crc(id, durable), &welcome.content_crc)?;
        Ok(durable)
    }

    /// The expected content of each state that has an observation.
    fn states(&self, durable: &[u64]) -> BTreeMap<String, StateExpectation> {
        let mut states: Vec<StateExpectation> = vec![StateExpectation::default(); self.feed.states as usize];
        for (producer, &durable) in (0..).zip(durable) {
            for o in (1..=durable).map(|sequence| self.feed.observation(producer, sequence)) {
                if o.is_refused() {
                    continue;
                }
                let state = &mut states[o.state as usize];
                state.observations += 1;
                state.sum += o.value;
                if state.last.is_none_or(|(time, _)| time < o.time_nanos) {
                    state.last = Some((o.time_nanos, o.value));
                }
            }
        }
        let named = (0..).map(state_name).zip(states);
        named.filter(|(_, state)| state.observations > 0).collect()
    }

    async fn verify_map(
        &self,
        client: &Client,
        expected: &BTreeMap<String, StateExpectation>,
        update: bool,
    ) -> Result<(), Violation> {
        let total: u64 = expected.values().map(|state| state.observations).sum();
        let map = client.map(&self.map).await.expect("the map is there");
        same(|| "observations of the map".to_owned(), &total, &map.observations)?;
        let (states, more) = client.states(&self.map, "").await.expect("the map is there");
        assert_eq!(more, None, "one page holds all states");
        let counts: BTreeMap<String, u64> = states.iter().map(|s| (s.name.clone(), s.observations)).collect();
        let wanted: BTreeMap<String, u64> = expected.iter().map(|(name, s)| (name.clone(), s.observations)).collect();
        same(|| "observations by state".to_owned(), &wanted, &counts)?;
        if update {
            run_update(client, &self.map, None).await;
            let pending = client.map(&self.map).await.expect("the map is there").pending_observations;
            same(|| "observations pending after an update".to_owned(), &0, &pending)?;
        }
        for (name, state) in expected {
            let latest = self.latest(client, name).await;
            same(|| format!("the latest value of {name:?}"), &state.last.map(|(_, value)| value), &Some(latest))?;
            let model = client.describe_model(&self.map, name).await.expect("the state is there");
            same(|| format!("the time of {name:?}"), &state.last.map(|(time, _)| time), &model.last_nanos)?;
            if update {
                let what = || format!("observations of {name:?} folded in");
                same(what, &state.observations, &model.learned_observations)?;
                near(|| format!("the mean of {name:?}"), state.sum / state.observations as f64, model.mean)?;
            }
        }
        Ok(())
    }

    async fn latest(&self, client: &Client, state: &str) -> f64 {
        let model = ModelSelector { kind: ModelKind::Latest, ..ModelSelector::default() };
        let mut predictions = client.predict(&self.map, vec![state.to_owned()], vec![i64::MAX / 2], model);
        predictions.next().await.expect("the state is there").expect("a prediction").probabilities[0]
    }
}

/// Waits until no update waits or runs: an interrupted one runs again after the start, while the daemon serves.
///
/// # Panics
/// If the daemon does not answer.
pub async fn settled(client: &Client) {
    let is_out = |state: JobState| matches!(state, JobState::Waiting | JobState::Running);
    while client.jobs().await.expect("the daemon responds").iter().any(|job| is_out(job.state)) {
        tokio::time::sleep(Duration::from_millis(5)).await;
    }
}

/// Does the same as [`settled`], for tests without a runtime.
///
/// # Panics
/// If the daemon does not answer.
pub fn settle(daemon: &Daemon) {
    let runtime = tokio::runtime::Runtime::new().expect("a runtime");
    runtime.block_on(async { settled(&daemon.client()).await });
}

/// Updates a map and waits for the end of it.
///
/// # Panics
/// If the update fails.
pub async fn run_update(client: &Client, map: &str, until_nanos: Option<i64>) {
    let job = client.run_update(map, until_nanos).await.expect("the map is there");
    let mut watch = client.watch_job(job.id).await.expect("the job is known");
    let mut last = job;
    while let Some(job) = watch.next().await.expect("the daemon responds") {
        last = job;
    }
    assert_eq!(last.state, JobState::Done, "the update ended with {:?}", last.error);
}
