//! Sends the rows of a file. Rows that the daemon already has are compared, not sent.
//!
//! Invariant: nothing is sent before all rows that the daemon has are compared. Once a row is durable, it counts as
//! exactly one of accepted, duplicate and refused.

use std::collections::{BTreeMap, BTreeSet};

use tidemap_client::maps::RowKind;
use tidemap_client::observe::{
    Phase, Producer, ProducerError, Progress, SightingReport, TraversalReport, content::ContentCrc,
};
use tokio::{sync::watch, task::JoinHandle};

use super::{
    advice::RowAdvice,
    feed::{RefusalReport, RowChunk, RowChunks},
    kinds::Kinds,
    next_steps::NextSteps,
};
use crate::progress::Bar;
use tidemap_formats::observation_file::{
    Layout as _, ObservationColumns, ObservationRow, RowPlace, sightings::SightingRow, traversals::TraversalRow,
};

/// Maximum number of states that are compared with the states of the map.
const STATES_MAX: usize = 10_000;

/// A row that can be sent.
pub(crate) trait Sendable {
    fn at(&self) -> RowPlace;
    /// Adds the row to the checksum of the content.
    fn add_to(&self, crc: &mut ContentCrc);
    fn send(&self, producer: &mut Producer) -> impl Future<Output = Result<u64, ProducerError>>;
    /// Why the row is invalid, as far as the client can detect.
    fn wrong(&self, kinds: &mut Kinds) -> impl Future<Output = Option<String>>;
    /// The row as an observation of a state.
    fn observation(&self) -> Option<&ObservationRow>;
}

impl Sendable for ObservationRow {
    fn at(&self) -> RowPlace {
        ObservationColumns::at(self)
    }

    fn add_to(&self, crc: &mut ContentCrc) {
        match &self.position {
            None if self.label.is_some() => crc.add(&self.name_sent(), self.time_nanos, self.value),
            None => crc.add(&self.state, self.time_nanos, self.value),
            Some(position) => crc.add_position(&self.state, self.time_nanos, position.coordinates()),
        }
    }

    async fn send(&self, producer: &mut Producer) -> Result<u64, ProducerError> {
        match (&self.position, &self.label) {
            (None, Some(label)) => producer.send_label(&self.state, self.time_nanos, label).await,
            (None, None) => producer.send(&self.state, self.time_nanos, self.value).await,
            (Some(position), _) => producer.send_position(&self.state, self.time_nanos, position.coordinates()).await,
        }
    }

    async fn wrong(&self, kinds: &mut Kinds) -> Option<String> {
        kinds.wrong(self).await
    }

    fn observation(&self) -> Option<&ObservationRow> {
        Some(self)
    }
}

impl Sendable for TraversalRow {
    fn at(&self) -> RowPlace {
        self.at
    }

    fn add_to(&self, crc: &mut ContentCrc) {
        crc.add_traversal(&report(self));
    }

    async fn send(&self, producer: &mut Producer) -> Result<u64, ProducerError> {
        producer.send_traversal(&report(self)).await
    }

    async fn wrong(&self, _: &mut Kinds) -> Option<String> {
        self.wrong.clone().or_else(|| report(self).wrong())
    }

    fn observation(&self) -> Option<&ObservationRow> {
        None
    }
}

fn report(row: &TraversalRow) -> TraversalReport {
    let TraversalRow { from, to, action, start_nanos, end_nanos, success, reason, .. } = row.clone();
    TraversalReport { from, to, action, start_nanos, end_nanos, success, reason }
}

impl Sendable for SightingRow {
    fn at(&self) -> RowPlace {
        self.at
    }

    fn add_to(&self, crc: &mut ContentCrc) {
        crc.add_sighting(&sighting(self));
    }

    async fn send(&self, producer: &mut Producer) -> Result<u64, ProducerError> {
        producer.send_sighting(&sighting(self)).await
    }

    async fn wrong(&self, _: &mut Kinds) -> Option<String> {
        self.wrong.clone().or_else(|| sighting(self).wrong())
    }

    fn observation(&self) -> Option<&ObservationRow> {
        None
    }
}

fn sighting(row: &SightingRow) -> SightingReport {
    let SightingRow { place, part_m: [from_m, to_m], time_nanos, seen, out_of_view, .. } = row.clone();
    SightingReport { place, from_m, to_m, time_nanos, seen, out_of_view, traversal: None }
}

/// Sends a file's rows or scans.
pub(crate) trait Transfer {
    /// Number of rows or scans that the daemon had at the start.
    fn sent_before(&self) -> u64;
    /// Sends everything and waits until it is durable.
    fn run(&mut self) -> impl Future<Output = TransferEnd>;
    /// Waits until everything sent so far is durable.
    fn flush(&mut self) -> impl Future<Output = Result<(), ProducerError>>;
}

/// The end of a transfer, after all data that was sent before is durable: rows before an error in a file count.
pub(crate) async fn ended(transfer: &mut impl Transfer, end: TransferEnd) -> TransferEnd {
    match end {
        TransferEnd::Unreadable(error) => {
            transfer.flush().await.map_or_else(TransferEnd::Stopped, |()| TransferEnd::Unreadable(error))
        }
        end => end,
    }
}

