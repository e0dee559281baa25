//! The single writer of a map: one thread that orders batches, hands them to the log, applies what is durable,
//! publishes views and runs updates.
//!
//! Invariant: the order of the log is the order of application. An acknowledgement leaves after the view that shows
//! its observations is published. The thread never waits for a reader, a client or an update.

use std::{
    collections::{BTreeMap, BTreeSet, VecDeque},
    panic::{AssertUnwindSafe, catch_unwind},
    sync::{Arc, mpsc},
    time::{Duration, Instant},
};

use arc_swap::ArcSwap;
use tidemap_map::{
    event::{Event, StateId},
    live_map::LiveMap,
    snapshot::MapSnapshot,
    spec::MapSpec,
    update::{UpdateResult, UpdateWork},
    view::MapView,
};
use tidemap_store::{AppendError, MapId, MapLog, Store};
use tokio::sync::{OwnedSemaphorePermit, oneshot, watch};
use tracing::{error, info, warn};

use super::{
    protocol::{Batch, Command, Ending, Hello, HelloError, Opened, Refused, SessionEvent, SessionId, is_fatal},
    sessions::Sessions,
    updates::{Updates, Wanted},
};
use crate::{
    clock::Clock,
    jobs::{Job, Jobs},
};

/// How often the writer looks at the clock when nothing else happens.
const TICK: Duration = Duration::from_secs(1);
/// Commands handled between two publications, at most.
const BURST: usize = 512;
/// Updates in the time of imported data follow each other fast; they are not each saved, because the log gives them
/// back. At least this often they are.
const SAVE_INTERVAL: Duration = Duration::from_secs(20);

#[cfg(test)]
mod tests;

/// What a writer needs from the daemon.
#[derive(Clone, Debug)]
pub struct Context {
    /// The store.
    pub store: Arc<Store>,
    /// All jobs.
    pub jobs: Arc<Jobs>,
    /// The clock.
    pub clock: Arc<dyn Clock>,
    /// Threads of updates.
    pub update_pool: Arc<rayon::ThreadPool>,
    /// Told when storage has failed for good.
    pub fatal: tokio::sync::mpsc::UnboundedSender<String>,
    /// Most states of a map.
    pub max_states: usize,
    /// Most producer keys of a map.
    pub max_producers: usize,
    /// Pending observations above which an update runs early.
    pub max_pending: u64,
}

/// A map, as everybody but its writer sees it.
#[derive(Debug)]
pub struct MapHandle {
    /// Its number in the store.
    pub id: MapId,
    /// Its fixed properties.
    pub spec: Arc<MapSpec>,
    view: Arc<ArcSwap<MapView>>,
    commands: mpsc::Sender<Command>,
    saturated: watch::Receiver<bool>,
}

impl MapHandle {
    /// The map as it stands; never waits.
    #[must_use]
    pub fn view(&self) -> Arc<MapView> {
        self.view.load_full()
    }

    /// Sends the writer a command. `false`: the writer has stopped.
    #[must_use]
    pub fn send(&self, command: Command) -> bool {
        self.commands.send(command).is_ok()
    }

    /// Whether streams should wait, because updates do not keep up.
    #[must_use]
    pub fn saturated(&self) -> watch::Receiver<bool> {
        self.saturated.clone()
    }

    /// Stops the writer, once everything in flight is answered.
    pub async fn stop(&self, ending: Ending) {
        let (done, stopped) = oneshot::channel();
        if self.send(Command::Stop { ending, done }) {
            // An error means that the writer is gone already.
            let _ = stopped.await;
        }
    }
}

/// Starts the writer of a map that was restored.
///
/// # Errors
/// The thread cannot be started.
pub fn start(context: Context, id: MapId, map: LiveMap, log: MapLog) -> std::io::Result<Arc<MapHandle>> {
    let spec = Arc::clone(map.spec());
    let (commands, inbox) = mpsc::channel();
    let (saturated_sender, saturated) = watch::channel(false);
    let mut map = map;
    let view = Arc::new(ArcSwap::from_pointee(map.publish()));
    let handle = Arc::new(MapHandle {
        id,
        spec: Arc::clone(&spec),
        view: Arc::clone(&view),
        commands: commands.clone(),
        saturated,
    });
    let writer = Writer {
        sessions: Sessions::new(spec.zone.offset_cache(), context.max_states, context.max_producers),
        updates: Updates::new(spec.name.clone(), Arc::clone(&context.jobs), context.max_pending),
        context,
        id,
        map,
        log,
        view,
        saturated: saturated_sender,
        commands,
        flights: VecDeque::new(),
        failing: None,
        waiting_hellos: Vec::new(),
        acks: BTreeMap::new(),
        ended_jobs: Vec::new(),
        changed: false,
        unsaved: None,
        saving: false,
        last_save: None,
        stopping: None,
    };
    std::thread::Builder::new().name(format!("map-{}", id.0)).spawn(move || writer.run(&inbox))?;
    Ok(handle)
}

