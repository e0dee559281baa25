//! Maps with a shared log, as the tests of roles and followers start them.

use std::sync::Mutex;

use tidemap_cluster::replica::{ReplicaEvent, ReplicaListener};
use tidemap_map::event::{Epoch, Event};
use tidemap_store::{AppendError, Done};

use super::*;
use crate::{catalog::restore_map, digests::DigestStatus, update_turns::UpdateTurn};

/// The thread of a map with a shared log, on a store of its own.
pub(super) struct Replica {
    pub(super) context: Context,
    pub(super) clock: Arc<SetClock>,
    pub(super) id: MapId,
    pub(super) handle: Arc<MapHandle>,
    pub(super) forks: events::UnboundedReceiver<ForkedMap>,
    pub(super) fatal: events::UnboundedReceiver<String>,
    log: Arc<dyn EventLog>,
    listener: ReplicaListener,
}

impl Replica {
    /// Opens the store of a folder, and its map, which is created where there is none. `log` replaces the map's own
    /// log.
    pub(super) fn open(dir: &Path, spec: &MapSpec, log: Option<Arc<dyn EventLog>>) -> Self {
        Self::open_with(dir, spec, log, |_| {})
    }

    pub(super) fn open_with(
        dir: &Path,
        spec: &MapSpec,
        log: Option<Arc<dyn EventLog>>,
        change: impl FnOnce(&mut Context),
    ) -> Self {
        let (mut context, clock) = context(dir, NOON);
        change(&mut context);
        let (forks_sender, forks) = events::unbounded_channel();
        let (fatal_sender, fatal) = events::unbounded_channel();
        (context.forks, context.fatal) = (forks_sender, fatal_sender);
        let known = context.store.maps().first().map(|(id, _)| *id);
        let id = known.unwrap_or_else(|| context.store.create_map(spec).expect("created"));
        let mut restored = restore_map(&context, id, &Arc::new(spec.clone()), &|_, _| true).expect("restored");
        restored.is_shared = true;
        restored.log = log.unwrap_or(restored.log);
        let log = Arc::clone(&restored.log);
        let handle = start(context.clone(), id, restored).expect("a thread");
        let notified = Arc::clone(&handle);
        let listener: ReplicaListener = Arc::new(move |event| {
            notified.send(Command::Replica(event));
        });
        Self { context, clock, id, handle, forks, fatal, log, listener }
    }

    /// Stops the map, which saves its unsaved data, and closes the store.
    pub(super) async fn stop(self) {
        self.handle.stop(Ending::Shutdown).await;
        self.context.store.close();
    }

    pub(super) fn write(&self, epoch: u64) {
        (self.listener)(ReplicaEvent::Writing { epoch });
    }

    /// Does the same as [`Self::write`], with the record of the epoch in the log.
    pub(super) async fn take_over(&self, epoch: u64) {
        let event = Event::Epoch(Epoch { epoch, writer: "a".to_owned(), version: "1".to_owned(), maths: 1 });
        let (done, position) = oneshot::channel();
        self.log.append(&event, Box::new(move |result| drop(done.send(result)))).expect("queued");
        let position = position.await.expect("an answer").expect("in the log");
        self.send_events(vec![(position, event)]).await.expect("applied");
        self.write(epoch);
    }

    pub(super) fn follow(&self, writer: &str) {
        (self.listener)(ReplicaEvent::Following { writer: Some(writer.to_owned()) });
    }

    pub(super) fn fork(&self, common: u64) {
        (self.listener)(ReplicaEvent::Forked { common });
    }

    /// Sends events of the log; returns the receiver that is notified when they are applied.
    pub(super) fn send_events(&self, events: Vec<(u64, Event)>) -> oneshot::Receiver<()> {
        let (applied, answer) = oneshot::channel();
        (self.listener)(ReplicaEvent::Followed { events, applied });
        answer
    }

    /// Requests an update; returns its job.
    pub(super) fn update(&self) -> Arc<UpdateJob> {
        let job = self.context.jobs.create(self.handle.spec.name.clone(), UpdateCause::Request, NOON);
        let command = Command::Update { until_nanos: None, cause: UpdateCause::Request, job: Arc::clone(&job) };
        assert!(self.handle.send(command));
        job
    }

    /// Waits until the digest of a generation is known.
    pub(super) async fn digest(&self, generation: u64) -> DigestStatus {
        for _ in 0..6_000 {
            match self.handle.digest() {
                Some(status) if status.generation == generation => return status,
                _ => tokio::time::sleep(Duration::from_millis(5)).await,
            }
        }
        panic!("no digest of generation {generation}: {:?}", self.handle.digest());
    }

