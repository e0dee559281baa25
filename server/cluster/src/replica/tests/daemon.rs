//! A daemon with one map: its replica, and a simplified thread of the map.
//!
//! The thread applies only events of the log, appends the observations of producers, and replies to them when the log
//! has the observations.

use std::{
    collections::{BTreeMap, VecDeque},
    sync::{Arc, Mutex, atomic::AtomicU64},
    time::Duration,
};

use rand::{SeedableRng as _, rngs::SmallRng};
use tidemap_map::{
    event::{Envelope, Event, NewState, Observations, OffsetRun, SequenceSpan, StateKind, UpdateCause, UpdateStart},
    ids::{ProducerId, StateId},
    live_map::LiveMap,
    name::{MapName, ProducerKey, StateName},
    snapshot::MapSnapshot,
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

/// Length of the producers' time that each update learns.
const LEARNED_NANOS: i64 = 8_000_000_000;

/// A request of a producer to the map.
pub(super) enum Ask {
    /// Returns the sequence number up to which the producer's observations are durable; `None`: this daemon does not
    /// write the map.
    Welcome(String, oneshot::Sender<Option<u64>>),
    /// Takes a number of observations from a sequence number on; returns the durable sequence number.
    Observe(String, u64, u32, oneshot::Sender<Option<u64>>),
    /// Learns from the observations so far; returns the number of the generation.
    Update(oneshot::Sender<Option<u64>>),
}

enum Inbox {
    Event(ReplicaEvent),
    Committed(Result<u64, AppendError>),
    Request(Ask),
}

/// A running daemon.
pub(super) struct Daemon {
    pub(super) handle: ReplicaHandle,
    pub(super) log: SharedLog,
    pub(super) store: Store,
    pub(super) map: MapId,
    asks: mpsc::UnboundedSender<Inbox>,
    /// The tasks end with the daemon.
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
    StoreOptions { segment_bytes: 900, ..StoreOptions::default() }
}

/// A disk with its map, as a start reads it.
pub(super) struct OpenedDisk {
    store: Store,
    id: MapId,
    pub(super) map: LiveMap,
    pub(super) generation: u64,
}

impl OpenedDisk {
    /// Whether checkpoints have replaced the beginning of the log.
    pub(super) fn is_shortened(&self) -> bool {
        self.store.group_log(self.id).expect("open").groups(1).is_err()
    }
}

/// Opens the store of a disk and the map in it, which is created where there is none.
pub(super) fn open_disk(disk: &SimulatedDisk) -> Result<OpenedDisk, String> {
    let store = simulation::open(disk, options()).map_err(|error| error.to_string())?;
    let id = match store.maps().first() {
        Some(&(map, _)) => map,
        None => store.create_map(&spec()).map_err(|error| error.to_string())?,
    };
    let opened = store.open_map(id, &spec()).map_err(|error| error.to_string())?;
    let (known, mut generation) =
        opened.snapshot.as_ref().map_or((0, 0), |snapshot| (snapshot.position, snapshot.generation));
    let mut map = match opened.snapshot {
        Some(snapshot) => LiveMap::restore(Arc::new(spec()), snapshot),
        None => LiveMap::new(Arc::new(spec())),
    };
    for entry in opened.replay {
        let (position, event) = entry.map_err(|error| error.to_string())?;
        if position <= known {
            map.recover_pending(position, &event).map_err(|error| error.to_string())?;
        } else if let Some(snapshot) = applied(&mut map, position, &event)? {
            generation = snapshot.generation;
        }
    }
    Ok(OpenedDisk { store, id, map, generation })
}

/// Applies an event. An update runs at once; returns the map that it has made.
fn applied(map: &mut LiveMap, position: u64, event: &Event) -> Result<Option<MapSnapshot>, String> {
    let Some(work) = map.apply(position, event).map_err(|error| error.to_string())? else { return Ok(None) };
    let result = work.run(&AtomicU64::new(0)).map_err(|error| error.to_string())?;
    Ok(Some(map.finish_update(result)))
}

/// The thread of the map.
struct MapTask {
    name: String,
    store: Store,
    id: MapId,
    map: LiveMap,
    generation: u64,
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
    /// Starts the daemon on a disk. `forked` receives the position of a fork.
    pub(super) fn start(
        name: &str,
        rank: u32,
        disk: &SimulatedDisk,
        engine: SimulatedEngine,
        seen: &Arc<Mutex<Seen>>,
        forked: oneshot::Sender<u64>,
        planted: Planted,
    ) -> Daemon {
        let OpenedDisk { store, id, map: live, generation } = open_disk(disk).expect("the disk is sound");
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
        let listener: ReplicaListener = Arc::new(move |event| drop(listening.send(Inbox::Event(event))));
        let group_log = store.group_log(id).expect("open");
        let (replica, handle, log) = Replica::new(engine.clone(), settings, group_log, listener);
        handle.set_candidacy(Some(rank));
        let task = MapTask {
            name: name.to_owned(),
            store: store.clone(),
            id,
            map: live,
            generation,
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
        Daemon { handle, log, store, map: id, asks: sender, tasks }
    }

    pub(super) async fn ask(&self, ask: Ask) {
        // A daemon that ends never replies.
        let _ = self.asks.send(Inbox::Request(ask));
    }

    /// The end of the own log.
    pub(super) fn end(&self) -> LogPoint {
        self.store.group_log(self.map).expect("open").end()
    }

    /// All records of the own log.
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
                Inbox::Event(ReplicaEvent::Followed { events, applied }) => {
                    for (position, event) in events {
                        self.apply(position, &event);
                    }
                    drop(applied);
                }
                Inbox::Event(ReplicaEvent::Writing { epoch }) => {
                    self.is_writing = true;
                    self.epoch = epoch;
                    self.seen.lock().expect("sound").writes(&self.name, epoch, self.map.position());
                }
                Inbox::Event(ReplicaEvent::Following { .. }) => self.is_writing = false,
                Inbox::Event(ReplicaEvent::Forked { common }) => {
                    if let Some(forked) = self.forked.take() {
                        let _ = forked.send(common);
                    }
                    return;
                }
                Inbox::Committed(result) => self.committed(&result),
                Inbox::Request(ask) => self.handle_request(ask),
            }
            if self.in_flight.is_empty() {
                if std::mem::take(&mut self.has_failed) {
                    self.log.resume();
                }
                for ask in std::mem::take(&mut self.waiting) {
                    self.handle_request(ask);
                }
            }
        }
    }

    fn apply(&mut self, position: u64, event: &Event) {
        if let Some(snapshot) = applied(&mut self.map, position, event).expect("the log fits the map") {
            self.generation = snapshot.generation;
            // A failed save leaves the save before it and the log.
            let _ = self.store.save(self.id, &snapshot);
        }
    }

    fn committed(&mut self, result: &Result<u64, AppendError>) {
        let Some((event, reply)) = self.in_flight.pop_front() else { panic!("a reply without a request") };
        match result {
            &Ok(position) => {
                self.apply(position, &event);
                let Some(envelope) = event.envelope() else {
                    let _ = reply.send(Some(self.generation));
                    return;
                };
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

    fn handle_request(&mut self, ask: Ask) {
        match ask {
            Ask::Welcome(producer, reply) => {
                let durable = self.durable(&producer).map_or(0, |(_, durable)| durable);
                let _ = reply.send((self.is_writing && self.log.is_current()).then_some(durable));
            }
            Ask::Observe(_, _, _, reply) | Ask::Update(reply) if !self.is_writing => {
                let _ = reply.send(None);
            }
            ask @ Ask::Observe(..) if self.has_failed => self.waiting.push(ask),
            ask @ Ask::Update(_) if self.has_failed || !self.in_flight.is_empty() => self.waiting.push(ask),
            Ask::Update(reply) => {
                let generation = self.generation + 1;
                let cut_nanos = generation as i64 * LEARNED_NANOS;
                self.append(
                    Event::UpdateStart(UpdateStart { generation, cut_nanos, cause: UpdateCause::Request }),
                    reply,
                );
            }
            Ask::Observe(producer, first, count, reply) => {
                let known = self.durable(&producer);
                let in_flight = |(event, _): &(Event, _)| {
                    let id = known.map(|(id, _)| id);
                    event.envelope().map(|envelope| envelope.producer) == id
                };
                // A new entity gets the next number, so it is alone.
                let is_new = known.is_none() || self.map.states() == 0;
                if (is_new && !self.in_flight.is_empty()) || self.in_flight.iter().any(in_flight) {
                    return self.waiting.push(Ask::Observe(producer, first, count, reply));
                }
                if known.map_or(0, |(_, durable)| durable) + 1 != first {
                    let _ = reply.send(None);
                    return;
                }
                let event = self.event(&producer, known.map(|(id, _)| id), first, count);
                self.append(event, reply);
            }
        }
    }

    fn append(&mut self, event: Event, reply: oneshot::Sender<Option<u64>>) {
        let sender = self.sender.clone();
        match self.log.append(&event, Box::new(move |result| drop(sender.send(Inbox::Committed(result))))) {
            Ok(()) => self.in_flight.push_back((event, reply)),
            Err(_) => {
                let _ = reply.send(None);
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
