//! Replies that are computed off the async threads and wait for their reader.
//!
//! Invariant: the wait for a reader is bounded, for all its replies together. Replies that end early end with an error,
//! so that a part is never taken for the whole. Work that waits for a reader holds no permit to compute.

use std::{
    sync::{Arc, Mutex, PoisonError},
    time::{Duration, Instant},
};

use tokio::{runtime::Handle, sync::mpsc};
use tokio_stream::wrappers::ReceiverStream;
use tonic::Status;

use super::{
    permits::{Permit, run_blocking},
    status::RpcError,
};

/// Number of replies that are computed before the reader takes them.
const REPLIES_AHEAD: usize = 8;
/// The time to read all replies.
const READ_WITHIN: Duration = Duration::from_secs(30);
/// Work that waits for its reader keeps its memory for this long.
const KEPT_FOR: Duration = Duration::from_millis(100);

/// A stream of replies.
pub(super) type Replies<T> = ReceiverStream<Result<T, Status>>;

/// Sends computed replies.
#[derive(Clone, Debug)]
pub(super) struct ReplySink<T> {
    ready: mpsc::Sender<Result<T, RpcError>>,
    /// The permits to compute that the sending work holds.
    permits: Option<Arc<Mutex<Vec<Permit>>>>,
}

impl<T> ReplySink<T> {
    /// Returns this sink for work that holds permits until it drops the sink. The permits are free while the work waits
    /// for the reader.
    pub(super) fn holding(self, permits: Vec<Permit>) -> Self {
        Self { permits: Some(Arc::new(Mutex::new(permits))), ..self }
    }

    /// Sends a reply when there is room. Returns `false` if the client is gone. Only on a blocking thread.
    pub(super) fn send(&self, reply: T) -> bool {
        self.send_freeing(reply, || ())
    }

    /// Does the same as [`ReplySink::send`], for work that holds much memory and can compute its content again: `free`
    /// is called before a longer wait, for the reader or for a permit, and perhaps more than once.
    pub(super) fn send_freeing(&self, reply: T, mut free: impl FnMut()) -> bool {
        match self.ready.try_send(Ok(reply)) {
            Ok(()) => {
                if self.any_permit(Permit::is_due) {
                    free();
                    // All permits are paused: work that waited for one permit and held another would block those who
                    // wait for the other.
                    self.with_permits(Permit::pause);
                    self.with_permits(Permit::resume);
                }
                true
            }
            Err(mpsc::error::TrySendError::Full(reply)) => {
                self.with_permits(Permit::pause);
                let room = tokio::time::timeout(KEPT_FOR, self.ready.reserve());
                let is_sent = match Handle::current().block_on(async { room.await.map(|room| room.map(drop)) }) {
                    // Only this work sends, so that the room is still there.
                    Ok(Ok(())) => self.ready.blocking_send(reply).is_ok(),
                    Ok(Err(_)) => false,
                    Err(_) => {
                        free();
                        self.ready.blocking_send(reply).is_ok()
                    }
                };
                if is_sent {
                    if self.any_permit(Permit::is_contended) {
                        free();
                    }
                    self.with_permits(Permit::resume);
                }
                is_sent
            }
            Err(mpsc::error::TrySendError::Closed(_)) => false,
        }
    }

    fn any_permit(&self, which: impl Fn(&Permit) -> bool) -> bool {
        let permits = self.permits.as_ref().map(|permits| permits.lock().unwrap_or_else(PoisonError::into_inner));
        permits.is_some_and(|permits| permits.iter().any(which))
    }

    fn with_permits(&self, each: impl FnMut(&mut Permit)) {
        if let Some(permits) = &self.permits {
            permits.lock().unwrap_or_else(PoisonError::into_inner).iter_mut().for_each(each);
        }
    }

    /// Whether the client is gone.
    pub(super) fn is_closed(&self) -> bool {
        self.ready.is_closed()
    }

    /// Ends when the client is gone.
    pub(super) async fn closed(&self) {
        self.ready.closed().await;
    }
}

