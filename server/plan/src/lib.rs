//! Planning on the views of a map: exploration (where and when to observe next), tours, searches, routes and policies.
//!
//! Invariant: no I/O, no clock, no hidden randomness (a seed is an argument). Information is in bits. The cost of a
//! request is bounded before the work begins; an error names the limit.
#![forbid(unsafe_code)]
#![cfg_attr(test, allow(clippy::unwrap_used))]

pub mod day;
pub mod encounters;
pub mod information;
pub mod localise;
pub mod location;
pub mod policy;
pub mod predicted;
pub mod presence;
pub mod route;
pub mod search;
pub mod strategy;
pub mod tasks;
#[cfg(test)]
mod testkit;
pub mod tour;
pub mod travel;
pub mod view;
