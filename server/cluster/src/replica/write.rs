//! Writes the shared log: one group at a time, to this disk and to the engine together.
//!
//! Invariant: a group is acknowledged when both have it. A group whose fate is not known ends this daemon's writing.

use std::time::Duration;

use tidemap_store::{AppendError, WrittenGroup};
use tokio::{
    sync::oneshot,
    time::{Instant, sleep},
};

use super::{
    compare::CompareError,
    driver::{Driver, Next, PROBE},
    events::{ReplicaEvent, ReplicaRole},
    follow::{CHECKS_PER_LEASE, READ_PATIENCE, StreamEnd},
    lease_keeper::LeaseKeeper,
    send::Sent,
    settings::Order,
};
use crate::{
    engine::{Engine, EngineError},
    message::encode,
};

/// The next writer, and the channel of the caller that waits for the hand-over.
type HandOver = (Option<String>, oneshot::Sender<bool>);

/// Time limit for giving a lease back.
const GIVE_BACK: Duration = Duration::from_secs(1);

impl<E: Engine> Driver<E> {
    /// Writes the log until this daemon is deposed, hands it over or stops.
    pub(super) async fn write(&mut self) -> Next {
        let Some(keeper) = self.keeper.take() else { return Next::Align };
        self.role(ReplicaRole::Writing);
        self.shared.open();
        (self.listener)(ReplicaEvent::Writing { epoch: self.epoch });
        let mut successor = None;
        let next = self.write_until(&keeper, &mut successor).await;
        self.shared.close(&AppendError::NotWriter { writer: None });
        self.set_writer(None);
        (self.listener)(ReplicaEvent::Following { writer: None });
        if matches!(next, Next::Stop | Next::Follow) {
            let to = successor.as_ref().and_then(|(to, _)| to.clone());
            let _ = tokio::time::timeout(GIVE_BACK, keeper.give_back(&self.engine, to)).await;
        }
        self.lease_watch.forget();
        if let Some((_, done)) = successor {
            let _ = done.send(true);
        }
        next
    }

    async fn write_until(&mut self, keeper: &LeaseKeeper, successor: &mut Option<HandOver>) -> Next {
        let mut leaves: Option<Instant> = None;
        loop {
            if self.is_stopping() {
                return Next::Stop;
            }
            if keeper.is_lost() {
                return Next::Follow;
            }
            match self.next_order() {
                Some(Order::HandOver(_, done)) if successor.is_some() => drop(done.send(false)),
                Some(Order::HandOver(to, done)) => {
                    // Writing goes on until the successor reads the lease often.
                    let mut until = Instant::now();
                    if let Some(to) = &to {
                        keeper.announce(to);
                        until += self.settings.lease / CHECKS_PER_LEASE + READ_PATIENCE;
                    }
                    leaves = Some(until);
                    *successor = Some((to, done));
                }
                Some(Order::Stop) | None => {}
            }
            if leaves.is_some_and(|leaves| leaves <= Instant::now()) {
                return Next::Follow;
            }
            let events = self.shared.take(self.settings.group_bytes);
            if events.is_empty() {
                match self.wait_for_work(keeper, leaves).await {
                    Some(next) => return next,
                    None => continue,
                }
            }
            let log = self.shared.log.clone();
            let next = match self.on_disk(move || log.write(events)).await {
                Ok(written) => self.commit(written).await,
                // The appends wait for the undo of the map's thread, or nothing was left to write.
                Err(AppendError::AfterFailure) => None,
                Err(error) => {
                    self.trouble(Some(format!("another daemon replaces this one: {error}")));
                    self.let_others_write();
                    Some(Next::Follow)
                }
            };
            if let Some(next) = next {
                return next;
            }
        }
    }

    /// Makes a written group part of the shared log, or takes it back; returns the next step where writing ends.
    async fn commit(&mut self, written: WrittenGroup) -> Option<Next> {
        let messages = encode(written.records(), self.settings.map, self.epoch);
        let end = written.records().after.position;
        let log = self.shared.log.clone();
        #[cfg(test)]
        let skips_sync = self.settings.planted == super::settings::Planted::AckBeforeSync;
        #[cfg(not(test))]
        let skips_sync = false;
        let sync = move || {
            let synced = if skips_sync { Ok(()) } else { log.sync(&written) };
            (written, synced)
        };
        let (sent, (written, synced)) = if self.settings.disk_inline {
            (self.send(&messages).await, sync())
        } else {
            // Both begin at the same time.
            let syncing = tokio::task::spawn_blocking(sync);
            let sent = self.send(&messages).await;
            // The runtime ends, or the disk task panicked: the completions are lost with the group.
            let Ok(both) = syncing.await else { return Some(Next::Stop) };
            (sent, both)
        };
        let outcome = match (synced, &sent) {
            (Err(error), _) => Err(error),
            (Ok(()), Sent::Done) => Ok(()),
            (Ok(()), Sent::Full(reason)) => Err(AppendError::StreamFull(reason.clone())),
            // It is not known whether the stream has the group that was given up, so the group is not acknowledged.
            (Ok(()), Sent::Deposed | Sent::Forgotten | Sent::Stopped) => Err(AppendError::NotWriter { writer: None }),
        };
        let is_fatal = matches!(outcome, Err(AppendError::Poisoned { .. }));
        let log = self.shared.log.clone();
        let is_in = outcome.is_ok();
        self.on_disk(move || log.end_group(written, outcome)).await;
        if is_in {
            self.note_contact(end, Instant::now());
        }
        match sent {
            _ if is_fatal => Some(Next::Stop),
            Sent::Done | Sent::Full(_) => None,
            Sent::Deposed | Sent::Forgotten => Some(Next::Align),
            Sent::Stopped => Some(Next::Stop),
        }
    }

    /// Waits for work, at most until `leaves`; returns the next step where this daemon stops writing.
    async fn wait_for_work(&mut self, keeper: &LeaseKeeper, leaves: Option<Instant>) -> Option<Next> {
        let left = leaves.map(|leaves| leaves.saturating_duration_since(Instant::now()));
        tokio::select! {
            biased;
            () = self.shared.has_work.notified() => return None,
            order = self.orders.recv() => {
                self.order = order;
                return None;
            }
            () = keeper.lost() => return None,
            () = sleep(left.unwrap_or(PROBE)), if left.is_some() => return None,
            () = sleep(PROBE) => {}
        }
        match self.probe().await {
            Ok(StreamEnd::Own) => None,
            // The stream has forgotten messages, or somebody else has appended.
            Ok(StreamEnd::More | StreamEnd::Lost) | Err(CompareError::Engine(EngineError::Missing(_))) => {
                Some(Next::Align)
            }
            Err(error) => {
                self.trouble(Some(error.to_string()));
                None
            }
        }
    }
}
