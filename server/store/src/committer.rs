//! The only thread that writes logs. It groups all queued records, for all maps, into one write and one fdatasync per
//! log and round.
//!
//! Invariant: each completion is called exactly once, in the order of the map's appends, and with `Ok` only when the
//! record is durable. After any error but a full disk, no append succeeds until the process restarts.

use std::{
    collections::BTreeMap,
    mem,
    sync::{Arc, Condvar, Mutex, MutexGuard, OnceLock, PoisonError, Weak},
    time::Instant,
};

use crate::{
    error::AppendError,
    lock::Lock,
    log::{Done, Log, frame::EncodedEvent},
    trouble::Watch,
};

mod commit_steps;
pub(crate) mod rounds;
mod sync_stats;

use commit_steps::Followed;
pub use commit_steps::{CommitFollower, CommitStep, GroupFollower};
pub use sync_stats::SyncStats;
use sync_stats::SyncTimes;

/// Limit of the queue in bytes of frames; a full queue blocks the appending threads.
const QUEUE_BYTES_MAX: usize = 32 << 20;
/// Limit of the queue in records.
const QUEUE_RECORDS_MAX: usize = 65_536;

/// One record to append.
pub(crate) struct Append {
    pub(crate) log: Arc<Log>,
    pub(crate) epoch: u64,
    pub(crate) event: EncodedEvent,
    pub(crate) done: Done,
}

#[derive(Default)]
struct Queue {
    appends: Vec<Append>,
    bytes: usize,
    is_closed: bool,
}

/// The queue of the committer and its measurements.
#[derive(Default)]
pub(crate) struct Committer {
    /// The lock is held for a push or a take, never while the disk works.
    queue: Mutex<Queue>,
    has_work: Condvar,
    has_room: Condvar,
    times: SyncTimes,
    /// Receives that the disk is full, and that it no longer is.
    pub(crate) watch: Watch,
    /// The follower of the group commits, if there is one.
    pub(crate) followed: Followed,
    /// Set once and never cleared: after a failed fsync the content of the disk is unknown.
    poison: OnceLock<AppendError>,
    /// The lock of the folder, which a store holds; none on a simulated disk.
    lock: OnceLock<Weak<Lock>>,
}

/// The appends of one log in one round.
pub(crate) struct Group {
    log: Arc<Log>,
    events: Vec<EncodedEvent>,
    dones: Vec<Done>,
    follower: Option<GroupFollower>,
}

impl Group {
    fn step(&mut self, step: CommitStep) {
        if let Some(follower) = &mut self.follower {
            follower(step);
        }
    }
}

impl Committer {
    /// The error that stopped all writing, if there was one.
    pub(crate) fn poison(&self) -> Option<AppendError> {
        self.poison.get().cloned()
    }

    /// From now on nothing is appended without this lock.
    pub(crate) fn hold(&self, lock: &Arc<Lock>) {
        // Set once, when the store is opened.
        let _ = self.lock.set(Arc::downgrade(lock));
    }

    /// Stops all writing.
    pub(crate) fn poison_with(&self, error: AppendError) -> AppendError {
        self.poison.get_or_init(|| error).clone()
    }

    /// The error that stops all writing, if the folder is no longer ours. The check takes microseconds beside a sync.
    pub(crate) fn check_lock(&self) -> Option<AppendError> {
        let lock = self.lock.get()?.upgrade()?;
        let (file, reason) = lock.problem()?;
        Some(self.poison_with(AppendError::Poisoned { file, reason: reason.to_owned() }))
    }

    pub(crate) fn sync_stats(&self) -> SyncStats {
        self.times.stats()
    }

