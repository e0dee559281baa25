//! The single writer of a map: one thread that orders batches, hands them to the log, applies durable events, publishes
//! views and runs updates. It is plain blocking code without locks, and a slow map does not delay another one.
//!
//! ```text
//! stream ─▶ Backlog ─▶ Sessions: an event ─▶ Appends ─▶ log, fsync ─▶ apply ─▶ publish ─▶ acknowledge
//!                                              UpdateSchedule ─▶ Updates ─▶ publish ─▶ Saves
//! ```
//!
//! - [`appends`]: events in flight, and their failures. [`backlog`]: the handovers that wait for room. [`edits`]:
//!   states and site edits of clients. [`update_run`]: updates. [`saves`]: snapshots, and the history that is not
//!   stored. [`follower`]: a shared log, which this daemon writes or follows. [`update_ends`]: the results of updates
//!   in a shared log.
//! - **The writer takes only data for which it has room.** Handovers wait in the backlog, with their buffer budgets,
//!   while too much is in flight or pending. Commands that make room never wait behind handovers.
//! - **Observations with a time in the future wait apart** (more than 5 minutes after the clock when they are
//!   received). They make no update due, and at most a quarter of the pending limit may wait. They join the others at
//!   the first update whose cut has passed their time. The last value does not show them before.
//! - **Updates run beside the thread**, and the map serves the previous generation meanwhile. Early updates, above
//!   `max_pending_observations`, free memory.
//!
//! Invariant: the order of the log is the order of application. An acknowledgement is sent after the view that shows
//! its observations is published. The thread never waits for a reader, a client or an update. The steps of
//! [`Writer::pump`] have a fixed order.

use std::{
    collections::BTreeMap,
    panic::{AssertUnwindSafe, catch_unwind},
    sync::{Arc, atomic::Ordering, mpsc},
    time::Duration,
};

use arc_swap::ArcSwap;
use tidemap_base::clock::Clock;
use tidemap_map::{
    event::UpdateDone,
    ids::ProducerId,
    live_map::{LiveMap, PendingLimits},
    snapshot::{MapSnapshot, ProducerMark},
    update::UpdateWork,
    view::MapView,
};
use tidemap_store::{EventLog, MapId, Store};
use tokio::sync::{oneshot, watch};
use tracing::warn;

#[cfg(test)]
use super::handle::MapHandle;
use super::{
    anomaly_feed::AnomalyFeed,
    ending::Ending,
    handle::{OpenProgress, Shown, WriterEndpoints},
    protocol::{Command, Hello, HelloError, KnownProducer, RefusedObservation, SessionEvent, SessionId, Welcome},
    sessions::{SessionLimits, Sessions},
    update_schedule::{DueUpdate, UpdateSchedule},
    update_turns::UpdateTurns,
};
use crate::{cluster::Cluster, jobs::Jobs};

/// Longest time between two reads of the clock by the writer.
const TICK: Duration = Duration::from_secs(1);
/// Maximum number of commands handled between two publications.
const BURST: usize = 512;
mod appends;
mod backlog;
mod edits;
mod follower;
mod saves;
#[cfg(test)]
mod tests;
mod update_ends;
mod update_run;

use appends::Appends;
use backlog::{Backlog, PENDING_LOAD_MAX};
use edits::Edits;
use follower::Follower;
pub use follower::ForkedMap;
use saves::{Saves, checkpoint_span};
use update_ends::UpdateEnds;
pub use update_run::UpdateFailed;
use update_run::Updates;

/// The resources of the daemon that a writer uses.
#[derive(Clone, Debug)]
pub struct Context {
    /// The store of the daemon.
    pub store: Arc<Store>,
    /// The updates that wait, run or have ended.
    pub jobs: Arc<Jobs>,
    /// The clock.
    pub clock: Arc<dyn Clock>,
    /// The turns of updates.
    pub update_turns: Arc<UpdateTurns>,
    /// Receives a message when storage has failed for good.
    pub fatal: tokio::sync::mpsc::UnboundedSender<String>,
    /// Receives the maps whose own log differs from the shared log, when their writers have stopped.
    pub forks: tokio::sync::mpsc::UnboundedSender<ForkedMap>,
    /// The cluster of which the daemon is a member, if there is one.
    pub cluster: Option<Cluster>,
    /// Maximum number of states of a map.
    pub max_states: usize,
    /// Maximum number of producer keys of a map.
    pub max_producers: usize,
    /// Maximum number of producer keys of a map that one client has introduced.
    pub max_producers_of_client: usize,
    /// Number of pending observations above which an update runs early.
    pub max_pending: PendingLimits,
    /// Maximum number of readings that the rows of an update represent. It equals the constant of the same name, except
    /// in tests. All daemons of a cluster must have the same value.
    pub update_readings_max: u64,
    /// Whether the local midnight of the clock makes an update due.
    pub update_at_midnight: bool,
    /// Maximum number of tiles of a map.
    pub max_tiles: usize,
    /// Memory for the learned models of a map's tiles, in bytes.
    pub tile_cache_bytes: u64,
}

