//! A replica of a map: a map of a cluster as one daemon has it.
//!
//! It compares its own log with the shared one, follows it, becomes its writer and stops being it ([`driver`]).
//!
//! Invariant: see [`events`]: the thread of the map receives everything that is in the shared log, in its order, once.

use std::sync::Arc;

use tidemap_store::GroupLog;
use tokio::sync::{mpsc, oneshot, watch};

use crate::engine::Engine;

mod compare;
mod driver;
mod events;
mod follow;
mod lease_keeper;
mod send;
mod settings;
mod shared_log;
mod shorten;
mod take_over;
#[cfg(test)]
mod tests;
mod write;

use driver::Driver;
pub use events::{ReplicaEvent, ReplicaListener, ReplicaRole, ReplicaStatus};
use settings::Order;
#[cfg(test)]
pub use settings::Planted;
pub use settings::ReplicaSettings;
use shared_log::LogState;
pub use shared_log::SharedLog;
pub use shorten::{Shortening, shorten};

/// The handle of a replica. The replica stops when it is dropped.
pub struct ReplicaHandle {
    orders: mpsc::UnboundedSender<Order>,
    stop: watch::Sender<bool>,
    candidacy: watch::Sender<Option<u32>>,
}

impl ReplicaHandle {
    /// Sets the rank after which the replica may become the writer; `None`: it may not become the writer.
    pub fn set_candidacy(&self, rank: Option<u32>) {
        self.candidacy.send_if_modified(|known| std::mem::replace(known, rank) != rank);
    }

    /// Hands the log over to another daemon, or to any; returns whether this replica was the writer. The order is sent
    /// at once, not when the result is awaited.
    pub fn hand_over(&self, successor: Option<String>) -> impl Future<Output = bool> + Send + use<> {
        let (done, answer) = oneshot::channel();
        let sent = self.orders.send(Order::HandOver(successor, done));
        async move { sent.is_ok() && answer.await.unwrap_or(false) }
    }

    /// Ends the replica; [`Replica::run`] returns when everything in flight has been completed.
    pub fn stop(&self) {
        self.stop.send_replace(true);
        let _ = self.orders.send(Order::Stop);
    }
}

impl Drop for ReplicaHandle {
    fn drop(&mut self) {
        self.stop();
    }
}

/// A replica that is ready to run.
pub struct Replica<E: Engine>(Driver<E>);

impl<E: Engine> Replica<E> {
    /// A replica of the map with this log, and the shared log that its thread appends to.
    pub fn new(
        engine: E,
        settings: ReplicaSettings,
        log: GroupLog,
        listener: ReplicaListener,
    ) -> (Replica<E>, ReplicaHandle, SharedLog) {
        let shared = Arc::new(LogState::new(log));
        let (orders, inbox) = mpsc::unbounded_channel();
        let (stop, stopping) = watch::channel(false);
        let (candidacy, rank) = watch::channel(None);
        let driver = Driver::new(engine, settings, Arc::clone(&shared), listener, inbox, stopping, rank);
        (Replica(driver), ReplicaHandle { orders, stop, candidacy }, SharedLog { shared })
    }

    /// Runs the replica until it is stopped or its log has forked.
    pub async fn run(self) {
        self.0.run().await;
    }
}
