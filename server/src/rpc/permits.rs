//! Permits: how many requests of a kind compute at once.
//!
//! Invariant: a request that gets no permit within [`PERMIT_WITHIN`] ends with an error that says so. Who waits for a
//! reader holds no permit, who computes for long gives others a turn, and work that nobody waits for ends and gives its
//! permit back.

use std::{
    sync::{
        Arc,
        atomic::{AtomicBool, Ordering},
    },
    time::{Duration, Instant},
};

use tidemap_model::StopSignal;
use tokio::{
    runtime::Handle,
    sync::{OwnedSemaphorePermit, Semaphore},
};

use super::status::RpcError;

/// Minimum number of requests that compute at once.
const PERMITS_MIN: usize = 4;
/// A request waits this long for others to end.
const PERMIT_WITHIN: Duration = Duration::from_secs(30);

/// A long computation offers its permit to others after this time.
const SLICE: Duration = Duration::from_millis(50);

/// Permits to compute. Clones share them.
#[derive(Clone, Debug)]
pub(super) struct Permits {
    permits: Arc<Semaphore>,
    max: usize,
}

/// A permit to compute, given back when dropped.
#[derive(Debug)]
pub(super) struct Permit {
    permits: Arc<Semaphore>,
    held: Option<HeldPermit>,
    since: Instant,
}

/// A permit that is held now, as the metrics show.
#[derive(Debug)]
struct HeldPermit {
    _permit: OwnedSemaphorePermit,
}

impl HeldPermit {
    fn new(permit: OwnedSemaphorePermit) -> Self {
        metrics::gauge!("tidemap_computing_requests").increment(1.0);
        Self { _permit: permit }
    }
}

impl Drop for HeldPermit {
    fn drop(&mut self) {
        metrics::gauge!("tidemap_computing_requests").decrement(1.0);
    }
}

impl Permit {
    /// Gives the permit to others while its holder waits for something else.
    pub(super) fn pause(&mut self) {
        self.held = None;
    }

    /// Waits for the permit again, behind those that wait already. Only on a blocking thread.
    pub(super) fn resume(&mut self) {
        if self.held.is_none() {
            // The permits are closed never; without a permit the work would end all the same.
            self.held = Handle::current().block_on(Arc::clone(&self.permits).acquire_owned()).ok().map(HeldPermit::new);
            self.since = Instant::now();
        }
    }

    /// Whether somebody else has all permits, so that a permit that is given back may not come back soon.
    pub(super) fn is_contended(&self) -> bool {
        self.permits.available_permits() == 0
    }

    /// Whether the holder had the permit for long and somebody may wait.
    pub(super) fn is_due(&self) -> bool {
        self.since.elapsed() >= SLICE && self.is_contended()
    }

    /// Gives others a turn if that is due. Only on a blocking thread.
    pub(super) fn offer(&mut self) {
        if self.is_due() {
            self.pause();
            self.resume();
        }
    }
}

impl Default for Permits {
    fn default() -> Self {
        // Twice the processors, because some requests wait for their readers.
        Self::new(PERMITS_MIN.max(2 * processors()))
    }
}

/// Number of processors of the machine.
pub(super) fn processors() -> usize {
    std::thread::available_parallelism().map_or(1, std::num::NonZero::get)
}

/// Runs work on a blocking thread, which keeps the permit until the work is done: for work that ends soon.
///
/// # Errors
/// [`RpcError::Stopping`] if the daemon stops before the work is done.
pub(super) async fn run_blocking<T: Send + 'static>(
    permit: impl Send + 'static,
    work: impl FnOnce() -> T + Send + 'static,
) -> Result<T, RpcError> {
    let work = move || {
        let _permit = permit;
        work()
    };
    tokio::task::spawn_blocking(work).await.map_err(|_| RpcError::Stopping)
}

/// Runs work on a blocking thread, which keeps the permit until the work is done. It is told to stop `within` a time of
/// its start, and when nobody waits for it any more: the client is gone, or the deadline of its call has passed.
///
/// # Errors
/// [`RpcError::Stopping`] if the daemon stops before the work is done.
pub(super) async fn run_while_awaited<T: Send + 'static>(
    permit: impl Send + 'static,
    within: Option<Duration>,
    work: impl FnOnce(StopSignal<'_>) -> T + Send + 'static,
) -> Result<T, RpcError> {
    let is_left = Arc::new(AtomicBool::new(false));
    let _awaited = Awaited(Arc::clone(&is_left));
    let work = move || {
        let deadline = within.map(|within| Instant::now() + within);
        let is_set = || is_left.load(Ordering::Relaxed) || deadline.is_some_and(|at| Instant::now() >= at);
        work(StopSignal::new(&is_set))
    };
    run_blocking(permit, work).await
}

/// Tells work when it is dropped that nobody waits any more.
struct Awaited(Arc<AtomicBool>);

impl Drop for Awaited {
    fn drop(&mut self) {
        self.0.store(true, Ordering::Relaxed);
    }
}

impl Permits {
    /// `max` permits.
    pub(super) fn new(max: usize) -> Self {
        Self { permits: Arc::new(Semaphore::new(max)), max }
    }

    /// Waits for a permit, which is given back when it is dropped.
    ///
    /// # Errors
    /// [`RpcError::Busy`] if none was free in time.
    pub(super) async fn take(&self) -> Result<Permit, RpcError> {
        let permit = Arc::clone(&self.permits).acquire_owned();
        match tokio::time::timeout(PERMIT_WITHIN, permit).await {
            Ok(held) => {
                let held = Some(HeldPermit::new(held.map_err(|_| RpcError::Stopping)?));
                Ok(Permit { permits: Arc::clone(&self.permits), held, since: Instant::now() })
            }
            Err(_) => Err(RpcError::Busy { max: self.max, secs: PERMIT_WITHIN.as_secs() }),
        }
    }
}
