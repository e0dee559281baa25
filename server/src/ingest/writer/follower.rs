//! The map of a log that daemons share: events that another daemon has appended are applied, and the roles change.
//!
//! What the replica tells is done in its order. It waits, and with it what follows, while appends of this daemon are
//! not answered, and at the start of an update while the update before runs. The replica tells no more events before
//! those that it has told are applied and public, so that little waits.
//!
//! Invariant: only what is in the log is applied, so that the map stays as it is when its role changes. As a follower
//! the map takes nothing from clients and begins no update by itself.

use std::collections::VecDeque;

use tidemap_cluster::replica::ReplicaEvent;
use tidemap_map::{event::Event, name::MapName};
use tidemap_store::{AppendError, MapId};
use tokio::sync::{oneshot, watch};
use tracing::{error, info};

use super::Writer;
use crate::ingest::{
    ending::Ending,
    role::{MapRole, NotWriter},
};

/// A map whose own log has records that the shared log does not have.
#[derive(Clone, Debug, PartialEq, Eq)]
pub(crate) struct ForkedMap {
    /// Its number in the store.
    pub id: MapId,
    /// The name of the map.
    pub map: MapName,
    /// The last position that both logs have.
    pub common: u64,
}

/// Events of the log that are not all applied.
struct FollowedBatch {
    events: VecDeque<(u64, Event)>,
    applied: oneshot::Sender<()>,
}

/// The role of the daemon, and what its replica has told and is not done.
pub(super) struct Follower {
    role: watch::Sender<MapRole>,
    queue: VecDeque<ReplicaEvent>,
    batch: Option<FollowedBatch>,
    /// To be answered when the view shows what was applied.
    applied: Vec<oneshot::Sender<()>>,
    /// Where the own log and the shared one part, if they do.
    fork: Option<u64>,
}

impl Follower {
    /// `is_shared`: daemons share the log; then this one writes it only when the replica says so.
    pub(super) fn new(role: watch::Sender<MapRole>, is_shared: bool) -> Self {
        role.send_replace(MapRole::at_first(is_shared));
        Self { role, queue: VecDeque::new(), batch: None, applied: Vec::new(), fork: None }
    }

    pub(super) fn push(&mut self, event: ReplicaEvent) {
        self.queue.push_back(event);
    }

    pub(super) fn is_shared(&self) -> bool {
        self.role.borrow().is_shared()
    }

    pub(super) fn is_writing(&self) -> bool {
        self.role.borrow().is_writing()
    }

    pub(super) fn fork(&self) -> Option<u64> {
        self.fork
    }

    /// The log says who writes it from here on.
    fn name_writer(&self, writer: String) {
        if !self.is_writing() {
            self.role.send_replace(MapRole::Following { writer: Some(writer) });
        }
    }

    /// The view shows everything that was applied.
    pub(super) fn published(&mut self) {
        for applied in self.applied.drain(..) {
            // The replica may have stopped.
            let _ = applied.send(());
        }
    }
}

impl Writer {
    /// Why the map takes nothing from clients because another daemon writes it; `None`: that is not so.
    pub(super) fn not_writer(&self) -> Option<NotWriter> {
        let map = &self.map.spec().name;
        let refused = self.follower.role.borrow().not_writer(map);
        refused.or_else(|| match self.appends.failure() {
            // The log knows it before the replica has told.
            Some(AppendError::NotWriter { writer }) => Some(NotWriter { map: map.clone(), writer: writer.clone() }),
            _ => None,
        })
    }

    /// Why nobody is told how far a sequence is durable; `None`: all of the log is known here. A daemon that was cut
    /// off does not know yet that another one writes, and what that one has acknowledged.
    pub(super) fn not_current(&self) -> Option<NotWriter> {
        (!self.log.is_current()).then(|| NotWriter { map: self.map.spec().name.clone(), writer: None })
    }

    /// Does what the replica has told, as far as it can be done now.
    pub(super) fn follow(&mut self) {
        while self.stopping.is_none() && self.follow_next() {}
    }

    /// Does the next of it; gives whether that could be done.
    fn follow_next(&mut self) -> bool {
        if let Some(batch) = self.follower.batch.take() {
            return self.apply_followed(batch);
        }
        match self.follower.queue.pop_front() {
            None => return false,
            Some(ReplicaEvent::Following { writer }) => self.become_follower(writer),
            Some(waiting) if !self.appends.is_empty() => {
                self.follower.queue.push_front(waiting);
                return false;
            }
            Some(ReplicaEvent::Followed { events, applied }) => {
                self.follower.batch = Some(FollowedBatch { events: events.into(), applied });
            }
            Some(ReplicaEvent::Writing { epoch }) => self.become_writer(epoch),
            Some(ReplicaEvent::Forked { common }) => self.fork(common),
        }
        true
    }

    /// Applies events of the log up to the start of an update that has to wait; gives whether all are applied.
    fn apply_followed(&mut self, mut batch: FollowedBatch) -> bool {
        while let Some((position, event)) = batch.events.pop_front() {
            if matches!(event, Event::UpdateStart(_)) && !self.may_follow_update() {
                batch.events.push_front((position, event));
                self.follower.batch = Some(batch);
                return false;
            }
            // Without it the map is unusable, and the daemon stops.
            let Ok(work) = self.apply(position, &event) else { return false };
            self.tell_applied(&event);
            if let Some(work) = work {
                let (name, now) = (self.map.spec().name.clone(), self.context.clock.now_nanos());
                let job = self.context.jobs.create(name, work.start().cause, now);
                self.run_update(work, &job);
            }
            match event {
                Event::UpdateDone(done) => self.read_digest(done),
                Event::Epoch(epoch) => self.follower.name_writer(epoch.writer),
                _ => {}
            }
        }
        self.follower.applied.push(batch.applied);
        true
    }

    /// Another daemon writes the map. What it has in flight is answered.
    fn become_follower(&mut self, writer: Option<String>) {
        let role = MapRole::Following { writer: writer.clone() };
        if *self.follower.role.borrow() == role {
            return;
        }
        // Streams hear of what became durable before they hear of the end.
        self.publish();
        let map = &self.map.spec().name;
        info!(%map, writer = writer.as_deref().unwrap_or("unknown"), "another daemon writes the map");
        if self.follower.role.send_replace(role).is_writing() {
            metrics::counter!("tidemap_cluster_depositions_total").increment(1);
        }
        self.backlog.clear();
        self.sessions.end_all(&Ending::Moved { writer });
        // Hellos and edits that wait are answered by `pump`.
        if let Some(refused) = self.not_writer() {
            self.updates.schedule.fail_all(&refused.to_string());
        }
    }

    /// This daemon writes the map: everything in the log before is applied.
    fn become_writer(&mut self, epoch: u64) {
        info!(map = %self.map.spec().name, epoch, position = self.map.position(), "this daemon writes the map");
        self.follower.role.send_replace(MapRole::Writing { epoch });
        metrics::counter!("tidemap_cluster_takeovers_total").increment(1);
        // What was known of the end of the log is of another time.
        self.sessions.roll_back();
        self.updates.become_due_again();
    }

    /// The map holds records that the shared log does not have: it ends here.
    fn fork(&mut self, common: u64) {
        error!(
            map = %self.map.spec().name, common, position = self.map.position(),
            "the own log and the shared log differ: this daemon sets its records aside and opens the map again"
        );
        self.follower.fork = Some(common);
        self.stopping = Some((Ending::Forked { common }, oneshot::channel().0));
        self.backlog.clear();
    }
}
