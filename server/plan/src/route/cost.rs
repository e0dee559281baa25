//! The cost of an edge under an objective.
//!
//! Invariant: costs are finite, not negative, and add up along a route; they are compared by their first part, then by
//! the second. The first part of [`Objective::Success`] is a whole number, so that its sums are exact and ties are
//! exact.

use std::cmp::Ordering;

use super::{Objective, forecast::expected_secs};

/// The step of -ln p where ties matter.
pub(super) const LOG_STEP: f64 = 1e-12;

/// The cost of a route or of a part of it.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(super) struct Cost {
    pub first: f64,
    /// Breaks ties of the first part.
    pub then: f64,
}

impl Eq for Cost {}

impl Ord for Cost {
    fn cmp(&self, other: &Cost) -> Ordering {
        self.first.total_cmp(&other.first).then(self.then.total_cmp(&other.then))
    }
}

impl PartialOrd for Cost {
    fn partial_cmp(&self, other: &Cost) -> Option<Ordering> {
        Some(self.cmp(other))
    }
}

impl Cost {
    pub(super) const ZERO: Cost = Cost { first: 0.0, then: 0.0 };
    pub(crate) const INFINITE: Cost = Cost { first: f64::INFINITY, then: f64::INFINITY };

    pub(super) fn plus(self, other: Cost) -> Cost {
        Cost { first: self.first + other.first, then: self.then + other.then }
    }

    /// The lesser of both parts, each by itself: a lower bound of both in either order.
    pub(super) fn least(self, other: Cost) -> Cost {
        Cost { first: self.first.min(other.first), then: self.then.min(other.then) }
    }

    /// Whether a lower bound excludes costs at or below `limit`; sums in another order may differ in their last digits.
    pub(super) fn is_beyond(self, limit: Cost) -> bool {
        let above = |found: f64, bound: f64| found > bound * (1.0 + 1e-12);
        above(self.first, limit.first) || (self.first == limit.first && above(self.then, limit.then))
    }
}

/// The options that price a traversal.
#[derive(Clone, Copy, Debug)]
pub(super) struct Costing {
    pub objective: Objective,
    pub recovery_secs: f64,
    pub failure_cost_secs: f64,
    pub encounter_cost_secs: f64,
}

impl Costing {
    /// The cost of a traversal; it falls with the success and rises with the duration and the encounters.
    pub(super) fn cost(&self, success: f64, duration_secs: f64, encounters: f64) -> Cost {
        let avoided_secs = self.encounter_cost_secs * encounters;
        let secs = expected_secs(success, duration_secs, self.recovery_secs) + avoided_secs;
        // Adding 0 makes -0 a 0.
        let doubt = -success.ln() + 0.0;
        match self.objective {
            Objective::Success => Cost { first: (doubt / LOG_STEP).round(), then: secs },
            Objective::Time => Cost { first: secs, then: doubt },
            Objective::Blend { weight } => {
                Cost { first: (1.0 - weight) * secs + weight * self.failure_cost_secs * doubt, then: secs }
            }
        }
    }

    /// The cost as reported to the user.
    pub(super) fn reported(&self, cost: Cost) -> f64 {
        if self.objective == Objective::Success { cost.first * LOG_STEP } else { cost.first }
    }
}
