//! Choice: where and when to look next, in which order to go, and what to expect of it, from the views of a map.
//!
//! Invariant: no I/O, no clock, no hidden randomness (a seed is an argument). Information is in bits. What a question may
//! cost is bounded before it is answered, and told where it would cost more.
#![forbid(unsafe_code)]
#![warn(unreachable_pub)]
#![cfg_attr(test, allow(clippy::unwrap_used))]

pub mod day;
pub mod information;
pub mod location;
pub mod policy;
pub mod predicted;
pub mod route;
pub mod search;
pub mod strategy;
#[cfg(test)]
mod testkit;
pub mod tour;
pub mod travel;
pub mod view;
