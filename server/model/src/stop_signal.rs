//! A signal that stops long work whose result is no longer needed.
//!
//! The caller of the work sets it: a client left, or its deadline passed. Work checks the signal in its inner loops,
//! every few thousand steps, because a check costs some nanoseconds. Invariant: a signal that is set stays set, so that
//! work that left a loop early finds it set again at its end, and returns [`EarlyStop`] instead of half a result.

use std::fmt;

/// Whether work has to stop.
#[derive(Clone, Copy)]
pub struct StopSignal<'a> {
    is_set: &'a (dyn Fn() -> bool + Sync),
}

/// The work was stopped: there is no result.
#[derive(Clone, Copy, Debug, PartialEq, Eq, thiserror::Error)]
#[error("nobody waits for the result any more")]
pub struct EarlyStop;

impl<'a> StopSignal<'a> {
    /// A signal that is never set.
    pub const NEVER: StopSignal<'static> = StopSignal { is_set: &|| false };

    /// A signal that is set as soon as the function returns `true`; it must return `true` from then on. It is called
    /// often, by all threads of the work.
    #[must_use]
    pub fn new(is_set: &'a (dyn Fn() -> bool + Sync)) -> StopSignal<'a> {
        StopSignal { is_set }
    }

    /// Whether the work has to stop.
    #[must_use]
    pub fn is_set(self) -> bool {
        (self.is_set)()
    }

    /// Checks whether the work may go on.
    ///
    /// # Errors
    /// [`EarlyStop`] if the work has to stop.
    pub fn check(self) -> Result<(), EarlyStop> {
        if self.is_set() { Err(EarlyStop) } else { Ok(()) }
    }
}

impl Default for StopSignal<'_> {
    fn default() -> Self {
        StopSignal::NEVER
    }
}

impl fmt::Debug for StopSignal<'_> {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.debug_struct("StopSignal").finish_non_exhaustive()
    }
}
