//! Persistence: how long a state tends to keep its value, and what the last observation still says.
//!
//! Unlike the spectral model it depends on the order of arrival: only observations newer than the
//! last one count. Invariant: 1/τ is finite and not negative, and the last value lies in `[0,1]`.

use crate::InvalidParts;

#[cfg(test)]
mod tests;

/// τ before anything was observed, which keeps the weight of one pair of observations.
const PRIOR_TAU_SECS: f64 = 3600.0;

/// The persistence model of one state, T-RO section III.D.
#[derive(Clone, Copy, Debug, PartialEq, Default)]
pub struct Persistence {
    parts: PersistenceParts,
}

/// What a [`Persistence`] consists of, for storage.
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
    /// Takes in an observation with a value in `[0,1]`; one that is not newer than the last changes
    /// nothing (T-RO eq. 12).
    pub fn observe(&mut self, utc_nanos: i64, value: f64) {
        if let Some((last_nanos, last_value)) = self.parts.last {
            if utc_nanos <= last_nanos {
                return;
            }
            self.parts.pairs = self.parts.pairs.saturating_add(1);
            self.parts.change_rate_sum += (value - last_value).abs() / secs_between(last_nanos, utc_nanos);
        }
        self.parts.last = Some((utc_nanos, value));
    }

    /// UTC nanoseconds and value of the newest observation.
    pub fn last(&self) -> Option<(i64, f64)> {
        self.parts.last
    }

    /// Mean time between changes τ in seconds: 1/τ = (1/3600 + Σ |Δs|/Δt) / (1 + m), which is T-RO
    /// eq. 12 with a prior of one hour that weighs as much as one pair of observations.
    pub fn tau_secs(&self) -> f64 {
        (1.0 + self.parts.pairs as f64) / (1.0 / PRIOR_TAU_SECS + self.parts.change_rate_sum)
    }

    /// The long-term prediction `p` for a time, drawn towards the last observed value by how recent it
    /// is (T-RO eq. 13). For a time before the last observation it is `p`.
    pub fn blend(&self, p: f64, utc_nanos: i64) -> f64 {
        match self.parts.last {
            Some((last_nanos, last_value)) if utc_nanos >= last_nanos => {
                let weight = (-secs_between(last_nanos, utc_nanos) / self.tau_secs()).exp();
                last_value * weight + p * (1.0 - weight)
            }
            _ => p,
        }
    }

    /// What to store.
    pub fn to_parts(&self) -> PersistenceParts {
        self.parts
    }

    /// A model from what was stored.
    ///
    /// # Errors
    /// [`InvalidParts`] where a number is outside its range.
    pub fn from_parts(parts: PersistenceParts) -> Result<Persistence, InvalidParts> {
        InvalidParts::check("change_rate_sum", parts.change_rate_sum, 0.0..=f64::MAX)?;
        if let Some((_, value)) = parts.last {
            InvalidParts::check("last value", value, 0.0..=1.0)?;
        }
        Ok(Persistence { parts })
    }
}

/// Seconds from one time to a later one; the difference may exceed i64.
fn secs_between(earlier_nanos: i64, later_nanos: i64) -> f64 {
    later_nanos.abs_diff(earlier_nanos) as f64 / 1e9
}
