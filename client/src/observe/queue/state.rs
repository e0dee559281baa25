//! The state that the handle of a queue shares with the task that sends.
//!
//! Invariant: the lock is never held across an await. The records in flight are those before the next one to send, in
//! order.

use std::{
    collections::VecDeque,
    sync::{Mutex, MutexGuard, PoisonError},
};

use tidemap_grid::spec::GridSpec;
use tokio::sync::{Notify, watch};

use super::{
    error::QueueError,
    folder::{QueueFolder, RecordPlace},
    record,
};
use crate::observe::{Phase, Progress, Refusal, RefusalReason, shared::REFUSALS_MAX};

/// Maximum number of records in flight, and of their bytes.
const IN_FLIGHT_RECORDS: usize = 4096;
const IN_FLIGHT_BYTES: usize = 24 << 20;

/// Counts of a queue since it was opened, unless stated otherwise.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct QueueState {
    /// Whether the daemon can be reached now.
    pub connected: bool,
    /// Why nothing is sent now; all is kept.
    pub error: Option<QueueError>,
    /// Number of the last observation that was taken, ever.
    pub last: u64,
    /// Observations in the queue that the daemon has not acknowledged, also of earlier runs.
    pub waiting: u64,
    /// Time of the oldest of them, nanoseconds UTC.
    pub oldest_waiting_nanos: Option<i64>,
    /// Bytes of the files; acknowledged observations leave them together with their neighbours.
    pub bytes: u64,
    /// Maximum number of these bytes.
    pub bytes_max: u64,
    /// Observations that the daemon has on its disk, or has refused.
    pub durable: u64,
    /// Observations that the daemon refused.
    pub refused: u64,
    /// The number of refusals for each reason; `None`: a reason that this version does not know.
    pub refused_by_reason: Vec<(Option<RefusalReason>, u64)>,
    /// The last refusal in words; empty if there is none.
    pub last_refusal: String,
    /// Observations that became durable while the connection broke, so that refusals of them are unknown.
    pub unreported: u64,
    /// Observations that cannot be sent: the map has no grid, or another version wrote them. The daemon counts a
    /// refusal in the place of each.
    pub unsendable: u64,
    /// Why the last of them cannot be sent; empty if there is none.
    pub last_unsendable: String,
    /// Observations that the queue did not take because it was full, or because the disk failed.
    pub not_taken: u64,
    /// Observations that the daemon had acknowledged and no longer has, ever: a backup was restored.
    pub lost: u64,
    /// Bytes that were cut off when the queue was opened: an observation that was not written whole.
    pub cut_bytes: u64,
    /// The grid of the map; `None` before the daemon was reached, or if the map has none.
    pub grid: Option<GridSpec>,
}

/// A record that was handed over and is not acknowledged.
#[derive(Clone, Copy, Debug)]
struct InFlight {
    number: u64,
    bytes: usize,
    time_nanos: i64,
}

#[derive(Debug, Default)]
pub(super) struct Underway {
    /// The counts of the sender; the counts of the folder are added when they are read.
    pub(super) state: QueueState,
    pub(super) refusals: Vec<Refusal>,
    /// Number of the next record to hand over, and its place.
    pub(super) next: u64,
    pub(super) at: Option<RecordPlace>,
    in_flight: VecDeque<InFlight>,
    bytes_in_flight: usize,
    /// Refusals and unreported observations of connections that have ended, and of this one.
    unreported_before: u64,
    unreported_now: u64,
}

impl Underway {
    pub(super) fn has_room(&self) -> bool {
        self.in_flight.len() < IN_FLIGHT_RECORDS && self.bytes_in_flight < IN_FLIGHT_BYTES
    }

    pub(super) fn handed_over(&mut self, bytes: usize, time_nanos: i64, following: RecordPlace) {
        self.in_flight.push_back(InFlight { number: self.next, bytes, time_nanos });
        self.bytes_in_flight += bytes;
        self.next = following.number;
        self.at = Some(following);
    }

    /// Number of the oldest record that is not known to be durable.
    pub(super) fn first_waiting(&self) -> u64 {
        self.in_flight.front().map_or(self.next, |oldest| oldest.number)
    }

