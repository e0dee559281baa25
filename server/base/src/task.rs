//! Work on a thread that may block, and work beside the caller.
//!
//! Invariant: tokio sees one type of each. For every type of task it generates dozens of functions, which took a tenth
//! of the compile time of this crate.

use std::{
    future::Future,
    pin::Pin,
    task::{Context, Poll},
};

use tokio::sync::oneshot;

/// The work ended without a result.
#[derive(Debug, thiserror::Error)]
#[error("the work ended without a result: it panicked, or the daemon stops")]
pub struct NoResult;

/// Started work, and its result when it is awaited. Dropping this does not stop the work.
#[derive(Debug)]
pub struct Task<T>(oneshot::Receiver<T>);

impl<T> Future for Task<T> {
    type Output = Result<T, NoResult>;

    fn poll(mut self: Pin<&mut Self>, context: &mut Context<'_>) -> Poll<Self::Output> {
        Pin::new(&mut self.0).poll(context).map_err(|_| NoResult)
    }
}

/// Starts work on a thread that may block, for the disk or for long computations.
pub fn blocking<T: Send + 'static>(work: impl FnOnce() -> T + Send + 'static) -> Task<T> {
    let (sender, result) = oneshot::channel();
    let work: Box<dyn FnOnce() + Send> = Box::new(move || drop(sender.send(work())));
    drop(tokio::task::spawn_blocking(work));
    Task(result)
}

/// Starts work beside the caller.
pub fn spawn<T: Send + 'static>(work: impl Future<Output = T> + Send + 'static) -> Task<T> {
    let (sender, result) = oneshot::channel();
    let work: Pin<Box<dyn Future<Output = ()> + Send>> = Box::pin(async move { drop(sender.send(work.await)) });
    drop(tokio::spawn(work));
    Task(result)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[tokio::test]
    async fn work_has_a_result_or_reports_that_it_has_none() {
        assert_eq!(blocking(|| 7).await.expect("a result"), 7);
        assert_eq!(spawn(async { "done" }).await.expect("a result"), "done");
        assert!(blocking(|| -> u8 { panic!("a defect") }).await.is_err());
        assert!(spawn(async { panic!("a defect") }).await.map(|(): ()| ()).is_err());
    }

    #[tokio::test]
    async fn work_goes_on_when_nobody_waits() {
        let (sender, done) = oneshot::channel();
        drop(blocking(move || sender.send(1)));
        assert_eq!(done.await, Ok(1));
        let (sender, done) = oneshot::channel();
        drop(spawn(async move { sender.send(2) }));
        assert_eq!(done.await, Ok(2));
    }
}
