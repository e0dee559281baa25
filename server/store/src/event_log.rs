//! The interface of a log that the writer of a map needs, whether the log lies on this disk alone or daemons share it.
//!
//! Invariant: completions are called once each, in the order of the appends, and with `Ok` only when the record is in
//! the log for good. After an append has failed, every later one fails until [`EventLog::resume`].

use tidemap_map::event::Event;

use crate::{error::AppendError, log::Done, map_log::MapLog};

/// The log of a map, open for appending.
pub trait EventLog: Send + Sync {
    /// Encodes an event and queues it; waits while the queue is full. `done` is called on a thread of the log when the
    /// record is in the log or has failed. It must be quick and must not append itself.
    ///
    /// # Errors
    /// [`AppendError`] where the event is not even queued; `done` is not called then.
    fn append(&self, event: &Event, done: Done) -> Result<(), AppendError>;

    /// Accepts appends again after one has failed. The map's writer calls this when it has undone everything that
    /// was not acknowledged; appends queued before still fail.
    fn resume(&self);

    /// Position of the last record that is in the log; 0 if there is none.
    fn end(&self) -> u64;

    /// Bytes of records after the position of the newest saved snapshot, roughly.
    fn tail_bytes(&self) -> u64;

    /// Whether the log that this daemon knows is complete, because nobody else may be writing it. A producer that asks
    /// how far its sequence is durable gets a reply only then.
    fn is_current(&self) -> bool {
        true
    }
}

impl EventLog for MapLog {
    fn append(&self, event: &Event, done: Done) -> Result<(), AppendError> {
        MapLog::append(self, event, done)
    }

    fn resume(&self) {
        MapLog::resume(self);
    }

    fn end(&self) -> u64 {
        MapLog::end(self)
    }

    fn tail_bytes(&self) -> u64 {
        MapLog::tail_bytes(self)
    }
}
