//! Sends the observations of recordings. Observations that the daemon already has are compared, not sent.
//!
//! Invariant: nothing is sent before all observations that the daemon has are compared. Once an observation is durable,
//! it counts as accepted or refused for its topic, unless an earlier run had sent it.

use std::{collections::VecDeque, sync::Arc};

use tidemap_client::observe::{Phase, Producer, ProducerError, Progress, Replay, tiles::TileError};
use tidemap_recordings::plan::Plan;
use tokio::{sync::watch, task::JoinHandle};

use super::{
    counts::TopicCounts,
    feed::{ImportChunk, ImportChunks, ImportContent, ImportItem},
    prepare::NewStates,
};
use crate::{
    commands::observe::{
        feed::RefusalReport,
        transfer::{Transfer, TransferEnd, ended},
    },
    progress::Bar,
};

pub(super) struct ImportTransfer {
    producer: Producer,
    changes: watch::Receiver<Progress>,
    notices: JoinHandle<()>,
    chunks: ImportChunks,
    states: NewStates,
    plan: Arc<Plan>,
    pub(super) report: RefusalReport,
    counts: TopicCounts,
    bar: Bar,
    /// Number of observations that the daemon had at the start, and their checksum.
    sent_before: u64,
    content_crc: u32,
    /// Replays the observations that the daemon already has; `None` once they are compared.
    replay: Option<Replay>,
    read: u64,
    /// Topics of the observations that are sent and not known to be durable; the first one has the number `first_open`.
    open: VecDeque<Option<usize>>,
    first_open: u64,
    dropped: u64,
}

impl ImportTransfer {
    pub(super) fn new(
        (producer, notices): (Producer, JoinHandle<()>),
        (chunks, states, plan): (ImportChunks, NewStates, Arc<Plan>),
        (report, counts): (RefusalReport, TopicCounts),
        bar: Bar,
    ) -> Self {
        let progress = producer.progress();
        let sent_before = progress.resumed_at;
        Self {
            changes: producer.watch(),
            producer,
            notices,
            chunks,
            states,
            plan,
            report,
            counts,
            bar,
            sent_before,
            content_crc: progress.content_crc,
            replay: (sent_before > 0).then(Replay::default),
            read: 0,
            open: VecDeque::new(),
            first_open: sent_before + 1,
            dropped: progress.dropped_refusals,
        }
    }

    pub(super) fn counts(&self) -> &TopicCounts {
        &self.counts
    }

    /// Takes the refusals that have arrived since the last wait, which may have been cut short.
    pub(super) fn conclude(&mut self) {
        self.collect();
        let progress = self.producer.progress();
        if progress.unreported > 0 {
            self.bar.status_line(&format!(
                "{} observations became durable while the connection broke: refused ones among them count as \
                 accepted",
                progress.unreported
            ));
        }
        let dropped = progress.dropped_refusals.saturating_sub(self.dropped);
        if dropped > 0 {
            self.bar.status_line(&format!("{dropped} more observations were refused, which count as accepted"));
            self.report.count_refused(dropped);
        }
    }

    async fn send_all(&mut self) -> TransferEnd {
        loop {
            let ImportChunk { items, position, is_last, beams, .. } = match self.chunk().await {
                Ok(Some(chunk)) => chunk,
                Ok(None) => return TransferEnd::Unreadable(anyhow::anyhow!("the reading ended before its last chunk")),
                Err(end) => return end,
            };
            for (topic, item) in items {
                let sent = match item {
                    Ok(item) => self.item(topic, item).await,
                    Err(why) => {
                        self.counts.not_made(topic, &why);
                        continue;
                    }
                };
                if let Err(ended) = sent {
                    self.collect();
                    return ended;
                }
            }
            self.counts.have_beams(&beams);
            self.bar.set(position);
            self.collect();
            if is_last {
                break;
            }
        }
        if self.read < self.sent_before {
            let (read, sent_before) = (self.read, self.sent_before);
            return TransferEnd::Differs(format!(
                "there are only {read} observations, but {sent_before} were sent before"
            ));
        }
        let closed = self.producer.close().await;
        self.collect();
        closed.map_or_else(TransferEnd::Stopped, |_| TransferEnd::Whole)
    }

    /// Waits for observations, and handles refusals meanwhile.
    async fn chunk(&mut self) -> Result<Option<ImportChunk>, TransferEnd> {
        loop {
            tokio::select! {
                chunk = self.chunks.recv() => return chunk.transpose().map_err(TransferEnd::Unreadable),
                Ok(()) = self.changes.changed() => {
                    let phase = self.changes.borrow_and_update().phase.clone();
                    self.collect();
                    if let Phase::Ended(error) = phase {
                        return Err(TransferEnd::Stopped(error));
                    }
                }
            }
        }
    }

