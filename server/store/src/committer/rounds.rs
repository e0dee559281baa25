//! A group of one log in two phases, for a log that daemons share: its records are written and made durable here, and
//! whether they belong to the log is decided elsewhere meanwhile.
//!
//! Invariant: a group ends with its completions called once each: kept, or cut off again and failed.

use std::{sync::PoisonError, time::Instant};

use super::{Append, Committer, Group};
use crate::{error::AppendError, log::writer::LogWriter};

impl Committer {
    /// Writes the appends, all of one log. Where that fails, their completions have received the error;
    /// [`AppendError::AfterFailure`] where each of them had failed before.
    pub(crate) fn begin(&self, appends: Vec<Append>) -> Result<Group, AppendError> {
        let mut group: Option<Group> = None;
        for append in appends.into_iter().filter_map(|append| self.admit(append)) {
            let Append { log, event, done, .. } = append;
            let group =
                group.get_or_insert_with(|| Group { log, events: Vec::new(), dones: Vec::new(), follower: None });
            group.events.push(event);
            group.dones.push(done);
        }
        self.write(group.ok_or(AppendError::AfterFailure)?)
    }

    /// Makes a written group durable. After an error, the caller must end the group by [`Self::end`] with this error.
    pub(crate) fn sync_written(&self, group: &Group) -> Result<(), AppendError> {
        if let Some(error) = self.poison() {
            return Err(error);
        }
        let start = Instant::now();
        let result = group.with_writer(LogWriter::sync_written);
        self.times.add(start.elapsed());
        result.and_then(|()| self.check_lock().map_or(Ok(()), Err))
    }

    /// Ends a written group: kept, or taken back with the reason.
    pub(crate) fn end(&self, group: Group, outcome: Result<(), AppendError>) {
        let ended = match outcome {
            Ok(()) => group.with_writer(|writer| {
                writer.keep();
                Ok(writer.end())
            }),
            Err(error @ AppendError::Poisoned { .. }) => Err(error),
            Err(error) => Err(group.with_writer(LogWriter::take_back).err().unwrap_or(error)),
        };
        match ended {
            Ok(end) => self.complete(group, end),
            Err(error) => self.fail(group, error),
        }
    }
}

impl Group {
    /// Uses the log's writer.
    pub(crate) fn with_writer<T>(
        &self,
        work: impl FnOnce(&mut LogWriter) -> Result<T, AppendError>,
    ) -> Result<T, AppendError> {
        match &mut *self.log.writer.lock().unwrap_or_else(PoisonError::into_inner) {
            Some(writer) => work(writer),
            None => Err(AppendError::Closed),
        }
    }

    /// Number of its records.
    pub(crate) fn records(&self) -> usize {
        self.events.len()
    }
}
