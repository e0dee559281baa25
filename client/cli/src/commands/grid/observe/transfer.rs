//! Sends the scans of files. Scans that the daemon already has are compared, not sent.
//!
//! Invariant: nothing is sent before all scans that the daemon has are compared. Once a scan is durable, it counts as
//! exactly one of accepted, duplicate and refused.

use tidemap_client::observe::{Phase, Producer, ProducerError, Progress, Replay, tiles::TileError};
use tokio::{sync::watch, task::JoinHandle};

use super::super::scans::{ScanChunk, ScanChunks, ScanInput};
use crate::{
    commands::observe::{
        feed::RefusalReport,
        transfer::{Transfer, TransferEnd, ended},
    },
    progress::Bar,
};

#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) struct ScanCounts {
    pub(super) accepted: u64,
    pub(super) duplicate: u64,
    pub(super) refused: u64,
}

pub(super) struct ScanTransfer {
    producer: Producer,
    changes: watch::Receiver<Progress>,
    notices: JoinHandle<()>,
    chunks: ScanChunks,
    pub(super) report: RefusalReport,
    bar: Bar,
    /// Number of scans that the daemon had at the start, and their checksum.
    sent_before: u64,
    content_crc: u32,
    /// Replays the scans that the daemon already has; `None` once they are compared.
    replay: Option<Replay>,
    read: u64,
    duplicate: u64,
    refused: u64,
    /// Whether options of the command describe the scans.
    from_options: bool,
}

impl ScanTransfer {
    pub(super) fn new(
        producer: Producer,
        notices: JoinHandle<()>,
        chunks: ScanChunks,
        report: RefusalReport,
        bar: Bar,
    ) -> Self {
        let progress = producer.progress();
        Self {
            changes: producer.watch(),
            producer,
            notices,
            chunks,
            report,
            bar,
            sent_before: progress.resumed_at,
            content_crc: progress.content_crc,
            replay: (progress.resumed_at > 0).then(Replay::default),
            read: 0,
            duplicate: 0,
            refused: 0,
            from_options: false,
        }
    }

    async fn send_all(&mut self) -> TransferEnd {
        loop {
            let ScanChunk { scans, position } = match self.chunk().await {
                Ok(Some(chunk)) => chunk,
                Ok(None) => break,
                Err(end) => return end,
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
            return TransferEnd::Differs(format!("there are only {read} scans, but {sent_before} were sent before"));
        }
        let closed = self.producer.close().await;
        self.collect();
        closed.map_or_else(TransferEnd::Stopped, |_| TransferEnd::Whole)
    }

    /// Waits for scans, and handles refusals meanwhile.
    async fn chunk(&mut self) -> Result<Option<ScanChunk>, TransferEnd> {
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

    async fn scan(&mut self, scan: ScanInput) -> Result<(), TransferEnd> {
        let number = self.read + 1;
        self.from_options = matches!(scan, ScanInput::Single { .. });
        let invalid = |error: TileError| TransferEnd::Unreadable(anyhow::anyhow!("scan {number} is invalid: {error}"));
        if let Some(replay) = &mut self.replay {
            let followed = match scan {
                ScanInput::Wire(scan) => replay.wire_scan(scan.time_nanos, &scan.new_tiles, scan.scan),
                ScanInput::Single { time_nanos, scan } => replay.scan(time_nanos, scan),
            };
            followed.map_err(invalid)?;
            (self.read, self.duplicate) = (number, self.duplicate + 1);
            return if number == self.sent_before { self.compared().await } else { Ok(()) };
        }
        let sent = match scan {
            ScanInput::Wire(scan) => self.producer.send_wire_scan(scan.time_nanos, &scan.new_tiles, scan.scan).await,
            ScanInput::Single { time_nanos, scan } => self.producer.send_scan(time_nanos, scan).await,
        };
        match sent {
            Ok(sequence) => debug_assert_eq!(sequence, number),
            Err(ProducerError::Tiles(error)) => return Err(invalid(error)),
            Err(error) => return Err(TransferEnd::Stopped(error)),
        }
        self.read = number;
        Ok(())
    }

    /// Compares the checksum of the replayed scans, and continues from their tiles.
    async fn compared(&mut self) -> Result<(), TransferEnd> {
        let Some(replay) = self.replay.take() else { return Ok(()) };
        if replay.content_crc() != self.content_crc {
            let sent_before = self.sent_before;
            return Err(TransferEnd::Differs(format!(
                "the first {sent_before} scans are not the {sent_before} sent before"
            )));
        }
        self.producer.go_on_from(replay.into_tiles()).await.map_err(TransferEnd::Stopped)
    }

    fn collect(&mut self) {
        for refusal in self.producer.take_refusals() {
            self.refused += 1;
            let why = if self.from_options { in_options(&refusal.detail) } else { refusal.detail };
            self.report.refused(refusal.sequence, None, &why);
        }
    }

    pub(super) fn counts(&mut self) -> ScanCounts {
        // The last wait may have been cut short.
        self.collect();
        let progress = self.producer.progress();
        if progress.unreported > 0 {
            self.bar.status_line(&format!(
                "{} scans became durable while the connection broke: refused ones among them count as accepted",
                progress.unreported
            ));
        }
        let durable = progress.durable_sequence.saturating_sub(self.sent_before);
        self.report.count_refused(progress.dropped_refusals);
        let refused = self.refused + progress.dropped_refusals;
        ScanCounts { accepted: durable.saturating_sub(refused), duplicate: self.duplicate, refused }
    }
}

/// The daemon's message with the names of options in place of fields of the wire.
fn in_options(detail: &str) -> String {
    detail.replace("min_range_m", "--min-range").replace("max_range_m", "--max-range")
}

impl Transfer for ScanTransfer {
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

impl Drop for ScanTransfer {
    fn drop(&mut self) {
        self.notices.abort();
    }
}