    /// A connection begins, and `next` is the first record to send on it.
    pub(super) fn connected(&mut self, next: u64) {
        self.abandon();
        // These were in flight when a connection broke, and had arrived.
        self.state.durable += next.saturating_sub(self.next);
        self.next = next;
        self.at = None;
        (self.state.connected, self.state.error) = (true, None);
    }

    /// A connection has ended: what was in flight is sent again.
    pub(super) fn abandon(&mut self) {
        if let Some(oldest) = self.in_flight.front() {
            (self.next, self.at) = (oldest.number, None);
        }
        self.in_flight.clear();
        self.bytes_in_flight = 0;
        self.unreported_before += std::mem::take(&mut self.unreported_now);
        self.state.connected = false;
    }

    /// The daemon has the records up to `durable`. Returns the number of newly durable ones.
    pub(super) fn acknowledged(&mut self, durable: u64) -> u64 {
        let mut gone = 0;
        while let Some(oldest) = self.in_flight.front().filter(|oldest| oldest.number <= durable) {
            self.bytes_in_flight -= oldest.bytes;
            self.in_flight.pop_front();
            gone += 1;
        }
        self.state.durable += gone;
        gone
    }

    /// Counts refusals, whose numbers are those of the queue.
    pub(super) fn refused(&mut self, refusals: Vec<Refusal>) {
        self.state.refused += refusals.len() as u64;
        for refusal in refusals {
            let counts = &mut self.state.refused_by_reason;
            match counts.iter_mut().find(|(reason, _)| *reason == refusal.reason) {
                Some((_, count)) => *count += 1,
                None => counts.push((refusal.reason, 1)),
            }
            self.state.last_refusal.clone_from(&refusal.detail);
            if self.refusals.len() < REFUSALS_MAX {
                self.refusals.push(refusal);
            }
        }
    }

    pub(super) fn follow(&mut self, progress: &Progress) {
        self.unreported_now = progress.unreported + progress.dropped_refusals;
        match &progress.phase {
            Phase::Connected => (self.state.connected, self.state.error) = (true, None),
            Phase::Waiting(error) => {
                (self.state.connected, self.state.error) = (false, Some(QueueError::Unreachable(error.clone())));
            }
            Phase::Ended(error) => {
                (self.state.connected, self.state.error) = (false, Some(QueueError::Producer(error.clone())));
            }
            Phase::Connecting => {}
        }
    }
}

/// The folder and the state that the handle and the tasks share.
#[derive(Debug)]
pub(super) struct QueueShared {
    pub(super) folder: QueueFolder,
    underway: Mutex<Underway>,
    /// Wakes the sender: a record was appended.
    pub(super) grown: Notify,
    /// Wakes the sender from its pause after a failure.
    pub(super) retry: Notify,
    /// The daemon has the records up to this number.
    pub(super) durable: watch::Sender<u64>,
}

impl QueueShared {
    pub(super) fn new(folder: QueueFolder) -> Self {
        let counts = folder.counts();
        let next = counts.first.max(counts.acknowledged.saturating_add(1)).min(counts.last + 1);
        let underway = Mutex::new(Underway { next, ..Underway::default() });
        let durable = watch::Sender::new(next - 1);
        Self { folder, underway, grown: Notify::new(), retry: Notify::new(), durable }
    }

    pub(super) fn underway(&self) -> MutexGuard<'_, Underway> {
        self.underway.lock().unwrap_or_else(PoisonError::into_inner)
    }

    /// The state now.
    pub(super) fn state(&self) -> QueueState {
        let (mut state, at, next, oldest) = {
            let underway = self.underway();
            let mut state = underway.state.clone();
            state.unreported = underway.unreported_before + underway.unreported_now;
            state.waiting = underway.first_waiting();
            (state, underway.at, underway.next, underway.in_flight.front().map(|oldest| oldest.time_nanos))
        };
        let counts = self.folder.counts();
        state.last = counts.last;
        state.waiting = (counts.last + 1).saturating_sub(state.waiting);
        (state.bytes, state.bytes_max) = (counts.bytes, self.folder.bytes_max);
        (state.lost, state.cut_bytes) = (counts.lost, counts.cut_bytes);
        // A record that cannot be read is reported when it is sent.
        let read = || self.folder.read(at, next).ok().flatten().and_then(|(raw, _)| record::time_in(&raw));
        state.oldest_waiting_nanos = oldest.or_else(read);
        state
    }
}
