//! The messages of one connection, made from the window.
//!
//! Invariant: a new connection knows nothing of earlier ones: names and tiles are sent again. Messages that were
//! returned count as sent, in the order of their numbers.

use std::collections::VecDeque;

use tidemap_grid::index::CellBox;
use tidemap_proto::{
    convert::{
        grid::cell_box_to_wire,
        reports::{BATCH_TEXT_BYTES_MAX, SIGHTINGS_MAX, is_sighting, wire_bytes},
        vectors::shape_to_wire,
    },
    v1::{ObservationBatch, ObserveRequest, Report, ReportBatch, ScanBatch, Welcome, observe_request::Message},
};

use super::{
    columns::{BatchLimits, Entry, StreamTable, declare_labels, fitting, pack},
    scan_stream::{ScanMessageLimits, ScanStream},
    shared::SharedState,
    window::Window,
};
use crate::maps::StateShape;

/// Maximum number of bytes of a request in addition to its batch.
const REQUEST_BYTES_EXTRA: usize = 64;
/// Maximum number of observations of labels in one message.
const LABELS_MAX: usize = 4096;

/// Limits of one message.
#[derive(Clone, Copy, Debug)]
pub(super) struct MessageLimits {
    observations: BatchLimits,
    scans: ScanMessageLimits,
}

impl MessageLimits {
    pub(super) fn of(welcome: &Welcome) -> Self {
        let limit = |limit: u32| usize::try_from(limit).unwrap_or(usize::MAX).max(1);
        let bytes = limit(welcome.max_message_bytes).saturating_sub(REQUEST_BYTES_EXTRA).max(1);
        Self {
            observations: BatchLimits { observations: limit(welcome.max_batch_observations), bytes },
            scans: ScanMessageLimits { scans: limit(welcome.max_batch_scans), bytes },
        }
    }
}

#[derive(Debug)]
pub(super) struct Outgoing {
    limits: MessageLimits,
    names: StreamTable,
    /// The kind that the stream declares for its names.
    kind: Option<StateShape>,
    /// Absent until the first scan.
    scans: Option<ScanStream>,
    /// Parts of a scan that is too large for one message.
    parts: VecDeque<ScanBatch>,
}

impl Outgoing {
    /// A new connection.
    pub(super) fn new(limits: MessageLimits, kind: Option<StateShape>) -> Self {
        Self { limits, names: StreamTable::default(), kind, scans: None, parts: VecDeque::new() }
    }

    /// Whether there is a message to send now.
    pub(super) fn is_ready(&self, state: &SharedState) -> bool {
        let MessageLimits { observations, scans } = self.limits;
        !self.parts.is_empty()
            || state.window.as_ref().is_some_and(|window| {
                window.to_send(observations.observations, state.urgent).next().is_some()
                    || window.scans_to_send(scans.scans, scans.bytes, state.urgent).next().is_some()
                    || window.reports_to_send(reports_max(observations), state.urgent).next().is_some()
            })
    }

    /// The next message; its content counts as sent.
    pub(super) fn next(&mut self, state: &mut SharedState) -> Option<ObserveRequest> {
        let urgent = state.urgent;
        let window = state.window.as_mut()?;
        let message = match self.parts.pop_front() {
            Some(part) => Message::Scans(part),
            None => self
                .observations(window, urgent)
                .or_else(|| self.reports(window, urgent))
                .or_else(|| self.scans(window, urgent))?,
        };
        Some(ObserveRequest { message: Some(message) })
    }

    fn observations(&mut self, window: &mut Window, urgent: u64) -> Option<Message> {
        let mut limits = self.limits.observations;
        if window.has_labels() {
            limits.observations = limits.observations.min(LABELS_MAX);
        }
        let first_sequence = window.next_unsent();
        let waiting = || window.to_send(limits.observations, urgent);
        let count = fitting(waiting(), window.names(), &self.names, limits);
        let entries: Vec<Entry> = waiting().take(count).copied().collect();
        if entries.is_empty() {
            return None;
        }
        window.sent(entries.len());
        let mut columns = pack(&entries, window.names(), &mut self.names);
        if window.has_labels() {
            declare_labels(&mut columns, |name| window.is_label(name));
        }
        // Vectors and labels have declared it already.
        if let Some(shape) = self.kind.filter(|shape| shape.is_single()) {
            columns.new_kinds.resize(columns.new_states.len(), 0);
            columns
                .new_kinds
                .iter_mut()
                .filter(|kind| **kind == 0)
                .for_each(|kind| *kind = shape_to_wire(shape).0.into());
        }
        Some(Message::Batch(ObservationBatch { first_sequence, observations: Some(columns) }))
    }

    fn reports(&self, window: &mut Window, urgent: u64) -> Option<Message> {
        let limits = self.limits.observations;
        let first_sequence = window.next_unsent();
        let reports = first_reports(window.reports_to_send(reports_max(limits), urgent), limits);
        if reports.is_empty() {
            return None;
        }
        window.sent(reports.len());
        Some(Message::Reports(ReportBatch { first_sequence, reports }))
    }

