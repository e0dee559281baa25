//! The observations, scans and reports that a producer keeps until they are durable.
//!
//! Invariant: pure. Sequence numbers have no gaps, over items of all kinds together; each item is kept from its push
//! until it is acknowledged. After a reconnection, sending continues right after the last item that the daemon has:
//! nothing is left out, and an item that is sent twice has the same number. The tiles of the last acknowledged scan are
//! known, so that the differences after it can be sent again.

mod scans;

use std::collections::{HashMap, VecDeque};

pub use scans::KeptScan;
use tidemap_model::Position;
use tidemap_proto::{
    convert::{
        reports,
        scans::{TilePicture, TileTable},
    },
    v1,
};

use super::{ProducerError, columns::Entry, content::ContentCrc};

/// Default maximum number of bytes of kept scans and observations.
pub const WINDOW_BYTES: usize = 64 << 20;
/// Place of the indices of labels.
const LABELS_AT: usize = 3;

/// An item with a sequence number.
#[derive(Clone, Debug)]
enum Item {
    Observation(Entry),
    Scan(Box<KeptScan>),
    Report(Box<v1::Report>),
}

impl Item {
    fn bytes(&self) -> usize {
        size_of::<Self>()
            + match self {
                Self::Observation(_) => 0,
                Self::Scan(scan) => scan.bytes(),
                Self::Report(report) => size_of::<v1::Report>() + reports::wire_bytes(report),
            }
    }
}

/// The observations and scans of a producer that are not known to be durable, and the names of its states.
#[derive(Clone, Debug)]
pub struct Window {
    capacity: usize,
    bytes_max: usize,
    /// Sequence number of `entries[0]`.
    first_kept: u64,
    entries: VecDeque<Item>,
    /// Bytes of all entries, and of those sent on this connection.
    bytes: usize,
    sent_bytes: usize,
    /// Sequence number of the next observation to send on this connection.
    next_unsent: u64,
    /// Checksum over everything before `first_kept`.
    crc: ContentCrc,
    names: Vec<Box<str>>,
    /// Indices of single values, of vectors by number of coordinates, and of labels: a name with several meanings has
    /// several indices.
    indices: [HashMap<Box<str>, u32>; 4],
    /// Tiles after the last pushed scan.
    tiles: TileTable,
    /// Tiles after the last acknowledged scan.
    base: TilePicture,
}

impl Window {
    /// Begins after the items that the daemon has at the first connection.
    #[must_use]
    pub fn new(capacity: usize, durable: u64, content_crc: u32) -> Self {
        Self {
            capacity: capacity.max(1),
            bytes_max: WINDOW_BYTES,
            bytes: 0,
            sent_bytes: 0,
            first_kept: durable + 1,
            entries: VecDeque::new(),
            next_unsent: durable + 1,
            crc: ContentCrc::from_value(content_crc),
            names: Vec::new(),
            indices: Default::default(),
            tiles: TileTable::default(),
            base: TilePicture::default(),
        }
    }

    /// This window with another limit of bytes. A single scan may exceed it.
    #[must_use]
    pub fn with_bytes(self, bytes_max: usize) -> Self {
        Self { bytes_max: bytes_max.max(1), ..self }
    }

    /// Whether there is room for another observation or scan.
    #[must_use]
    pub fn has_room(&self) -> bool {
        self.entries.len() < self.capacity && self.bytes < self.bytes_max
    }

    /// Pushes an observation and returns its number; `None` if the window is full.
    pub fn push(&mut self, state: &str, time_nanos: i64, value: f64) -> Option<u64> {
        if !self.has_room() {
            return None;
        }
        let state = self.index(state, 0);
        Some(self.take(Item::Observation(Entry { state, time_nanos, value, position: None })))
    }

    /// Pushes an observation of a label, called `STATE/LABEL`, and returns its number; `None` if the window is full.
    pub fn push_label(&mut self, name: &str, time_nanos: i64) -> Option<u64> {
        if !self.has_room() {
            return None;
        }
        let state = self.index(name, LABELS_AT);
        Some(self.take(Item::Observation(Entry { state, time_nanos, value: 1.0, position: None })))
    }

    /// Whether a name is the name of a label.
    #[must_use]
    pub fn is_label(&self, name: &str) -> bool {
        self.indices[LABELS_AT].contains_key(name)
    }

    /// Whether observations of labels were pushed.
    #[must_use]
    pub fn has_labels(&self) -> bool {
        !self.indices[LABELS_AT].is_empty()
    }

    /// Pushes an observation of a vector and returns its number; `None` if the window is full.
    pub fn push_position(&mut self, state: &str, time_nanos: i64, position: Position) -> Option<u64> {
        if !self.has_room() {
            return None;
        }
        let state = self.index(state, position.dimensions().count() - 1);
        Some(self.take(Item::Observation(Entry { state, time_nanos, value: 0.0, position: Some(position) })))
    }