/// An append that the committer has not answered.
enum Flight {
    Observations { session: SessionId, event: Event, refused: Vec<Refused>, _permits: [OwnedSemaphorePermit; 2] },
    UpdateStart { event: Event, job: Arc<Job> },
}

#[derive(Default)]
struct PendingAck {
    durable_sequence: u64,
    refused: Vec<Refused>,
}

/// A job and what it published, generation and cut, or why it failed.
type EndedJob = (Arc<Job>, Result<(u64, i64), String>);

struct Writer {
    context: Context,
    id: MapId,
    map: LiveMap,
    log: MapLog,
    view: Arc<ArcSwap<MapView>>,
    saturated: watch::Sender<bool>,
    commands: mpsc::Sender<Command>,
    sessions: Sessions,
    updates: Updates,
    flights: VecDeque<Flight>,
    /// Set while appends fail, until all in flight are answered.
    failing: Option<AppendError>,
    waiting_hellos: Vec<Hello>,
    acks: BTreeMap<SessionId, PendingAck>,
    ended_jobs: Vec<EndedJob>,
    changed: bool,
    /// The newest snapshot that is not saved, with the states that differ from the saved one.
    unsaved: Option<(MapSnapshot, BTreeSet<StateId>)>,
    saving: bool,
    last_save: Option<Instant>,
    stopping: Option<(Ending, oneshot::Sender<()>)>,
}

impl Writer {
    fn run(mut self, inbox: &mpsc::Receiver<Command>) {
        loop {
            match inbox.recv_timeout(TICK) {
                Ok(command) => {
                    self.handle(command);
                    for command in inbox.try_iter().take(BURST) {
                        self.handle(command);
                    }
                }
                Err(mpsc::RecvTimeoutError::Timeout) => {}
                Err(mpsc::RecvTimeoutError::Disconnected) => break,
            }
            self.pump();
            if self.stopping.is_some() && self.flights.is_empty() && !self.saving {
                break;
            }
        }
        self.stop();
    }

    fn handle(&mut self, command: Command) {
        match command {
            Command::Hello(hello) => self.hello(hello),
            Command::Batch { session, batch, permits } => self.batch(session, batch, permits),
            Command::Leave { session, clean } => self.leave(session, clean),
            Command::Update { until_nanos, cause, job } => self.updates.push(Wanted { until_nanos, cause, job }),
            Command::Committed(result) => self.committed(result),
            Command::UpdateDone { job, result } => self.update_done(&job, result),
            Command::Saved(result) => self.saved(result),
            Command::Stop { ending, done } => {
                self.sessions.end_all(&ending);
                self.stopping = Some((ending, done));
            }
        }
    }

    /// After each burst of commands: publish, then tell those who wait for what is now public, then start what is due.
    fn pump(&mut self) {
        if std::mem::take(&mut self.changed) {
            self.view.store(Arc::new(self.map.publish()));
        }
        let now = self.context.clock.now_nanos();
        let accepting = self.stopping.is_none() && self.failing.is_none();
        if accepting {
            // Before the acknowledgements: who has one can see the update that it made due.
            self.updates.look(&self.map, &self.sessions, now);
        }
        for (id, ack) in std::mem::take(&mut self.acks) {
            if let Some(session) = self.sessions.get(id) {
                session.tell(SessionEvent::Ack { durable_sequence: ack.durable_sequence, refused: ack.refused });
            }
        }
        for (job, result) in std::mem::take(&mut self.ended_jobs) {
            job.end(result);
        }
        if self.flights.is_empty() && self.failing.take().is_some() {
            self.sessions.roll_back();
            self.log.resume();
        }
        for hello in std::mem::take(&mut self.waiting_hellos) {
            self.hello(hello);
        }
        if accepting {
            self.start_update(now);
        }
        let saturated = self.map.pending() + self.map.updating() > 2 * self.context.max_pending;
        self.saturated.send_if_modified(|known| std::mem::replace(known, saturated) != saturated);
        if self.last_save.is_none_or(|last| last.elapsed() >= SAVE_INTERVAL) {
            self.save();
        }
    }