impl Context {
    /// The identity to which producers send: that of the cluster, or that of the store if the daemon is alone.
    pub fn identity(&self) -> &str {
        self.cluster.as_ref().map_or_else(|| self.store.store_id(), Cluster::id)
    }
}

/// A map that is restored from its checkpoint and its log.
pub struct RestoredMap {
    /// The map.
    pub map: LiveMap,
    /// The log to which the writer appends.
    pub log: Arc<dyn EventLog>,
    /// Whether the log is shared. Then the writer follows it until it is ordered to write.
    pub is_shared: bool,
    /// The result of the last update in the log, if the log contains it.
    pub logged: Option<UpdateDone>,
    /// The unsaved result of updates that were repeated during the start.
    pub unsaved: Option<MapSnapshot>,
    /// An update that the log has begun, and that may have been cut off.
    pub begun: Option<UpdateWork>,
}

/// Starts the writer of a restored map, with a handle of its own.
#[cfg(test)]
pub fn start(context: Context, id: MapId, mut restored: RestoredMap) -> std::io::Result<Arc<MapHandle>> {
    let (spec, view) = (Arc::clone(restored.map.spec()), restored.map.publish());
    let (handle, endpoints) = MapHandle::with_endpoints((id, None), spec, view, &context.clock);
    start_in(endpoints, context, id, restored)?;
    Ok(Arc::new(handle))
}

/// Starts the writer of a restored map behind existing endpoints. From then on the map is open.
///
/// # Errors
/// The thread cannot be started.
pub fn start_in(endpoints: WriterEndpoints, context: Context, id: MapId, restored: RestoredMap) -> std::io::Result<()> {
    let (writer, inbox) = build(endpoints, context, id, restored);
    std::thread::Builder::new().name(format!("map-{}", id.0)).spawn(move || {
        let fatal = writer.context.fatal.clone();
        if catch_unwind(AssertUnwindSafe(|| writer.run(&inbox))).is_err() {
            // Without its writer a map is not served. The log has all acknowledged observations.
            drop(fatal.send("the writer of a map panicked; this is a defect of tidemap".to_owned()));
        }
    })?;
    Ok(())
}

/// A writer that does not run yet, and the receiver of its commands. The map is open when this returns, and an update
/// that the log has begun runs.
fn build(
    endpoints: WriterEndpoints,
    context: Context,
    id: MapId,
    restored: RestoredMap,
) -> (Writer, mpsc::Receiver<Command>) {
    let RestoredMap { mut map, log, is_shared, logged, unsaved, begun } = restored;
    let spec = Arc::clone(map.spec());
    let WriterEndpoints { view, commands, inbox, saturated, tile_bytes, opening, role, digest, shown } = endpoints;
    tile_bytes.store(map.tile_memory().bytes, Ordering::Relaxed);
    // The view comes first: clients that have waited for the map see all acknowledged observations.
    view.store(Arc::new(map.publish()));
    shown.send_replace(Shown::of(&view.load()));
    let follower = Follower::new(role, is_shared);
    opening.send_replace(OpenProgress::Open);
    let limits = SessionLimits {
        states: context.max_states,
        producers: context.max_producers,
        producers_of_client: context.max_producers_of_client,
        // A quarter of the pending limit: enough for a robot with a wrong clock, too little to do harm.
        ahead: context.max_pending.observations / 4,
        tiles: context.max_tiles,
    };
    let schedule = UpdateSchedule::new(
        spec.name.clone(),
        Arc::clone(&context.jobs),
        context.max_pending,
        context.update_at_midnight,
    );
    let mut writer = Writer {
        sessions: Sessions::new(spec.zone.offset_cache(), limits),
        context,
        id,
        map,
        log,
        view,
        shown,
        saturated,
        commands,
        appends: Appends::default(),
        backlog: Backlog::default(),
        edits: Edits::default(),
        saves: Saves::new(unsaved, tile_bytes),
        updates: Updates::new(schedule),
        ends: UpdateEnds::new(logged, digest),
        follower,
        feed: AnomalyFeed::default(),
        acks: BTreeMap::new(),
        changed: false,
        stopping: None,
    };
    begun.into_iter().for_each(|work| writer.repeat_update(work));
    (writer, inbox)
}

/// The acknowledgement that a stream gets with the next view.
#[derive(Default)]
struct PendingAck {
    durable_sequence: u64,
    refused: Vec<RefusedObservation>,
}

