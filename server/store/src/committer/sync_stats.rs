//! The durations of fdatasync on this disk.
//!
//! Invariant: only the newest durations are kept, so memory does not grow.

use std::{
    sync::{Mutex, PoisonError},
    time::Duration,
};

/// Durations that are kept.
const KEPT: usize = 4096;

/// The durations of fdatasync of the observation logs.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct SyncStats {
    /// Number of calls since the store was opened.
    pub count: u64,
    /// Half of the newest 4,096 were faster.
    pub p50: Duration,
    /// 99 % of the newest 4,096 were faster.
    pub p99: Duration,
}

/// The newest durations.
#[derive(Default)]
pub(super) struct SyncTimes(
    /// The lock is held to add one entry or to copy all, never during disk access.
    Mutex<Ring>,
);

#[derive(Default)]
struct Ring {
    durations: Vec<Duration>,
    count: u64,
}

impl SyncTimes {
    pub(super) fn add(&self, duration: Duration) {
        let mut ring = self.0.lock().unwrap_or_else(PoisonError::into_inner);
        let slot = (ring.count % KEPT as u64) as usize;
        match ring.durations.get_mut(slot) {
            Some(old) => *old = duration,
            None => ring.durations.push(duration),
        }
        ring.count += 1;
    }

    pub(super) fn stats(&self) -> SyncStats {
        let ring = self.0.lock().unwrap_or_else(PoisonError::into_inner);
        let (mut durations, count) = (ring.durations.clone(), ring.count);
        drop(ring);
        durations.sort_unstable();
        let at = |share: f64| {
            let index = (durations.len() as f64 * share) as usize;
            durations.get(index.min(durations.len().saturating_sub(1))).copied().unwrap_or_default()
        };
        SyncStats { count, p50: at(0.5), p99: at(0.99) }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn percentiles_are_those_of_the_newest() {
        let times = SyncTimes::default();
        assert_eq!(times.stats(), SyncStats::default());
        for _ in 0..KEPT {
            times.add(Duration::from_secs(9));
        }
        for millis in 0..KEPT as u64 {
            times.add(Duration::from_millis(millis));
        }
        let stats = times.stats();
        assert_eq!(stats.count, 2 * KEPT as u64);
        assert_eq!(stats.p50, Duration::from_millis(2048));
        assert_eq!(stats.p99, Duration::from_millis(4055));
    }
}
