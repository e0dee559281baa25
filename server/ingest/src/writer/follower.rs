//! The map of a shared log: events that another daemon has appended are applied, and the roles change.
//!
//! The events of the replica are processed in their order. An event waits, and the events behind it wait, while appends
//! of this daemon are not completed. The start of an update also waits while the update before it runs. The replica
//! sends no more events before the earlier ones are applied and public, so few events wait.
//!
//! Invariant: only events in the log are applied, so the map stays as it is when its role changes. As a follower, the
//! map accepts nothing from clients and begins no update by itself.

use std::collections::VecDeque;

use tidemap_cluster::replica::ReplicaEvent;
use tidemap_map::{event::Event, name::MapName};
use tidemap_store::{AppendError, MapId};
use tokio::sync::{oneshot, watch};
use tracing::{error, info};

use super::Writer;
use crate::{
    ending::Ending,
    role::{MapRole, NotWriter},
};

/// A map whose own log has records that the shared log does not have.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct ForkedMap {
    /// Number of the map in the store.
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

/// The role of the daemon, and the events of its replica that are not processed yet.
pub(super) struct Follower {
    role: watch::Sender<MapRole>,
    queue: VecDeque<ReplicaEvent>,
    batch: Option<FollowedBatch>,
    /// Notified when the view shows the applied events.
    applied: Vec<oneshot::Sender<()>>,
    /// The position at which the own log and the shared one diverge, if they do.
    fork: Option<u64>,
}

impl Follower {
    /// `is_shared`: the log is shared; then this daemon writes it only when the replica orders it.
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

    /// The log names its writer from here on.
    fn name_writer(&self, writer: String) {
        if !self.is_writing() {
            self.role.send_replace(MapRole::Following { writer: Some(writer) });
        }
    }

    /// Notifies the replica that the view shows all applied events.
    pub(super) fn published(&mut self) {
        for applied in self.applied.drain(..) {
            // The replica may have stopped.
            let _ = applied.send(());
        }
    }
}

impl Writer {
    /// The reason why the map accepts nothing from clients, if another daemon writes it; `None`: this daemon writes it.
    pub(super) fn not_writer(&self) -> Option<NotWriter> {
        let map = &self.map.spec().name;
        let refused = self.follower.role.borrow().not_writer(map);
        refused.or_else(|| match self.appends.failure() {
            // The log has this state before the replica has sent it.
            Some(AppendError::NotWriter { writer }) => Some(NotWriter { map: map.clone(), writer: writer.clone() }),
            _ => None,
        })
    }

    /// The reason why no durable sequence number is sent; `None`: all of the log is known here. A daemon that was cut
    /// off does not know yet that another one writes, nor the records that that one has acknowledged.
    pub(super) fn not_current(&self) -> Option<NotWriter> {
        (!self.log.is_current()).then(|| NotWriter { map: self.map.spec().name.clone(), writer: None })
    }

    /// Processes the events of the replica, as far as is possible now.
    pub(super) fn follow(&mut self) {
        while self.stopping.is_none() && self.follow_next() {}
    }

    /// Processes the next event; returns whether this was possible.
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

    /// Applies events of the log up to the start of an update that has to wait; returns whether all are applied.
    fn apply_followed(&mut self, mut batch: FollowedBatch) -> bool {
        while let Some((position, event)) = batch.events.pop_front() {
            if matches!(event, Event::UpdateStart(_)) && !self.may_follow_update() {
                batch.events.push_front((position, event));
                self.follower.batch = Some(batch);
                return false;
            }
            // Without this event the map is unusable, and the daemon stops.
            let Ok(work) = self.apply(position, &event) else { return false };
            self.report_applied(&event);
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

    /// Another daemon writes the map. The appends of this daemon in flight have been completed.
    fn become_follower(&mut self, writer: Option<String>) {
        let role = MapRole::Following { writer: writer.clone() };
        if *self.follower.role.borrow() == role {
            return;
        }
        // Streams receive their acknowledgements before they receive their end.
        self.publish();
        let map = &self.map.spec().name;
        info!(%map, writer = writer.as_deref().unwrap_or("unknown"), "another daemon writes the map");
        if self.follower.role.send_replace(role).is_writing() {
            metrics::counter!("tidemap_cluster_depositions_total").increment(1);
        }
        self.backlog.clear();
        self.sessions.end_all(&Ending::Moved { writer });
        // `pump` replies to waiting hellos and edits.
        if let Some(refused) = self.not_writer() {
            self.updates.schedule.fail_all(&refused.to_string());
        }
    }

    /// This daemon writes the map: all earlier events in the log are applied.
    fn become_writer(&mut self, epoch: u64) {
        info!(map = %self.map.spec().name, epoch, position = self.map.position(), "this daemon writes the map");
        self.follower.role.send_replace(MapRole::Writing { epoch });
        metrics::counter!("tidemap_cluster_takeovers_total").increment(1);
        // The data about the end of the log is out of date.
        self.sessions.roll_back();
        self.updates.become_due_again();
    }

    /// The map has records that the shared log does not have: it ends here.
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
