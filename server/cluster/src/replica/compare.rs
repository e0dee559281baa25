//! Compares this daemon's own log with the shared one.
//!
//! A message of the stream is **void** if tidemap has not written it, or if its group does not begin where the group
//! before it ended. The latter happens only where the stream had forgotten messages: an old writer appended behind a
//! number that had been used again. Void messages are part of no log, and each daemon leaves them out, because each
//! reads the messages in their order.
//!
//! Invariant: logs are compared by the chain at a position, never by lengths alone, and nothing is changed.

use tidemap_store::{LogPoint, OpenError};

use super::driver::{Driver, READ_BYTES};
use crate::{
    engine::{Engine, EngineError, Message},
    message::GroupPart,
};

/// Number of messages before the end that are read to find void ones, by a daemon that has not read them before.
pub(super) const READ_BACK: u64 = 1024;
/// Number of messages that are read before the last one that was read, by a daemon that has read all messages in their
/// order up to that one.
pub(super) const READ_BACK_FOLLOWING: u64 = 64;

/// The relation of the own log to the shared one.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) enum Relation {
    /// The shared log contains the whole own log, which ends at the message of this number, and perhaps more behind it.
    Holds {
        /// Number of the last message that the own log has, or that is void.
        last_sequence: u64,
        /// Whether a complete group follows it.
        has_more: bool,
    },
    /// The shared log ends before the own one, of which it is a part.
    Ahead {
        /// The end of the shared log.
        end: LogPoint,
        /// Number of the stream's last message.
        last_sequence: u64,
    },
    /// The logs differ behind this position.
    Forked {
        /// The last position that both logs have.
        common: u64,
    },
    /// The shared log begins behind the end of the own one, or behind the point where they begin to differ. The records
    /// between are only in checkpoints of other daemons.
    Behind {
        /// The position before the first record of the shared log.
        from: u64,
        /// Whether the logs are known to differ before it: the own log then has records that the shared one never gets.
        differs: bool,
    },
    /// The own log no longer has the records at the end of the shared log, which is shorter: the logs cannot be
    /// compared.
    Unknown {
        /// The end of the shared log.
        end: u64,
    },
}