/// The end of a transfer of rows or scans.
pub(crate) enum TransferEnd {
    /// Everything is durable.
    Whole,
    /// By Ctrl-C.
    Interrupted,
    /// The content differs from the data that was sent before; the text states how.
    Differs(String),
    /// A file cannot be read further.
    Unreadable(anyhow::Error),
    /// The producer failed.
    Stopped(ProducerError),
    /// Everything is durable, but the nightly updates failed.
    Updates(anyhow::Error),
}

#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) struct RowCounts {
    pub(super) read: u64,
    pub(super) accepted: u64,
    pub(super) duplicate: u64,
    pub(super) refused: u64,
    /// Sent rows whose value is a word.
    pub(super) mapped: u64,
    /// Sent rows that state that no value is known.
    pub(super) without_value: u64,
}

pub(super) struct RowTransfer<T> {
    producer: Producer,
    changes: watch::Receiver<Progress>,
    notices: JoinHandle<()>,
    rows: RowChunks<T>,
    pub(super) report: RefusalReport,
    kinds: Kinds,
    bar: Bar,
    /// Number of rows that the daemon had at the start, and their checksum.
    sent_before: u64,
    content_crc: u32,
    crc: ContentCrc,
    read: u64,
    duplicate: u64,
    refused: u64,
    mapped: u64,
    without_value: u64,
    seen: RowAdvice,
    /// States of rows that were sent before.
    before: BTreeSet<String>,
    /// Numbers of the invalid rows, until the daemon confirms them.
    wrong: BTreeSet<u64>,
    /// Line minus number of the rows from a number on: blank lines have no number.
    lines: BTreeMap<u64, u64>,
    /// Dropped refusals that are already counted.
    dropped: u64,
}

impl<T: Sendable> RowTransfer<T> {
    pub(super) fn new(
        producer: Producer,
        notices: JoinHandle<()>,
        rows: RowChunks<T>,
        (report, kinds): (RefusalReport, Kinds),
        bar: Bar,
    ) -> Self {
        let progress = producer.progress();
        Self {
            changes: producer.watch(),
            producer,
            notices,
            rows,
            report,
            kinds,
            bar,
            sent_before: progress.resumed_at,
            content_crc: progress.content_crc,
            crc: ContentCrc::default(),
            read: 0,
            duplicate: 0,
            refused: 0,
            mapped: 0,
            without_value: 0,
            seen: RowAdvice::default(),
            before: BTreeSet::new(),
            wrong: BTreeSet::new(),
            lines: BTreeMap::new(),
            dropped: progress.dropped_refusals,
        }
    }

