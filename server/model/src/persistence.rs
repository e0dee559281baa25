//! Persistence: how long a state usually keeps its value, and how much the last observation still matters.
//!
//! Unlike the spectral model, persistence depends on the order of arrival: only observations newer than the last one
//! count. Invariant: 1/τ is finite and not negative, and the last value is one that the state's kind allows.

use crate::{InvalidParts, StateKind};

mod memory;

#[cfg(test)]
mod tests;

pub use memory::MemoryBasis;

/// The prior of τ, with the weight of one pair of observations.
const PRIOR_TAU_SECS: f64 = 3600.0;

/// The persistence model of one state, T-RO section III.D.
#[derive(Clone, Copy, Debug, PartialEq, Default)]
pub struct Persistence {
    parts: PersistenceParts,
}

/// The parts of a [`Persistence`], for storage.
#[derive(Clone, Copy, Debug, PartialEq, Default)]
pub struct PersistenceParts {
    /// Number m of pairs of successive observations.
    pub pairs: u64,
    /// Sum over pairs of |change of value| / time between, per second.
    pub change_rate_sum: f64,
    /// UTC nanoseconds and value of the newest observation.
    pub last: Option<(i64, f64)>,
}

impl Persistence {
    /// Learns an observation whose value the state's kind allows. An observation that is not newer than the last one
    /// changes nothing (T-RO eq. 12).
    pub fn observe(&mut self, utc_nanos: i64, value: f64) {
        if let Some((last_nanos, last_value)) = self.parts.last {
            if utc_nanos <= last_nanos {
                return;
            }
            self.parts.pairs = self.parts.pairs.saturating_add(1);
            self.parts.change_rate_sum += (value - last_value).abs() / secs_between(last_nanos, utc_nanos);
            debug_assert!(self.parts.change_rate_sum.is_finite(), "the rate of changes from {last_value} to {value}");
        }
        self.parts.last = Some((utc_nanos, value));
    }

    /// Records that the newest value has held up to a time, as if it had been observed every `step_nanos` until then. A
    /// time that is not newer changes nothing.
    pub fn hold(&mut self, until_nanos: i64, step_nanos: i64) {
        let Some((last_nanos, value)) = self.parts.last.filter(|(last, _)| *last < until_nanos) else { return };
        let steps = until_nanos.abs_diff(last_nanos).div_ceil(step_nanos.unsigned_abs().max(1));
        self.parts.pairs = self.parts.pairs.saturating_add(steps);
        self.parts.last = Some((until_nanos, value));
    }

    /// UTC nanoseconds and value of the newest observation.
    pub fn last(&self) -> Option<(i64, f64)> {
        self.parts.last
    }

    /// Mean time between changes τ in seconds: 1/τ = (1/3600 + Σ |Δs|/Δt) / (1 + m), which is T-RO
    /// eq. 12 with a prior of one hour that weighs as much as one pair of observations.
    pub fn tau_secs(&self) -> f64 {
        self.tau_secs_of(1.0)
    }

    /// Does the same as [`Persistence::tau_secs`] for a state whose values change by `change` rather than by 1, such as
    /// from one standard deviation below their mean to one above it: changes are measured in units of `change`. A
    /// `change` that is not above 0 and finite counts as 1.
    pub fn tau_secs_of(&self, change: f64) -> f64 {
        let change = if change > 0.0 && change.is_finite() { change } else { 1.0 };
        (1.0 + self.parts.pairs as f64) / (1.0 / PRIOR_TAU_SECS + self.parts.change_rate_sum / change)
    }

    /// The long-term prediction `p` for a time, shrunk towards the last observed value by how recent it is (T-RO eq.
    /// 13). For a time before the last observation the result is `p`.
    pub fn blend(&self, p: f64, utc_nanos: i64) -> f64 {
        self.blend_of(1.0, p, utc_nanos)
    }

    /// Does the same as [`Persistence::blend`] for a state whose values change by `change`; see
    /// [`Persistence::tau_secs_of`].
    pub fn blend_of(&self, change: f64, p: f64, utc_nanos: i64) -> f64 {
        match self.parts.last {
            Some((last_nanos, last_value)) if utc_nanos >= last_nanos => {
                let weight = libm::exp(-secs_between(last_nanos, utc_nanos) / self.tau_secs_of(change));
                last_value * weight + p * (1.0 - weight)
            }
            _ => p,
        }
    }

    /// The parts to store.
    pub fn to_parts(&self) -> PersistenceParts {
        self.parts
    }

    /// The model of a probability from stored parts.
    ///
    /// # Errors
    /// [`InvalidParts`] where a number is outside its range.
    pub fn from_parts(parts: PersistenceParts) -> Result<Persistence, InvalidParts> {
        Persistence::from_parts_of(StateKind::Probability, parts)
    }

    /// The model of a state of the given kind from stored parts.
    ///
    /// # Errors
    /// The errors of [`Persistence::from_parts`].
    pub fn from_parts_of(kind: StateKind, parts: PersistenceParts) -> Result<Persistence, InvalidParts> {
        InvalidParts::check("change_rate_sum", parts.change_rate_sum, 0.0..=f64::MAX)?;
        if let Some((_, value)) = parts.last {
            InvalidParts::check("last value", value, kind.bounds())?;
        }
        Ok(Persistence { parts })
    }
}

/// Seconds from one time to a later one; the difference may exceed i64.
fn secs_between(earlier_nanos: i64, later_nanos: i64) -> f64 {
    later_nanos.abs_diff(earlier_nanos) as f64 / 1e9
}
