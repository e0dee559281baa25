//! The way between the wire and the domain types.
//!
//! Invariant: what comes in is checked here, once, and each error names the field; what goes out is not checked.

use std::fmt::Display;

pub mod anomaly;
pub mod cells;
pub mod columns;
pub mod enabled;
pub mod exploration;
pub mod grid;
pub mod map;
pub mod query;
pub mod route;
pub mod scans;
pub mod search;
pub mod site;
pub mod time;
pub mod topology;
pub mod traversals;
pub mod vectors;

/// A field of a request that cannot be what it is.
#[derive(Clone, Debug, PartialEq, Eq, thiserror::Error)]
#[error("{field}: {description}")]
pub struct InvalidField {
    /// Path of the field within the request, for example `periodicities.list.periods[3]`.
    pub field: String,
    /// What is wrong, with which value, and what would be right.
    pub description: String,
}

impl InvalidField {
    /// A field and what is wrong with it.
    pub fn new(field: impl Into<String>, description: impl Display) -> Self {
        Self { field: field.into(), description: format!("{description}") }
    }
}
