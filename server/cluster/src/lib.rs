//! Maps that outlive a machine: the log of a map is shared through an engine, one daemon writes it at a time, and the
//! others follow it.
//!
//! [`replica`] is a map of a cluster as one daemon has it. [`engine`] is the interface that an engine must implement.
//! No other crate uses the client library of an engine.
//!
//! Invariant: the engine provides consensus. An acknowledged record is on the engine's quorum and on the writer's own
//! disk.

pub mod assignment;
pub mod catalogue;
pub mod engine;
pub mod lease;
pub mod member;
pub mod membership;
pub mod message;
#[cfg_attr(not(feature = "nats"), path = "no_nats.rs")]
pub mod nats;
#[cfg(any(test, feature = "testing"))]
pub mod nats_process;
pub mod race;
pub mod replica;
#[cfg(any(test, feature = "testing"))]
pub mod simulated;
