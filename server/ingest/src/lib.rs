//! The path of an observation from a decoded message to the map: intake checks it, the map's single writer orders it,
//! logs it and applies it.
//!
//! Invariant: nothing is acknowledged before it is on disk, and every observation is applied exactly once, in the order
//! of the log.

pub mod anomaly_feed;
pub mod backups;
pub mod catalog;
pub mod cluster;
pub mod digests;
pub mod ending;
pub mod handle;
pub mod intake;
pub mod jobs;
pub mod peers;
pub mod probe;
pub mod protocol;
pub mod role;
mod sessions;
pub mod statistics;
pub(crate) mod tile_totals;
mod training_data;
mod update_schedule;
pub mod update_turns;
pub mod writer;