/// The replies that `work` computes in a blocking thread. The permits are held until it ends, but not while it waits
/// for the reader.
pub(super) fn compute_replies<T: Send + 'static>(
    permits: Vec<Permit>,
    work: impl FnOnce(&ReplySink<T>) -> Result<(), RpcError> + Send + 'static,
) -> Replies<T> {
    stream_replies(|sink| async move {
        let sink = sink.holding(permits);
        run_blocking((), move || work(&sink)).await?
    })
}

/// The replies that async `work` sends; the work takes its permits itself.
pub(super) fn stream_replies<T: Send + 'static, W>(work: impl FnOnce(ReplySink<T>) -> W) -> Replies<T>
where
    W: Future<Output = Result<(), RpcError>> + Send + 'static,
{
    let (sink, ready) = mpsc::channel(1);
    let (replies, stream) = mpsc::channel(REPLIES_AHEAD);
    let work = work(ReplySink { ready: sink.clone(), permits: None });
    let work = tidemap_base::task::spawn(async move {
        if let Err(error) = work.await {
            // The client may be gone.
            let _ = sink.send(Err(error)).await;
        }
    });
    tidemap_base::task::spawn(async move {
        let all_sent = pass_on(ready, &replies, READ_WITHIN).await;
        if work.await.is_err() && all_sent {
            // The reader must not take a part of the replies for all of them.
            let _ = tokio::time::timeout(READ_WITHIN, replies.send(Err(RpcError::Stopping.into()))).await;
        }
    });
    ReceiverStream::new(stream)
}

/// Passes replies to the reader until all are sent, the reader is gone, or the reader is too slow, which the last reply
/// states. Returns whether all were sent.
async fn pass_on<T>(
    mut ready: mpsc::Receiver<Result<T, RpcError>>,
    replies: &mpsc::Sender<Result<T, Status>>,
    read_within: Duration,
) -> bool {
    // The room is reserved now: when the reader is slow, there is no room for the last reply.
    let Ok(last_word) = replies.clone().reserve_owned().await else { return false };
    let mut left = read_within;
    loop {
        // This ends also while no reply is ready, so that work that computes for long notices that the reader is gone.
        let reply = tokio::select! {
            reply = ready.recv() => reply,
            () = replies.closed() => return false,
        };
        let Some(reply) = reply else { return true };
        let began = Instant::now();
        match tokio::time::timeout(left, replies.send(reply.map_err(Status::from))).await {
            Ok(Ok(())) => left = left.saturating_sub(began.elapsed()),
            Ok(Err(_)) => return false,
            Err(_) => {
                last_word.send(Err(RpcError::SlowReader(read_within.as_secs()).into()));
                return false;
            }
        }
    }
}

#[cfg(test)]
mod tests {
    use tokio_stream::StreamExt as _;

    use super::*;
    use crate::permits::Permits;

    #[tokio::test]
    async fn a_slow_reader_gets_an_error_and_is_not_waited_for() {
        let (sink, ready) = mpsc::channel(1);
        let (replies, mut stream) = mpsc::channel(3);
        let passing = tokio::spawn(async move { pass_on(ready, &replies, Duration::from_millis(20)).await });
        while sink.send(Ok(7)).await.is_ok() {}
        assert!(!passing.await.expect("no panic"));
        // Earlier replies are still read, then the reason of the end.
        assert!(stream.recv().await.expect("a reply").is_ok());
        assert!(stream.recv().await.expect("a reply").is_ok());
        let end = stream.recv().await.expect("an error").expect_err("too slow");
        assert_eq!(end.code(), tonic::Code::ResourceExhausted);
        assert!(stream.recv().await.is_none());
    }

    #[tokio::test]
    async fn a_reader_that_takes_a_reply_now_and_then_is_not_waited_for_longer() {
        let (sink, ready) = mpsc::channel(1);
        let (replies, mut stream) = mpsc::channel(2);
        let passing = tokio::spawn(async move { pass_on(ready, &replies, Duration::from_millis(50)).await });
        let computing = tokio::spawn(async move { while sink.send(Ok(7)).await.is_ok() {} });
        // Each reply is in time, but not all of them together.
        let mut end = None;
        while let Some(reply) = stream.recv().await {
            end = reply.err();
            tokio::time::sleep(Duration::from_millis(5)).await;
        }
        assert_eq!(end.map(|end| end.code()), Some(tonic::Code::ResourceExhausted));
        assert!(!passing.await.expect("no panic"));
        computing.await.expect("no panic");
    }

