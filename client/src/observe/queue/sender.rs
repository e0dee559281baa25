//! The task that sends the records of a queue to the daemon, in order, and takes its acknowledgements.
//!
//! Invariant: record n has the sequence number n + offset, on every connection and after every restart; so the daemon
//! counts it once. A record that cannot be sent uses its number for something that the daemon refuses.

use std::{convert::Infallible, sync::Arc, time::Duration};

use tidemap_grid::spec::GridSpec;
use tidemap_proto::v1::{self, scan::Content as WireScan};

use super::{
    error::QueueError,
    record::{QueuedRecord, RecordContent},
    state::QueueShared,
};
use crate::{
    connection::Client,
    error::Error,
    observe::{
        Phase, Producer, ProducerError, ProducerOptions, Refusal,
        occupancy::{OccupancyError, OccupancyGrid},
        scan::Scan,
    },
};

/// Pauses before another attempt after a stream has ended for good.
const PAUSES_SECS: [u64; 6] = [1, 2, 5, 10, 20, 30];
/// Records between two times at which acknowledgements are taken.
const SENT_AT_ONCE: usize = 256;
/// The name of a value in the place of a record that cannot be sent: a name has no slash, so the daemon refuses it, and
/// its number is used.
const UNSENDABLE: &str = "tidemap//unsendable";

/// Why a record was not handed over.
enum NotSent {
    /// The record can never be sent.
    Unsendable(String),
    /// The record is kept; the connection has a problem.
    Failed(QueueError),
}

impl From<ProducerError> for NotSent {
    fn from(error: ProducerError) -> Self {
        match error {
            ProducerError::Tiles(_)
            | ProducerError::TimeBefore1970(_)
            | ProducerError::Coordinates(_)
            | ProducerError::NameTooLong(_) => Self::Unsendable(error.to_string()),
            error => Self::Failed(error.into()),
        }
    }
}

pub(super) struct QueueSender {
    client: Client,
    options: ProducerOptions,
    shared: Arc<QueueShared>,
    grid: Result<Option<GridSpec>, Error>,
    failures: usize,
}

impl QueueSender {
    pub(super) fn new(client: Client, options: ProducerOptions, shared: Arc<QueueShared>) -> Self {
        // The queue has the patience: a robot may start before its daemon, or without a network.
        let options = ProducerOptions { patience: Duration::MAX, ..options };
        Self { client, options, shared, grid: Ok(None), failures: 0 }
    }

    pub(super) async fn run(mut self) {
        loop {
            let Err(error) = self.session().await;
            {
                let mut underway = self.shared.underway();
                underway.abandon();
                underway.state.error = Some(error);
            }
            let pause = PAUSES_SECS[self.failures.min(PAUSES_SECS.len() - 1)];
            self.failures += 1;
            tokio::select! {
                () = tokio::time::sleep(Duration::from_secs(pause)) => {}
                () = self.shared.retry.notified() => {}
            }
        }
    }

    /// One producer, until it ends.
    async fn session(&mut self) -> Result<Infallible, QueueError> {
        let mut producer = Producer::start(&self.client, self.options.clone());
        self.opened(&producer).await?;
        self.link(&producer).await?;
        self.failures = 0;
        let mut progress = producer.watch();
        loop {
            self.acknowledge(&mut producer)?;
            if self.send_next(&mut producer).await? == 0 {
                tokio::select! {
                    // The sender of the progress lives as long as the producer.
                    _ = progress.changed() => {}
                    () = self.shared.grown.notified() => {}
                }
            }
        }
    }

    /// Waits for the first connection; the state shows the progress meanwhile.
    async fn opened(&mut self, producer: &Producer) -> Result<(), QueueError> {
        let mut watched = producer.watch();
        loop {
            let progress = watched.borrow_and_update().clone();
            match progress.phase {
                Phase::Connected => break,
                Phase::Ended(error) => return Err(error.into()),
                Phase::Connecting | Phase::Waiting(_) => self.shared.underway().follow(&progress),
            }
            if watched.changed().await.is_err() {
                return Err(QueueError::Closed);
            }
        }
        self.grid = match self.client.map(&self.options.map).await {
            Ok(map) => Ok(map.grid),
            Err(error) if error.is_transient() => return Err(QueueError::Map(error)),
            // A token may allow to observe only; the grid is needed for grids only.
            Err(error) => Err(error),
        };
        Ok(())
    }

    async fn link(&self, producer: &Producer) -> Result<(), QueueError> {
        let durable = producer.progress().durable_sequence;
        let shared = Arc::clone(&self.shared);
        let linked = tokio::task::spawn_blocking(move || shared.folder.linked(durable));
        linked.await.map_err(|_| QueueError::Closed)??;
        let following = self.shared.folder.number(durable).saturating_add(1);
        let next = following.max(self.shared.folder.counts().first);
        {
            let mut underway = self.shared.underway();
            underway.connected(next);
            underway.state.grid = self.grid.clone().unwrap_or_default();
        }
        self.shared.durable.send_replace(next - 1);
        Ok(())
    }

