//! The pace of an update: how much of it is done, and when it may go on.
//!
//! Invariant: an update computes the same, whatever its pace.

use std::sync::atomic::{AtomicU64, Ordering};

/// The pace of an update. It is asked from all threads of the update at once.
pub trait Pace: Sync {
    /// This many more states and tiles are done.
    fn add_done(&self, parts: u64);

    /// Returns when the update may compute its next piece. Each piece is small: a local day of a state, a part of the
    /// scans of a tile. The default never waits.
    fn await_turn(&self) {}
}

/// Counts, and never waits.
impl Pace for AtomicU64 {
    fn add_done(&self, parts: u64) {
        self.fetch_add(parts, Ordering::Relaxed);
    }
}
