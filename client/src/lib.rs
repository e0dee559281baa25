//! The tidemap client: asks and feeds a map that knows *when* things change.
//!
//! [`Client`] reaches a daemon; its methods are in [`maps`], [`queries`], [`exploration`], [`routes`]
//! and [`updates`]. [`observe::Producer`] sends
//! observations and scans, each exactly once, whatever happens to connections; [`scan_file`] keeps scans in files.
//!
//! Invariant: times are i64 nanoseconds UTC and nothing here decides anything about maps or models; the daemon does.

pub mod clock;
pub mod connection;
pub mod error;
pub mod exploration;
pub mod maps;
pub mod observe;
pub mod queries;
pub mod routes;
pub mod scan_file;
pub mod updates;

pub use connection::Client;
pub use error::Error;
pub use tidemap_map::time;