    fn acknowledge(&self, producer: &mut Producer) -> Result<(), QueueError> {
        // The progress first: the refusals up to its number have arrived.
        let progress = producer.progress();
        let folder = &self.shared.folder;
        let numbered = |refusal: Refusal| Refusal { sequence: folder.number(refusal.sequence), ..refusal };
        let refusals = producer.take_refusals().into_iter().map(numbered).collect();
        let durable = folder.number(progress.durable_sequence);
        let (gone, first_waiting) = {
            let mut underway = self.shared.underway();
            underway.refused(refusals);
            underway.follow(&progress);
            (underway.acknowledged(durable), underway.first_waiting())
        };
        if gone > 0 {
            folder.acknowledged(progress.durable_sequence)?;
            self.shared.durable.send_replace(first_waiting - 1);
        }
        match progress.phase {
            Phase::Ended(error) => Err(error.into()),
            _ => Ok(()),
        }
    }

    /// Hands records over as long as there is room, and returns their number.
    async fn send_next(&self, producer: &mut Producer) -> Result<usize, QueueError> {
        let mut sent = 0;
        while sent < SENT_AT_ONCE {
            let (number, at) = {
                let underway = self.shared.underway();
                if !underway.has_room() {
                    break;
                }
                (underway.next, underway.at)
            };
            let Some((raw, following)) = self.shared.folder.read(at, number)? else { break };
            let expected = self.shared.folder.sequence(number);
            let (found, time_nanos) = self.send(producer, &raw).await?;
            if i128::from(found) != expected {
                return Err(QueueError::OutOfStep { found, expected });
            }
            self.shared.underway().handed_over(raw.len(), time_nanos, following);
            sent += 1;
        }
        Ok(sent)
    }

    /// Hands a record over, and returns its sequence number and time. It uses exactly one number.
    async fn send(&self, producer: &mut Producer, raw: &[u8]) -> Result<(u64, i64), QueueError> {
        let (time_nanos, reason) = match QueuedRecord::read(raw) {
            Ok((time_nanos, content)) => match self.hand_over(producer, time_nanos, content).await {
                Ok(number) => return Ok((number, time_nanos)),
                Err(NotSent::Failed(error)) => return Err(error),
                Err(NotSent::Unsendable(reason)) => (time_nanos.max(0), reason),
            },
            Err(error) => (0, error.to_string()),
        };
        let number = producer.send(UNSENDABLE, time_nanos, 0.0).await?;
        let mut underway = self.shared.underway();
        underway.state.unsendable += 1;
        underway.state.last_unsendable = reason;
        Ok((number, time_nanos))
    }

    async fn hand_over(
        &self,
        producer: &mut Producer,
        time_nanos: i64,
        content: RecordContent,
    ) -> Result<u64, NotSent> {
        let scan = match content {
            RecordContent::Value(one) => return Ok(producer.send(&one.state, time_nanos, one.value).await?),
            RecordContent::Label(name) => {
                return Ok(producer.push(|window| window.push_label(&name, time_nanos)).await?);
            }
            RecordContent::Position(one) => {
                return Ok(producer.send_position(&one.state, time_nanos, &one.coordinates).await?);
            }
            RecordContent::Report(report) => return Ok(producer.push(|window| window.push_report(report)).await?),
            RecordContent::Cloud(cloud) => WireScan::Cloud(cloud),
            RecordContent::Ranges(ranges) => WireScan::Ranges(ranges),
            RecordContent::Tiles(tiles) => {
                let scan = tiles.scan().map_err(|error| NotSent::Unsendable(error.to_string()))?;
                return Ok(producer.send_scan(time_nanos, scan).await?);
            }
            RecordContent::Grid(record) => {
                let grid = record.grid().map_err(|error| NotSent::Unsendable(error.to_string()))?;
                let scan = self.in_cells_of_map(grid).await?;
                return Ok(producer.send_scan(time_nanos, scan).await?);
            }
        };
        Ok(producer.send_wire_scan(time_nanos, &[], v1::Scan { content: Some(scan) }).await?)
    }

    async fn in_cells_of_map(&self, grid: OccupancyGrid) -> Result<Scan, NotSent> {
        let spec = match &self.grid {
            Ok(Some(spec)) => (spec.resolution_m, spec.origin_m),
            Ok(None) => return Err(NotSent::Unsendable(OccupancyError::NoGrid.to_string())),
            Err(error) => return Err(NotSent::Failed(QueueError::Map(error.clone()))),
        };
        // A large grid takes a part of a second.
        let made = tokio::task::spawn_blocking(move || grid.in_cells(spec.0, spec.1));
        let made = made.await.map_err(|_| NotSent::Failed(QueueError::Closed))?;
        made.map_err(|error| NotSent::Unsendable(error.to_string()))
    }
}
