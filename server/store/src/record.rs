//! The types of the domain as the records of the disk format, and back.
//!
//! Invariant: what is written can be read: whatever could not be read back is refused before it is written, and what
//! is read has passed the constructors of the domain again.

mod alternatives;
mod cells;
mod columns;
pub(crate) mod day;
pub(crate) mod doubles;
pub(crate) mod event;
mod fits;
pub(crate) mod history;
mod ids;
mod offsets;
pub(crate) mod scans;
mod sensors;
mod sightings;
pub(crate) mod site;
pub(crate) mod snapshot;
pub(crate) mod spec;
pub(crate) mod tile;
pub(crate) mod tile_model;
pub(crate) mod tile_set;
mod topology;
mod traversal;
mod varint;

/// Why a record cannot be written, or is not believed.
pub(crate) type Invalid = &'static str;
