//! Requests that wait for their turn: the client sends no more at a time than a daemon takes from one client, and sends
//! a request again if the daemon has no room.
//!
//! Invariant: a request is sent again only if the daemon did nothing, and stated the time of the next attempt.

use std::{
    future::Future,
    hash::{BuildHasher as _, RandomState},
    sync::Arc,
    time::Duration,
};

use tidemap_client::{Error, error::retry_after};
use tokio::{
    sync::{OwnedSemaphorePermit, Semaphore},
    time::Instant,
};
use tonic::Status;

/// Requests of a client at a time: half of the number that a daemon takes from one client by default.
const AT_ONCE: usize = 64;
/// A request that found no room for this long is given up.
const PATIENCE: Duration = Duration::from_secs(60);
/// Least time between two tries; it doubles with each try, up to the longest.
const FIRST_PAUSE: Duration = Duration::from_millis(50);
const LONGEST_PAUSE: Duration = Duration::from_secs(5);

/// An error that may state when the same request will find room.
pub(crate) trait Hint {
    /// After which time; `None`: it is final.
    fn hint(&self) -> Option<Duration>;
}

impl Hint for Error {
    fn hint(&self) -> Option<Duration> {
        self.retry_after()
    }
}

impl Hint for Status {
    fn hint(&self) -> Option<Duration> {
        retry_after(self)
    }
}

/// The turns of a client. Clones share them.
#[derive(Clone)]
pub(crate) struct Room(Arc<Semaphore>);

/// A turn, which is over when it is dropped.
pub(crate) struct Turn {
    _permit: Option<OwnedSemaphorePermit>,
}

impl Room {
    /// Makes a room in which all turns are free.
    pub(crate) fn new() -> Self {
        Self(Arc::new(Semaphore::new(AT_ONCE)))
    }

    /// Sends a request when its turn comes, and again as long as the daemon has no room. Returns the reply, with the
    /// turn of the request.
    pub(crate) async fn ask<T, E: Hint, F: Future<Output = Result<T, E>>>(
        &self,
        ask: impl Fn() -> F,
    ) -> Result<(T, Turn), E> {
        let mut until = None;
        let mut pause = FIRST_PAUSE;
        loop {
            // The semaphore is never closed.
            let turn = Turn { _permit: Arc::clone(&self.0).acquire_owned().await.ok() };
            let until = *until.get_or_insert_with(|| Instant::now() + PATIENCE);
            let error = match ask().await {
                Ok(answer) => return Ok((answer, turn)),
                Err(error) => error,
            };
            let Some(hint) = error.hint() else { return Err(error) };
            let wait = spread(hint.min(LONGEST_PAUSE).max(pause));
            if Instant::now() + wait > until {
                return Err(error);
            }
            drop(turn);
            tokio::time::sleep(wait).await;
            pause = (pause * 2).min(LONGEST_PAUSE);
        }
    }
}

/// A time between `wait` and two times `wait`, so that requests that were refused together do not come again together.
fn spread(wait: Duration) -> Duration {
    let random = RandomState::new().hash_one(0_u8);
    wait.mul_f64(1.0 + (random % 1024) as f64 / 1024.0)
}
