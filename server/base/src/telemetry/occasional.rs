//! Log lines that strangers can cause. They are written at a bounded rate.
//!
//! Invariant: at most one line per [`EVERY`] is written for each [`Occasional`]; the line contains the number of lines
//! that were left out since the one before.

use std::{
    sync::{Mutex, PoisonError},
    time::{Duration, Instant},
};

/// Least time between two lines.
const EVERY: Duration = Duration::from_secs(1);

/// The time of the last line of one kind, and the number of lines left out since.
#[derive(Debug)]
pub struct Occasional(Mutex<(Option<Instant>, u64)>);

impl Default for Occasional {
    fn default() -> Self {
        Self::new()
    }
}

impl Occasional {
    /// No line was written yet.
    pub const fn new() -> Self {
        Self(Mutex::new((None, 0)))
    }

    /// Whether the next line may be written now; returns the number of lines that were left out before it.
    pub fn next(&self) -> Option<u64> {
        let mut state = self.0.lock().unwrap_or_else(PoisonError::into_inner);
        let (written, left_out) = &mut *state;
        if written.is_some_and(|written| written.elapsed() < EVERY) {
            *left_out += 1;
            return None;
        }
        *written = Some(Instant::now());
        Some(std::mem::take(left_out))
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn lines_are_left_out_and_counted() {
        let lines = Occasional::new();
        assert_eq!(lines.next(), Some(0));
        assert_eq!([lines.next(), lines.next()], [None, None]);
        lines.0.lock().expect("sound").0 = Instant::now().checked_sub(EVERY);
        assert_eq!(lines.next(), Some(2));
        assert_eq!(lines.next(), None);
    }
}
