//! The single writer of a map: one thread that orders batches, hands them to the log, applies what is durable,
//! publishes views and runs updates.
//!
//! Invariant: the order of the log is the order of application. An acknowledgement leaves after the view that shows
//! its observations is published. The thread never waits for a reader, a client or an update.

use std::{
    collections::{BTreeMap, VecDeque},
    panic::{AssertUnwindSafe, catch_unwind},
    sync::{Arc, mpsc},
    time::{Duration, Instant},
};

use arc_swap::ArcSwap;
use tidemap_map::{event::Event, live_map::LiveMap, snapshot::MapSnapshot, update::UpdateWork, view::MapView};
use tidemap_store::{AppendError, MapId, MapLog, Store};
use tokio::sync::{OwnedSemaphorePermit, oneshot, watch};
use tracing::{error, warn};

use super::{
    handle::MapHandle,
    protocol::{Batch, Command, Ending, Hello, HelloError, Opened, Refused, SessionEvent, SessionId, is_fatal},
    sessions::{Limits, Sessions},
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
/// A log that has grown by this much since the last checkpoint is not to grow further before the next.
const TAIL_BYTES: u64 = 256 << 20;
/// How long updates wait after the log could not take one.
const UPDATE_RETRY: Duration = Duration::from_secs(10);

mod learning;
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
    let handle = MapHandle::new(id, Arc::clone(&spec), Arc::clone(&view), commands.clone(), saturated);
    let writer = Writer {
        sessions: Sessions::new(
            spec.zone.offset_cache(),
            Limits {
                states: context.max_states,
                producers: context.max_producers,
                // A quarter of what may be pending: enough for a robot with a wrong clock, too little to matter.
                ahead: context.max_pending / 4,
            },
        ),
        updates: Updates::new(spec.name.clone(), Arc::clone(&context.jobs), context.max_pending),
        context,
        id,
        map,
        log,
        view,
        saturated: saturated_sender,
        commands,
        flights: VecDeque::new(),
        grounded: Vec::new(),
        failing: None,
        waiting_hellos: Vec::new(),
        acks: BTreeMap::new(),
        ended_jobs: Vec::new(),
        changed: false,
        running_job: None,
        updates_wait_until: None,
        unsaved: None,
        saving: false,
        last_save: None,
        stopping: None,
    };
    std::thread::Builder::new().name(format!("map-{}", id.0)).spawn(move || {
        let fatal = writer.context.fatal.clone();
        if catch_unwind(AssertUnwindSafe(|| writer.run(&inbox))).is_err() {
            // A map without a writer is no service. The log has what was acknowledged.
            drop(fatal.send("the writer of a map panicked; this is a defect of tidemap".to_owned()));
        }
    })?;
    Ok(Arc::new(handle))
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
    /// Refused by the log because of a failure whose answer is still on its way.
    grounded: Vec<Flight>,
    /// Set while appends fail, until all in flight are answered.
    failing: Option<AppendError>,
    waiting_hellos: Vec<Hello>,
    acks: BTreeMap<SessionId, PendingAck>,
    ended_jobs: Vec<EndedJob>,
    changed: bool,
    /// The update that is out.
    running_job: Option<Arc<Job>>,
    /// No update starts before, because the log could not take the last one.
    updates_wait_until: Option<Instant>,
    /// The newest snapshot that is not saved.
    unsaved: Option<MapSnapshot>,
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
        self.stop(inbox);
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
            Command::Stop { ending, done } => self.stopping = Some((ending, done)),
        }
    }

    /// After each burst of commands: publish, then tell those who wait for what is now public, then start what is due.
    fn pump(&mut self) {
        let now = self.context.clock.now_nanos();
        for (key, reached) in self.sessions.take_broken() {
            self.updates.stream_broke(key, reached);
        }
        let may_update = self.may_update();
        // Before the acknowledgements: who has one can see the update that it made due.
        if self.stopping.is_none() && self.failing.is_none() {
            self.updates.look_at_data(&self.map, &self.sessions, now);
        }
        if may_update {
            self.updates.look(&self.map, now);
        }
        self.publish();
        if self.flights.is_empty() && self.failing.take().is_some() {
            self.sessions.roll_back();
            self.log.resume();
        }
        for hello in std::mem::take(&mut self.waiting_hellos) {
            self.hello(hello);
        }
        if may_update {
            self.start_update(now);
        }
        let saturated = self.map.pending() + self.map.updating() > 2 * self.context.max_pending;
        self.saturated.send_if_modified(|known| std::mem::replace(known, saturated) != saturated);
        let tail_is_long = self.log.tail_bytes() >= TAIL_BYTES;
        if tail_is_long || self.last_save.is_none_or(|last| last.elapsed() >= SAVE_INTERVAL) {
            self.save();
        }
    }

    /// Makes public what was applied, and tells those who wait for it.
    fn publish(&mut self) {
        if std::mem::take(&mut self.changed) {
            self.view.store(Arc::new(self.map.publish()));
        }
        for (id, ack) in std::mem::take(&mut self.acks) {
            self.sessions.tell(id, SessionEvent::Ack { durable_sequence: ack.durable_sequence, refused: ack.refused });
        }
        for (job, result) in std::mem::take(&mut self.ended_jobs) {
            job.end(result);
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
        if self.stopping.is_some() {
            return;
        }
        if let Some(error) = &self.failing {
            return self.sessions.end(session, &Ending::Storage(error.clone()));
        }
        let now = self.context.clock.now_nanos();
        let Some((observations, refused)) = self.sessions.event(session, batch, &self.map, now) else { return };
        let event = Event::Observations(observations);
        self.launch(Flight::Observations { session, event, refused, _permits: permits });
    }

    /// Hands an event to the log.
    fn launch(&mut self, flight: Flight) {
        let (Flight::Observations { event, .. } | Flight::UpdateStart { event, .. }) = &flight;
        match self.append(event) {
            Ok(()) => self.flights.push_back(flight),
            // It never joined the queue: the committer owes no answer for it, and those before it wait for theirs.
            Err(error) => self.append_failed(error, flight),
        }
    }

    fn append(&self, event: &Event) -> Result<(), AppendError> {
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
        if self.failing.is_none() && error == AppendError::AfterFailure && !self.flights.is_empty() {
            // The answer that says what has failed is on its way.
            return self.grounded.push(flight);
        }
        // What became durable before this is acknowledged before the streams hear of the end.
        self.publish();
        if self.failing.is_none() {
            warn!(map = %self.map.spec().name, %error, "the log could not be written; nothing of it is acknowledged");
        }
        if is_fatal(&error) && !self.failing.as_ref().is_some_and(is_fatal) {
            self.fatal(error.to_string());
            self.failing = Some(error.clone());
        }
        // Those that fail because one before them failed are told of that one.
        let first = self.failing.get_or_insert(error).clone();
        match flight {
            Flight::Observations { session, .. } => self.sessions.failed(session, &Ending::Storage(first)),
            Flight::UpdateStart { job, .. } => {
                self.updates.failed(job.cause);
                self.updates_wait_until = Some(Instant::now() + UPDATE_RETRY);
                job.end(Err(first.to_string()));
            }
        }
        for flight in std::mem::take(&mut self.grounded) {
            self.append_failed(AppendError::AfterFailure, flight);
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

    fn stop(mut self, inbox: &mpsc::Receiver<Command>) {
        let (ending, done) = match self.stopping.take() {
            Some((ending, done)) => (ending, Some(done)),
            None => (Ending::Shutdown, None),
        };
        let reason = if ending == Ending::MapDeleted { "the map was deleted" } else { "the daemon is stopping" };
        // What came in after the stop is answered, not done.
        for command in inbox.try_iter() {
            match command {
                Command::Hello(hello) => self.waiting_hellos.push(hello),
                Command::Update { job, .. } | Command::UpdateDone { job, .. } => job.end(Err(reason.to_owned())),
                _ => {}
            }
        }
        self.sessions.end_all(&ending);
        self.updates.fail_all(reason);
        if let Some(job) = self.running_job.take() {
            job.end(Err(reason.to_owned()));
        }
        for hello in self.waiting_hellos.drain(..) {
            // The client is gone if it does not want the answer.
            let _ = hello.reply.send(Err(HelloError::Closing));
        }
        if let Some(snapshot) = self.unsaved.take().filter(|_| ending != Ending::MapDeleted)
            && let Err(error) = self.context.store.save(self.id, &snapshot)
        {
            warn!(map = %self.map.spec().name, %error, "checkpoint not saved; the log keeps everything");
        }
        if let Some(done) = done {
            // The stop was not waited for.
            let _ = done.send(());
        }
    }
}
