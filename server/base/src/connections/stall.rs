//! The time for which a client takes nothing of the data that is sent to it.
//!
//! Invariant: a client that takes nothing for [`UNREAD_FOR`], in all its pauses together, has stalled. Bytes that the
//! client takes reduce this time, so that a slow link is no stall.

use std::{
    pin::Pin,
    task::{Context, Poll},
    time::Duration,
};

use tokio::time::{Instant, Sleep, sleep_until};

/// Maximum time for a client to take the data that was sent.
pub(super) const UNREAD_FOR: Duration = Duration::from_secs(30);
/// Number of bytes that reduce the time by one second.
const BYTES_PER_SEC: u32 = 16 << 10;

/// The pauses of a client.
#[derive(Debug, Default)]
pub(super) struct Stall {
    /// The sum of the pauses so far, minus the time for the bytes that were taken.
    paused: Duration,
    /// The present pause: its beginning, and when it is too long.
    now: Option<(Instant, Pin<Box<Sleep>>)>,
}

impl Stall {
    /// Records that the client took bytes.
    pub(super) fn note_taken(&mut self, bytes: usize) {
        if let Some((began, _)) = self.now.take() {
            self.paused += began.elapsed();
        }
        let back = Duration::from_secs(1) * u32::try_from(bytes).unwrap_or(u32::MAX) / BYTES_PER_SEC;
        self.paused = self.paused.saturating_sub(back);
    }

    /// Records that the client takes nothing now. Ready when the client has stalled; otherwise the task is woken when
    /// it has.
    pub(super) fn poll_stalled(&mut self, context: &mut Context<'_>) -> Poll<()> {
        let (_, until) = self.now.get_or_insert_with(|| {
            let began = Instant::now();
            (began, Box::pin(sleep_until(began + UNREAD_FOR.saturating_sub(self.paused))))
        });
        until.as_mut().poll(context)
    }

    /// The beginning of the present pause.
    pub(super) fn began(&self) -> Option<Instant> {
        self.now.as_ref().map(|(began, _)| *began)
    }
}

#[cfg(test)]
mod tests {
    use std::future::poll_fn;

    use super::*;

    async fn stalls_within(stall: &mut Stall, time: Duration) -> bool {
        tokio::time::timeout(time, poll_fn(|context| stall.poll_stalled(context))).await.is_ok()
    }

    #[tokio::test(start_paused = true)]
    async fn pauses_add_up_and_bytes_give_time_back() {
        let mut stall = Stall::default();
        for _ in 0..2 {
            assert!(!stalls_within(&mut stall, UNREAD_FOR / 3).await);
            stall.note_taken(1);
        }
        assert!(stalls_within(&mut stall, UNREAD_FOR / 2).await, "a byte now and then is no reading");
        stall.note_taken(1 << 20);
        for _ in 0..10 {
            assert!(!stalls_within(&mut stall, UNREAD_FOR / 3).await);
            stall.note_taken(BYTES_PER_SEC as usize * 10);
        }
        assert!(stalls_within(&mut stall, 2 * UNREAD_FOR).await);
    }
}