    fn scans(&mut self, window: &mut Window, urgent: u64) -> Option<Message> {
        let limits = self.limits.scans;
        let first_sequence = window.next_unsent();
        let mut waiting = window.scans_to_send(limits.scans, limits.bytes, urgent).peekable();
        waiting.peek()?;
        // Before the first scan of a connection everything else must be acknowledged.
        let stream = self.scans.get_or_insert_with(|| ScanStream::new(window.base()));
        let (count, messages) = stream.pack(waiting, window.tiles(), first_sequence, limits);
        let sent = window.scans_to_send(limits.scans, limits.bytes, urgent).take(count);
        let shown = sent.fold(CellBox::default(), |all, scan| all.union(&scan.shown()));
        window.sent(count);
        self.parts = messages.into();
        if let Some(first) = self.parts.front_mut().filter(|_| !shown.is_empty()) {
            first.shown = Some(cell_box_to_wire(&shown));
        }
        self.parts.pop_front().map(Message::Scans)
    }
}

/// Maximum number of reports of one message.
fn reports_max(limits: BatchLimits) -> usize {
    limits.reports().max(SIGHTINGS_MAX)
}

/// The first reports, as many as fit into a message; at least one, if there is any.
fn first_reports<'a>(waiting: impl Iterator<Item = &'a Report>, limits: BatchLimits) -> Vec<Report> {
    let (mut bytes, mut sightings) = (0, 0);
    let mut reports: Vec<Report> = Vec::new();
    for report in waiting {
        bytes += wire_bytes(report);
        sightings += usize::from(is_sighting(report));
        let others = reports.len() + 1 - sightings;
        let is_too_large = bytes > limits.bytes.min(BATCH_TEXT_BYTES_MAX);
        if !reports.is_empty() && (is_too_large || sightings > SIGHTINGS_MAX || others > limits.reports()) {
            break;
        }
        reports.push(report.clone());
    }
    reports
}

#[cfg(test)]
mod tests {
    use tidemap_proto::convert::{sightings::SightingReport, traversals::TraversalReport};

    use super::*;
    use crate::observe::{
        scan::{PointCloud, Scan},
        tiles::{Mask, TileIndex, TileMasks},
    };

    #[test]
    fn all_leave_in_the_order_of_their_numbers() -> Result<(), Box<dyn std::error::Error>> {
        let welcome =
            Welcome { max_batch_observations: 3, max_batch_scans: 2, max_message_bytes: 5000, ..Welcome::default() };
        let tile = |x| (TileIndex { x, y: 0, z: 0 }, TileMasks::clipped(Mask([1; 8]), Mask::EMPTY));
        let mut window = Window::new(100, 0, 0);
        for time in 0..5 {
            window.push("door", time, 1.0);
        }
        for time in 5..8 {
            window.push_scan(time, Scan::Tiles(vec![tile(1), tile(2)]))?;
        }
        window.push_scan(8, Scan::Cloud(PointCloud { xyz_m: vec![0.5; 3000], ..PointCloud::default() }))?;
        window.push("door", 9, 0.0);
        for _ in 0..2 {
            window.push_report(TraversalReport::default().to_report());
        }
        window.push("door", 9, 0.0);
        for _ in 0..3 {
            window.push_report(SightingReport::default().to_report());
        }
        let mut state = SharedState { window: Some(window), urgent: 16, closing: false, refusals: Vec::new() };
        let mut outgoing = Outgoing::new(MessageLimits::of(&welcome), None);
        let mut sent = Vec::new();
        while outgoing.is_ready(&state) {
            let message = outgoing.next(&mut state).and_then(|request| request.message);
            sent.push(match message.ok_or("a message")? {
                Message::Batch(batch) => {
                    (batch.first_sequence, batch.observations.map_or(0, |columns| columns.time_deltas.len()), false)
                }
                Message::Scans(batch) => (batch.first_sequence, batch.scans.len(), batch.continues),
                Message::Reports(batch) => (batch.first_sequence, batch.reports.len(), false),
                Message::Hello(_) | Message::Alive(_) => return Err("no batch".into()),
            });
        }
        let parts = sent.iter().filter(|(sequence, ..)| *sequence == 9).count();
        assert!(parts >= 3, "{sent:?}");
        assert_eq!(sent[..4], [(1, 3, false), (4, 2, false), (6, 2, false), (8, 1, false)]);
        assert!(sent[4..4 + parts - 1].iter().all(|part| *part == (9, 1, true)), "{sent:?}");
        assert_eq!(
            sent[3 + parts..],
            [(9, 1, false), (10, 1, false), (11, 1, false), (12, 1, false), (13, 1, false), (14, 3, false)]
        );
        assert!(outgoing.next(&mut state).is_none());
        Ok(())
    }
}
