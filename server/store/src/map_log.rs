//! The log of a map as its writer uses it: appends, and the position of the end.
//!
//! Invariant: after an append has failed, every later one fails until the caller has called [`MapLog::resume`].

use std::sync::{Arc, PoisonError, atomic::Ordering};

use tidemap_map::event::Event;

use crate::{
    committer::{Append, Committer},
    error::AppendError,
    log::{Done, Log, frame::EncodedEvent},
};

/// The log of a map, open for appending. Clones append to the same log.
#[derive(Clone)]
pub struct MapLog {
    log: Arc<Log>,
    committer: Arc<Committer>,
}

impl MapLog {
    pub(crate) fn new(log: Arc<Log>, committer: Arc<Committer>) -> MapLog {
        MapLog { log, committer }
    }

    /// Encodes an event on this thread and queues it; waits while the queue is full. `done` is called on the
    /// committer's thread, in the order of the appends, when the record is durable or has failed. It must be quick and
    /// must not append itself.
    ///
    /// # Errors
    /// [`AppendError`] where the event is not even queued; `done` is not called then.
    pub fn append(&self, event: &Event, done: Done) -> Result<(), AppendError> {
        if let Some(poison) = self.committer.poison() {
            return Err(poison);
        }
        let epoch = self.log.epoch.load(Ordering::Acquire);
        if self.log.has_failed(epoch) {
            return Err(AppendError::AfterFailure);
        }
        let event = EncodedEvent::encode(event).map_err(AppendError::InvalidEvent)?;
        self.committer.push(Append { log: Arc::clone(&self.log), epoch, event, done })
    }

    /// Accepts appends again after one has failed. The map's writer calls this when it has undone everything that
    /// was not acknowledged; appends queued before still fail.
    pub fn resume(&self) {
        if self.log.has_failed(self.log.epoch.load(Ordering::Acquire)) {
            self.log.epoch.fetch_add(1, Ordering::AcqRel);
        }
    }

    /// Position of the last durable record; 0 if there is none.
    pub fn end(&self) -> u64 {
        self.log.end.load(Ordering::Acquire)
    }

    /// Bytes of durable records after the position of the newest saved snapshot, roughly.
    pub fn tail_bytes(&self) -> u64 {
        let progress = self.log.progress.lock().unwrap_or_else(PoisonError::into_inner);
        progress.bytes.saturating_sub(progress.covered)
    }
}
