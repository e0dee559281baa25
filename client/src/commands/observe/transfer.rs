//! Sending a file's rows: those that the daemon has are compared, the others sent.
//!
//! Invariant: nothing is sent before all rows that the daemon has were compared. Each row counts as exactly one of
//! accepted, duplicate and refused once it is durable.

use std::collections::BTreeSet;

use tidemap::observe::{Phase, Producer, ProducerError, Progress, content::ContentCrc};
use tokio::{
    sync::{mpsc, watch},
    task::JoinHandle,
};

use super::{
    feed::{Chunk, Told},
    kinds::Kinds,
};
use crate::{
    progress::Bar,
    rows::{Row, RowsError},
};

/// How a transfer of rows or scans ended.
pub enum Ended {
    /// All was sent.
    Whole,
    /// By Ctrl-C.
    Interrupted,
    /// The content is not what was sent before; how it differs.
    Differs(String),
    /// A file cannot be read further.
    Unreadable(anyhow::Error),
    /// The producer ended.
    Stopped(ProducerError),
    /// All was sent, but the nightly updates failed.
    Nights(anyhow::Error),
}

/// What became of the rows.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) struct Counts {
    pub(super) read: u64,
    pub(super) accepted: u64,
    pub(super) duplicate: u64,
    pub(super) refused: u64,
}

pub(super) struct Transfer {
    producer: Producer,
    changes: watch::Receiver<Progress>,
    notices: JoinHandle<()>,
    rows: mpsc::Receiver<Result<Chunk, RowsError>>,
    pub(super) told: Told,
    kinds: Kinds,
    bar: Bar,
    /// What the daemon had at the start, with its checksum.
    sent_before: u64,
    content_crc: u32,
    crc: ContentCrc,
    read: u64,
    duplicate: u64,
    refused: u64,
    /// Rows that were found wrong here, until the daemon has confirmed their numbers.
    wrong: BTreeSet<u64>,
    /// Refusals without a place for them that were counted already.
    dropped: u64,
}

impl Transfer {
    pub(super) fn new(
        producer: Producer,
        notices: JoinHandle<()>,
        rows: mpsc::Receiver<Result<Chunk, RowsError>>,
        (told, kinds): (Told, Kinds),
        bar: Bar,
    ) -> Self {
        let progress = producer.progress();
        Self {
            changes: producer.watch(),
            producer,
            notices,
            rows,
            told,
            kinds,
            bar,
            sent_before: progress.resumed_at,
            content_crc: progress.content_crc,
            crc: ContentCrc::default(),
            read: 0,
            duplicate: 0,
            refused: 0,
            wrong: BTreeSet::new(),
            dropped: progress.dropped_refusals,
        }
    }

    pub(super) fn sent_before(&self) -> u64 {
        self.sent_before
    }

    /// Sends everything and waits until it is durable.
    pub(super) async fn run(&mut self) -> Ended {
        loop {
            let chunk = match self.chunk().await {
                Ok(Some(chunk)) => chunk,
                Ok(None) => break,
                Err(ended) => return ended,
            };
            for row in &chunk.rows {
                if let Err(ended) = self.row(row).await {
                    self.collect();
                    return ended;
                }
            }
            self.told.last_line(&chunk);
            self.bar.set(chunk.bytes);
            self.collect();
        }
        if self.read < self.sent_before {
            let (read, sent_before) = (self.read, self.sent_before);
            return Ended::Differs(format!("it has only {read} rows, but {sent_before} were sent before"));
        }
        let closed = self.producer.close().await;
        self.collect();
        closed.map_or_else(Ended::Stopped, |_| Ended::Whole)
    }

    /// Waits for rows, and meanwhile for what the daemon has to say: nothing may come on stdin for hours.
    async fn chunk(&mut self) -> Result<Option<Chunk>, Ended> {
        loop {
            tokio::select! {
                chunk = self.rows.recv() => return chunk.transpose().map_err(|error| Ended::Unreadable(error.into())),
                // The producer holds the sender: this fails only when there is nothing left to wait for.
                Ok(()) = self.changes.changed() => {
                    let phase = self.changes.borrow_and_update().phase.clone();
                    self.collect();
                    if let Phase::Ended(error) = phase {
                        return Err(Ended::Stopped(error));
                    }
                }
            }
        }
    }

    async fn row(&mut self, row: &Row) -> Result<(), Ended> {
        if row.number <= self.sent_before {
            self.read = row.number;
            self.duplicate += 1;
            match &row.position {
                None => self.crc.add(&row.state, row.time_nanos, row.value),
                Some(position) => self.crc.add_position(&row.state, row.time_nanos, position.coordinates()),
            }
            if row.number == self.sent_before && self.crc.value() != self.content_crc {
                let sent_before = self.sent_before;
                return Err(Ended::Differs(format!(
                    "its first {sent_before} rows are not the {sent_before} sent before"
                )));
            }
            return Ok(());
        }
        let sent = match &row.position {
            None => self.producer.send(&row.state, row.time_nanos, row.value).await,
            Some(position) => self.producer.send_position(&row.state, row.time_nanos, position.coordinates()).await,
        };
        let sequence = sent.map_err(Ended::Stopped)?;
        debug_assert_eq!(sequence, row.number);
        self.read = row.number;
        if let Some(wrong) = self.kinds.wrong(row).await {
            self.refused += 1;
            self.wrong.insert(row.number);
            self.told.refused(row.number, Some(row.line), &wrong);
        }
        Ok(())
    }

    /// Waits until everything sent is durable.
    pub(super) async fn flush(&mut self) -> Result<(), ProducerError> {
        let flushed = self.producer.flush().await;
        self.collect();
        flushed.map(|_| ())
    }

    /// Takes the refusals that have arrived. A row that was found wrong here was told already, with a better reason.
    fn collect(&mut self) {
        // Before the refusals: those of everything up to here have arrived then.
        let progress = self.producer.progress();
        for refusal in self.producer.take_refusals() {
            if !self.wrong.remove(&refusal.sequence) {
                self.refused += 1;
                self.told.refused(refusal.sequence, None, &refusal.detail);
            }
        }
        let later = self.wrong.split_off(&(progress.durable_sequence + 1));
        let confirmed = std::mem::replace(&mut self.wrong, later);
        // What is left of those confirmed was dropped, or lost with a connection: it must not count twice.
        let dropped = progress.dropped_refusals.saturating_sub(self.dropped).saturating_sub(confirmed.len() as u64);
        self.dropped = progress.dropped_refusals;
        self.refused += dropped;
        self.told.refused_untold(dropped);
    }

    pub(super) fn counts(&mut self) -> Counts {
        // Once more: the last wait may have been cut short.
        self.collect();
        let progress = self.producer.progress();
        if progress.unreported > 0 {
            self.bar.notice(&format!(
                "{} rows became durable while the connection broke: those among them that only the daemon knows to be \
                 refused, such as for a state's name, count as accepted",
                progress.unreported
            ));
        }
        let durable = progress.durable_sequence.saturating_sub(self.sent_before);
        // Rows that are wrong and not durable yet are not refused yet.
        let refused = self.refused.saturating_sub(self.wrong.len() as u64);
        Counts { read: self.read, accepted: durable.saturating_sub(refused), duplicate: self.duplicate, refused }
    }
}

impl Drop for Transfer {
    fn drop(&mut self) {
        self.notices.abort();
    }
}
