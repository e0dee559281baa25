//! A daemon with one map: its replica, and the thread of the map in short.
//!
//! It applies only what the log has, appends what producers send, and answers them when the log has it.

use std::{
    collections::{BTreeMap, VecDeque},
    sync::{Arc, Mutex},
    time::Duration,
};

use rand::{SeedableRng as _, rngs::SmallRng};
use tidemap_map::{
    event::{Envelope, Event, NewState, Observations, OffsetRun, SequenceSpan, StateKind},
    ids::{ProducerId, StateId},
    live_map::LiveMap,
    name::{MapName, ProducerKey, StateName},
    spec::MapSpec,
};
use tidemap_store::{
    AppendError, EventLog as _, LogPoint, MapId, Store, StoreOptions,
    simulation::{self, SimulatedDisk},
};
use tokio::{
    sync::{mpsc, oneshot},
    task::JoinSet,
    time::sleep,
};

use super::{super::*, Seen, UID};
use crate::{engine::Bucket, member::MemberReport, simulated::SimulatedEngine};

/// What a producer asks of the map.
pub(super) enum Ask {
    /// How far its sequence is durable; `None`: this daemon does not write the map.
    Welcome(String, oneshot::Sender<Option<u64>>),
    /// To take so many observations from a sequence number on; answered with the durable one.
    Observe(String, u64, u32, oneshot::Sender<Option<u64>>),
}

enum Inbox {
    Told(ReplicaEvent),
    Committed(Result<u64, AppendError>),
    Asked(Ask),
}

/// A daemon that runs.
pub(super) struct Daemon {
    pub(super) handle: ReplicaHandle,
    pub(super) log: SharedLog,
    pub(super) store: Store,
    pub(super) map: MapId,
    asks: mpsc::UnboundedSender<Inbox>,
    /// Ended with the daemon.
    pub(super) tasks: JoinSet<()>,
}

pub(super) fn spec() -> MapSpec {
    MapSpec { created_nanos: 1, ..MapSpec::new(MapName::new("office").expect("valid")) }
}

pub(super) fn new_disk(seed: u64) -> SimulatedDisk {
    let disk = SimulatedDisk::new(SmallRng::seed_from_u64(seed));
    simulation::make_directory(&disk);
    disk
}

fn options() -> StoreOptions {
    StoreOptions { segment_bytes: 4000, ..StoreOptions::default() }
}

/// The thread of the map.
struct MapTask {
    name: String,
    map: LiveMap,
    log: SharedLog,
    inbox: mpsc::UnboundedReceiver<Inbox>,
    sender: mpsc::UnboundedSender<Inbox>,
    is_writing: bool,
    epoch: u64,
    has_failed: bool,
    in_flight: VecDeque<(Event, oneshot::Sender<Option<u64>>)>,
    waiting: Vec<Ask>,
    seen: Arc<Mutex<Seen>>,
    forked: Option<oneshot::Sender<u64>>,
}

impl Daemon {
    /// Starts on a disk. `forked` hears of a fork.
    pub(super) fn start(
        name: &str,
        rank: u32,
        disk: &SimulatedDisk,
        engine: SimulatedEngine,
        seen: &Arc<Mutex<Seen>>,
        forked: oneshot::Sender<u64>,
        planted: Planted,
    ) -> Daemon {
        let store = simulation::open(disk, options()).expect("the disk is sound");
        let map = match store.maps().first() {
            Some(&(map, _)) => map,
            None => store.create_map(&spec()).expect("created"),
        };
        let opened = store.open_map(map, &spec()).expect("the log is sound");
        let mut live = LiveMap::new(Arc::new(spec()));
        for entry in opened.replay {
            let (position, event) = entry.expect("sound");
            live.apply(position, &event).expect("follows");
        }
        let settings = ReplicaSettings {
            map: UID,
            stream: "tm".to_owned(),
            member: name.to_owned(),
            version: "test".to_owned(),
            maths: 1,
            engine_replicas: 3,
            lease: Duration::from_secs(3),
            heal_wait: Duration::from_secs(30),
            group_bytes: 2000,
            patience: Duration::from_millis(500),
            disk_inline: true,
            planted,
        };
        let (sender, inbox) = mpsc::unbounded_channel();
        let listening = sender.clone();
        let listener: ReplicaListener = Arc::new(move |event| drop(listening.send(Inbox::Told(event))));
        let group_log = store.group_log(map).expect("open");
        let (replica, handle, log) = Replica::new(engine.clone(), settings, group_log, listener);
        handle.set_candidacy(Some(rank));
        let task = MapTask {
            name: name.to_owned(),
            map: live,
            log: log.clone(),
            inbox,
            sender: sender.clone(),
            is_writing: false,
            epoch: 0,
            has_failed: false,
            in_flight: VecDeque::new(),
            waiting: Vec::new(),
            seen: Arc::clone(seen),
            forked: Some(forked),
        };
        let mut tasks = JoinSet::new();
        tasks.spawn(task.run());
        tasks.spawn(replica.run());
        tasks.spawn(report(name.to_owned(), engine, log.clone()));
        Daemon { handle, log, store, map, asks: sender, tasks }
    }

    pub(super) async fn ask(&self, ask: Ask) {
        // A daemon that ends answers nothing.
        let _ = self.asks.send(Inbox::Asked(ask));
    }

    /// Where its own log ends.
    pub(super) fn end(&self) -> LogPoint {
        self.store.group_log(self.map).expect("open").end()
    }

