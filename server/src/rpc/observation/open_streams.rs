//! The open streams of observations: how many there are, and which one makes room for the next.
//!
//! Invariant: at most as many streams stay as the limit says. When it is reached, one that has not said hello makes
//! room, or the one that was silent for longest, if it was silent for a given time and all that it sent is
//! acknowledged. If there is none, the new stream is refused.

use std::{
    collections::HashMap,
    sync::{
        Arc, Mutex, MutexGuard, PoisonError,
        atomic::{AtomicBool, AtomicU64, Ordering},
    },
    time::{Duration, Instant},
};

use tidemap_proto::convert::OverLimit;
use tokio::sync::watch;

/// The open streams. Clones share them.
#[derive(Clone, Debug)]
pub(crate) struct OpenStreams {
    max: usize,
    idle_after: Duration,
    open: Arc<Mutex<Open>>,
}

#[derive(Debug, Default)]
struct Open {
    streams: HashMap<u64, Arc<Activity>>,
    next: u64,
}

/// What is known of an open stream.
#[derive(Debug)]
struct Activity {
    opened: Instant,
    /// Milliseconds from `opened` to its last message, and one more; 0 before its Hello.
    active_after_millis: AtomicU64,
    /// Something that it sent is not acknowledged.
    is_unacknowledged: AtomicBool,
    is_displaced: watch::Sender<bool>,
}

impl Activity {
    /// Which of two streams makes room first: those that have not said hello, then those silent for longest.
    fn rank(&self, idle_after: Duration, now: Instant) -> Option<(bool, Duration)> {
        if *self.is_displaced.borrow() || self.is_unacknowledged.load(Ordering::Acquire) {
            return None;
        }
        let silent_since = match self.active_after_millis.load(Ordering::Acquire).checked_sub(1) {
            None => return Some((true, now.saturating_duration_since(self.opened))),
            Some(millis) => self.opened + Duration::from_millis(millis),
        };
        let silent = now.saturating_duration_since(silent_since);
        (silent >= idle_after).then_some((false, silent))
    }
}

/// The entry of an open stream; taken out when dropped.
#[derive(Debug)]
pub(super) struct StreamEntry {
    number: u64,
    activity: Arc<Activity>,
    displaced: watch::Receiver<bool>,
    streams: OpenStreams,
}

impl Drop for StreamEntry {
    fn drop(&mut self) {
        let mut open = self.streams.lock();
        open.streams.remove(&self.number);
        metrics::gauge!("tidemap_streams").set(open.streams.len() as f64);
    }
}

impl OpenStreams {
    /// No streams; at most `max`, of which one that was silent for `idle_after` makes room.
    pub(crate) fn new(max: usize, idle_after: Duration) -> Self {
        Self { max, idle_after, open: Arc::default() }
    }

    fn lock(&self) -> MutexGuard<'_, Open> {
        self.open.lock().unwrap_or_else(PoisonError::into_inner)
    }

    /// How long a stream was silent that makes room.
    pub(super) fn idle_after(&self) -> Duration {
        self.idle_after
    }

    /// Enters a new stream; another one makes room if it has to.
    ///
    /// # Errors
    /// All others are in use.
    pub(super) fn enter(&self) -> Result<StreamEntry, OverLimit> {
        let now = Instant::now();
        let mut open = self.lock();
        // Most of the time the limit is far away, and nothing is counted one by one.
        if open.streams.len() >= self.max {
            let staying = open.streams.values().filter(|stream| !*stream.is_displaced.borrow()).count();
            let ranked = open.streams.values().filter_map(|stream| Some((stream.rank(self.idle_after, now)?, stream)));
            match ranked.max_by_key(|(rank, _)| *rank) {
                _ if staying < self.max => {}
                Some((_, stream)) => {
                    stream.is_displaced.send_replace(true);
                    metrics::counter!("tidemap_streams_displaced_total").increment(1);
                }
                None => OverLimit::check("streams", staying + 1, self.max, "setting max_streams")?,
            }
        }
        let (is_displaced, displaced) = watch::channel(false);
        let activity = Arc::new(Activity {
            opened: now,
            active_after_millis: AtomicU64::new(0),
            is_unacknowledged: AtomicBool::new(false),
            is_displaced,
        });
        let number = open.next;
        open.next += 1;
        open.streams.insert(number, Arc::clone(&activity));
        metrics::gauge!("tidemap_streams").set(open.streams.len() as f64);
        drop(open);
        Ok(StreamEntry { number, activity, displaced, streams: self.clone() })
    }
}

impl StreamEntry {
    /// The stream has sent something now.
    pub(super) fn mark_active(&self) {
        let millis = u64::try_from(self.activity.opened.elapsed().as_millis()).unwrap_or(u64::MAX);
        self.activity.active_after_millis.store(millis.saturating_add(1), Ordering::Release);
    }

    /// Says whether something that the stream sent is not acknowledged.
    pub(super) fn set_unacknowledged(&self, is_unacknowledged: bool) {
        self.activity.is_unacknowledged.store(is_unacknowledged, Ordering::Release);
    }

    /// Waits until the stream has to make room.
    pub(super) async fn displaced(&mut self) {
        // The sender is part of the entry, so that it cannot be gone.
        let _ = self.displaced.wait_for(|is_displaced| *is_displaced).await;
    }

    /// How long a stream was silent that makes room.
    pub(super) fn idle_after(&self) -> Duration {
        self.streams.idle_after()
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn is_displaced(entry: &StreamEntry) -> bool {
        *entry.displaced.borrow()
    }

    #[test]
    fn the_stream_that_was_silent_for_longest_makes_room() {
        let streams = OpenStreams::new(3, Duration::ZERO);
        let [first, second, third] = [(); 3].map(|()| streams.enter().expect("room"));
        for entry in [&second, &first, &third] {
            entry.mark_active();
            std::thread::sleep(Duration::from_millis(2));
        }
        first.set_unacknowledged(true);
        let _fourth = streams.enter().expect("the second makes room");
        assert!(is_displaced(&second) && !is_displaced(&first) && !is_displaced(&third));
        // The fourth has not said hello.
        let fifth = streams.enter().expect("the fourth makes room");
        fifth.mark_active();
        assert!(is_displaced(&_fourth) && !is_displaced(&third));
        let _sixth = streams.enter().expect("the third makes room");
        assert!(is_displaced(&third) && !is_displaced(&first), "never one with something that is not acknowledged");
        drop((second, third));
        assert_eq!(streams.lock().streams.len(), 4);
    }

    #[test]
    fn streams_in_use_are_left_alone() {
        let streams = OpenStreams::new(1, Duration::from_secs(60));
        let first = streams.enter().expect("room");
        first.mark_active();
        let error = streams.enter().expect_err("the first was heard just now");
        assert!(error.to_string().contains("max_streams"), "{error}");
        assert!(!is_displaced(&first));
        drop(first);
        assert!(streams.enter().is_ok());
    }
}
