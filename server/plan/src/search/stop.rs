//! The rule that ends a search early.
//!
//! Invariant: a stop cuts off the end of a walk and changes nothing before it.

/// The rule that ends a walk before all places are visited; by default it never does.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct Stop {
    /// End once the probability of all goals not yet visited, over that of all goals, is below this; 0 to 1.
    pub remains_below: Option<f64>,
    /// The cost of a second of search, in units of the value of finding the target; at least 0. The walk ends where the
    /// remaining gain in probability is worth less than its expected time.
    pub cost_per_sec: Option<f64>,
    /// Seconds after the start by which the robot must be at the last place; at least 0. The order is that of an
    /// unlimited search.
    pub within_secs: Option<f64>,
}

/// The reason why a walk ends before all goals are visited.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum StopReason {
    /// The remaining probability is below the limit.
    Unlikely,
    /// The remaining gain is not worth the time.
    NotWorthIt,
    /// The time is over.
    OutOfTime,
}

/// The error for a limit of the stop rule that is out of range.
#[derive(Clone, Debug, PartialEq, thiserror::Error)]
pub enum StopError {
    /// The limit of the remaining probability is out of range.
    #[error("the remaining probability at which a search stops is {0}: expected 0 to 1")]
    Remains(f64),
    /// The cost of a second is out of range.
    #[error("the cost of a second of search is {0}: expected 0 or more")]
    Cost(f64),
    /// The time limit is out of range.
    #[error("the time limit of a search is {0} s: expected 0 or more")]
    Within(f64),
}

impl Stop {
    pub(super) fn check(&self) -> Result<(), StopError> {
        match (self.remains_below, self.cost_per_sec) {
            (Some(below), _) if !(0.0..=1.0).contains(&below) => Err(StopError::Remains(below)),
            (_, Some(cost)) if !(0.0..=f64::MAX).contains(&cost) => Err(StopError::Cost(cost)),
            _ => match self.within_secs.filter(|secs| !(0.0..=f64::MAX).contains(secs)) {
                Some(secs) => Err(StopError::Within(secs)),
                None => Ok(()),
            },
        }
    }
}