    /// All that its own log holds.
    pub(super) fn records(&self) -> Vec<(u64, Event)> {
        let log = self.store.group_log(self.map).expect("open");
        let groups = log.groups(1).expect("readable").map(|group| group.expect("sound"));
        groups.flat_map(|group| group.events().expect("sound")).collect()
    }
}

async fn report(name: String, engine: SimulatedEngine, log: SharedLog) {
    for counter in 0.. {
        let report = MemberReport { counter, logs: BTreeMap::from([(UID, log.end())]), ..MemberReport::default() };
        let _ = engine.set(Bucket::Members, &name, report.encode()).await;
        sleep(Duration::from_millis(750)).await;
    }
}

impl MapTask {
    async fn run(mut self) {
        while let Some(message) = self.inbox.recv().await {
            match message {
                Inbox::Told(ReplicaEvent::Followed { events, applied }) => {
                    for (position, event) in events {
                        self.apply(position, &event);
                    }
                    drop(applied);
                }
                Inbox::Told(ReplicaEvent::Writing { epoch }) => {
                    self.is_writing = true;
                    self.epoch = epoch;
                    self.seen.lock().expect("sound").writes(&self.name, epoch, self.map.position());
                }
                Inbox::Told(ReplicaEvent::Following { .. }) => self.is_writing = false,
                Inbox::Told(ReplicaEvent::Forked { common }) => {
                    if let Some(forked) = self.forked.take() {
                        let _ = forked.send(common);
                    }
                    return;
                }
                Inbox::Committed(result) => self.committed(&result),
                Inbox::Asked(ask) => self.asked(ask),
            }
            if self.in_flight.is_empty() {
                if std::mem::take(&mut self.has_failed) {
                    self.log.resume();
                }
                for ask in std::mem::take(&mut self.waiting) {
                    self.asked(ask);
                }
            }
        }
    }

    fn apply(&mut self, position: u64, event: &Event) {
        self.map.apply(position, event).expect("the log fits the map");
    }

    fn committed(&mut self, result: &Result<u64, AppendError>) {
        let Some((event, reply)) = self.in_flight.pop_front() else { panic!("an answer to nothing") };
        match result {
            &Ok(position) => {
                self.apply(position, &event);
                let envelope = event.envelope().expect("of a producer");
                let mark = &self.map.producer_marks()[envelope.producer.0 as usize];
                let mut seen = self.seen.lock().expect("sound");
                seen.acknowledged(mark.key.producer(), envelope.span.last, self.epoch, position);
                drop(seen);
                let _ = reply.send(Some(envelope.span.last));
            }
            Err(_) => {
                self.has_failed = true;
                let _ = reply.send(None);
            }
        }
    }

    fn durable(&self, producer: &str) -> Option<(ProducerId, u64)> {
        let key = ProducerKey::new(producer, "").expect("valid");
        self.map.producer(&key).map(|(id, mark)| (id, mark.durable_sequence))
    }

    fn asked(&mut self, ask: Ask) {
        match ask {
            Ask::Welcome(producer, reply) => {
                let durable = self.durable(&producer).map_or(0, |(_, durable)| durable);
                let _ = reply.send((self.is_writing && self.log.is_current()).then_some(durable));
            }
            Ask::Observe(_, _, _, reply) if !self.is_writing => {
                let _ = reply.send(None);
            }
            ask @ Ask::Observe(..) if self.has_failed => self.waiting.push(ask),
            Ask::Observe(producer, first, count, reply) => {
                let known = self.durable(&producer);
                let in_flight = |(event, _): &(Event, _)| {
                    let id = known.map(|(id, _)| id);
                    event.envelope().map(|envelope| envelope.producer) == id
                };
                // What appears for the first time gets the next number, so it is alone.
                let is_new = known.is_none() || self.map.states() == 0;
                if (is_new && !self.in_flight.is_empty()) || self.in_flight.iter().any(in_flight) {
                    return self.waiting.push(Ask::Observe(producer, first, count, reply));
                }
                if known.map_or(0, |(_, durable)| durable) + 1 != first {
                    let _ = reply.send(None);
                    return;
                }
                let event = self.event(&producer, known.map(|(id, _)| id), first, count);
                let sender = self.sender.clone();
                match self.log.append(&event, Box::new(move |result| drop(sender.send(Inbox::Committed(result))))) {
                    Ok(()) => self.in_flight.push_back((event, reply)),
                    Err(_) => {
                        let _ = reply.send(None);
                    }
                }
            }
        }
    }

    fn event(&self, producer: &str, known: Option<ProducerId>, first: u64, count: u32) -> Event {
        let next = ProducerId(self.map.producers() as u32);
        let key = ProducerKey::new(producer, "").expect("valid");
        let envelope = Envelope {
            producer: known.unwrap_or(next),
            new_producer: known.is_none().then(|| key.into()),
            incarnation: 1,
            span: SequenceSpan { first, last: first + u64::from(count) - 1, content_crc: first as u32 },
            received_nanos: 1_700_000_000_000_000_000,
            refused: Vec::new(),
        };
        let state = StateName::new("door").expect("valid");
        let is_first = self.map.states() == 0;
        let times = (first..).take(count as usize).map(|sequence| sequence as i64 * 1_000_000_000);
        Event::Observations(
            envelope,
            Observations {
                new_states: is_first
                    .then(|| NewState::sampled(StateId(0), state, StateKind::Probability))
                    .into_iter()
                    .collect(),
                states: vec![StateId(0); count as usize],
                times_nanos: times.collect(),
                values: (first..).take(count as usize).map(|sequence| f64::from(sequence % 3 == 0)).collect(),
                offsets: vec![OffsetRun { count, offset_secs: 0 }],
                ..Observations::default()
            },
        )
    }
}