/// The reason why logs could not be compared.
#[derive(Debug, thiserror::Error)]
pub(super) enum CompareError {
    #[error(transparent)]
    Engine(#[from] EngineError),
    #[error(transparent)]
    Own(#[from] OpenError),
    #[error("message {sequence} of stream {stream} is not valid: {reason}")]
    Invalid { stream: String, sequence: u64, reason: &'static str },
}

/// The end of a group that is not void.
#[derive(Clone, Copy, Debug)]
pub(super) struct Mark {
    /// Number of the group's first message.
    pub(super) first: u64,
    pub(super) after: LogPoint,
}

/// The groups in consecutive messages.
#[derive(Debug, Default)]
pub(super) struct Scan {
    /// The point at which the first group begins, and the message before it.
    begin: Option<Mark>,
    /// The ends of the groups that are not void.
    pub(super) marks: Vec<Mark>,
    epoch: u64,
    /// A group that is not complete yet: number of its first message, its first part, and the index of the next part.
    open: Option<(u64, GroupPart, u16)>,
    /// Number of the last message that was read.
    last: u64,
}

impl Scan {
    fn end(&self) -> Option<Mark> {
        self.marks.last().copied().or(self.begin)
    }

    pub(super) fn take(&mut self, sequence: u64, part: Option<GroupPart>) {
        self.last = sequence;
        let Some(part) = part else {
            self.open = None;
            return;
        };
        if self.begin.is_none() && part.part == 0 {
            self.begin = Some(Mark { first: sequence, after: part.before });
        }
        let is_next_part = self.open.as_ref().is_some_and(|(_, first, next)| {
            (first.epoch, first.before, first.after, first.parts, *next)
                == (part.epoch, part.before, part.after, part.parts, part.part)
        });
        let follows = part.part == 0 && self.end().is_some_and(|end| end.after == part.before);
        let open = self.open.take().filter(|_| is_next_part);
        if !follows && open.is_none() {
            return;
        }
        let (first, next) = (open.as_ref().map_or(sequence, |&(first, ..)| first), part.part + 1);
        if part.is_last() {
            self.epoch = self.epoch.max(part.epoch);
            self.marks.push(Mark { first, after: part.after });
        } else {
            self.open = Some((first, open.map_or(part, |(_, begin, _)| begin), next));
        }
    }

    /// The last message before the group that follows a point, and whether that group is complete; `None` where no
    /// group ends at the point.
    fn last_before_next(&self, point: LogPoint) -> Option<(u64, bool)> {
        let points: Vec<&Mark> = self.begin.iter().chain(&self.marks).collect();
        let found = points.iter().rposition(|mark| mark.after == point)?;
        let next = points.get(found + 1).map(|next| next.first);
        let open = self.open.as_ref().map(|&(first, ..)| first);
        Some((next.or(open).map_or(self.last, |first| first - 1), next.is_some()))
    }
}

impl<E: Engine> Driver<E> {
    /// The part in a message; `None` for a message that is not of the map.
    pub(super) fn part(&self, message: &Message) -> Result<Option<GroupPart>, CompareError> {
        let invalid =
            |reason| CompareError::Invalid { stream: self.settings.stream.clone(), sequence: message.sequence, reason };
        let part = GroupPart::decode(&message.content).map_err(invalid)?;
        Ok(part.filter(|part| part.map == self.settings.map))
    }

    /// The part in a message that the stream has.
    pub(super) async fn part_at(&self, sequence: u64) -> Result<Option<GroupPart>, CompareError> {
        let message = self.engine.read(&self.settings.stream, sequence).await?;
        // The message was purged or forgotten meanwhile: the caller compares again.
        let gone = || EngineError::Unavailable(format!("message {sequence} no longer exists"));
        self.part(&message.ok_or_else(gone)?)
    }

    /// The part in the last message of the map from `first` to `sequence`; `None` where there is none.
    pub(super) async fn part_up_to(&self, sequence: u64, first: u64) -> Result<Option<GroupPart>, CompareError> {
        for sequence in (first..=sequence).rev() {
            if let Some(part) = self.part_at(sequence).await? {
                return Ok(Some(part));
            }
        }
        Ok(None)
    }

    async fn chain_at(&self, position: u64) -> Result<Option<u32>, CompareError> {
        let log = self.shared.log.clone();
        Ok(self.on_disk(move || log.chain_at(position)).await?)
    }

    async fn is_own(&self, point: LogPoint) -> Result<bool, CompareError> {
        Ok(self.chain_at(point.position).await? == Some(point.chain))
    }

    /// The groups in the messages from `first` to `last`.
    async fn scan(&self, first: u64, last: u64) -> Result<Scan, CompareError> {
        let mut scan = Scan::default();
        let mut next = first;
        while next <= last {
            let stream = &self.settings.stream;
            let messages = self.engine.read_from(stream, next, READ_BYTES, self.settings.patience).await?;
            if messages.first().is_none_or(|message| message.sequence != next) {
                return Err(EngineError::Unavailable(format!("message {next} did not arrive")).into());
            }
            for message in messages.iter().filter(|message| message.sequence <= last) {
                scan.take(message.sequence, self.part(message)?);
                next = message.sequence + 1;
            }
        }
        Ok(scan)
    }

    /// The relation of the own log to the shared one. Reads the last messages, from `read_back` before the end on, or
    /// before the last known one.
    pub(super) async fn relation(&mut self, read_back: u64) -> Result<Relation, CompareError> {
        let ends = self.engine.ends(&self.settings.stream).await?;
        let own = self.shared.log.end();
        // The last message may be void: its content is not relied on.
        let Some(last) = self.part_up_to(ends.last, ends.first.max(1)).await? else {
            return Ok(match own.position {
                0 => Relation::Holds { last_sequence: ends.last, has_more: false },
                _ => Relation::Ahead { end: LogPoint::BEGINNING, last_sequence: ends.last },
            });
        };
        let (from, to) = if own.position < last.before.position {
            let near = self.near(own.position, ends.first, ends.last).await?;
            (near.saturating_sub(READ_BACK_FOLLOWING), (near + READ_BACK_FOLLOWING).min(ends.last))
        } else {
            let known = ends.last.min(self.last_sequence.max(1));
            let from = if read_back < READ_BACK { known } else { ends.last };
            (from.saturating_sub(read_back), ends.last)
        };
        let scan = self.scan(from.max(ends.first), to).await?;
        self.epoch = self.epoch.max(scan.epoch);
        let Some(end) = scan.end() else {
            // The stream has only parts of a group whose beginning was purged.
            return Ok(Relation::Behind { from: last.after.position, differs: false });
        };
        if to == ends.last {
            self.sees_end(end.after.position);
        }
        if let Some((last_sequence, has_more)) = scan.last_before_next(own) {
            return Ok(Relation::Holds { last_sequence, has_more: has_more || to < ends.last });
        }
        if own.position > end.after.position && to == ends.last {
            return match self.chain_at(end.after.position).await? {
                Some(chain) if chain == end.after.chain => {
                    Ok(Relation::Ahead { end: end.after, last_sequence: ends.last })
                }
                Some(_) => self.fork(&scan, ends.first, to).await,
                None => Ok(Relation::Unknown { end: end.after.position }),
            };
        }
        match scan.begin {
            Some(begin) if begin.after.position > own.position => {
                Ok(Relation::Behind { from: begin.after.position, differs: false })
            }
            _ => self.fork(&scan, ends.first, to).await,
        }
    }

    /// The first message whose group ends behind a position, as far as the messages are in order.
    async fn near(&self, position: u64, first: u64, last: u64) -> Result<u64, CompareError> {
        let (mut low, mut high) = (first, last);
        while low < high {
            let middle = low + (high - low) / 2;
            let part = self.part_up_to(middle, low).await?;
            if part.is_some_and(|part| part.after.position > position) { high = middle } else { low = middle + 1 }
        }
        Ok(low)
    }

    /// The point at which the logs, which differ, begin to differ.
    async fn fork(&self, scan: &Scan, first: u64, last: u64) -> Result<Relation, CompareError> {
        for mark in scan.begin.iter().chain(&scan.marks).rev() {
            if self.is_own(mark.after).await? {
                return Ok(Relation::Forked { common: mark.after.position });
            }
        }
        // Before the messages that were read, chains are equal up to the common position and differ behind it.
        let (mut low, mut high) = (first, last + 1);
        while low < high {
            let middle = low + (high - low) / 2;
            let is_common = match self.part_up_to(middle, low).await? {
                Some(part) => self.is_own(part.after).await?,
                None => true,
            };
            if is_common { low = middle + 1 } else { high = middle }
        }
        let point = match self.part_up_to(low.saturating_sub(1), first).await? {
            Some(part) if part.is_last() => part.after,
            Some(part) => part.before,
            None => self.part_at(first).await?.map_or(LogPoint::BEGINNING, |part| part.before),
        };
        if self.is_own(point).await? {
            return Ok(Relation::Forked { common: point.position });
        }
        // The stream no longer has the records that both logs have in common.
        let behind = Relation::Behind { from: point.position, differs: true };
        Ok(if first > 1 { behind } else { Relation::Forked { common: 0 } })
    }
}
