//! What a producer keeps until it is durable.
//!
//! Invariant: pure. Sequence numbers are gapless; an observation is kept from [`Window::push`] until it is acknowledged;
//! after a reconnection sending starts right after what the daemon has, so that nothing is left out, and what is sent
//! twice carries the same number twice.

use std::collections::{HashMap, VecDeque};

use super::{ProducerError, columns::Entry, content::ContentCrc};

/// The observations of a producer that are not known to be durable, and the names of its states.
#[derive(Clone, Debug)]
pub struct Window {
    capacity: usize,
    /// Sequence number of `entries[0]`.
    first_kept: u64,
    entries: VecDeque<Entry>,
    /// Sequence number of the next observation to send on this connection.
    next_unsent: u64,
    /// Checksum over everything before `first_kept`.
    crc: ContentCrc,
    names: Vec<Box<str>>,
    indices: HashMap<Box<str>, u32>,
}

impl Window {
    /// Begins after what the daemon has at the first connection.
    #[must_use]
    pub fn new(capacity: usize, durable: u64, content_crc: u32) -> Self {
        Self {
            capacity: capacity.max(1),
            first_kept: durable + 1,
            entries: VecDeque::new(),
            next_unsent: durable + 1,
            crc: ContentCrc::from_value(content_crc),
            names: Vec::new(),
            indices: HashMap::new(),
        }
    }

    /// Takes an observation in and gives it the next number; `None` where the window is full.
    pub fn push(&mut self, state: &str, time_nanos: i64, value: f64) -> Option<u64> {
        if self.entries.len() >= self.capacity {
            return None;
        }
        let state = self.index(state);
        self.entries.push_back(Entry { state, time_nanos, value });
        Some(self.last())
    }

    fn index(&mut self, name: &str) -> u32 {
        if let Some(&index) = self.indices.get(name) {
            return index;
        }
        // A map holds at most u32::MAX states, and a name takes at least a byte here.
        let index = u32::try_from(self.names.len()).unwrap_or(u32::MAX);
        self.names.push(name.into());
        self.indices.insert(name.into(), index);
        index
    }

    /// Number of the last observation taken in.
    #[must_use]
    pub fn last(&self) -> u64 {
        self.first_kept + self.entries.len() as u64 - 1
    }

    /// Everything up to this number is durable, or refused.
    #[must_use]
    pub fn durable(&self) -> u64 {
        self.first_kept - 1
    }

    /// Number of the next observation to send.
    #[must_use]
    pub fn next_unsent(&self) -> u64 {
        self.next_unsent
    }

    /// Names of the states, by index.
    #[must_use]
    pub fn names(&self) -> &[Box<str>] {
        &self.names
    }

    /// The observations to send next, at most `most`; empty where it is better to wait for more.
    ///
    /// A batch leaves when it is full, when nothing is under way, or when somebody waits for one of its observations
    /// (`urgent`: up to that number). So a slow producer's observations leave at once, and a fast one's together.
    pub fn to_send(&self, most: usize, urgent: u64) -> impl Iterator<Item = &Entry> {
        let sent = usize::try_from(self.next_unsent - self.first_kept).unwrap_or(usize::MAX);
        let unsent = self.entries.len() - sent;
        let go = unsent >= most || sent == 0 || urgent >= self.next_unsent;
        self.entries.iter().skip(if go { sent } else { self.entries.len() }).take(most)
    }

    /// Notes that the next `count` observations were sent.
    pub fn sent(&mut self, count: usize) {
        self.next_unsent += count as u64;
    }

    /// The daemon has everything up to `durable`.
    ///
    /// # Errors
    /// [`ProducerError::Foreign`] where that was never sent.
    pub fn acknowledged(&mut self, durable: u64) -> Result<(), ProducerError> {
        if durable >= self.next_unsent {
            return Err(ProducerError::Foreign { durable, sent: self.next_unsent - 1 });
        }
        while self.first_kept <= durable {
            let Some(entry) = self.entries.pop_front() else { break };
            self.first_kept += 1;
            let name = self.names.get(entry.state as usize).map_or("", |name| name);
            self.crc.add(name, entry.time_nanos, entry.value);
        }
        Ok(())
    }

    /// A new connection: the daemon has everything up to `durable`, with that checksum. Gives the number of
    /// observations of which it was not known before.
    ///
    /// # Errors
    /// [`ProducerError::Lost`] where the daemon has less than it acknowledged, [`ProducerError::Foreign`] where it has
    /// more than was sent, [`ProducerError::Differs`] where it has something else.
    pub fn welcomed(&mut self, durable: u64, content_crc: u32) -> Result<u64, ProducerError> {
        let acknowledged = self.durable();
        if durable < acknowledged {
            return Err(ProducerError::Lost { durable, acknowledged });
        }
        if durable > self.last() {
            return Err(ProducerError::Foreign { durable, sent: self.last() });
        }
        self.next_unsent = self.last() + 1;
        self.acknowledged(durable)?;
        self.next_unsent = durable + 1;
        if self.crc.value() != content_crc {
            return Err(ProducerError::Differs { durable });
        }
        Ok(durable - acknowledged)
    }
}

#[cfg(test)]
mod tests;
