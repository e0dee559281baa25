//! The log of a map on this disk, as a log that daemons share needs it: groups of records are written here and decided
//! about elsewhere, groups of other daemons are appended byte for byte, and groups are read again.
//!
//! Invariant: two such logs that hold a record of one position and chain hold equal bytes up to it, because the chain
//! goes over the headers of all records before, and these hold the checksums of their bodies.

use std::{
    path::PathBuf,
    sync::{Arc, PoisonError, atomic::Ordering},
};

use tidemap_layout::log::FIRST_CHAIN;
use tidemap_map::event::Event;

use crate::{
    MapId, Store,
    committer::{Append, Committer, Group},
    disk::Disk,
    error::{AppendError, OpenError, open_io},
    folders,
    log::{
        Done, Log,
        frame::EncodedEvent,
        groups::Groups,
        record_group::{LogPoint, RecordGroup},
        segment_position,
    },
};

/// An event that is encoded and waits to be written.
pub struct QueuedEvent(Append);

impl QueuedEvent {
    /// Bytes of its frame.
    #[must_use]
    pub fn bytes(&self) -> usize {
        self.0.event.frame_length()
    }

    /// Ends it without writing it.
    pub fn fail(self, error: AppendError) {
        (self.0.done)(Err(error));
    }
}

/// A group that is written here and not decided about.
#[must_use = "a group must be ended, or its appends are never answered"]
pub struct WrittenGroup {
    group: Group,
    records: RecordGroup,
}

impl WrittenGroup {
    /// The records.
    #[must_use]
    pub fn records(&self) -> &RecordGroup {
        &self.records
    }
}