    /// Waits until the view shows an event of the log.
    pub(super) async fn reaches(&self, position: u64) {
        for _ in 0..6_000 {
            if self.handle.position() >= position {
                return;
            }
            tokio::time::sleep(Duration::from_millis(5)).await;
        }
        panic!("the view shows {} events, not {position}", self.handle.position());
    }

    /// The durable sequence numbers of the producers.
    pub(super) async fn marks(&self) -> Vec<ProducerMark> {
        let (reply, answer) = oneshot::channel();
        assert!(self.handle.send(Command::ListProducers(reply)));
        answer.await.expect("an answer").into_iter().map(|known| known.mark).collect()
    }
}

/// Keeps the turn of updates until the result is dropped.
pub(super) fn keep_busy(context: &Context) -> UpdateTurn {
    context.update_turns.begin()
}

/// Waits until the digest of a generation is compared.
pub(super) async fn compared(replica: &Replica, generation: u64, is_equal: bool) {
    for _ in 0..6_000 {
        let status = replica.digest(generation).await;
        if status.is_equal.is_some() {
            return assert_eq!(status.is_equal, Some(is_equal));
        }
        tokio::time::sleep(Duration::from_millis(5)).await;
    }
    panic!("generation {generation} is not compared");
}

/// A shared log in memory: it can hold appends back, and refuse them for another writer.
#[derive(Default)]
pub(super) struct SharedMemory {
    state: Mutex<MemoryState>,
}

#[derive(Default)]
struct MemoryState {
    events: Vec<Event>,
    holds: bool,
    held: Vec<(Event, Done)>,
    writer: Option<String>,
    is_stale: bool,
}

impl SharedMemory {
    /// Whether another daemon may be writing.
    pub(super) fn set_stale(&self, is_stale: bool) {
        self.state.lock().expect("not poisoned").is_stale = is_stale;
    }

    /// All events, by position.
    pub(super) fn events(&self) -> Vec<(u64, Event)> {
        (1..).zip(self.state.lock().expect("not poisoned").events.iter().cloned()).collect()
    }

    /// From now on appends are not completed.
    pub(super) fn hold(&self) {
        self.state.lock().expect("not poisoned").holds = true;
    }

    /// Waits until `count` appends are not completed.
    pub(super) async fn holds(&self, count: usize) {
        for _ in 0..6_000 {
            if self.state.lock().expect("not poisoned").held.len() == count {
                return;
            }
            tokio::time::sleep(Duration::from_millis(5)).await;
        }
        panic!("{count} appends are not on their way");
    }

    /// Another daemon writes: appends in flight fail, and so do later ones.
    pub(super) fn depose(&self, writer: &str) {
        let held = {
            let mut state = self.state.lock().expect("not poisoned");
            (state.writer, state.holds) = (Some(writer.to_owned()), false);
            std::mem::take(&mut state.held)
        };
        for (_, done) in held {
            done(Err(AppendError::NotWriter { writer: Some(writer.to_owned()) }));
        }
    }

    /// The other daemon appends; returns the events with their positions.
    pub(super) fn append_elsewhere(&self, events: Vec<Event>) -> Vec<(u64, Event)> {
        let mut state = self.state.lock().expect("not poisoned");
        let first = state.events.len() as u64 + 1;
        state.events.extend(events.iter().cloned());
        (first..).zip(events).collect()
    }

    /// This daemon writes again.
    pub(super) fn reinstate(&self) {
        self.state.lock().expect("not poisoned").writer = None;
    }

    /// Waits until the log has `count` events; returns them.
    pub(super) async fn grown(&self, count: usize) -> Vec<(u64, Event)> {
        for _ in 0..6_000 {
            let events = self.events();
            if events.len() >= count {
                return events;
            }
            tokio::time::sleep(Duration::from_millis(5)).await;
        }
        panic!("the log has not {count} events: {:?}", self.events());
    }
}

impl EventLog for SharedMemory {
    fn append(&self, event: &Event, done: Done) -> Result<(), AppendError> {
        let mut state = self.state.lock().expect("not poisoned");
        if let Some(writer) = &state.writer {
            return Err(AppendError::NotWriter { writer: Some(writer.clone()) });
        }
        if state.holds {
            state.held.push((event.clone(), done));
            return Ok(());
        }
        state.events.push(event.clone());
        done(Ok(state.events.len() as u64));
        Ok(())
    }

    fn resume(&self) {}

    fn end(&self) -> u64 {
        self.state.lock().expect("not poisoned").events.len() as u64
    }

    fn tail_bytes(&self) -> u64 {
        0
    }

    fn is_current(&self) -> bool {
        !self.state.lock().expect("not poisoned").is_stale
    }
}
