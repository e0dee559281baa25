//! The pace of an update: how much of the update is done, and when it may go on.
//!
//! Invariant: the result of an update does not depend on its pace.

use std::sync::atomic::{AtomicU64, Ordering};

/// The pace of an update. All threads of the update call it at once.
pub trait Pace: Sync {
    /// Reports that this many more states and tiles are done.
    fn add_done(&self, parts: u64);

    /// Returns when the update may compute its next piece. Each piece is small: a local day of a state, a part of the
    /// scans of a tile. The default never waits.
    fn await_turn(&self) {}
}

/// This pace counts, and never waits.
impl Pace for AtomicU64 {
    fn add_done(&self, parts: u64) {
        self.fetch_add(parts, Ordering::Relaxed);
    }
}