    fn hello(&mut self, hello: Hello) {
        let answer = if self.stopping.is_some() {
            Err(HelloError::Closing)
        } else if let Some(error) = &self.failing {
            Err(HelloError::Storage(error.clone()))
        } else {
            match self.sessions.open(&hello, &self.map) {
                Ok(Some(opened)) => Ok(opened),
                Ok(None) => return self.waiting_hellos.push(hello),
                Err(error) => Err(error),
            }
        };
        let opened: Option<Opened> = answer.as_ref().ok().copied();
        if opened.is_some() {
            self.updates.stream_settled(&hello.key);
        }
        if hello.reply.send(answer).is_err() {
            // The client went away while it waited.
            if let Some(opened) = opened {
                self.sessions.leave(opened.session);
            }
        }
    }

    fn batch(&mut self, session: SessionId, batch: Batch, permits: [OwnedSemaphorePermit; 2]) {
        if let Some(error) = &self.failing {
            return self.sessions.end(session, &Ending::Storage(error.clone()));
        }
        let now = self.context.clock.now_nanos();
        let Some((observations, refused)) = self.sessions.event(session, batch, &self.map, now) else { return };
        let event = Event::Observations(observations);
        let appended = self.append(&event);
        self.flights.push_back(Flight::Observations { session, event, refused, _permits: permits });
        if let Err(error) = appended {
            self.committed(Err(error));
        }
    }

    fn append(&mut self, event: &Event) -> Result<(), AppendError> {
        let commands = self.commands.clone();
        // A writer that has stopped does not need the answer.
        self.log.append(event, Box::new(move |result| drop(commands.send(Command::Committed(result)))))
    }

    fn leave(&mut self, session: SessionId, clean: bool) {
        if let Some((key, reached)) = self.sessions.leave(session)
            && !clean
        {
            self.updates.stream_broke(key, reached);
        }
    }

    fn committed(&mut self, result: Result<u64, AppendError>) {
        let Some(flight) = self.flights.pop_front() else { return };
        match (result, flight) {
            (Ok(position), Flight::Observations { session, event, refused, .. }) => {
                if self.apply(position, &event).is_none() {
                    return;
                }
                if let Event::Observations(observations) = &event {
                    let ack = self.acks.entry(session).or_default();
                    ack.durable_sequence = observations.last_sequence;
                    ack.refused.extend(refused);
                    metrics::counter!("tidemap_observations_total").increment(observations.states.len() as u64);
                    metrics::counter!("tidemap_refused_total").increment(observations.refused.len() as u64);
                    self.sessions.applied(session, observations);
                }
            }
            (Ok(position), Flight::UpdateStart { event, job }) => match self.apply(position, &event) {
                Some(Some(work)) => self.run_update(work, &job),
                _ => job.end(Err("the update did not start".to_owned())),
            },
            (Err(error), flight) => self.append_failed(error, flight),
        }
    }

    fn append_failed(&mut self, error: AppendError, flight: Flight) {
        if self.failing.is_none() {
            warn!(map = %self.map.spec().name, %error, "the log could not be written; nothing of it is acknowledged");
            if is_fatal(&error) {
                self.fatal(error.to_string());
            }
        }
        // Those that fail because one before them failed are told of that one.
        let first = self.failing.get_or_insert(error).clone();
        match flight {
            Flight::Observations { session, .. } => self.sessions.failed(session, &Ending::Storage(first)),
            Flight::UpdateStart { job, .. } => job.end(Err(first.to_string())),
        }
    }

    fn fatal(&self, reason: String) {
        // The daemon is stopping already if nobody listens.
        let _ = self.context.fatal.send(reason);
    }

    fn apply(&mut self, position: u64, event: &Event) -> Option<Option<UpdateWork>> {
        self.changed = true;
        match self.map.apply(position, event) {
            Ok(work) => Some(work),
            Err(inconsistent) => {
                error!(map = %self.map.spec().name, error = %inconsistent, "the map and its log disagree");
                self.fatal(inconsistent.to_string());
                None
            }
        }
    }

    fn start_update(&mut self, now: i64) {
        let in_flight = self.flights.iter().any(|flight| matches!(flight, Flight::UpdateStart { .. }));
        if in_flight || self.map.is_updating() {
            return;
        }
        let Some(Wanted { until_nanos, cause, job }) = self.updates.pop() else { return };
        let event = Event::UpdateStart(self.map.plan_update(until_nanos, now, cause));
        let appended = self.append(&event);
        self.flights.push_back(Flight::UpdateStart { event, job });
        if let Err(error) = appended {
            self.committed(Err(error));
        }
    }

