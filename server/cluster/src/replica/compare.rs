//! Comparing this daemon's own log with the shared one.
//!
//! Invariant: logs are compared by the chain at a position, never by lengths alone, and nothing is changed.

use tidemap_store::{LogPoint, OpenError};

use super::driver::Driver;
use crate::{
    engine::{Engine, EngineError, Message},
    message::GroupPart,
};

/// How the own log and the shared one relate.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) enum Relation {
    /// The shared log holds all of the own one, up to the message of this number, and perhaps more behind it.
    Holds {
        /// Number of the last message that the own log has.
        last_sequence: u64,
    },
    /// The shared log ends before the own one, of which it is a part.
    Ahead {
        /// The end of the shared log.
        end: LogPoint,
        /// Number of its last message.
        last_sequence: u64,
    },
    /// They differ behind this position.
    Forked {
        /// The last position that both have.
        common: u64,
    },
    /// The shared log begins behind the end of the own one: what is between is in checkpoints of others only.
    Behind {
        /// The position before its first record.
        from: u64,
    },
    /// The own log no longer holds the records at the end of the shared one, which is shorter: they cannot be compared.
    Unknown {
        /// The end of the shared log.
        end: u64,
    },
}

/// Why logs could not be compared.
#[derive(Debug, thiserror::Error)]
pub(super) enum CompareError {
    #[error(transparent)]
    Engine(#[from] EngineError),
    #[error(transparent)]
    Own(#[from] OpenError),
    #[error("message {sequence} of stream {stream} is not valid: {reason}")]
    Invalid { stream: String, sequence: u64, reason: &'static str },
}

impl<E: Engine> Driver<E> {
    pub(super) fn part(&self, message: &Message) -> Result<GroupPart, CompareError> {
        let invalid =
            |reason| CompareError::Invalid { stream: self.settings.stream.clone(), sequence: message.sequence, reason };
        let part = GroupPart::decode(&message.content).map_err(invalid)?;
        if part.map != self.settings.map {
            return Err(invalid("it belongs to another map"));
        }
        Ok(part)
    }

    /// The part in a message, which the stream holds.
    pub(super) async fn part_at(&self, sequence: u64) -> Result<GroupPart, CompareError> {
        let message = self.engine.read(&self.settings.stream, sequence).await?;
        // It was purged or forgotten since: the caller compares again.
        let gone = || EngineError::Unavailable(format!("message {sequence} is gone"));
        self.part(&message.ok_or_else(gone)?)
    }

    pub(super) async fn chain_at(&self, position: u64) -> Result<Option<u32>, CompareError> {
        let log = self.shared.log.clone();
        Ok(self.on_disk(move || log.chain_at(position)).await?)
    }

    /// How the own log and the shared one relate.
    pub(super) async fn relation(&mut self) -> Result<Relation, CompareError> {
        let ends = self.engine.ends(&self.settings.stream).await?;
        let own = self.shared.log.end();
        if ends.last == 0 || ends.first > ends.last {
            return Ok(match own.position {
                0 => Relation::Holds { last_sequence: ends.last },
                _ => Relation::Ahead { end: LogPoint::BEGINNING, last_sequence: ends.last },
            });
        }
        // The last complete group.
        let last = self.part_at(ends.last).await?;
        let (mut tail, mut tail_sequence) = (last.after, ends.last);
        if !last.is_last() {
            tail = last.before;
            tail_sequence = ends.last.saturating_sub(u64::from(last.part) + 1);
        }
        // A writer counts on from the newest epoch of all.
        self.epoch = self.epoch.max(last.epoch);
        self.heard_of(tail.position, last.epoch);
        if own.position == tail.position {
            return match own.chain == tail.chain {
                true => Ok(Relation::Holds { last_sequence: tail_sequence }),
                false => self.fork(ends.first, ends.last).await,
            };
        }
        if own.position > tail.position {
            return match self.chain_at(tail.position).await? {
                Some(chain) if chain == tail.chain => Ok(Relation::Ahead { end: tail, last_sequence: ends.last }),
                Some(_) => self.fork(ends.first, ends.last).await,
                None => Ok(Relation::Unknown { end: tail.position }),
            };
        }
        self.find_own_end(own, ends.first, ends.last).await
    }

    /// Where the end of the own log, which is shorter, lies in the stream.
    async fn find_own_end(&self, own: LogPoint, first: u64, last: u64) -> Result<Relation, CompareError> {
        // The first message whose group ends behind the own end.
        let (mut low, mut high) = (first, last);
        while low < high {
            let middle = low + (high - low) / 2;
            if self.part_at(middle).await?.after.position > own.position { high = middle } else { low = middle + 1 }
        }
        let next = self.part_at(low).await?;
        if next.before.position > own.position {
            // Parts of a group whose beginning was purged count as missing.
            return Ok(Relation::Behind { from: next.before.position });
        }
        let sequence = low.saturating_sub(u64::from(next.part) + 1);
        if next.before == own && low - first >= u64::from(next.part) {
            return Ok(Relation::Holds { last_sequence: sequence });
        }
        if next.before == own {
            return Ok(Relation::Behind { from: next.after.position });
        }
        self.fork(first, low).await
    }

    /// Where the logs, which differ, begin to differ.
    async fn fork(&self, first: u64, last: u64) -> Result<Relation, CompareError> {
        let own_end = self.shared.log.end().position;
        // Chains are equal up to the common position and differ behind it.
        let (mut low, mut high) = (first, last + 1);
        while low < high {
            let middle = low + (high - low) / 2;
            let after = self.part_at(middle).await?.after;
            let is_common = after.position <= own_end && self.chain_at(after.position).await? == Some(after.chain);
            if is_common { low = middle + 1 } else { high = middle }
        }
        let common = match low.checked_sub(1).filter(|&sequence| sequence >= first) {
            Some(sequence) => {
                let part = self.part_at(sequence).await?;
                if part.is_last() { part.after } else { part.before }
            }
            None => self.part_at(first).await?.before,
        };
        let is_common = self.chain_at(common.position).await? == Some(common.chain);
        Ok(Relation::Forked { common: if is_common { common.position } else { 0 } })
    }
}
