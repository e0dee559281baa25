//! Permits: how many requests of a kind compute at once.
//!
//! Invariant: a request that gets no permit within [`PERMIT_WITHIN`] ends with an error that says so. Who waits for a
//! reader holds no permit, and who computes for long gives others a turn.

use std::{
    sync::Arc,
    time::{Duration, Instant},
};

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
    held: Option<OwnedSemaphorePermit>,
    since: Instant,
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
            self.held = Handle::current().block_on(Arc::clone(&self.permits).acquire_owned()).ok();
            self.since = Instant::now();
        }
    }

    /// Gives others a turn if the holder had the permit for long and somebody may wait. Only on a blocking thread.
    pub(super) fn offer(&mut self) {
        if self.since.elapsed() >= SLICE && self.permits.available_permits() == 0 {
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

/// Runs work on a blocking thread, which keeps the permit until the work is done.
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
                let held = Some(held.map_err(|_| RpcError::Stopping)?);
                Ok(Permit { permits: Arc::clone(&self.permits), held, since: Instant::now() })
            }
            Err(_) => Err(RpcError::Busy { max: self.max, secs: PERMIT_WITHIN.as_secs() }),
        }
    }
}
