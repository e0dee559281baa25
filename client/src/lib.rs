//! The tidemap client library: connects to a daemon, sends observations and sends queries.
//!
//! [`Client`] connects to a daemon; its methods are in [`cluster`], [`maps`], [`queries`], [`exploration`], [`routes`],
//! [`tasks`] and [`updates`]. [`observe::Producer`] sends observations and scans, each exactly once, even if
//! connections break; [`scan_file`] reads and writes scans in files.
//!
//! Invariant: times are i64 nanoseconds UTC, and this library decides nothing about maps or models; the daemon does.

pub mod classify;
pub mod clock;
pub mod cluster;
pub mod connection;
pub mod error;
pub mod exploration;
pub mod landmarks;
pub mod maps;
pub mod observe;
pub mod queries;
mod read_tokens;
pub mod routes;
pub mod scan_file;
pub mod tasks;
pub mod updates;

pub use connection::Client;
pub use error::Error;
pub use tidemap_model::time;
