//! The world of the simulated engine: its servers, streams and clients, the current faults, and the data that an oracle
//! may read.
//!
//! Invariant: the world changes only under its lock, by the call of a client at a time of tokio's clock; it waits for
//! nothing.

use std::{
    collections::{BTreeMap, VecDeque},
    time::Duration,
};

use bytes::Bytes;
use rand::{Rng, SeedableRng, rngs::SmallRng};
use tokio::time::Instant;

use super::{
    faults::{EngineFault, EngineFaults, draw},
    stream::{Kept, SERVERS, SimulatedStream, SplitSide},
};
use crate::engine::{EngineError, Message};

/// Messages that arrive within this time count as simultaneous, for the defect where a stream accepts two of them.
const TOGETHER: Duration = Duration::from_millis(50);

/// A message that a client has appended.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct Acknowledged {
    /// The stream.
    pub stream: String,
    /// The message, with the number that the engine gave it.
    pub message: Message,
    /// The client to which the message was acknowledged.
    pub client: String,
    /// Time since the beginning of the simulation.
    pub at: Duration,
}

/// Defects that a test plants, which its checks must find.
#[derive(Clone, Copy, Debug, Default)]
pub struct PlantedDefects {
    /// The expected number of an append, and the expected revision of a key, are not checked.
    pub ignore_expected: bool,
    /// The ends of a stream and its messages come from a server that lags.
    pub stale_reads: bool,
    /// A stream accepts two messages after the one that both expect, if they arrive at the same time.
    pub two_at_one_position: bool,
    /// A lease seems not to be renewed, and every daemon may take it.
    pub useless_leases: bool,
}

/// The way of a request and its reply.
pub(super) struct UnderWay {
    /// Time for which the request is under way; `None`: it never arrives.
    pub(super) out: Option<Duration>,
    /// Time for which the reply is under way; `None`: it never arrives.
    pub(super) back: Option<Duration>,
    /// The client notices at once that it has no connection.
    pub(super) is_refused: bool,
}

#[derive(Default)]
struct ClientState {
    /// Time at which the cut ends; inner `None`: when the client is joined again.
    cut_until: Option<Option<Instant>>,
    is_frozen: bool,
    next: VecDeque<EngineFault>,
}

pub(super) struct EngineWorld {
    start: Instant,
    rng: SmallRng,
    pub(super) faults: EngineFaults,
    pub(super) defects: PlantedDefects,
    /// Time until which each server is stopped; inner `None`: until it is started again.
    stopped: [Option<Option<Instant>>; SERVERS],
    pub(super) streams: BTreeMap<String, SimulatedStream>,
    clients: BTreeMap<String, ClientState>,
    pub(super) acknowledged: Vec<Acknowledged>,
    pub(super) history: Vec<String>,
    pub(super) counts: BTreeMap<EngineFault, usize>,
}

impl EngineWorld {
    pub(super) fn new(seed: u64, faults: EngineFaults) -> Self {
        Self {
            start: Instant::now(),
            rng: SmallRng::seed_from_u64(seed),
            faults,
            defects: PlantedDefects::default(),
            stopped: [None; SERVERS],
            streams: BTreeMap::new(),
            clients: BTreeMap::new(),
            acknowledged: Vec::new(),
            history: Vec::new(),
            counts: BTreeMap::new(),
        }
    }

    pub(super) fn elapsed(&self) -> Duration {
        self.start.elapsed()
    }

    pub(super) fn note(&mut self, text: &str) {
        let line = format!("{:.6} {text}", self.elapsed().as_secs_f64());
        self.history.push(line);
    }

    fn count(&mut self, fault: EngineFault) {
        *self.counts.entry(fault).or_default() += 1;
    }

    fn client(&mut self, name: &str) -> &mut ClientState {
        self.clients.entry(name.to_owned()).or_default()
    }

    // --- the way between a client and the servers ---

    pub(super) fn set_frozen(&mut self, name: &str, is_frozen: bool) {
        self.client(name).is_frozen = is_frozen;
    }

    pub(super) fn is_frozen(&self, name: &str) -> bool {
        self.clients.get(name).is_some_and(|client| client.is_frozen)
    }

    /// Cuts a client off until a time; `None`: until [`join`](Self::join).
    pub(super) fn cut(&mut self, name: &str, until: Option<Instant>) {
        self.client(name).cut_until = Some(until);
        self.count(EngineFault::CutOff);
    }

    pub(super) fn join(&mut self, name: &str) {
        self.client(name).cut_until = None;
    }

