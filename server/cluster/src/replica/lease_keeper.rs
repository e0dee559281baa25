//! Keeps a lease: raises its counter until the lease is lost or given back.
//!
//! Invariant: a lease that was given back is not renewed. While the lease is current by this daemon's own clock, no
//! other daemon has taken it, because others wait longer than it is current.

use std::{
    sync::{
        Arc,
        atomic::{AtomicU64, Ordering},
    },
    time::Duration,
};

use tokio::{
    sync::watch,
    task::JoinHandle,
    time::{Instant, sleep},
};

use super::shared_log::LogState;
use crate::{
    engine::{Bucket, Engine, SetError},
    lease::Lease,
};

/// The content of a lease, and the time for which it lasts.
pub(super) struct LeaseTerms {
    /// Key of the map.
    pub(super) key: String,
    /// Name of this daemon.
    pub(super) member: String,
    /// The epoch that this daemon claims.
    pub(super) epoch: u64,
    /// Time for which others wait before they take the lease.
    pub(super) lasts: Duration,
}

/// A lease that this daemon has. When it is dropped, it is no longer renewed.
pub(super) struct LeaseKeeper {
    is_lost: watch::Receiver<bool>,
    revision: Arc<AtomicU64>,
    epoch: u64,
    shared: Arc<LogState>,
    key: String,
    member: String,
    successor: watch::Sender<Option<String>>,
    task: JoinHandle<()>,
}

impl Drop for LeaseKeeper {
    fn drop(&mut self) {
        self.task.abort();
        self.shared.set_current_until(None);
    }
}

impl LeaseKeeper {
    /// Keeps the lease that has this revision since `taken`.
    pub(super) fn start<E: Engine>(
        engine: E,
        shared: Arc<LogState>,
        terms: LeaseTerms,
        revision: u64,
        taken: Instant,
    ) -> LeaseKeeper {
        let (lost, is_lost) = watch::channel(false);
        let (successor, mut announced) = watch::channel(None);
        let LeaseTerms { key, member, epoch, lasts } = terms;
        let revision = Arc::new(AtomicU64::new(revision));
        let known = Arc::clone(&revision);
        let (own_key, own_member, own_shared) = (key.clone(), member.clone(), Arc::clone(&shared));
        // Others wait for the whole time of the lease, and they start to wait later than this daemon.
        let is_current_for = lasts * 3 / 4;
        shared.set_current_until(Some(taken + is_current_for));
        let task = tokio::spawn(async move {
            for counter in 1.. {
                tokio::select! {
                    () = sleep(lasts / 4) => {}
                    Ok(()) = announced.changed() => {}
                }
                let begun = Instant::now();
                let expected = known.load(Ordering::Acquire);
                let successor = announced.borrow_and_update().clone();
                let lease = Lease { writer: member.clone(), epoch, counter, successor };
                match engine.set_if(Bucket::Writers, &key, expected, lease.encode()).await {
                    Ok(revision) => {
                        known.store(revision, Ordering::Release);
                        shared.set_current_until(Some(begun + is_current_for));
                    }
                    // A renewal whose reply was lost has been made, or somebody else has taken the lease.
                    Err(SetError::NotExpected) => match engine.get(Bucket::Writers, &key).await {
                        Ok(Some(entry)) if Lease::decode(&entry.value).writer == member => {
                            known.store(entry.revision, Ordering::Release);
                        }
                        Ok(_) => break,
                        Err(_) => {}
                    },
                    // Try again: the engine may be electing a leader.
                    Err(SetError::Engine(_)) => {}
                }
            }
            shared.set_current_until(None);
            let _ = lost.send(true);
        });
        LeaseKeeper { is_lost, revision, epoch, shared: own_shared, key: own_key, member: own_member, successor, task }
    }

    /// The epoch that the lease claims.
    pub(super) fn epoch(&self) -> u64 {
        self.epoch
    }

    /// Names the next holder in the lease, while this daemon goes on writing.
    pub(super) fn announce(&self, successor: &str) {
        self.successor.send_replace(Some(successor.to_owned()));
    }

    /// Whether somebody else has the lease.
    pub(super) fn is_lost(&self) -> bool {
        *self.is_lost.borrow()
    }

    /// Returns when somebody else has the lease.
    pub(super) async fn lost(&self) {
        let _ = self.is_lost.clone().wait_for(|lost| *lost).await;
    }

    /// Gives the lease back, to a successor or to any. The engine's reply does not matter: the lease expires.
    pub(super) async fn give_back<E: Engine>(self, engine: &E, successor: Option<String>) {
        self.task.abort();
        self.shared.set_current_until(None);
        let lease = Lease { writer: String::new(), epoch: self.epoch(), counter: 0, successor };
        for _ in 0..2 {
            let expected = self.revision.load(Ordering::Acquire);
            match engine.set_if(Bucket::Writers, &self.key, expected, lease.encode()).await {
                Err(SetError::NotExpected) => match engine.get(Bucket::Writers, &self.key).await {
                    // The interrupted renewal had been made.
                    Ok(Some(entry)) if Lease::decode(&entry.value).writer == self.member => {
                        self.revision.store(entry.revision, Ordering::Release);
                    }
                    _ => return,
                },
                _ => return,
            }
        }
    }
}
