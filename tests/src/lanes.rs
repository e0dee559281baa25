//! Producers of a cluster that stream for ever, each a part of a feed, and go to the next daemon when theirs fails.
//!
//! Invariant: a producer records as acknowledged only observations that a daemon has acknowledged to it. Observations
//! that a cluster has forgotten are reported before anything is sent again.

use std::{
    sync::{
        Arc, Mutex, MutexGuard, PoisonError,
        atomic::{AtomicBool, Ordering},
    },
    time::{Duration, Instant},
};

use rand::{Rng as _, rngs::SmallRng};
use serde_json::{Value, json};
use tidemap_client::{
    Client, clock,
    observe::{Producer, ProducerError, ProducerOptions},
};
use tokio::{sync::mpsc::UnboundedSender, time::timeout};

use crate::{
    feed::{Feed, Observation, state_name},
    oracle::{Mark, producer_name},
    rounds::draws,
};

/// A daemon that does not answer within this time is left for the next one.
const PATIENCE: Duration = Duration::from_secs(3);
/// How long a cluster may take to find what it has acknowledged before producers send it again.
const HEALS_WITHIN: Duration = Duration::from_secs(90);
const PAUSE_MILLIS: u64 = 120;
const BATCH_MAX: u64 = 20;

/// Name of a state: each producer has its own, so that the order between producers is of no effect.
#[must_use]
pub fn lane_state(producer: usize, state: u32) -> String {
    format!("{} {}", producer_name(producer), state_name(state))
}

/// Observation number `sequence` of a producer.
#[must_use]
pub fn observation(feed: &Feed, producer: usize, sequence: u64) -> Observation {
    feed.observation(u32::try_from(producer).expect("a small number"), sequence)
}

/// Seconds since 1970, for comparison with other processes of this machine.
#[must_use]
pub fn now_secs() -> f64 {
    clock::now_nanos() as f64 / 1e9
}

/// The data that all producers share.
#[derive(Debug)]
pub struct Lanes {
    /// Name of the map.
    pub map: String,
    /// The source of the observations.
    pub feed: Feed,
    marks: Mutex<Vec<Mark>>,
    is_paused: AtomicBool,
    idle: Mutex<Vec<bool>>,
    events: UnboundedSender<Value>,
}

impl Lanes {
    /// Producers with these marks, which begin paused. Their events are sent to `events`.
    #[must_use]
    pub fn new(map: &str, feed: Feed, marks: Vec<Mark>, events: UnboundedSender<Value>) -> Arc<Self> {
        let idle = Mutex::new(vec![false; marks.len()]);
        let (map, marks) = (map.to_owned(), Mutex::new(marks));
        Arc::new(Self { map, feed, marks, is_paused: AtomicBool::new(true), idle, events })
    }

    fn locked(&self) -> MutexGuard<'_, Vec<Mark>> {
        self.marks.lock().unwrap_or_else(PoisonError::into_inner)
    }

    /// The marks of all producers.
    #[must_use]
    pub fn marks(&self) -> Vec<Mark> {
        self.locked().clone()
    }

    /// Lets producers stop when everything is acknowledged, or go on.
    pub fn pause(&self, is_paused: bool) {
        self.is_paused.store(is_paused, Ordering::Relaxed);
    }

    /// Whether all producers have stopped, with everything acknowledged.
    #[must_use]
    pub fn are_idle(&self) -> bool {
        self.idle.lock().unwrap_or_else(PoisonError::into_inner).iter().all(|idle| *idle)
    }

    fn set_idle(&self, index: usize, is_idle: bool) {
        self.idle.lock().unwrap_or_else(PoisonError::into_inner)[index] = is_idle;
    }

    fn send_event(&self, event: Value) {
        // Nobody listens only at the end.
        let _ = self.events.send(event);
    }

    /// Starts all producers. Each begins at another one of the daemons.
    pub fn start(self: &Arc<Self>, clients: &[Client], seed: u64) {
        for index in 0..self.locked().len() {
            let lane = Lane {
                lanes: Arc::clone(self),
                clients: clients.to_vec(),
                at: index % clients.len(),
                index,
                random: draws(seed ^ (index as u64) << 32),
                forgotten_since: None,
            };
            drop(tokio::spawn(lane.run()));
        }
    }
}

/// Why a producer leaves its daemon.
enum Leave {
    /// Everything is acknowledged, and producers are paused.
    Paused,
    /// The daemon did not do the request.
    Failed(ProducerError),
    /// The daemon did not answer in time.
    Silent,
    /// The cluster lacks what it has acknowledged, and may still find it.
    Forgotten,
}

struct Lane {
    lanes: Arc<Lanes>,
    clients: Vec<Client>,
    /// The daemon that it talks to.
    at: usize,
    index: usize,
    random: SmallRng,
    forgotten_since: Option<Instant>,
}

impl Lane {
    fn mark(&self) -> Mark {
        self.lanes.locked()[self.index]
    }

    fn set_mark(&self, acknowledged: u64, sent: u64) {
        let mark = &mut self.lanes.locked()[self.index];
        *mark = Mark { acknowledged: mark.acknowledged.max(acknowledged), sent: mark.sent.max(sent) };
    }

