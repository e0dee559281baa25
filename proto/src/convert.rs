//! Conversions between the wire and the domain types, in both directions.
//!
//! Invariant: every received value is checked here, once, and each error names its field; sent values are not checked.
//! A concept of the wire has one domain type, and no other crate converts between them.

use std::fmt::Display;

/// Converts between a wire enum and a domain enum, both ways, from one table.
macro_rules! both_ways {
    ($(#[$doc:meta])* $to:ident, $from:ident, $domain:ty, $wire:ty, [$($here:ident = $there:ident),* $(,)?]) => {
        $(#[$doc])*
        #[must_use]
        pub fn $to(domain: $domain) -> $wire {
            match domain { $(<$domain>::$here => <$wire>::$there,)* }
        }

        /// A value from the wire; `None` if it is unspecified.
        #[must_use]
        pub fn $from(wire: $wire) -> Option<$domain> {
            match wire { $(<$wire>::$there => Some(<$domain>::$here),)* <$wire>::Unspecified => None }
        }
    };
}

pub mod anomaly;
pub mod cells;
pub mod classify;
pub mod columns;
pub mod copies;
pub mod enabled;
pub mod erasure;
pub mod exploration;
pub mod forks;
pub mod grid;
pub mod labels;
pub mod landmarks;
pub mod map;
mod model_kind;
pub mod observe;
pub mod page;
pub mod query;
pub mod reporting;
pub mod reports;
#[cfg(test)]
mod round_trips;
pub mod route;
pub mod scans;
pub mod search;
pub mod sequences;
pub mod sightings;
pub mod site;
pub mod state_sensor;
pub mod task;
pub mod task_runs;
pub mod time;
pub mod topology;
pub mod traversals;
pub mod updates;
pub mod vectors;

/// A request field with an invalid value.
#[derive(Clone, Debug, PartialEq, Eq, thiserror::Error)]
#[error("{field}: {description}")]
pub struct InvalidField {
    /// Path of the field within the request, for example `periodicities.list.periods[3]`.
    pub field: String,
    /// The problem, with the value and what would be valid.
    pub description: String,
}

/// More of something than a limit allows.
#[derive(Clone, Debug, PartialEq, Eq, thiserror::Error)]
#[error("{what}: {}more than the {max} that {setting} allows", got.map_or_else(String::new, |got| format!("{got} is ")))]
pub struct OverLimit {
    /// Name of the elements of which there are too many.
    pub what: &'static str,
    /// The number of elements, if it is known.
    pub got: Option<u64>,
    /// The maximum number of elements.
    pub max: u64,
    /// The setting or rule that limits the number.
    pub setting: &'static str,
}

impl OverLimit {
    /// Checks an amount against its limit.
    ///
    /// # Errors
    /// `got` exceeds `max`.
    pub fn check(what: &'static str, got: usize, max: usize, setting: &'static str) -> Result<(), Self> {
        if got > max { Err(Self { what, got: Some(got as u64), max: max as u64, setting }) } else { Ok(()) }
    }
}

impl InvalidField {
    /// A field and what is wrong with it.
    pub fn new(field: impl Into<String>, description: impl Display) -> Self {
        Self { field: field.into(), description: format!("{description}") }
    }
}
