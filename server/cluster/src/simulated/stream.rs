//! A stream of the simulated engine: its content, its leader, and the last number on each server.
//!
//! Three servers hold the stream. The leader and one follower have all messages; the other may lag. So two of three
//! servers always include one that has all.
//!
//! Invariant: the last number never falls, except by amnesia and at the end of a split.

use std::collections::VecDeque;

use bytes::Bytes;
use tokio::time::Instant;

use crate::engine::{Message, StreamEnds};

/// Servers of the simulated engine.
pub(super) const SERVERS: usize = 3;

/// The content of a stream at one number: a message, or a write of a key.
#[derive(Clone, Debug)]
pub(super) struct Kept {
    /// The key of a bucket; empty in a stream.
    pub(super) key: String,
    /// `None` where a key was deleted.
    pub(super) content: Option<Bytes>,
}

/// Messages with numbers.
#[derive(Clone, Debug)]
pub(super) struct Numbered {
    first: u64,
    kept: VecDeque<Kept>,
}

impl Numbered {
    fn new() -> Self {
        Self { first: 1, kept: VecDeque::new() }
    }

    pub(super) fn last(&self) -> u64 {
        self.first + self.kept.len() as u64 - 1
    }

    /// The ends of the stream on a server that has the messages up to `held`.
    pub(super) fn ends(&self, held: u64) -> StreamEnds {
        let last = self.last().min(held);
        let content = self.get(last).and_then(|kept| kept.content.as_ref());
        let stamp = content.map_or(0, |content| u64::from(crc32c::crc32c(content)));
        StreamEnds { first: self.first.min(last + 1), last, stamp }
    }

    pub(super) fn push(&mut self, kept: Kept) -> u64 {
        self.kept.push_back(kept);
        self.last()
    }

    pub(super) fn get(&self, sequence: u64) -> Option<&Kept> {
        let at = usize::try_from(sequence.checked_sub(self.first)?).ok()?;
        self.kept.get(at)
    }

    pub(super) fn message(&self, sequence: u64) -> Option<Message> {
        let content = self.get(sequence)?.content.clone()?;
        Some(Message { sequence, content })
    }

    /// The newest write of a key, with its number.
    pub(super) fn newest(&self, key: &str) -> Option<(u64, &Kept)> {
        let numbers = (self.first..=self.last()).rev();
        numbers.filter_map(|sequence| Some((sequence, self.get(sequence)?))).find(|(_, kept)| kept.key == key)
    }

    pub(super) fn all(&self) -> impl Iterator<Item = (u64, &Kept)> {
        (self.first..).zip(&self.kept)
    }

    pub(super) fn purge_before(&mut self, sequence: u64) {
        while self.first < sequence && self.kept.pop_front().is_some() {
            self.first += 1;
        }
    }

    /// Forgets the last messages.
    pub(super) fn forget(&mut self, count: u64) {
        let kept = (self.kept.len() as u64).saturating_sub(count);
        self.kept.truncate(usize::try_from(kept).unwrap_or(usize::MAX));
    }

    pub(super) fn bytes(&self) -> u64 {
        self.kept.iter().filter_map(|kept| kept.content.as_ref()).map(|content| content.len() as u64).sum()
    }
}

/// A stream that one client has for itself.
pub(super) struct SplitSide {
    pub(super) client: String,
    pub(super) numbered: Numbered,
    pub(super) until: Instant,
}

/// A stream with its state.
pub(super) struct SimulatedStream {
    pub(super) numbered: Numbered,
    /// Number of servers that hold the stream, as its creator requested.
    pub(super) replicas: usize,
    pub(super) leader: usize,
    /// The last number on each server.
    pub(super) held: [u64; SERVERS],
    pub(super) leaderless_until: Instant,
    pub(super) full_until: Option<Instant>,
    /// Time of the last message.
    pub(super) pushed: Option<Instant>,
    pub(super) side: Option<SplitSide>,
}

impl SimulatedStream {
    pub(super) fn new(replicas: usize, leader: usize, now: Instant) -> Self {
        Self {
            numbered: Numbered::new(),
            replicas,
            leader,
            held: [0; SERVERS],
            leaderless_until: now,
            full_until: None,
            pushed: None,
            side: None,
        }
    }

    /// The stream as a client sees it.
    pub(super) fn seen_by(&mut self, client: &str) -> &mut Numbered {
        match &mut self.side {
            Some(side) if side.client == client => &mut side.numbered,
            _ => &mut self.numbered,
        }
    }

    /// Whether a client has the stream for itself.
    pub(super) fn is_split_for(&self, client: &str) -> bool {
        self.side.as_ref().is_some_and(|side| side.client == client)
    }

    /// Replicates the messages that the running servers lack; the server that lags stays `lag` messages behind.
    pub(super) fn replicate(&mut self, runs: &[bool; SERVERS], lag: u64) {
        let last = self.numbered.last();
        let all_run = runs.iter().all(|&runs| runs);
        let laggard = (self.leader + 2) % SERVERS;
        for (server, held) in self.held.iter_mut().enumerate().filter(|&(server, _)| runs[server]) {
            let lags = server == laggard && all_run;
            *held = (*held).max(if lags { last.saturating_sub(lag) } else { last });
        }
    }

    pub(super) fn forget(&mut self, count: u64) {
        self.numbered.forget(count);
        let last = self.numbered.last();
        self.held.iter_mut().for_each(|held| *held = (*held).min(last));
    }

    /// The last number on the running server that is the furthest behind.
    pub(super) fn stale_last(&self, runs: &[bool; SERVERS]) -> u64 {
        (0..SERVERS).filter(|&server| runs[server]).map(|server| self.held[server]).min().unwrap_or_default()
    }
}