    fn is_done(&self) -> bool {
        let Mark { acknowledged, sent } = self.mark();
        self.lanes.is_paused.load(Ordering::Relaxed) && acknowledged == sent && self.forgotten_since.is_none()
    }

    async fn run(mut self) {
        let mut failures = 0_u32;
        loop {
            while self.is_done() {
                self.lanes.set_idle(self.index, true);
                tokio::time::sleep(Duration::from_millis(20)).await;
            }
            self.lanes.set_idle(self.index, false);
            let before = self.mark().acknowledged;
            match self.stream().await {
                Leave::Paused => continue,
                Leave::Silent | Leave::Forgotten => {}
                Leave::Failed(error) => self.judge(&error),
            }
            self.at = (self.at + 1) % self.clients.len();
            failures = if self.mark().acknowledged > before { 0 } else { failures + 1 };
            let pause = 50_u64.saturating_mul(1 << failures.min(4));
            tokio::time::sleep(Duration::from_millis(self.random.random_range(pause / 2..=pause))).await;
        }
    }

    /// Reports what no outage explains.
    fn judge(&self, error: &ProducerError) {
        let is_violation = matches!(
            error,
            ProducerError::DataMismatch(_)
                | ProducerError::OutOfSequence(_)
                | ProducerError::MapNotFound(_)
                | ProducerError::MapDeleted(_)
                | ProducerError::Invalid(_)
                | ProducerError::Differs { .. }
        );
        let word = if is_violation { "violation" } else { "left" };
        let text = format!("{}: {error}", producer_name(self.index));
        self.lanes.send_event(json!({ "event": word, "text": text, "via": self.at, "at": now_secs() }));
    }

    /// Streams through one daemon until it fails, or producers are paused.
    async fn stream(&mut self) -> Leave {
        let options = ProducerOptions {
            patience: Duration::ZERO,
            key_patience: PATIENCE,
            window: 4096,
            ..ProducerOptions::new(&producer_name(self.index), "", &self.lanes.map)
        };
        let opened = timeout(PATIENCE, Producer::open(&self.clients[self.at], options)).await;
        let mut producer = match opened {
            Ok(Ok(producer)) => producer,
            Ok(Err(error)) => return Leave::Failed(error),
            Err(_) => return Leave::Silent,
        };
        if self.has_forgotten(producer.last_sequence()) {
            return Leave::Forgotten;
        }
        let durable = producer.last_sequence();
        self.set_mark(durable, durable);
        let left = loop {
            match timeout(PATIENCE, self.batch(&mut producer)).await {
                Ok(Ok(())) if self.is_done() => break Leave::Paused,
                Ok(Ok(())) => {}
                Ok(Err(error)) => break Leave::Failed(error),
                Err(_) => break Leave::Silent,
            }
            tokio::time::sleep(Duration::from_millis(self.random.random_range(0..PAUSE_MILLIS))).await;
        };
        self.set_mark(producer.progress().durable_sequence, 0);
        if matches!(left, Leave::Paused) {
            // The key is free again once the daemon has answered.
            drop(timeout(PATIENCE, producer.close()).await);
        }
        left
    }

    /// Whether the cluster lacks what it has acknowledged. After a while the producer sends it again.
    fn has_forgotten(&mut self, durable: u64) -> bool {
        let Mark { acknowledged, sent } = self.mark();
        let report = |event: &str| {
            json!({ "event": event, "producer": self.index, "acknowledged": acknowledged, "sent": sent,
                "durable": durable, "via": self.at, "at": now_secs() })
        };
        if durable > sent && sent > 0 {
            self.lanes.send_event(report("foreign"));
        }
        if durable >= acknowledged {
            self.forgotten_since = None;
            return false;
        }
        let since = *self.forgotten_since.get_or_insert_with(|| {
            self.lanes.send_event(report("set_back"));
            Instant::now()
        });
        if since.elapsed() < HEALS_WITHIN {
            return true;
        }
        self.lanes.send_event(report("lost"));
        self.forgotten_since = None;
        false
    }

    /// Sends some observations, and waits until they are durable.
    async fn batch(&mut self, producer: &mut Producer) -> Result<(), ProducerError> {
        let next = producer.last_sequence() + 1;
        // Observations that were sent once are sent again first, even when producers are paused.
        let again = self.mark().sent.saturating_sub(next - 1);
        let count = match self.lanes.is_paused.load(Ordering::Relaxed) {
            true => again.min(1000),
            false => again.min(1000).max(self.random.random_range(1..=BATCH_MAX)),
        };
        for sequence in next..next + count {
            let o = observation(&self.lanes.feed, self.index, sequence);
            self.set_mark(0, sequence);
            let given = producer.send(&lane_state(self.index, o.state), o.time_nanos, o.value).await?;
            assert_eq!(given, sequence, "numbers go up by one");
        }
        let durable = producer.flush().await?.durable_sequence;
        self.set_mark(durable, 0);
        if count > 0 {
            self.lanes.send_event(json!({ "event": "ack", "producer": self.index, "via": self.at, "at": now_secs() }));
        }
        Ok(())
    }
}
