//! Permits: how many requests of a kind compute at once.
//!
//! Invariant: a request that gets no permit in time ends with an error that names this reason. If the wait can be
//! foreseen to be too long, from the number of waiting requests and the time for which requests of the kind computed
//! lately, the request is refused at once, which costs least. Work that waits for a reader holds no permit, work that
//! computes for long gives others a turn, and work that nobody waits for ends and gives its permit back.

use std::{
    sync::{
        Arc,
        atomic::{AtomicBool, AtomicU64, AtomicUsize, Ordering},
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
/// Maximum time that a request waits for others to end.
const PERMIT_WITHIN: Duration = Duration::from_secs(30);
/// A request that must be answered promptly is refused if it would wait for longer than this.
pub(super) const PROMPT: Duration = Duration::from_millis(75);
/// This number of requests per permit may wait, however long that takes: a few at once are no overload.
const QUEUED_PER_PERMIT: usize = 2;

/// A long computation offers its permit to others after this time.
const SLICE: Duration = Duration::from_millis(50);

/// Permits to compute. Clones share them.
#[derive(Clone, Debug)]
pub(super) struct Permits {
    permits: Arc<Semaphore>,
    max: usize,
    /// Maximum time for which a request may be foreseen to wait.
    patience: Duration,
    load: Arc<Load>,
}

/// The load on permits.
#[derive(Debug, Default)]
struct Load {
    waiting: AtomicUsize,
    /// The time for which a request computed lately, in nanoseconds: an exponentially fading mean.
    computed_nanos: AtomicU64,
}

impl Load {
    fn note(&self, computed: Duration) {
        let nanos = u64::try_from(computed.as_nanos()).unwrap_or(u64::MAX);
        // If two requests end at the same moment, one of the two times may be lost, which does not matter.
        let mean = self.computed_nanos.load(Ordering::Relaxed);
        self.computed_nanos.store(mean - mean / 8 + nanos / 8, Ordering::Relaxed);
    }
}

/// A waiting request.
struct Waiting<'a>(&'a Load);

impl<'a> Waiting<'a> {
    /// Enters a waiting request; returns it and the number of requests that wait now.
    fn enter(load: &'a Load) -> (Self, usize) {
        let waiting = load.waiting.fetch_add(1, Ordering::Relaxed) + 1;
        (Self(load), waiting)
    }
}

impl Drop for Waiting<'_> {
    fn drop(&mut self) {
        self.0.waiting.fetch_sub(1, Ordering::Relaxed);
    }
}

/// A permit to compute, given back when dropped.
#[derive(Debug)]
pub(super) struct Permit {
    permits: Arc<Semaphore>,
    load: Arc<Load>,
    held: Option<HeldPermit>,
    since: Instant,
    /// The time for which the permit was held before.
    computed: Duration,
}

impl Drop for Permit {
    fn drop(&mut self) {
        self.pause();
        self.load.note(self.computed);
    }
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
    /// Gives the permit back while its holder waits for something else.
    pub(super) fn pause(&mut self) {
        if self.held.take().is_some() {
            self.computed += self.since.elapsed();
        }
    }

    /// Waits for the permit again, behind the requests that wait already. Only on a blocking thread.
    pub(super) fn resume(&mut self) {
        if self.held.is_none() {
            let _waits = Waiting::enter(&self.load);
            // The permits are never closed; without a permit the work would end all the same.
            self.held = Handle::current().block_on(Arc::clone(&self.permits).acquire_owned()).ok().map(HeldPermit::new);
            self.since = Instant::now();
        }
    }

    /// Whether others hold all permits, so that a permit that is given back may not be free again soon.
    pub(super) fn is_contended(&self) -> bool {
        self.permits.available_permits() == 0
    }

    /// Whether the holder has had the permit for long and somebody may wait.
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
        // The number is twice that of the processors, because some requests wait for their readers.
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
    Ok(tidemap_base::task::blocking(work).await?)
}

