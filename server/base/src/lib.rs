//! The base of the daemon: access, settings, connections, shares of clients, and telemetry.
//!
//! Invariant: nothing here knows a map that runs, and no request: the crates above use it, and it uses none of them.

pub mod access;
pub mod clock;
pub mod config;
pub mod connections;
pub mod random_id;
pub mod secret_file;
pub mod shares;
pub mod task;
pub mod telemetry;
