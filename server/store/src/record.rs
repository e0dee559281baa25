//! Conversion of the domain's types to records of the disk format, and back.
//!
//! Invariant: each written record can be read. A value that could not be read back is refused before it is written, and
//! a value that is read has passed the constructors of the domain.

mod cell_watch;
mod cells;
mod columns;
pub(crate) mod day;
pub(crate) mod doubles;
pub(crate) mod event;
pub(crate) mod fields;
pub(crate) mod history;
mod ids;
mod observation_runs;
mod offsets;
pub(crate) mod published;
mod rows;
mod runs;
pub(crate) mod scans;
mod sensors;
pub(crate) mod snapshot;
mod sources;
pub(crate) mod spec;
mod surprises;
pub(crate) mod tables;
pub(crate) mod tile;
pub(crate) mod tile_model;
pub(crate) mod tile_set;
mod varint;

/// The reason why a record cannot be written, or is invalid.
pub(crate) type Invalid = &'static str;
