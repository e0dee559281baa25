//! Producers that stream at the same time, each a part of a feed, in batches of many sizes.
//!
//! Invariant: a producer records as acknowledged only what the daemon has acknowledged to it, and as sent
//! everything that it ever sent.

use std::{
    sync::{
        Arc,
        atomic::{AtomicBool, Ordering},
    },
    time::Duration,
};

use rand::{Rng as _, rngs::SmallRng};
use tidemap_client::{
    Client,
    observe::{Producer, ProducerError, ProducerOptions},
};
use tokio::task::JoinHandle;

use crate::{
    feed::{Feed, state_name},
    oracle::{Mark, Oracle, producer_name},
    rounds::draws,
};

/// How producers stream.
#[derive(Clone, Copy, Debug)]
pub struct Manner {
    /// Announce data time.
    pub nightly: bool,
    /// Timeout for reaching the daemon; zero: the first failure ends the producer.
    pub patience: Duration,
    /// Stops after this number; 0: only on request, or when the daemon ends.
    pub until: u64,
    /// Longest pause between two batches.
    pub pause: Duration,
}

impl Default for Manner {
    fn default() -> Self {
        Self { nightly: false, patience: Duration::ZERO, until: 0, pause: Duration::from_millis(12) }
    }
}

/// How one producer ended.
#[derive(Debug)]
struct Outcome {
    mark: Mark,
    error: Option<ProducerError>,
}

/// Running producers.
#[derive(Debug)]
pub struct Herd {
    producers: Vec<JoinHandle<Outcome>>,
    stop: Arc<AtomicBool>,
    flowing: Arc<AtomicBool>,
}

impl Herd {
    /// Starts one producer for each that the oracle knows.
    #[must_use]
    pub fn start(client: &Client, oracle: &Oracle, manner: Manner, seed: u64) -> Self {
        let (stop, flowing) = (Arc::new(AtomicBool::new(false)), Arc::new(AtomicBool::new(false)));
        let producers = (0..oracle.marks.len())
            .map(|index| {
                let run = Run {
                    client: client.clone(),
                    feed: oracle.feed,
                    index,
                    map: oracle.map.clone(),
                    manner,
                    random: draws(seed ^ (index as u64) << 32),
                    stop: Arc::clone(&stop),
                    flowing: Arc::clone(&flowing),
                };
                tokio::spawn(run.go())
            })
            .collect();
        Self { producers, stop, flowing }
    }

    /// Waits until something was acknowledged, so that a round without traffic does not count.
    ///
    /// # Panics
    /// If nothing is acknowledged.
    pub async fn flowing(&self) {
        let flows = async {
            while !self.flowing.load(Ordering::Relaxed) {
                tokio::time::sleep(Duration::from_millis(1)).await;
            }
        };
        tokio::time::timeout(Duration::from_secs(60), flows).await.expect("something is acknowledged");
    }

    /// Stops all producers.
    pub fn stop(&self) {
        self.stop.store(true, Ordering::Relaxed);
    }

    /// Waits for the end of all and records their sequence numbers. Returns the errors that they ended with.
    ///
    /// # Panics
    /// If a producer panics.
    pub async fn settle(self, oracle: &mut Oracle) -> Vec<ProducerError> {
        let mut errors = Vec::new();
        for (producer, mark) in self.producers.into_iter().zip(&mut oracle.marks) {
            let outcome = producer.await.expect("a producer does not panic");
            mark.acknowledged = mark.acknowledged.max(outcome.mark.acknowledged);
            mark.sent = mark.sent.max(outcome.mark.sent);
            errors.extend(outcome.error);
        }
        errors
    }
}

struct Run {
    client: Client,
    feed: Feed,
    index: usize,
    map: String,
    manner: Manner,
    random: SmallRng,
    stop: Arc<AtomicBool>,
    flowing: Arc<AtomicBool>,
}

impl Run {
    async fn go(mut self) -> Outcome {
        let options = ProducerOptions {
            nightly: self.manner.nightly,
            patience: self.manner.patience,
            window: 4096,
            ..ProducerOptions::new(&producer_name(self.index), "", &self.map)
        };
        let mut producer = match Producer::open(&self.client, options).await {
            Ok(producer) => producer,
            Err(error) => return Outcome { mark: Mark::default(), error: Some(error) },
        };
        let first = producer.last_sequence() + 1;
        let error = self.stream(&mut producer, first).await.err();
        let mark = Mark { acknowledged: producer.progress().durable_sequence, sent: producer.last_sequence() };
        Outcome { mark, error }
    }

    async fn stream(&mut self, producer: &mut Producer, first: u64) -> Result<(), ProducerError> {
        let id = u32::try_from(self.index).expect("a small number");
        let mut next = first;
        while !self.stop.load(Ordering::Relaxed) && (self.manner.until == 0 || next <= self.manner.until) {
            // Most batches are small, some fill a message.
            let max_length = if self.random.random_ratio(1, 40) { 4096 } else { 60 };
            let mut end = next + self.random.random_range(1..=max_length);
            if self.manner.until != 0 {
                end = end.min(self.manner.until + 1);
            }
            for sequence in next..end {
                let o = self.feed.observation(id, sequence);
                let given = producer.send(&state_name(o.state), o.time_nanos, o.value).await?;
                assert_eq!(given, sequence, "numbers go up by one");
            }
            next = end;
            if self.random.random_ratio(1, 2) {
                producer.flush().await?;
                self.flowing.store(true, Ordering::Relaxed);
            }
            tokio::time::sleep(self.manner.pause.mul_f64(self.random.random())).await;
        }
        producer.flush().await?;
        Ok(())
    }
}