    pub(super) fn is_cut(&self, name: &str) -> bool {
        let cut = self.clients.get(name).and_then(|client| client.cut_until);
        cut.is_some_and(|until| until.is_none_or(|until| Instant::now() < until))
    }

    pub(super) fn fault_next(&mut self, name: &str, fault: EngineFault) {
        self.client(name).next.push_back(fault);
    }

    /// Draws the outcome of the next call of a client, and starts the faults that it has drawn.
    pub(super) fn passage(&mut self, name: &str, patience: Duration) -> UnderWay {
        let chances = self.faults.chances.clone();
        let drawn: Vec<EngineFault> =
            chances.iter().filter(|&&(_, chance)| self.rng.random_bool(chance)).map(|&(fault, _)| fault).collect();
        let planned = self.client(name).next.pop_front();
        let mut passage = UnderWay {
            out: Some(draw(&mut self.rng, &self.faults.delay)),
            back: Some(draw(&mut self.rng, &self.faults.delay)),
            is_refused: false,
        };
        for fault in planned.into_iter().chain(drawn) {
            match fault {
                EngineFault::RequestLost => passage.out = None,
                EngineFault::ReplyLost => passage.back = None,
                EngineFault::Late => {
                    passage.out = Some(patience + patience.mul_f64(self.rng.random_range(0.0..2.0)));
                }
                _ => {
                    self.begin(name, fault);
                    continue;
                }
            }
            self.note(&format!("{name}: {fault:?}"));
            self.count(fault);
        }
        if self.is_cut(name) {
            passage.is_refused = self.rng.random_bool(0.5);
            passage.out = None;
        }
        passage
    }

    /// Starts a fault that affects more than one call.
    fn begin(&mut self, name: &str, fault: EngineFault) {
        let lasts = draw(&mut self.rng, &self.faults.lasts.clone());
        let until = Instant::now() + lasts;
        // A bucket never goes back by a drawn fault.
        let streams: Vec<String> = self.streams.keys().filter(|stream| !is_bucket(stream)).cloned().collect();
        let stream = (!streams.is_empty()).then(|| streams[self.rng.random_range(0..streams.len())].clone());
        match (fault, stream) {
            (EngineFault::NoLeader, _) => {
                let election = draw(&mut self.rng, &self.faults.election.clone());
                self.no_leader(election);
            }
            (EngineFault::CutOff, _) => {
                self.note(&format!("{name}: cut off for {lasts:?}"));
                self.cut(name, Some(until));
            }
            (EngineFault::ServerStopped, _) => {
                let server = self.rng.random_range(0..SERVERS);
                self.stop(server, Some(until));
            }
            (EngineFault::Full, Some(stream)) => self.fill(&stream, Some(until)),
            (EngineFault::Amnesia, Some(stream)) => {
                let count = self.rng.random_range(self.faults.forgets.clone());
                self.forget(&stream, count);
            }
            (EngineFault::Split, Some(stream)) => self.split(&stream, name, until),
            _ => {}
        }
    }

    // --- the servers ---

    pub(super) fn runs(&self) -> [bool; SERVERS] {
        let now = Instant::now();
        self.stopped.map(|stopped| stopped.is_none_or(|until| until.is_some_and(|until| until <= now)))
    }

    pub(super) fn stop(&mut self, server: usize, until: Option<Instant>) {
        self.note(&format!("server {server} stops"));
        self.count(EngineFault::ServerStopped);
        self.stopped[server] = Some(until);
        let names: Vec<String> = self.streams.keys().cloned().collect();
        for name in names {
            let election = draw(&mut self.rng, &self.faults.election.clone());
            if let Some(stream) = self.streams.get_mut(&name).filter(|stream| stream.leader == server) {
                stream.leaderless_until = stream.leaderless_until.max(Instant::now() + election);
            }
        }
    }

    pub(super) fn run(&mut self, server: usize) {
        self.note(&format!("server {server} starts"));
        self.stopped[server] = None;
    }

    pub(super) fn no_leader(&mut self, election: Duration) {
        self.note(&format!("no leader for {election:?}"));
        self.count(EngineFault::NoLeader);
        let until = Instant::now() + election;
        self.streams.values_mut().for_each(|stream| stream.leaderless_until = stream.leaderless_until.max(until));
    }

    // --- the streams ---

    pub(super) fn fill(&mut self, name: &str, until: Option<Instant>) {
        self.note(&format!("{name} is full"));
        self.count(EngineFault::Full);
        // A stream that is full until it is emptied gets an end in the far future.
        let until = until.unwrap_or_else(|| Instant::now() + Duration::from_secs(1 << 30));
        if let Some(stream) = self.streams.get_mut(name) {
            stream.full_until = Some(until);
        }
    }