    /// Waits for rows, and handles refusals meanwhile: stdin may be silent for hours.
    async fn chunk(&mut self) -> Result<Option<RowChunk<T>>, TransferEnd> {
        loop {
            tokio::select! {
                chunk = self.rows.recv() => return chunk.transpose().map_err(|error| TransferEnd::Unreadable(error.into())),
                // The producer holds the sender, so this never fails while the producer lives.
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

    async fn row(&mut self, row: &T) -> Result<(), TransferEnd> {
        let RowPlace { number, line, .. } = row.at();
        if number <= self.sent_before {
            self.read = number;
            self.duplicate += 1;
            row.add_to(&mut self.crc);
            if let Some(seen) = row.observation()
                && self.before.len() < STATES_MAX
                && !seen.state.is_empty()
                && !self.before.contains(&seen.state)
            {
                self.before.insert(seen.state.clone());
            }
            if number == self.sent_before && self.crc.value() != self.content_crc {
                let sent_before = self.sent_before;
                return Err(TransferEnd::Differs(format!(
                    "its first {sent_before} rows are not the {sent_before} sent before"
                )));
            }
            if self.report.kept().is_some()
                && let Some(wrong) = row.wrong(&mut self.kinds).await
            {
                self.report.was_refused(line, &wrong);
            }
            return Ok(());
        }
        let sequence = row.send(&mut self.producer).await.map_err(TransferEnd::Stopped)?;
        debug_assert_eq!(sequence, number);
        self.read = number;
        self.follow_line(number, line);
        if let Some(wrong) = row.wrong(&mut self.kinds).await {
            self.refused += 1;
            self.wrong.insert(number);
            self.report.refused(number, Some(line), &wrong);
            // An unknown word.
            if let Some(row) = row.observation().filter(|_| wrong.contains("--values")) {
                self.seen.see_unknown_word(row);
            }
        } else if let Some(row) = row.observation() {
            self.mapped += u64::from(row.is_word);
            self.without_value += u64::from(row.position.is_none() && row.value.is_nan());
            self.seen.see(row);
        }
        Ok(())
    }

    /// Advice about the content of the rows. `kind`: the kind as which they were sent.
    pub(super) fn advice(&self, kind: RowKind, steps: &NextSteps<'_>) -> Vec<String> {
        self.seen.lines(kind, steps)
    }

    /// Names of the states of rows that were sent before, only some if there are many.
    pub(super) fn sent_before_states(&self) -> &BTreeSet<String> {
        &self.before
    }

    /// Stores the line of a row, unless it follows from the row before.
    fn follow_line(&mut self, number: u64, line: u64) {
        let ahead = line.saturating_sub(number);
        if self.lines.last_key_value().is_none_or(|(_, known)| *known != ahead) {
            self.lines.insert(number, ahead);
        }
    }

    /// The line of a row that was sent.
    fn line(&self, number: u64) -> Option<u64> {
        self.lines.range(..=number).next_back().map(|(_, ahead)| number + ahead)
    }

    /// Takes the refusals that have arrived. A row that was found invalid here is already reported, with a better
    /// reason.
    fn collect(&mut self) {
        // Read before the refusals, so that the refusals of all these rows have arrived.
        let progress = self.producer.progress();
        for refusal in self.producer.take_refusals() {
            if !self.wrong.remove(&refusal.sequence) {
                self.refused += 1;
                let line = self.line(refusal.sequence);
                self.report.refused(refusal.sequence, line, &refusal.detail);
            }
        }
        let later = self.wrong.split_off(&(progress.durable_sequence + 1));
        let confirmed = std::mem::replace(&mut self.wrong, later);
        // The other confirmed rows were dropped or lost with a connection; they must not count twice.
        let dropped = progress.dropped_refusals.saturating_sub(self.dropped).saturating_sub(confirmed.len() as u64);
        self.dropped = progress.dropped_refusals;
        self.refused += dropped;
        self.report.count_refused(dropped);
        // No more refusals come for durable rows.
        let known = self.lines.range(..=progress.durable_sequence).next_back().map(|(number, _)| *number);
        self.lines = self.lines.split_off(&known.unwrap_or(0));
    }

    pub(super) fn counts(&mut self) -> RowCounts {
        // The last wait may have been cut short.
        self.collect();
        let progress = self.producer.progress();
        if progress.unreported > 0 {
            self.bar.status_line(&format!(
                "{} rows became durable while the connection broke: those among them that only the daemon refuses, \
                 refused, such as for a state's name, count as accepted",
                progress.unreported
            ));
        }
        let durable = progress.durable_sequence.saturating_sub(self.sent_before);
        // Invalid rows that are not durable yet are not refused yet.
        let refused = self.refused.saturating_sub(self.wrong.len() as u64);
        RowCounts {
            read: self.read,
            accepted: durable.saturating_sub(refused),
            duplicate: self.duplicate,
            refused,
            mapped: self.mapped,
            without_value: self.without_value,
        }
    }
}

impl<T: Sendable> Transfer for RowTransfer<T> {
    fn sent_before(&self) -> u64 {
        self.sent_before
    }

    async fn run(&mut self) -> TransferEnd {
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
            self.report.last_line(&chunk);
            self.bar.set(chunk.bytes);
            self.collect();
        }
        if self.read < self.sent_before {
            let (read, sent_before) = (self.read, self.sent_before);
            return TransferEnd::Differs(format!("it has only {read} rows, but {sent_before} were sent before"));
        }
        let closed = self.producer.close().await;
        self.collect();
        closed.map_or_else(TransferEnd::Stopped, |_| TransferEnd::Whole)
    }

    async fn flush(&mut self) -> Result<(), ProducerError> {
        let flushed = self.producer.flush().await;
        self.collect();
        flushed.map(|_| ())
    }
}

impl<T> Drop for RowTransfer<T> {
    fn drop(&mut self) {
        self.notices.abort();
    }
}

#[cfg(test)]
mod tests {
    use tidemap_formats::observation_file::{RowItem, RowReader, traversals::TraversalColumns};

    use super::*;

    #[test]
    fn what_is_wrong_with_a_traversal_is_reported_and_no_daemon_takes_it() -> anyhow::Result<()> {
        let long = "n".repeat(129);
        for (row, words) in [
            ("Hall,Lab,10,12", "has 4 fields, the header has 5"),
            ("Hall,Lab,soon,12,1", "start"),
            ("Hall,Lab,10,,1", "end"),
            ("Hall,Lab,10,12,yes", "success \"yes\" is neither true nor false"),
            (&format!("{long},Lab,10,12,1"), "from \"nnn"),
            ("Hall,Lab,12,10,0", "before start"),
            ("Hall,Lab,10,10,1", "takes time"),
            ("Hall,a/b,10,12,1", "\"a/b\""),
            (",Lab,10,12,1", "empty"),
            ("Hall,Lab,10,100000,1", "more than a day"),
        ] {
            let text = format!("from,to,start,end,success\n{row}\n");
            let mut rows = RowReader::<_, TraversalColumns>::open(text.as_bytes())?;
            let Some(RowItem::Row(row)) = rows.next_item()? else { anyhow::bail!("no row in {text:?}") };
            let wrong = row.wrong.clone().or_else(|| report(&row).wrong()).unwrap_or_default();
            assert!(wrong.contains(words), "{wrong}");
            assert!(report(&row).wrong().is_some());
        }
        Ok(())
    }
}
