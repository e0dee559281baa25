//! The robots: one producer each, all sending concurrently.
//!
//! Invariant: a robot sends its observations of the simulation in time order.

use anyhow::Context as _;
use tidemap_client::{
    Client,
    observe::{Producer, ProducerOptions},
};
use tidemap_sim::Office;
use tokio::task::JoinSet;

use super::MAP;

/// The robots, and the time that they have reached.
pub(super) struct Robots {
    robots: Vec<Robot>,
    until_nanos: i64,
}

struct Robot {
    index: usize,
    producer: Producer,
    /// Time of its last observation in nanoseconds UTC.
    seen_until_nanos: i64,
}

impl Robots {
    /// Opens a stream per robot; the robots start at `start_nanos` UTC.
    pub(super) async fn open(client: &Client, office: &Office, start_nanos: i64) -> anyhow::Result<Self> {
        let mut robots = Vec::new();
        for (index, name) in office.robots().into_iter().enumerate() {
            // The update runs when the data of all robots has passed midnight.
            let options = ProducerOptions { nightly: true, ..ProducerOptions::new(name, "", MAP) };
            let producer = Producer::open(client, options).await.with_context(|| name.to_owned())?;
            robots.push(Robot { index, producer, seen_until_nanos: start_nanos });
        }
        Ok(Self { robots, until_nanos: start_nanos })
    }

    /// Drives all robots until a time in nanoseconds UTC, and waits until their observations are durable.
    pub(super) async fn drive(&mut self, office: &Office, until_nanos: i64) -> anyhow::Result<()> {
        let mut driving = JoinSet::new();
        for mut robot in self.robots.drain(..) {
            let office = office.clone();
            let from_nanos = self.until_nanos;
            driving.spawn(async move {
                robot.drive(&office, from_nanos, until_nanos).await?;
                anyhow::Ok(robot)
            });
        }
        while let Some(robot) = driving.join_next().await {
            self.robots.push(robot??);
        }
        self.until_nanos = until_nanos;
        Ok(())
    }

    /// Number of acknowledged observations.
    pub(super) fn sent(&self) -> u64 {
        self.robots.iter().map(|robot| robot.producer.progress().durable_sequence).sum()
    }

    /// The time up to which all robots have sent data, in nanoseconds UTC.
    pub(super) fn seen_until(&self) -> i64 {
        self.robots.iter().map(|robot| robot.seen_until_nanos).min().unwrap_or(self.until_nanos)
    }
}

impl Robot {
    async fn drive(&mut self, office: &Office, from_nanos: i64, until_nanos: i64) -> anyhow::Result<()> {
        let states = office.states();
        // A day at a time, so that the iterator is not held across an await.
        const DAY_NANOS: i64 = 24 * 3600 * 1_000_000_000;
        let mut from = from_nanos;
        while from < until_nanos {
            let to = until_nanos.min(from + DAY_NANOS);
            let seen: Vec<_> = office.visits(self.index, from, to).collect();
            for (time, state, value) in seen {
                self.producer.send(states[state], time, value).await?;
                self.seen_until_nanos = time;
            }
            from = to;
        }
        self.producer.flush().await?;
        let refused = self.producer.take_refusals();
        anyhow::ensure!(refused.is_empty(), "the daemon refused an observation: {}", refused[0].detail);
        Ok(())
    }
}