struct Writer {
    context: Context,
    id: MapId,
    map: LiveMap,
    log: Arc<dyn EventLog>,
    view: Arc<ArcSwap<MapView>>,
    shown: watch::Sender<Shown>,
    saturated: watch::Sender<bool>,
    commands: mpsc::Sender<Command>,
    sessions: Sessions,
    appends: Appends,
    backlog: Backlog,
    edits: Edits,
    saves: Saves,
    updates: Updates,
    ends: UpdateEnds,
    follower: Follower,
    feed: AnomalyFeed,
    acks: BTreeMap<SessionId, PendingAck>,
    /// Whether the map has changed since the view was published.
    changed: bool,
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
            if self.stopping.is_some() && self.appends.is_empty() && !self.saves.is_saving() && !self.must_finish() {
                break;
            }
        }
        self.stop(inbox);
    }

    /// Whether an update must end before the writer stops. An update that goes on after an erasure would write among
    /// the new files. The same holds where the map is opened again without a part of its log, or from a copy.
    fn must_finish(&self) -> bool {
        let opens_again =
            matches!(self.stopping, Some((Ending::Erasure | Ending::Forked { .. } | Ending::Replaced, _)));
        opens_again && self.updates.is_running()
    }

    fn handle(&mut self, command: Command) {
        match command {
            Command::Hello(hello) => self.hello(hello),
            Command::StreamData { session, data } => self.hand_over(session, data),
            Command::Update { until_nanos, cause, job } => match self.not_writer() {
                Some(refused) => job.end(Err(refused.to_string())),
                None => self.updates.schedule.push(DueUpdate { until_nanos, cause, job }),
            },
            Command::Committed(result) => self.committed(result),
            Command::UpdateDone { job, result } => self.update_done(&job, result),
            Command::Digested { generation, digest } => self.digested(generation, digest),
            Command::Replica(event) => {
                self.follower.push(event);
                self.follow();
            }
            Command::Saved(result) => self.saved(result),
            Command::AddState(add) => self.add_state(add),
            Command::EditSite(edit) => self.edit_site(edit),
            Command::ForgetProducers(forget) => self.forget_producers(forget),
            Command::ReadHistory(read) => self.read_history(read),
            Command::ReadPending(read) => self.read_pending(read),
            // The clients may have gone away.
            Command::ListProducers(reply) => drop(reply.send(self.known_producers())),
            Command::Watch(reply) => drop(reply.send(self.feed.listen())),
            Command::WatchCells(reply) => {
                // A watcher needs the view from just before the first scans that it receives.
                self.publish();
                drop(reply.send(self.feed.listen_to_cells(self.view.load_full())));
            }
            Command::Stop { ending, done } => {
                self.stopping = Some((ending, done));
                // These handovers are not acknowledged: the streams end, and their producers still have the data.
                self.backlog.clear();
            }
        }
    }

    fn known_producers(&self) -> Vec<KnownProducer> {
        let known = |(id, mark): (ProducerId, &ProducerMark)| KnownProducer {
            id,
            mark: mark.clone(),
            is_connected: self.sessions.is_open(&mark.key),
        };
        let marks = (0..).map(ProducerId).zip(self.map.producer_marks());
        let mut producers: Vec<KnownProducer> = marks.map(known).collect();
        producers.sort_by(|a, b| a.mark.key.cmp(&b.mark.key));
        producers
    }

    /// Runs after each burst of commands: publishes, replies to requests whose results are now public, and starts what
    /// is due. The order of the steps matters; the comment on each step gives the steps that must come before it.
    fn pump(&mut self) {
        let now = self.context.clock.now_nanos();
        // First: events of the log that waited for an update or a completion. `publish` shows and acknowledges them.
        self.follow();
        for (key, reached) in self.sessions.take_broken() {
            self.updates.schedule.stream_broke(key, reached);
        }
        // Due updates are determined before `publish` sends acknowledgements: a producer with an acknowledgement sees
        // the update that its observations made due.
        let may_update = self.may_update();
        if self.stopping.is_none() && self.appends.failure().is_none() && self.follower.is_writing() {
            self.updates.schedule.check_data(&self.map, &self.sessions, now);
        }
        if may_update {
            self.updates.schedule.check(&self.map, now);
        }
        self.publish();
        // After `publish`, so that the streams of a failure first receive the acknowledgement of what became durable;
        // before any new append, because the log accepts nothing until it resumes.
        if self.appends.end_failure() {
            self.sessions.roll_back();
            self.log.resume();
        }
        for hello in self.backlog.take_hellos() {
            self.hello(hello);
        }
        for read in self.backlog.take_history_reads() {
            self.read_history(read);
        }
        self.continue_adding();
        self.continue_editing();
        // Before `start_update`: the end of an update is in the log before the start of the next.
        if self.stopping.is_none() && self.appends.failure().is_none() {
            self.log_update_end();
        }
        // Before the backlog: an update makes room, so a due update goes first. This also holds for appends and for a
        // running update.
        if may_update {
            self.start_update(now);
        }
        let is_idle =
            may_update && self.appends.is_empty() && !self.map.is_updating() && !self.updates.schedule.is_waited_for();
        self.drain_backlog(is_idle);
        // After the backlog, which adds to the load.
        let saturated = self.pending_load() > PENDING_LOAD_MAX || self.saves.is_history_too_large();
        self.saturated.send_if_modified(|known| std::mem::replace(known, saturated) != saturated);
        // After `start_update`, which may have put the start of an update in flight. A stop saves by itself.
        if self.stopping.is_none() && !self.appends.is_update_starting() && self.is_save_due() {
            self.save();
        }
    }

    /// Publishes the applied changes, then replies to the requests that wait for them.
    fn publish(&mut self) {
        if std::mem::take(&mut self.changed) {
            self.view.store(Arc::new(self.map.publish()));
            self.shown.send_replace(Shown::of(&self.view.load()));
        }
        self.feed.send_waiting(&self.view.load());
        self.edits.published();
        for (id, ack) in std::mem::take(&mut self.acks) {
            self.sessions
                .notify(id, SessionEvent::Ack { durable_sequence: ack.durable_sequence, refused: ack.refused });
        }
        self.updates.published();
        self.follower.published();
    }

    fn hello(&mut self, hello: Hello) {
        if hello.reply.is_closed() {
            return;
        }
        let answer = if self.stopping.is_some() {
            Err(HelloError::Closing)
        } else if let Some(refused) = self.not_writer().or_else(|| self.not_current()) {
            Err(refused.into())
        } else if let Some(error) = self.appends.failure() {
            Err(HelloError::Storage(error.clone()))
        } else if hello.incarnation == 0
            && self.sessions.open_of(&hello.key).is_some_and(|open| self.backlog.has_end(open))
        {
            return self.backlog.wait_hello(hello);
        } else {
            match self.sessions.open(&hello, &self.map) {
                Ok(Some(opened)) => Ok(opened),
                Ok(None) => return self.backlog.wait_hello(hello),
                Err(error) => Err(error),
            }
        };
        let opened: Option<Welcome> = answer.as_ref().ok().cloned();
        if opened.is_some() {
            self.updates.schedule.stream_settled(&hello.key);
        }
        if hello.reply.send(answer).is_err() {
            // The client went away while it waited.
            if let Some(opened) = opened {
                self.sessions.leave(opened.session);
            }
        }
    }

    fn stop(mut self, inbox: &mpsc::Receiver<Command>) {
        let (ending, done) = match self.stopping.take() {
            Some((ending, done)) => (ending, Some(done)),
            None => (Ending::Shutdown, None),
        };
        let reason = match ending {
            Ending::MapDeleted => "the map was deleted",
            Ending::Erasure => "something is erased from the map: start the update again",
            Ending::Forked { .. } => "the log of the map and the shared log differ",
            Ending::Replaced => "a copy of another daemon's map replaces the map",
            _ => "the daemon is stopping",
        };
        // Commands after the stop get a reply, but are not executed.
        for command in inbox.try_iter() {
            match command {
                Command::Hello(hello) => self.backlog.wait_hello(hello),
                Command::Update { job, .. } | Command::UpdateDone { job, .. } => job.end(Err(reason.to_owned())),
                _ => {}
            }
        }
        self.sessions.end_all(&ending);
        self.feed.end(ending.clone());
        self.updates.fail_all(reason);
        for hello in self.backlog.take_hellos() {
            // The client may be gone.
            let _ = hello.reply.send(Err(HelloError::Closing));
        }
        // History without its snapshot belongs to an update that is abandoned: the log has both.
        let fork = self.follower.fork();
        // Data that the shared log does not have is not saved either.
        let may_save = |snapshot: &MapSnapshot| {
            ending != Ending::MapDeleted && fork.is_none_or(|common| snapshot.position <= common)
        };
        if let Some(snapshot) = self.saves.take_unsaved().filter(may_save) {
            let span = checkpoint_span(&self.map.spec().name, &snapshot);
            if let Err(error) = self.context.store.save(self.id, &snapshot) {
                span.fail("not saved: the log has the reason");
                warn!(map = %self.map.spec().name, %error, "checkpoint not saved: the log has everything");
            }
        }
        let forked = fork.map(|common| ForkedMap { id: self.id, map: self.map.spec().name.clone(), common });
        let forks = self.context.forks.clone();
        // The store is also released before the caller of the stop continues.
        drop(self);
        if let Some(forked) = forked {
            // If nobody listens, the daemon is stopping.
            let _ = forks.send(forked);
        }
        if let Some(done) = done {
            // The caller may not wait.
            let _ = done.send(());
        }
    }
}
