//! The log of a map that daemons share, as the thread of the map uses it: appends wait here for the replica, which
//! writes them to this disk and to the engine.
//!
//! Invariant: appends are accepted only while the replica writes the log, and each accepted one is completed once, in
//! order: with `Ok` when it is on the engine's quorum and on this disk.

use std::{
    collections::VecDeque,
    sync::{Arc, Condvar, Mutex, MutexGuard, PoisonError},
};

use tidemap_map::event::Event;
use tidemap_store::{AppendError, Done, EventLog, GroupLog, OpenError, QueuedEvent};
use tokio::{
    sync::{Notify, watch},
    time::Instant,
};

use super::events::ReplicaStatus;

/// Limit of the queue in bytes of frames; a full queue blocks the appending thread.
const QUEUE_BYTES_MAX: usize = 32 << 20;
/// Limit of the queue in records.
const QUEUE_RECORDS_MAX: usize = 65_536;

struct AppendQueue {
    events: VecDeque<QueuedEvent>,
    bytes: usize,
    /// The reason why no append is accepted.
    refusal: Option<AppendError>,
}

/// The state that the handles of a shared log and its replica share.
pub(super) struct LogState {
    pub(crate) log: GroupLog,
    queue: Mutex<AppendQueue>,
    has_room: Condvar,
    /// Wakes the replica.
    pub(crate) has_work: Notify,
    pub(crate) status: watch::Sender<ReplicaStatus>,
    /// The time until which no other daemon may write, by this daemon's clock.
    current_until: Mutex<Option<Instant>>,
}

impl LogState {
    pub(crate) fn new(log: GroupLog) -> LogState {
        let position = log.end().position;
        let refusal = Some(AppendError::NotWriter { writer: None });
        LogState {
            log,
            queue: Mutex::new(AppendQueue { events: VecDeque::new(), bytes: 0, refusal }),
            has_room: Condvar::new(),
            has_work: Notify::new(),
            status: watch::Sender::new(ReplicaStatus { position, ..ReplicaStatus::default() }),
            current_until: Mutex::new(None),
        }
    }

    fn queue(&self) -> MutexGuard<'_, AppendQueue> {
        self.queue.lock().unwrap_or_else(PoisonError::into_inner)
    }

    pub(crate) fn set_current_until(&self, until: Option<Instant>) {
        *self.current_until.lock().unwrap_or_else(PoisonError::into_inner) = until;
    }

    fn is_current(&self) -> bool {
        let until = *self.current_until.lock().unwrap_or_else(PoisonError::into_inner);
        until.is_some_and(|until| Instant::now() < until)
    }

    /// Accepts appends from now on.
    pub(crate) fn open(&self) {
        self.log.resume();
        self.queue().refusal = None;
    }

    /// Refuses appends from now on, and the waiting ones.
    pub(crate) fn close(&self, error: &AppendError) {
        let mut queue = self.queue();
        queue.refusal = Some(error.clone());
        queue.bytes = 0;
        let waiting = std::mem::take(&mut queue.events);
        drop(queue);
        self.has_room.notify_all();
        for event in waiting {
            event.fail(error.clone());
        }
    }

    /// The events of the next group: as many of the waiting ones as fit, but at least one.
    pub(crate) fn take(&self, bytes_max: usize) -> Vec<QueuedEvent> {
        let mut queue = self.queue();
        let (mut events, mut bytes) = (Vec::new(), 0);
        while let Some(event) = queue.events.front() {
            if !events.is_empty() && bytes + event.bytes() > bytes_max {
                break;
            }
            bytes += event.bytes();
            events.extend(queue.events.pop_front());
        }
        queue.bytes = queue.bytes.saturating_sub(bytes);
        drop(queue);
        self.has_room.notify_all();
        events
    }
}

/// The shared log of a map, as its thread appends to it. Clones append to one log.
#[derive(Clone)]
pub struct SharedLog {
    pub(super) shared: Arc<LogState>,
}

impl SharedLog {
    /// The status of the replica.
    #[must_use]
    pub fn status(&self) -> watch::Receiver<ReplicaStatus> {
        self.shared.status.subscribe()
    }

    /// Position of the newest checkpoint of this daemon; 0 without one.
    #[must_use]
    pub fn checkpoint(&self) -> u64 {
        self.shared.log.checkpoint()
    }

    /// The chain behind a record of this daemon's own log; see [`GroupLog::chain_at`]. Reads the disk.
    ///
    /// # Errors
    /// [`OpenError`] where the log cannot be read.
    pub fn chain_at(&self, position: u64) -> Result<Option<u32>, OpenError> {
        self.shared.log.chain_at(position)
    }
}

impl EventLog for SharedLog {
    fn append(&self, event: &Event, done: Done) -> Result<(), AppendError> {
        // Encoded before the lock is taken.
        let event = match self.shared.queue().refusal.clone() {
            Some(refusal) => return Err(refusal),
            None => self.shared.log.queue(event, done)?,
        };
        let mut queue = self.shared.queue();
        // An empty queue accepts one record of any length.
        while queue.refusal.is_none()
            && !queue.events.is_empty()
            && (queue.events.len() >= QUEUE_RECORDS_MAX || queue.bytes + event.bytes() > QUEUE_BYTES_MAX)
        {
            queue = self.shared.has_room.wait(queue).unwrap_or_else(PoisonError::into_inner);
        }
        if let Some(refusal) = &queue.refusal {
            return Err(refusal.clone());
        }
        queue.bytes += event.bytes();
        queue.events.push_back(event);
        drop(queue);
        self.shared.has_work.notify_one();
        Ok(())
    }

    fn resume(&self) {
        self.shared.log.resume();
    }

    fn end(&self) -> u64 {
        self.shared.log.position()
    }

    fn tail_bytes(&self) -> u64 {
        self.shared.log.tail_bytes()
    }

    fn is_current(&self) -> bool {
        self.shared.is_current()
    }
}