    pub(super) fn forget(&mut self, name: &str, count: u64) {
        if let Some(stream) = self.streams.get_mut(name) {
            stream.forget(count);
            let last = stream.numbered.last();
            self.note(&format!("{name} forgets {count}, and ends with {last}"));
            self.count(EngineFault::Amnesia);
        }
    }

    pub(super) fn split(&mut self, name: &str, client: &str, until: Instant) {
        if let Some(stream) = self.streams.get_mut(name).filter(|stream| stream.side.is_none()) {
            let numbered = stream.numbered.clone();
            stream.side = Some(SplitSide { client: client.to_owned(), numbered, until });
            self.note(&format!("{name} is split: {client} has its own"));
            self.count(EngineFault::Split);
        }
    }

    /// Ends a split: the messages that its client has appended since are forgotten.
    pub(super) fn unite(&mut self, name: &str) {
        if self.streams.get_mut(name).is_some_and(|stream| stream.side.take().is_some()) {
            self.note(&format!("{name} is one again"));
        }
    }

    /// A stream that has a leader, as the call of a client finds it.
    pub(super) fn led(&mut self, name: &str, client: &str) -> Result<&mut SimulatedStream, EngineError> {
        let now = Instant::now();
        let runs = self.runs();
        let side = self.streams.get(name).and_then(|stream| stream.side.as_ref());
        if side.is_some_and(|side| side.until <= now) {
            self.unite(name);
        }
        check_quorum(&runs)?;
        let stream = self.streams.get_mut(name).ok_or_else(|| EngineError::Missing(name.to_owned()))?;
        if stream.is_split_for(client) {
            return Ok(stream);
        }
        if stream.leaderless_until > now {
            return Err(EngineError::Unavailable(format!("{name} has no leader")));
        }
        if !runs[stream.leader] {
            // Any two of three servers include one that has all messages.
            let longest = (0..SERVERS).filter(|&server| runs[server]).max_by_key(|&server| stream.held[server]);
            stream.leader = longest.unwrap_or_default();
        }
        Ok(stream)
    }

    /// Whether a stream accepts a message after the one that its sender expects.
    pub(super) fn takes_after(&mut self, name: &str, client: &str, expected: u64) -> Result<bool, EngineError> {
        let defects = self.defects;
        let stream = self.led(name, client)?;
        let last = stream.seen_by(client).last();
        let is_together = stream.pushed.is_some_and(|pushed| pushed.elapsed() < TOGETHER);
        let is_second = defects.two_at_one_position && is_together && expected + 1 == last;
        Ok(expected == last || is_second || defects.ignore_expected)
    }

    /// Puts a message at the end of a stream.
    pub(super) fn push(&mut self, name: &str, client: &str, kept: Kept) -> Result<u64, EngineError> {
        let runs = self.runs();
        let lag = self.rng.random_range(u64::from(self.defects.stale_reads)..=3);
        let stream = self.led(name, client)?;
        if stream.full_until.is_some_and(|until| Instant::now() < until) {
            return Err(EngineError::Full(format!("{name} is at its limit")));
        }
        let is_split = stream.is_split_for(client);
        let sequence = stream.seen_by(client).push(kept);
        stream.pushed = Some(Instant::now());
        if !is_split {
            stream.replicate(&runs, lag);
        }
        Ok(sequence)
    }

    pub(super) fn create(&mut self, name: &str, replicas: usize) -> Result<(), EngineError> {
        check_quorum(&self.runs())?;
        if !self.streams.contains_key(name) {
            let leader = self.rng.random_range(0..SERVERS);
            self.streams.insert(name.to_owned(), SimulatedStream::new(replicas, leader, Instant::now()));
        }
        Ok(())
    }

    pub(super) fn acknowledge(&mut self, stream: &str, client: &str, sequence: u64, content: Bytes) {
        let at = self.elapsed();
        let message = Message { sequence, content };
        self.acknowledged.push(Acknowledged { stream: stream.to_owned(), message, client: client.to_owned(), at });
    }
}

fn check_quorum(runs: &[bool; SERVERS]) -> Result<(), EngineError> {
    let is_quorum = runs.iter().filter(|&&runs| runs).count() * 2 > SERVERS;
    is_quorum.then_some(()).ok_or_else(|| EngineError::Unavailable("no quorum of servers".to_owned()))
}

/// Whether a stream holds the keys of a bucket.
fn is_bucket(stream: &str) -> bool {
    stream.starts_with("KV_")
}
