//! The single writer of a map: one thread that orders batches, hands them to the log, applies what is durable,
//! publishes views and runs updates.
//!
//! Invariant: the order of the log is the order of application. An acknowledgement leaves after the view that shows
//! its observations is published. The thread never waits for a reader, a client or an update.

use std::{
    collections::{BTreeMap, VecDeque},
    panic::{AssertUnwindSafe, catch_unwind},
    sync::{Arc, atomic::AtomicU64, mpsc},
    time::{Duration, Instant},
};

use arc_swap::ArcSwap;
use tidemap_map::{
    history::HistoryPiece,
    live_map::{LiveMap, PendingLimits},
    snapshot::MapSnapshot,
    update::UpdateWork,
    view::MapView,
};
use tidemap_store::{AppendError, MapId, MapLog, Store};
use tokio::sync::{oneshot, watch};
use tracing::warn;

use super::{
    handle::MapHandle,
    protocol::{Command, Ending, Hello, HelloError, Opened, Recall, SavedGrid, SessionEvent, SessionId},
    sessions::{Limits, Sessions},
    updates::{Updates, Wanted},
    watching::Watchers,
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
/// How long updates wait after the log could not take one.
const UPDATE_RETRY: Duration = Duration::from_secs(10);

mod flights;
mod learning;
mod queue;
mod recall;
mod saving;
mod site;
mod states;
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
    pub max_pending: PendingLimits,
    /// Most tiles of a map.
    pub max_tiles: usize,
    /// Memory for what is learned of a map's tiles, in bytes.
    pub tile_cache_bytes: u64,
    /// Work of an update of a grid before it notes what it has done.
    pub update_journal_min_work: u64,
}

/// Starts the writer of a map that was restored. `unsaved`: what an update that was run for that has left to be saved.
/// `begun`: an update that the log has begun, and that may have been cut off.
///
/// # Errors
/// The thread cannot be started.
pub fn start(
    context: Context,
    id: MapId,
    map: LiveMap,
    log: MapLog,
    unsaved: Option<MapSnapshot>,
    begun: Option<UpdateWork>,
) -> std::io::Result<Arc<MapHandle>> {
    let (mut writer, inbox, handle) = build(context, id, map, log, unsaved);
    begun.into_iter().for_each(|work| writer.repeat_update(work));
    std::thread::Builder::new().name(format!("map-{}", id.0)).spawn(move || {
        let fatal = writer.context.fatal.clone();
        if catch_unwind(AssertUnwindSafe(|| writer.run(&inbox))).is_err() {
            // A map without a writer is no service. The log has what was acknowledged.
            drop(fatal.send("the writer of a map panicked; this is a defect of tidemap".to_owned()));
        }
    })?;
    Ok(Arc::new(handle))
}

