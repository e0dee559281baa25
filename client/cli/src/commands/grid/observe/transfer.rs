//! Sending the scans of files: those that the daemon has are compared, the others sent.
//!
//! Invariant: nothing is sent before all scans that the daemon has were compared. Each scan counts as exactly one of
//! accepted, duplicate and refused once it is durable.

use tidemap_client::observe::{Phase, Producer, ProducerError, Progress, Replay, tiles::TileError};
use tokio::{sync::watch, task::JoinHandle};

use super::super::scans::{Chunk, Chunks, FromFile};
use crate::{
    commands::observe::{feed::Told, transfer::Ended},
    progress::Bar,
};

/// What became of the scans.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) struct Counts {
    pub(super) accepted: u64,
    pub(super) duplicate: u64,
    pub(super) refused: u64,
}

pub(super) struct Transfer {
    producer: Producer,
    changes: watch::Receiver<Progress>,
    notices: JoinHandle<()>,
    chunks: Chunks,
    pub(super) told: Told,
    bar: Bar,
    /// What the daemon had at the start, with its checksum.
    sent_before: u64,
    content_crc: u32,
    /// Scans that the daemon has already, until they are through.
    replay: Option<Replay>,
    read: u64,
    duplicate: u64,
    refused: u64,
    /// Whether options say what the scans are, and not a file of scans.
    of_options: bool,
}

impl Transfer {
    pub(super) fn new(producer: Producer, notices: JoinHandle<()>, chunks: Chunks, told: Told, bar: Bar) -> Self {
        let progress = producer.progress();
        Self {
            changes: producer.watch(),
            producer,
            notices,
            chunks,
            told,
            bar,
            sent_before: progress.resumed_at,
            content_crc: progress.content_crc,
            replay: (progress.resumed_at > 0).then(Replay::default),
            read: 0,
            duplicate: 0,
            refused: 0,
            of_options: false,
        }
    }

    pub(super) fn sent_before(&self) -> u64 {
        self.sent_before
    }

    /// Sends everything and waits until it is durable.
    pub(super) async fn run(&mut self) -> Ended {
        loop {
            let Chunk { scans, position } = match self.chunk().await {
                Ok(Some(chunk)) => chunk,
                Ok(None) => break,
                Err(ended) => return ended,
            };
            for scan in scans {
                if let Err(ended) = self.scan(scan).await {
                    self.collect();
                    return ended;
                }
            }
            self.bar.set(position);
            self.collect();
        }
        if self.read < self.sent_before {
            let (read, sent_before) = (self.read, self.sent_before);
            return Ended::Differs(format!("there are only {read} scans, but {sent_before} were sent before"));
        }
        let closed = self.producer.close().await;
        self.collect();
        closed.map_or_else(Ended::Stopped, |_| Ended::Whole)
    }

    /// Waits for scans, and meanwhile for what the daemon has to say.
    async fn chunk(&mut self) -> Result<Option<Chunk>, Ended> {
        loop {
            tokio::select! {
                chunk = self.chunks.recv() => return chunk.transpose().map_err(Ended::Unreadable),
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

    async fn scan(&mut self, scan: FromFile) -> Result<(), Ended> {
        let number = self.read + 1;
        self.of_options = matches!(scan, FromFile::Given { .. });
        let senseless = |error: TileError| Ended::Unreadable(anyhow::anyhow!("scan {number} makes no sense: {error}"));
        if let Some(replay) = &mut self.replay {
            let followed = match scan {
                FromFile::Wire(scan) => replay.wire_scan(scan.time_nanos, &scan.new_tiles, scan.scan),
                FromFile::Given { time_nanos, scan } => replay.scan(time_nanos, scan),
            };
            followed.map_err(senseless)?;
            (self.read, self.duplicate) = (number, self.duplicate + 1);
            return if number == self.sent_before { self.compared().await } else { Ok(()) };
        }
        let sent = match scan {
            FromFile::Wire(scan) => self.producer.send_wire_scan(scan.time_nanos, &scan.new_tiles, scan.scan).await,
            FromFile::Given { time_nanos, scan } => self.producer.send_scan(time_nanos, scan).await,
        };
        match sent {
            Ok(sequence) => debug_assert_eq!(sequence, number),
            Err(ProducerError::Tiles(error)) => return Err(senseless(error)),
            Err(error) => return Err(Ended::Stopped(error)),
        }
        self.read = number;
        Ok(())
    }

    /// All scans that the daemon has were followed: are they the same, and what did they show?
    async fn compared(&mut self) -> Result<(), Ended> {
        let Some(replay) = self.replay.take() else { return Ok(()) };
        if replay.content_crc() != self.content_crc {
            let sent_before = self.sent_before;
            return Err(Ended::Differs(format!("the first {sent_before} scans are not the {sent_before} sent before")));
        }
        self.producer.go_on_from(replay.into_tiles()).await.map_err(Ended::Stopped)
    }

    /// Waits until everything sent is durable.
    pub(super) async fn flush(&mut self) -> Result<(), ProducerError> {
        let flushed = self.producer.flush().await;
        self.collect();
        flushed.map(|_| ())
    }

    /// Takes the refusals that have arrived.
    fn collect(&mut self) {
        for refusal in self.producer.take_refusals() {
            self.refused += 1;
            let why = if self.of_options { in_options(&refusal.detail) } else { refusal.detail };
            self.told.refused(refusal.sequence, None, &why);
        }
    }

    pub(super) fn counts(&mut self) -> Counts {
        // Once more: the last wait may have been cut short.
        self.collect();
        let progress = self.producer.progress();
        if progress.unreported > 0 {
            self.bar.notice(&format!(
                "{} scans became durable while the connection broke: those among them that were refused count as accepted",
                progress.unreported
            ));
        }
        let durable = progress.durable_sequence.saturating_sub(self.sent_before);
        self.told.refused_untold(progress.dropped_refusals);
        let refused = self.refused + progress.dropped_refusals;
        Counts { accepted: durable.saturating_sub(refused), duplicate: self.duplicate, refused }
    }
}

/// What the daemon says of fields of the wire, said of the options that they come from.
fn in_options(detail: &str) -> String {
    detail.replace("min_range_m", "--min-range").replace("max_range_m", "--max-range")
}

impl Drop for Transfer {
    fn drop(&mut self) {
        self.notices.abort();
    }
}