    fn queue(&self) -> MutexGuard<'_, Queue> {
        self.queue.lock().unwrap_or_else(PoisonError::into_inner)
    }

    /// Queues a record; waits while the queue is full.
    pub(crate) fn push(&self, append: Append) -> Result<(), AppendError> {
        let bytes = append.event.frame_length();
        let mut queue = self.queue();
        // An empty queue accepts one record of any length.
        while !queue.is_closed
            && (queue.appends.len() >= QUEUE_RECORDS_MAX || (queue.bytes > 0 && queue.bytes + bytes > QUEUE_BYTES_MAX))
        {
            queue = self.has_room.wait(queue).unwrap_or_else(PoisonError::into_inner);
        }
        if queue.is_closed {
            return Err(AppendError::Closed);
        }
        queue.bytes += bytes;
        queue.appends.push(append);
        drop(queue);
        self.has_work.notify_one();
        Ok(())
    }

    /// Refuses new records; the thread ends when it has written the queue.
    pub(crate) fn close(&self) {
        self.queue().is_closed = true;
        self.has_work.notify_all();
        self.has_room.notify_all();
    }

    /// Waits for work; `None` when closed and empty.
    fn take(&self) -> Option<Vec<Append>> {
        let mut queue = self.queue();
        while queue.appends.is_empty() {
            if queue.is_closed {
                return None;
            }
            queue = self.has_work.wait(queue).unwrap_or_else(PoisonError::into_inner);
        }
        Some(self.take_queued(&mut queue))
    }

    fn take_queued(&self, queue: &mut Queue) -> Vec<Append> {
        queue.bytes = 0;
        self.has_room.notify_all();
        mem::take(&mut queue.appends)
    }

    /// The committer's thread.
    pub(crate) fn run(&self) {
        // If a completion panics, appending threads must not wait for ever.
        struct CloseAtEnd<'committer>(&'committer Committer);
        impl Drop for CloseAtEnd<'_> {
            fn drop(&mut self) {
                self.0.close();
            }
        }
        let _close = CloseAtEnd(self);
        while let Some(appends) = self.take() {
            self.commit(appends);
        }
    }

    /// Takes the queue, so that a test can commit it by hand.
    #[cfg(test)]
    pub(crate) fn take_now(&self) -> Vec<Append> {
        self.take_queued(&mut self.queue())
    }

    /// Writes, syncs and completes one round of appends.
    pub(crate) fn commit(&self, appends: Vec<Append>) {
        let mut groups: BTreeMap<u32, Group> = BTreeMap::new();
        for append in appends {
            let Some(append) = self.admit(append) else { continue };
            let new_group =
                || Group { log: Arc::clone(&append.log), events: Vec::new(), dones: Vec::new(), follower: None };
            let group = groups.entry(append.log.map).or_insert_with(new_group);
            group.events.push(append.event);
            group.dones.push(append.done);
        }
        // All writes come before the first fdatasync, so that the kernel can start on the other files meanwhile.
        let written: Vec<Group> = groups.into_values().filter_map(|group| self.write(group).ok()).collect();
        for group in written {
            self.sync(group);
        }
    }

    /// The append, unless it fails because of an earlier one.
    fn admit(&self, append: Append) -> Option<Append> {
        let error = if append.log.has_failed(append.epoch) { Some(AppendError::AfterFailure) } else { None };
        let Some(error) = self.poison().or(error) else { return Some(append) };
        (append.done)(Err(error));
        None
    }

    /// Writes a group. Where that fails, its completions have received the error.
    fn write(&self, mut group: Group) -> Result<Group, AppendError> {
        group.follower = self.followed.begin(group.log.map, group.events.iter().map(EncodedEvent::frame_length));
        let result = match &mut *group.log.writer.lock().unwrap_or_else(PoisonError::into_inner) {
            _ if self.poison.get().is_some() => Err(AppendError::AfterFailure),
            Some(writer) => writer.write(&group.events),
            None => Err(AppendError::Closed),
        };
        match result {
            Ok(()) => {
                group.step(CommitStep::Written);
                Ok(group)
            }
            Err(error) => {
                self.fail(group, error.clone());
                Err(error)
            }
        }
    }

    /// Makes a group durable and completes it.
    fn sync(&self, group: Group) {
        // Another log of this round may have failed.
        if let Some(error) = self.poison() {
            return self.fail(group, error);
        }
        let start = Instant::now();
        let result = match &mut *group.log.writer.lock().unwrap_or_else(PoisonError::into_inner) {
            Some(writer) => writer.sync().map(|()| writer.end()),
            None => Err(AppendError::Closed),
        };
        self.times.add(start.elapsed());
        let result = result.and_then(|end| self.check_lock().map_or(Ok(end), Err));
        match result {
            Ok(end) => self.complete(group, end),
            Err(error) => self.fail(group, error),
        }
    }

    /// Completes a group that is in the log up to `end`.
    fn complete(&self, mut group: Group, end: u64) {
        group.step(CommitStep::Durable);
        let first = end + 1 - group.events.len() as u64;
        let mut bytes = 0;
        let mut updates = Vec::new();
        for (position, event) in (first..).zip(&group.events) {
            bytes += event.frame_length() as u64;
            if event.is_update_start() {
                updates.push((position, bytes));
            }
        }
        group.log.advance(end, bytes, &updates);
        self.watch.appended(false);
        for (position, done) in (first..).zip(group.dones) {
            done(Ok(position));
        }
    }

    /// Completes a group with an error. Later appends to the same log fail too.
    fn fail(&self, mut group: Group, error: AppendError) {
        group.step(CommitStep::Failed);
        // Set before the first completion, because a completion may make the writer try again.
        group.log.fail();
        if error == AppendError::DiskFull {
            self.watch.appended(true);
        }
        let error = match error {
            AppendError::Poisoned { .. } => self.poison_with(error),
            AppendError::AfterFailure => self.poison().unwrap_or(error),
            _ => error,
        };
        for done in group.dones {
            done(Err(error.clone()));
        }
    }
}