/// A writer that does not run yet, where its commands come from, and its handle.
fn build(
    context: Context,
    id: MapId,
    mut map: LiveMap,
    log: MapLog,
    unsaved: Option<MapSnapshot>,
) -> (Writer, mpsc::Receiver<Command>, MapHandle) {
    let spec = Arc::clone(map.spec());
    let (commands, inbox) = mpsc::channel();
    let (saturated_sender, saturated) = watch::channel(false);
    let view = Arc::new(ArcSwap::from_pointee(map.publish()));
    let tile_bytes = Arc::new(AtomicU64::new(map.tile_memory().bytes));
    let handle =
        MapHandle::new(id, Arc::clone(&spec), Arc::clone(&view), commands.clone(), saturated, Arc::clone(&tile_bytes));
    let mut writer = Writer {
        sessions: Sessions::new(
            spec.zone.offset_cache(),
            Limits {
                states: context.max_states,
                producers: context.max_producers,
                // A quarter of what may be pending: enough for a robot with a wrong clock, too little to matter.
                ahead: context.max_pending.observations / 4,
                tiles: context.max_tiles,
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
        deferred: VecDeque::new(),
        flights: VecDeque::new(),
        flight_bytes: 0,
        flight_bytes_max: queue::FLIGHT_BYTES,
        grounded: Vec::new(),
        failing: None,
        waiting_hellos: Vec::new(),
        adds: states::Adds::default(),
        edits: site::Edits::default(),
        acks: BTreeMap::new(),
        ended_jobs: Vec::new(),
        changed: false,
        running_job: None,
        updates_wait_until: None,
        unsaved,
        unsaved_history: Vec::new(),
        saving_history: Vec::new(),
        waiting_recalls: Vec::new(),
        updating_times: None,
        saved_grid: None,
        tile_bytes,
        watchers: Watchers::default(),
        history_bytes: 0,
        saving: false,
        last_save: None,
        save_failures: 0,
        stopping: None,
    };
    writer.count_history();
    (writer, inbox, handle)
}

use flights::{Flight, PendingAck};
use queue::Deferred;

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
    /// What streams have handed over and is not taken yet.
    deferred: VecDeque<Deferred>,
    flights: VecDeque<Flight>,
    /// Memory of the scans among them, about, and above which no more are taken.
    flight_bytes: usize,
    flight_bytes_max: usize,
    /// Refused by the log because of a failure whose answer is still on its way.
    grounded: Vec<Flight>,
    /// Set while appends fail, until all in flight are answered.
    failing: Option<AppendError>,
    waiting_hellos: Vec<Hello>,
    adds: states::Adds,
    edits: site::Edits,
    acks: BTreeMap<SessionId, PendingAck>,
    ended_jobs: Vec<EndedJob>,
    changed: bool,
    /// The update that is out.
    running_job: Option<Arc<Job>>,
    /// No update starts before, because the log could not take the last one.
    updates_wait_until: Option<Instant>,
    /// The newest snapshot that is not saved, with all history that is not saved either.
    unsaved: Option<MapSnapshot>,
    /// History of snapshots that were dropped before they were saved; the next one takes it along.
    unsaved_history: Vec<Arc<HistoryPiece>>,
    /// History that a running save keeps.
    saving_history: Vec<Arc<HistoryPiece>>,
    /// Questions about what the running update has.
    waiting_recalls: Vec<Recall>,
    /// Least time of the observations that the running update has, and its cut.
    updating_times: Option<(i64, i64)>,
    /// What was saved while an update had the tiles.
    saved_grid: SavedGrid,
    /// What models and sums of tiles take in memory, for others to read.
    tile_bytes: Arc<AtomicU64>,
    watchers: Watchers,
    /// Memory of the history that no save has kept, about.
    history_bytes: usize,
    saving: bool,
    last_save: Option<Instant>,
    /// Saves that have failed since the last that did not.
    save_failures: u32,
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
            Command::Batch { session, batch, budget } => self.defer(Deferred::Batch(session, batch, budget)),
            Command::Scans { session, batch, budget } => self.defer(Deferred::Scans(session, batch, budget)),
            Command::Traversals { session, batch, budget } => {
                self.defer(Deferred::Traversals(session, batch, budget));
            }
            Command::Leave { session, clean } => self.defer(Deferred::Leave(session, clean)),
            Command::Update { until_nanos, cause, job } => self.updates.push(Wanted { until_nanos, cause, job }),
            Command::Committed(result) => self.committed(result),
            Command::UpdateDone { job, result } => self.update_done(&job, result),
            Command::Saved(result) => self.saved(result),
            Command::AddState(add) => self.add_state(add),
            Command::EditSite(edit) => self.edit_site(edit),
            Command::Recall(recall) => self.recall(recall),
            // Who asked may have gone away.
            Command::Watch(reply) => drop(reply.send(self.watchers.listen())),
            Command::Stop { ending, done } => {
                self.stopping = Some((ending, done));
                // Not acknowledged: the streams end, and their producers have it.
                self.deferred.clear();
            }
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
        for recall in std::mem::take(&mut self.waiting_recalls) {
            self.recall(recall);
        }
        self.go_on_adding();
        self.go_on_editing();
        if may_update {
            self.start_update(now);
        }
        // Before it takes more: an update that is due makes room, and so do appends and a running update.
        let is_idle = may_update && self.flights.is_empty() && !self.map.is_updating() && !self.updates.is_waited_for();
        self.take_deferred(is_idle);
        let saturated =
            self.map.crowding(self.context.max_pending, true) > queue::CROWDING_MAX || self.is_history_too_large();
        self.saturated.send_if_modified(|known| std::mem::replace(known, saturated) != saturated);
        // At a stop the last save follows by itself.
        if self.stopping.is_none() && !self.is_update_starting() && self.is_save_due() {
            self.save();
        }
    }

    /// Makes public what was applied, and tells those who wait for it.
    fn publish(&mut self) {
        if std::mem::take(&mut self.changed) {
            self.view.store(Arc::new(self.map.publish()));
        }
        self.watchers.tell(&self.view.load());
        self.tell_added();
        self.tell_edited();
        for (id, ack) in std::mem::take(&mut self.acks) {
            self.sessions.tell(id, SessionEvent::Ack { durable_sequence: ack.durable_sequence, refused: ack.refused });
        }
        for (job, result) in std::mem::take(&mut self.ended_jobs) {
            job.end(result);
        }
    }

    fn hello(&mut self, hello: Hello) {
        if hello.reply.is_closed() {
            return;
        }
        let answer = if self.stopping.is_some() {
            Err(HelloError::Closing)
        } else if let Some(error) = &self.failing {
            Err(HelloError::Storage(error.clone()))
        } else if hello.incarnation == 0 && self.defers_end_of(&hello) {
            return self.waiting_hellos.push(hello);
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
        self.watchers.end(ending.clone());
        self.updates.fail_all(reason);
        if let Some(job) = self.running_job.take() {
            job.end(Err(reason.to_owned()));
        }
        for hello in self.waiting_hellos.drain(..) {
            // The client is gone if it does not want the answer.
            let _ = hello.reply.send(Err(HelloError::Closing));
        }
        // History whose snapshot was dropped belongs to an update that is given up: the log gives both back.
        if let Some(snapshot) = self.unsaved.take().filter(|_| ending != Ending::MapDeleted)
            && let Err(error) = self.context.store.save(self.id, &snapshot)
        {
            warn!(map = %self.map.spec().name, %error, "checkpoint not saved; the log keeps everything");
        }
        // The store too is let go of before who waits for the stop goes on.
        drop(self);
        if let Some(done) = done {
            // The stop was not waited for.
            let _ = done.send(());
        }
    }
}
