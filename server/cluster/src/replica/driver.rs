//! Runs a replica: it compares its log with the shared one, follows it, becomes its writer and stops being the writer.
//!
//! Invariant: an event that the map's thread receives is in the shared log for good and in this daemon's own log.

use std::{sync::Arc, time::Duration};

use tidemap_store::{AppendError, LogPoint};
use tokio::{
    sync::{mpsc, watch},
    time::{Instant, timeout},
};

use super::{
    events::{ReplicaEvent, ReplicaListener, ReplicaRole},
    lease_keeper::LeaseKeeper,
    settings::{Order, ReplicaSettings},
    shared_log::LogState,
};
use crate::{engine::Engine, lease::LeaseWatch, message::Assembly};

/// Bytes that one read of the stream returns at most.
pub(super) const READ_BYTES: usize = 8 << 20;
/// Interval at which the end of the stream is read.
pub(super) const PROBE: Duration = Duration::from_secs(1);
/// Time for which a daemon that cannot write its own log leaves the lease to others.
const LET_OTHERS_WRITE: Duration = Duration::from_secs(10);

/// The next step of a replica.
#[derive(Debug)]
pub(super) enum Next {
    Align,
    Follow,
    TakeOver(u64),
    Write,
    Forked(u64),
    Stop,
}

/// A running replica.
pub(super) struct Driver<E: Engine> {
    pub(super) engine: E,
    pub(super) settings: ReplicaSettings,
    pub(super) shared: Arc<LogState>,
    pub(super) listener: ReplicaListener,
    pub(super) orders: mpsc::UnboundedReceiver<Order>,
    /// An order that came while the replica waited for something else.
    pub(super) order: Option<Order>,
    pub(super) stopping: watch::Receiver<bool>,
    pub(super) rank: watch::Receiver<Option<u32>>,
    /// Number of the last message whose records the own log has, or that is known to hold none.
    pub(super) last_sequence: u64,
    pub(super) assembly: Assembly,
    pub(super) epoch: u64,
    pub(super) lease_watch: LeaseWatch,
    pub(super) lease_checked: Option<Instant>,
    /// The end of the own log and the stamp of the stream's last message when they were last found to be equal.
    pub(super) probed_stamp: Option<(LogPoint, u64)>,
    /// The time at which the end of the stream was read last, and the number of its last message then.
    pub(super) end_received: Option<(Instant, u64)>,
    /// Whether this daemon has searched far back for void messages.
    pub(super) has_read_back: bool,
    /// The lease, from the take-over of the log until it is written.
    pub(super) keeper: Option<LeaseKeeper>,
}

impl<E: Engine> Driver<E> {
    pub(super) fn new(
        engine: E,
        settings: ReplicaSettings,
        shared: Arc<LogState>,
        listener: ReplicaListener,
        orders: mpsc::UnboundedReceiver<Order>,
        stopping: watch::Receiver<bool>,
        rank: watch::Receiver<Option<u32>>,
    ) -> Driver<E> {
        Driver {
            engine,
            settings,
            shared,
            listener,
            orders,
            order: None,
            stopping,
            rank,
            last_sequence: 0,
            assembly: Assembly::default(),
            epoch: 0,
            lease_watch: LeaseWatch::default(),
            lease_checked: None,
            probed_stamp: None,
            end_received: None,
            has_read_back: false,
            keeper: None,
        }
    }

    /// The next waiting order, if there is one.
    pub(super) fn next_order(&mut self) -> Option<Order> {
        self.order.take().or_else(|| self.orders.try_recv().ok())
    }

    pub(super) async fn run(mut self) {
        let mut next = Next::Align;
        loop {
            if self.is_stopping() && !matches!(next, Next::Write) {
                next = Next::Stop;
            }
            next = match next {
                Next::Align => self.align().await,
                Next::Follow => self.follow().await,
                Next::TakeOver(revision) => self.take_over(revision).await,
                Next::Write => self.write().await,
                Next::Forked(common) => {
                    self.role(ReplicaRole::Forked);
                    self.trouble(Some(format!(
                        "this daemon holds records behind position {common} that the shared log does not have"
                    )));
                    (self.listener)(ReplicaEvent::Forked { common });
                    return;
                }
                Next::Stop => {
                    // This is not fatal: the log is sound, and another daemon may write it.
                    self.shared.close(&AppendError::NotWriter { writer: None });
                    return;
                }
            };
        }
    }

    pub(super) fn is_stopping(&self) -> bool {
        *self.stopping.borrow()
    }

    /// Runs disk work outside the tasks of the runtime.
    pub(super) async fn on_disk<T: Send + 'static>(&self, work: impl FnOnce() -> T + Send + 'static) -> T {
        if self.settings.disk_inline {
            return work();
        }
        match tokio::task::spawn_blocking(work).await {
            Ok(value) => value,
            Err(error) => match error.try_into_panic() {
                Ok(panic) => std::panic::resume_unwind(panic),
                // The runtime ends: nothing waits for this task.
                Err(_) => std::future::pending().await,
            },
        }
    }

    pub(super) fn role(&self, role: ReplicaRole) {
        let end = self.shared.log.position();
        self.shared.status.send_modify(|status| {
            status.role = role;
            status.position = end;
        });
    }

    /// Sets the daemon that writes the log, as far as it is known. In a follower, the map's thread is notified of a
    /// change.
    pub(super) fn set_writer(&self, writer: Option<String>) {
        let mut role = ReplicaRole::Starting;
        let is_new = self.shared.status.send_if_modified(|status| {
            role = status.role;
            let differs = status.writer != writer;
            status.writer.clone_from(&writer);
            differs
        });
        if is_new && !matches!(role, ReplicaRole::Writing | ReplicaRole::TakingOver) {
            (self.listener)(ReplicaEvent::Following { writer });
        }
    }

    pub(super) fn trouble(&self, trouble: Option<String>) {
        self.shared.status.send_if_modified(|status| {
            let differs = status.trouble != trouble;
            status.trouble = trouble;
            differs
        });
    }

    /// Records that the shared log ends at this position, as far as it was seen.
    pub(super) fn sees_end(&self, position: u64) {
        let (own, epoch) = (self.shared.log.position(), self.epoch);
        self.shared.status.send_modify(|status| {
            status.shared_position = position;
            status.position = own;
            status.epoch = epoch;
        });
    }

    /// Records that this daemon has all of the shared log as of `moment`, when it ended at `position`.
    pub(super) fn note_contact(&self, position: u64, moment: Instant) {
        self.sees_end(position);
        self.shared.status.send_modify(|status| status.last_contact = status.last_contact.max(Some(moment)));
    }

    /// This daemon cannot write its own log: for a while it does not read the lease, so that others take it.
    pub(super) fn let_others_write(&mut self) {
        self.lease_checked = Some(Instant::now() + LET_OTHERS_WRITE);
    }

    /// Whether this daemon leaves the lease to others.
    pub(super) fn lets_others_write(&self) -> bool {
        self.lease_checked.is_some_and(|checked| checked > Instant::now())
    }

    /// Waits for `duration`, or until an order to stop comes.
    pub(super) async fn pause(&mut self, duration: Duration) {
        let _ = timeout(duration, self.stopping.wait_for(|stopping| *stopping)).await;
    }
}
