//! The path of an observation from a decoded message to the map: intake checks it, the map's single writer orders it,
//! logs it and applies it.
//!
//! Invariant: nothing is acknowledged before it is on disk, and every observation is applied exactly once, in the order
//! of the log.

pub(crate) mod anomaly_feed;
pub(crate) mod digests;
pub(crate) mod ending;
pub(crate) mod handle;
pub(crate) mod intake;
pub(crate) mod probe;
pub(crate) mod protocol;
pub(crate) mod role;
mod sessions;
pub(crate) mod tile_totals;
mod training_data;
mod update_schedule;
pub(crate) mod update_turns;
pub(crate) mod writer;