/// Why a group of another daemon is not appended.
#[derive(Clone, Debug, PartialEq, Eq, thiserror::Error)]
pub enum ForeignGroupError {
    /// The group does not begin where this log ends.
    #[error("the group follows record {}, and this log ends with record {} or has another record there", .group.position, .end.position)]
    NotNext {
        /// The beginning of the group.
        group: LogPoint,
        /// The end of this log.
        end: LogPoint,
    },
    /// The group cannot be read.
    #[error("the group is not valid: {0}")]
    Invalid(&'static str),
    /// The group cannot be written.
    #[error(transparent)]
    Append(#[from] AppendError),
}

/// The log of a map on this disk, whose groups are also elsewhere. Clones are handles of one log; one of them may
/// write.
#[derive(Clone)]
pub struct GroupLog {
    log: Arc<Log>,
    committer: Arc<Committer>,
    disk: Arc<dyn Disk>,
    folder: PathBuf,
}

impl Store {
    /// The log of an open map, for groups. From then on nobody may append to its [`crate::MapLog`].
    #[must_use]
    pub fn group_log(&self, map: MapId) -> Option<GroupLog> {
        let inner = self.inner();
        let log = inner.entry(map)?.log?;
        Some(GroupLog {
            log,
            committer: Arc::clone(&inner.committer),
            disk: Arc::clone(&inner.disk),
            folder: folders::log_folder(&inner.directory, map),
        })
    }
}

impl GroupLog {
    /// Encodes an event.
    ///
    /// # Errors
    /// [`AppendError`]; `done` is not called then.
    pub fn queue(&self, event: &Event, done: Done) -> Result<QueuedEvent, AppendError> {
        if let Some(poison) = self.committer.poison() {
            return Err(poison);
        }
        let epoch = self.log.epoch.load(Ordering::Acquire);
        if self.log.has_failed(epoch) {
            return Err(AppendError::AfterFailure);
        }
        let event = EncodedEvent::encode(event).map_err(AppendError::InvalidEvent)?;
        Ok(QueuedEvent(Append { log: Arc::clone(&self.log), epoch, event, done }))
    }

    /// See [`crate::EventLog::resume`].
    pub fn resume(&self) {
        if self.log.has_failed(self.log.epoch.load(Ordering::Acquire)) {
            self.log.epoch.fetch_add(1, Ordering::AcqRel);
        }
    }

    /// The end of the log.
    #[must_use]
    pub fn end(&self) -> LogPoint {
        let writer = self.log.writer.lock().unwrap_or_else(PoisonError::into_inner);
        match &*writer {
            Some(writer) => LogPoint { position: writer.end(), chain: writer.chain() },
            // The map is deleted or closed.
            None => LogPoint { position: self.log.end.load(Ordering::Acquire), chain: FIRST_CHAIN },
        }
    }

    /// Position of the last record; does not wait for the disk, as [`Self::end`] does.
    #[must_use]
    pub fn position(&self) -> u64 {
        self.log.end.load(Ordering::Acquire)
    }

    /// Position of the newest checkpoint; 0 without one.
    #[must_use]
    pub fn checkpoint(&self) -> u64 {
        self.log.saved.load(Ordering::Acquire)
    }

    /// Position of the first record that this disk keeps, if there is one behind it.
    ///
    /// # Errors
    /// [`OpenError`] where the log cannot be read.
    pub fn first_position(&self) -> Result<u64, OpenError> {
        let names = self.disk.list(&self.folder).map_err(open_io(&self.folder))?;
        Ok(names.iter().find_map(|name| segment_position(name)).unwrap_or(1))
    }

    /// See [`crate::EventLog::tail_bytes`].
    #[must_use]
    pub fn tail_bytes(&self) -> u64 {
        let progress = self.log.progress.lock().unwrap_or_else(PoisonError::into_inner);
        progress.bytes.saturating_sub(progress.covered)
    }

    /// Writes events as a group behind the end, not durably.
    ///
    /// # Errors
    /// The reason why the appends have failed; their completions have received it.
    pub fn write(&self, events: Vec<QueuedEvent>) -> Result<WrittenGroup, AppendError> {
        let before = self.end();
        let group = self.committer.begin(events.into_iter().map(|event| event.0).collect())?;
        let written = group.with_writer(|writer| Ok((writer.written_chain(), writer.written_frames().to_vec())));
        match written {
            Ok((chain, frames)) => {
                let after = LogPoint { position: before.position + group.records() as u64, chain };
                Ok(WrittenGroup { group, records: RecordGroup { before, after, frames } })
            }
            Err(error) => {
                self.committer.end(group, Err(error.clone()));
                Err(error)
            }
        }
    }

    /// Makes a written group durable on this disk. Waits for the disk.
    ///
    /// # Errors
    /// [`AppendError`], with which the group must be ended.
    pub fn sync(&self, written: &WrittenGroup) -> Result<(), AppendError> {
        self.committer.sync_written(&written.group)
    }

    /// Ends a group: its records belong to the log, or are cut off again; their completions are called. A group that
    /// is to stay must be durable.
    pub fn end_group(&self, written: WrittenGroup, outcome: Result<(), AppendError>) {
        self.committer.end(written.group, outcome);
    }

    /// Appends a group of another daemon, byte for byte; durable when this returns. Returns its events.
    ///
    /// # Errors
    /// [`ForeignGroupError`]; the log is as it was, unless its disk has failed.
    pub fn append_group(&self, group: &RecordGroup) -> Result<Vec<(u64, Event)>, ForeignGroupError> {
        if let Some(poison) = self.committer.poison() {
            return Err(poison.into());
        }
        let end = self.end();
        if group.before != end {
            return Err(ForeignGroupError::NotNext { group: group.before, end });
        }
        let events = group.events().map_err(ForeignGroupError::Invalid)?;
        let written = {
            let mut writer = self.log.writer.lock().unwrap_or_else(PoisonError::into_inner);
            let writer = writer.as_mut().ok_or(AppendError::Closed)?;
            writer.write_frames(&group.frames, group.after.position + 1, group.after.chain).and_then(|()| writer.sync())
        };
        match written {
            Ok(()) => {}
            Err(error @ AppendError::Poisoned { .. }) => return Err(self.committer.poison_with(error).into()),
            Err(error) => {
                self.committer.watch.appended(error == AppendError::DiskFull);
                return Err(error.into());
            }
        }
        if let Some(error) = self.committer.check_lock() {
            return Err(error.into());
        }
        self.committer.watch.appended(false);
        // Shares of the group's bytes do not matter to when a checkpoint is due.
        let bytes = group.frames.len() as u64;
        let is_start = |(_, event): &&(u64, Event)| matches!(event, Event::UpdateStart(_));
        let updates: Vec<(u64, u64)> = events.iter().filter(is_start).map(|&(position, _)| (position, bytes)).collect();
        self.log.advance(group.after.position, bytes, &updates);
        Ok(events)
    }

    /// The groups that this disk keeps, from the one on that holds the record at `position`.
    ///
    /// # Errors
    /// [`OpenError`] where the log cannot be read, or no longer holds that record.
    pub fn groups(&self, position: u64) -> Result<Groups, OpenError> {
        Groups::open(Arc::clone(&self.disk), self.folder.clone(), position, self.end().position)
    }

    /// The chain behind a record; `None` where this disk does not keep the record after it, and it is not the last.
    ///
    /// # Errors
    /// [`OpenError`] where the log cannot be read.
    pub fn chain_at(&self, position: u64) -> Result<Option<u32>, OpenError> {
        let end = self.end();
        if position >= end.position {
            return Ok((position == end.position).then_some(end.chain));
        }
        Groups::chain_before(&*self.disk, &self.folder, position + 1)
    }
}