    /// Pushes a report and returns its number; `None` if the window is full.
    pub fn push_report(&mut self, report: v1::Report) -> Option<u64> {
        self.has_room().then(|| self.take(Item::Report(Box::new(report))))
    }

    fn take(&mut self, item: Item) -> u64 {
        self.bytes += item.bytes();
        self.entries.push_back(item);
        self.last()
    }

    fn index(&mut self, name: &str, at: usize) -> u32 {
        let indices = &mut self.indices[at];
        if let Some(&index) = indices.get(name) {
            return index;
        }
        // A map has at most u32::MAX states, and a name takes at least a byte here.
        let index = u32::try_from(self.names.len()).unwrap_or(u32::MAX);
        self.names.push(name.into());
        indices.insert(name.into(), index);
        index
    }

    /// Number of the last pushed item.
    #[must_use]
    pub fn last(&self) -> u64 {
        self.first_kept + self.entries.len() as u64 - 1
    }

    /// All observations up to this number are durable, or refused.
    #[must_use]
    pub fn durable(&self) -> u64 {
        self.first_kept - 1
    }

    /// Checksum over everything durable.
    #[must_use]
    pub fn content_crc(&self) -> u32 {
        self.crc.value()
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

    /// The observations to send next, at most `max_count`; empty if it is better to wait for more, or another kind of
    /// item comes next.
    ///
    /// A batch is sent when it is full, when no other batch is in progress, or when a caller waits for one of its
    /// observations (`urgent`: up to that number). So the observations of a slow producer are sent at once, and
    /// observations of a fast producer together.
    pub fn to_send(&self, max_count: usize, urgent: u64) -> impl Iterator<Item = &Entry> {
        self.unsent(max_count, usize::MAX, urgent).map_while(|item| match item {
            Item::Observation(entry) => Some(entry),
            Item::Scan(_) | Item::Report(_) => None,
        })
    }

    /// The reports to send next, at most `max_count`; empty if it is better to wait for more, or another kind of item
    /// comes next.
    pub fn reports_to_send(&self, max_count: usize, urgent: u64) -> impl Iterator<Item = &v1::Report> {
        self.unsent(max_count, usize::MAX, urgent).map_while(|item| match item {
            Item::Report(report) => Some(&**report),
            Item::Observation(_) | Item::Scan(_) => None,
        })
    }

    /// The items to send next, at most `max_count`; empty if it is better to wait for more.
    fn unsent(&self, max_count: usize, bytes: usize, urgent: u64) -> impl Iterator<Item = &Item> {
        let sent = usize::try_from(self.next_unsent - self.first_kept).unwrap_or(usize::MAX);
        let unsent = self.entries.len() - sent;
        let full = unsent >= max_count || self.bytes - self.sent_bytes >= bytes;
        let go = full || sent == 0 || urgent >= self.next_unsent;
        self.entries.iter().skip(if go { sent } else { self.entries.len() }).take(max_count)
    }

    /// Notes that the next `count` observations or scans were sent.
    pub fn sent(&mut self, count: usize) {
        let from = usize::try_from(self.next_unsent - self.first_kept).unwrap_or(usize::MAX);
        self.sent_bytes += self.entries.iter().skip(from).take(count).map(Item::bytes).sum::<usize>();
        self.next_unsent += count as u64;
    }

    /// The daemon has everything up to `durable`.
    ///
    /// # Errors
    /// [`ProducerError::Foreign`] if that was never sent.
    pub fn acknowledged(&mut self, durable: u64) -> Result<(), ProducerError> {
        if durable >= self.next_unsent {
            return Err(ProducerError::Foreign { durable, sent: self.next_unsent - 1 });
        }
        while self.first_kept <= durable {
            let Some(item) = self.entries.pop_front() else { break };
            self.first_kept += 1;
            self.bytes -= item.bytes();
            self.sent_bytes = self.sent_bytes.saturating_sub(item.bytes());
            match item {
                Item::Observation(entry) => {
                    let name = self.names.get(entry.state as usize).map_or("", |name| name);
                    match &entry.position {
                        None => self.crc.add(name, entry.time_nanos, entry.value),
                        Some(position) => self.crc.add_position(name, entry.time_nanos, position.coordinates()),
                    }
                }
                Item::Report(report) => self.crc.add_report(&report),
                Item::Scan(scan) => {
                    self.crc.add_scan(scan.time_nanos(), scan.digest());
                    scan.follow_in(&mut self.base);
                }
            }
        }
        Ok(())
    }

    /// A new connection: the daemon has everything up to `durable`, with this checksum. Returns the number of
    /// observations that this newly shows to be durable.
    ///
    /// # Errors
    /// [`ProducerError::Lost`] if the daemon has less than it acknowledged, [`ProducerError::Foreign`] if it has more
    /// than was sent, [`ProducerError::Differs`] if its data differs.
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
        self.sent_bytes = 0;
        if self.crc.value() != content_crc {
            return Err(ProducerError::Differs { durable });
        }
        Ok(durable - acknowledged)
    }
}

#[cfg(test)]
mod tests;