    fn run_update(&mut self, work: UpdateWork, job: &Arc<Job>) {
        job.start(work.states(), work.observations());
        let commands = self.commands.clone();
        let pool = Arc::clone(&self.context.update_pool);
        let for_thread = Arc::clone(job);
        let spawned = std::thread::Builder::new().name(format!("update-{}", self.id.0)).spawn(move || {
            let run = || pool.install(|| work.run(&for_thread.states_done));
            let result = catch_unwind(AssertUnwindSafe(run)).map(Box::new);
            let result = result.map_err(|_| "the update panicked; this is a defect of tidemap".to_owned());
            // Without a writer there is nobody to take the result; the log gives it back at the next start.
            let _ = commands.send(Command::UpdateDone { job: for_thread, result });
        });
        if let Err(error) = spawned {
            // The log says that the update started: only a restart repeats it.
            job.end(Err(error.to_string()));
            self.fatal(format!("the update of map {} could not start: {error}", self.map.spec().name));
        }
    }

    fn update_done(&mut self, job: &Arc<Job>, result: Result<Box<UpdateResult>, String>) {
        match result {
            Ok(result) => {
                self.context.jobs.set_report(job, result.outcomes().to_vec());
                let (snapshot, states) = self.map.finish_update(*result);
                self.changed = true;
                metrics::counter!("tidemap_updates_total").increment(1);
                info!(
                    map = %self.map.spec().name, cause = ?job.cause, generation = snapshot.generation,
                    states = states.len(), observations = job.status().observations, "updated"
                );
                self.ended_jobs.push((Arc::clone(job), Ok((snapshot.generation, snapshot.cut_nanos))));
                let mut changed = self.unsaved.take().map(|(_, changed)| changed).unwrap_or_default();
                changed.extend(states);
                self.unsaved = Some((snapshot, changed));
            }
            Err(reason) => {
                error!(map = %self.map.spec().name, reason, "update failed; the generation before stays in force");
                self.ended_jobs.push((Arc::clone(job), Err(reason)));
            }
        }
    }

    fn save(&mut self) {
        if self.saving {
            return;
        }
        let Some((snapshot, changed)) = self.unsaved.take() else { return };
        let (store, id, commands) = (Arc::clone(&self.context.store), self.id, self.commands.clone());
        let states: Vec<StateId> = changed.into_iter().collect();
        let spawned = std::thread::Builder::new().name(format!("save-{}", id.0)).spawn(move || {
            let saved = store.save(id, &snapshot, &states).map_err(|error| (error.to_string(), snapshot));
            // At a stop nobody waits: the log gives back what is not saved.
            let _ = commands.send(Command::Saved(saved));
        });
        match spawned {
            Ok(_) => self.saving = true,
            Err(error) => warn!(%error, "no thread to save a checkpoint; tried again at the next update"),
        }
    }

    fn saved(&mut self, result: Result<(), (String, MapSnapshot)>) {
        self.saving = false;
        self.last_save = Some(Instant::now());
        if let Err((error, snapshot)) = result {
            warn!(map = %self.map.spec().name, error, "checkpoint not saved; the log keeps everything, tried again");
            // What differs from what is saved is not known any more: everything may.
            let everything = (0..snapshot.states.len()).filter_map(|index| u32::try_from(index).ok()).map(StateId);
            let (_, changed) = self.unsaved.get_or_insert_with(|| (snapshot.clone(), BTreeSet::new()));
            changed.extend(everything);
        }
    }

    fn stop(mut self) {
        self.updates.fail_all("the daemon stops");
        let reason = Err(HelloError::Closing);
        for hello in self.waiting_hellos.drain(..) {
            // The client is gone if it does not want the answer.
            let _ = hello.reply.send(reason.clone());
        }
        let deleted = self.stopping.as_ref().is_some_and(|(ending, _)| *ending == Ending::MapDeleted);
        if let Some((snapshot, changed)) = self.unsaved.take().filter(|_| !deleted) {
            let states: Vec<StateId> = changed.into_iter().collect();
            if let Err(error) = self.context.store.save(self.id, &snapshot, &states) {
                warn!(map = %self.map.spec().name, %error, "checkpoint not saved; the log keeps everything");
            }
        }
        drop(self.log);
        if let Some((_, done)) = self.stopping.take() {
            // The stop was not waited for.
            let _ = done.send(());
        }
    }
}