    async fn item(&mut self, topic: usize, item: ImportItem) -> Result<(), TransferEnd> {
        let number = self.read + 1;
        self.read = number;
        if let Some(replay) = &mut self.replay {
            follow(replay, item).map_err(|error| unreadable(number, &error))?;
            return if number == self.sent_before { self.compared().await } else { Ok(()) };
        }
        self.add_state(topic, &item.content).await.map_err(TransferEnd::Unreadable)?;
        let ImportItem { time_nanos, content } = item;
        let producer = &mut self.producer;
        let sent = match content {
            ImportContent::Scan(scan) => producer.send_scan(time_nanos, scan).await,
            ImportContent::Value { state, value, .. } => producer.send(&state, time_nanos, value).await,
            ImportContent::Label { state, label, .. } => producer.send_label(&state, time_nanos, &label).await,
            ImportContent::Position { state, coordinates } => {
                producer.send_position(&state, time_nanos, &coordinates).await
            }
            ImportContent::Traversal(report) => producer.send_traversal(&report).await,
        };
        match sent {
            Ok(sequence) => debug_assert_eq!(sequence, number),
            Err(ProducerError::Tiles(error)) => return Err(unreadable(number, &error)),
            Err(error) => return Err(TransferEnd::Stopped(error)),
        }
        self.open.push_back(Some(topic));
        Ok(())
    }

    async fn add_state(&mut self, topic: usize, content: &ImportContent) -> anyhow::Result<()> {
        let (ImportContent::Value { state, rule, .. } | ImportContent::Label { state, rule, .. }) = content else {
            return Ok(());
        };
        match self.plan.topics.get(topic).and_then(|plan| plan.states.get(*rule)) {
            Some(rule) => self.states.add(state, rule).await,
            None => Ok(()),
        }
    }

    /// Compares the checksum of the replayed observations, and continues from their tiles.
    async fn compared(&mut self) -> Result<(), TransferEnd> {
        let Some(replay) = self.replay.take() else { return Ok(()) };
        if replay.content_crc() != self.content_crc {
            let sent_before = self.sent_before;
            return Err(TransferEnd::Differs(format!(
                "the first {sent_before} observations are not the {sent_before} sent before"
            )));
        }
        self.producer.go_on_from(replay.into_tiles()).await.map_err(TransferEnd::Stopped)
    }

    /// Takes the refusals that have arrived, and counts the durable observations.
    fn collect(&mut self) {
        // The durable number is read before the refusals, so that the refusals of all these observations have arrived.
        let durable = self.producer.progress().durable_sequence;
        for refusal in self.producer.take_refusals() {
            let place = refusal.sequence.checked_sub(self.first_open).and_then(|place| usize::try_from(place).ok());
            let topic = place.and_then(|place| self.open.get_mut(place)).and_then(Option::take);
            if let Some(topic) = topic {
                self.counts.refused(topic, &refusal.detail);
            }
            self.report.refused(refusal.sequence, None, &refusal.detail);
        }
        while self.first_open <= durable
            && let Some(topic) = self.open.pop_front()
        {
            self.first_open += 1;
            topic.into_iter().for_each(|topic| self.counts.accepted(topic));
        }
    }
}

fn unreadable(number: u64, error: &TileError) -> TransferEnd {
    TransferEnd::Unreadable(anyhow::anyhow!("observation {number} is invalid: {error}"))
}

fn follow(replay: &mut Replay, item: ImportItem) -> Result<(), TileError> {
    let ImportItem { time_nanos, content } = item;
    match content {
        ImportContent::Scan(scan) => replay.scan(time_nanos, scan)?,
        ImportContent::Value { state, value, .. } => replay.value(&state, time_nanos, value),
        ImportContent::Label { state, label, .. } => replay.label(&state, time_nanos, &label),
        ImportContent::Position { state, coordinates } => replay.position(&state, time_nanos, &coordinates),
        ImportContent::Traversal(report) => replay.traversal(&report),
    }
    Ok(())
}

impl Transfer for ImportTransfer {
    fn sent_before(&self) -> u64 {
        self.sent_before
    }

    async fn run(&mut self) -> TransferEnd {
        let end = self.send_all().await;
        ended(self, end).await
    }

    async fn flush(&mut self) -> Result<(), ProducerError> {
        let flushed = self.producer.flush().await;
        self.collect();
        flushed.map(|_| ())
    }
}

impl Drop for ImportTransfer {
    fn drop(&mut self) {
        self.notices.abort();
    }
}