/// Runs work on a blocking thread, which keeps the permit until the work is done. The work gets a stop signal at
/// `within` after its start, or when nobody waits for it any more: the client is gone, or the deadline of its call has
/// passed.
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

/// Sets the stop signal of the work when it is dropped, because nobody waits any more.
struct Awaited(Arc<AtomicBool>);

impl Drop for Awaited {
    fn drop(&mut self) {
        self.0.store(true, Ordering::Relaxed);
    }
}

impl Permits {
    /// Creates `max` permits.
    pub(super) fn new(max: usize) -> Self {
        Self { permits: Arc::new(Semaphore::new(max)), max, patience: PERMIT_WITHIN, load: Arc::default() }
    }

    /// Limits the wait for these permits: a request that is foreseen to wait for longer than `patience` is refused.
    pub(super) fn beginning_within(self, patience: Duration) -> Self {
        Self { patience, ..self }
    }

    /// Refuses a request, the last of `waiting` ones, if it would wait for too long.
    fn foresee(&self, waiting: usize) -> Result<(), RpcError> {
        let computed = Duration::from_nanos(self.load.computed_nanos.load(Ordering::Relaxed));
        let wait = computed.mul_f64(waiting as f64 / self.max as f64);
        if waiting <= QUEUED_PER_PERMIT * self.max || wait <= self.patience {
            return Ok(());
        }
        metrics::counter!("tidemap_requests_refused").increment(1);
        Err(RpcError::Overloaded { waiting: waiting - 1, wait })
    }

    /// Waits for a permit, which is given back when it is dropped.
    ///
    /// # Errors
    /// [`RpcError::Overloaded`] if that would take too long, [`RpcError::Busy`] if none was free in time.
    pub(super) async fn take(&self) -> Result<Permit, RpcError> {
        let permit = match Arc::clone(&self.permits).try_acquire_owned() {
            Ok(permit) => permit,
            Err(_) => {
                let (_waits, waiting) = Waiting::enter(&self.load);
                self.foresee(waiting)?;
                let permit = tokio::time::timeout(PERMIT_WITHIN, Arc::clone(&self.permits).acquire_owned()).await;
                let busy = |_| RpcError::Busy { max: self.max, secs: PERMIT_WITHIN.as_secs() };
                permit.map_err(busy)?.map_err(|_| RpcError::Stopping)?
            }
        };
        Ok(Permit {
            permits: Arc::clone(&self.permits),
            load: Arc::clone(&self.load),
            held: Some(HeldPermit::new(permit)),
            since: Instant::now(),
            computed: Duration::ZERO,
        })
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[tokio::test]
    async fn a_request_that_would_wait_for_long_is_refused_at_once() {
        let permits = Permits::new(1).beginning_within(PROMPT);
        let mut held = permits.take().await.expect("the first");
        // A computation takes an hour here.
        held.computed = Duration::from_secs(3600);
        drop(held);
        let held = permits.take().await.expect("it is free again");
        let queue: Vec<_> = (0..QUEUED_PER_PERMIT)
            .map(|_| {
                let permits = permits.clone();
                tokio::spawn(async move { permits.take().await.map(drop) })
            })
            .collect();
        while permits.load.waiting.load(Ordering::Relaxed) < QUEUED_PER_PERMIT {
            tokio::task::yield_now().await;
        }
        let refused = permits.take().await.expect_err("too many wait");
        assert!(matches!(refused, RpcError::Overloaded { waiting: QUEUED_PER_PERMIT, .. }), "{refused}");
        drop(held);
        for waiting in queue {
            waiting.await.expect("no panic").expect("its turn");
        }
        assert_eq!(permits.load.waiting.load(Ordering::Relaxed), 0);
    }

    #[tokio::test]
    async fn short_requests_may_wait_in_a_long_queue() {
        let permits = Permits::new(1).beginning_within(PROMPT);
        permits.load.note(Duration::from_micros(800));
        assert!(permits.foresee(500).is_ok());
        assert!(permits.foresee(5_000).is_err());
        assert!(Permits::new(1).foresee(5_000).is_ok(), "nothing is known of their time");
    }
}
