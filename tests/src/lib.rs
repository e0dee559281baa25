//! The kit of the tests from outside: the real binaries as processes, observations that can be computed again,
//! and the answers expected of a daemon.
//!
//! Invariant: nothing here links the daemon. A process that is started here ends with its handle, and the answers that
//! a daemon should give are computed without it.

pub mod answers;
pub mod bag;
pub mod binaries;
pub mod certificates;
pub mod cli;
pub mod collector;
pub mod daemon;
pub mod disk;
pub mod feed;
pub mod film;
pub mod flood;
pub mod garbage;
pub mod herd;
pub mod lane_oracle;
pub mod lanes;
pub mod oracle;
pub mod raw_calls;
pub mod recordings;
pub mod rounds;
pub mod stored_kinds;
pub mod stream;
pub mod tokens;
pub mod web;

/// Compiles the Rust example of the guide with the doc tests.
#[cfg(doctest)]
#[doc = include_str!("../../docs/src/wire.md")]
struct GuideExample;
