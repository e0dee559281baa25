//! Keeps a lease: raises its counter until it is lost or given back.
//!
//! Invariant: a lease that was given back is not renewed.

use std::{
    sync::{
        Arc,
        atomic::{AtomicU64, Ordering},
    },
    time::Duration,
};

use tokio::{sync::watch, task::JoinHandle, time::sleep};

use crate::{
    engine::{Bucket, Engine, SetError},
    lease::Lease,
};

/// A lease that this daemon has. Dropped, it is no longer renewed.
pub(super) struct LeaseKeeper {
    is_lost: watch::Receiver<bool>,
    revision: Arc<AtomicU64>,
    epoch: Arc<AtomicU64>,
    member: String,
    task: JoinHandle<()>,
}

impl Drop for LeaseKeeper {
    fn drop(&mut self) {
        self.task.abort();
    }
}

impl LeaseKeeper {
    /// Keeps the lease of a map that has this revision, renewed every `interval`.
    pub(super) fn start<E: Engine>(
        engine: E,
        key: String,
        member: String,
        revision: u64,
        epoch: u64,
        interval: Duration,
    ) -> LeaseKeeper {
        let (lost, is_lost) = watch::channel(false);
        let (revision, epoch) = (Arc::new(AtomicU64::new(revision)), Arc::new(AtomicU64::new(epoch)));
        let (known, of_epoch) = (Arc::clone(&revision), Arc::clone(&epoch));
        let owner = member.clone();
        let task = tokio::spawn(async move {
            for counter in 1.. {
                sleep(interval).await;
                let expected = known.load(Ordering::Acquire);
                let epoch = of_epoch.load(Ordering::Acquire);
                let lease = Lease { writer: member.clone(), epoch, counter, successor: None };
                match engine.set_if(Bucket::Writers, &key, expected, lease.encode()).await {
                    Ok(revision) => known.store(revision, Ordering::Release),
                    // A renewal whose answer was lost has been made, or somebody else has taken the lease.
                    Err(SetError::NotExpected) => match engine.get(Bucket::Writers, &key).await {
                        Ok(Some(entry)) if Lease::decode(&entry.value).writer == member => {
                            known.store(entry.revision, Ordering::Release);
                        }
                        Ok(_) => break,
                        Err(_) => {}
                    },
                    // Tried again: the engine may elect a leader.
                    Err(SetError::Engine(_)) => {}
                }
            }
            let _ = lost.send(true);
        });
        LeaseKeeper { is_lost, revision, epoch, member: owner, task }
    }

    /// From now on the lease says this epoch.
    pub(super) fn tell_epoch(&self, epoch: u64) {
        self.epoch.store(epoch, Ordering::Release);
    }

    /// Whether somebody else has the lease.
    pub(super) fn is_lost(&self) -> bool {
        *self.is_lost.borrow()
    }

    /// Returns when somebody else has the lease.
    pub(super) async fn lost(&self) {
        let _ = self.is_lost.clone().wait_for(|lost| *lost).await;
    }

    /// Gives the lease back, to a successor or to any. What the engine answers does not matter: the lease runs out.
    pub(super) async fn give_back<E: Engine>(self, engine: &E, key: &str, successor: Option<String>) {
        self.task.abort();
        let epoch = self.epoch.load(Ordering::Acquire);
        let lease = Lease { writer: String::new(), epoch, counter: 0, successor };
        for _ in 0..2 {
            let expected = self.revision.load(Ordering::Acquire);
            match engine.set_if(Bucket::Writers, key, expected, lease.encode()).await {
                Err(SetError::NotExpected) => match engine.get(Bucket::Writers, key).await {
                    // The renewal that was cut off had been made.
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