    #[tokio::test(flavor = "multi_thread")]
    async fn who_waits_for_a_reader_holds_no_permit() {
        let permits = Permits::new(1);
        let mut unread = compute_replies(vec![permits.take().await.expect("a permit")], |sink| {
            while sink.send(7) {}
            Ok(())
        });
        assert!(unread.next().await.expect("a reply").is_ok());
        // The first work computes replies as far as there is room before its reader takes them; then others have their
        // turn.
        for _ in 0..3 {
            let permit = tokio::time::timeout(Duration::from_secs(10), permits.take()).await.expect("a turn");
            let replies = compute_replies(vec![permit.expect("a permit")], |sink| {
                assert!(sink.send(1));
                Ok(())
            });
            assert_eq!(replies.collect::<Vec<_>>().await.len(), 1);
        }
        assert!(unread.next().await.expect("the first goes on").is_ok());
    }

    #[tokio::test(flavor = "multi_thread")]
    async fn long_computations_take_turns() {
        let permits = Permits::new(1);
        let counting = |permit| {
            compute_replies(vec![permit], |sink| {
                for number in 0..4 {
                    std::thread::sleep(Duration::from_millis(60));
                    if !sink.send((number, Instant::now())) {
                        break;
                    }
                }
                Ok(())
            })
        };
        let first = counting(permits.take().await.expect("a permit"));
        let second = permits.take();
        let first = tokio::spawn(first.collect::<Vec<_>>());
        let second = counting(second.await.expect("a turn")).collect::<Vec<_>>().await;
        let first = first.await.expect("no panic");
        let times = |replies: Vec<Result<(i32, Instant), Status>>| {
            replies.into_iter().map(|reply| reply.expect("a reply").1).collect::<Vec<_>>()
        };
        let (first, second) = (times(first), times(second));
        assert_eq!((first.len(), second.len()), (4, 4));
        assert!(second[0] < first[3], "the second did not wait for the end of the first");
    }

    #[tokio::test(flavor = "multi_thread")]
    async fn who_gives_others_a_turn_gives_all_permits() {
        let (past, large) = (Permits::new(1), Permits::new(1));
        let take = || async { vec![past.take().await.expect("a permit"), large.take().await.expect("a permit")] };
        let counting = |permits| {
            compute_replies(permits, |sink| {
                for number in 0..4 {
                    std::thread::sleep(Duration::from_millis(60));
                    assert!(sink.send(number));
                }
                Ok(())
            })
        };
        let first = tokio::spawn(counting(take().await).collect::<Vec<_>>());
        let both = async { (counting(take().await).collect::<Vec<_>>().await, first.await.expect("no panic")) };
        let (second, first) = tokio::time::timeout(Duration::from_secs(20), both).await.expect("nobody waits for ever");
        assert_eq!((first.len(), second.len()), (4, 4));
    }

    #[tokio::test(flavor = "multi_thread")]
    async fn who_computes_for_long_learns_that_the_reader_is_gone() {
        let permits = Permits::new(1);
        let replies = compute_replies::<()>(vec![permits.take().await.expect("a permit")], |sink| {
            while !sink.is_closed() {
                std::thread::yield_now();
            }
            Ok(())
        });
        drop(replies);
        let permit = tokio::time::timeout(Duration::from_secs(10), permits.take()).await;
        assert!(permit.expect("the work has ended").is_ok());
    }

    #[tokio::test]
    async fn an_error_ends_the_replies() {
        let permit = || async { Permits::default().take().await.expect("a permit") };
        let replies: Vec<_> = compute_replies(vec![permit().await], |sink| {
            assert!(sink.send(1) && sink.send(2));
            Err(RpcError::UnknownJob(3))
        })
        .collect()
        .await;
        let codes: Vec<_> =
            replies.into_iter().map(|reply: Result<i32, Status>| reply.map_err(|end| end.code())).collect();
        assert_eq!(codes, [Ok(1), Ok(2), Err(tonic::Code::NotFound)]);
        assert_eq!(
            compute_replies(vec![permit().await], |sink| {
                sink.send(1);
                Ok(())
            })
            .collect::<Vec<_>>()
            .await
            .len(),
            1
        );
    }
}
