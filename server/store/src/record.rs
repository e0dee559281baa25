//! The types of the domain as the records of the disk format, and back.
//!
//! Invariant: what is written can be read: whatever could not be read back is refused before it is written, and what
//! is read has passed the constructors of the domain again.

mod columns;
pub(crate) mod event;
pub(crate) mod snapshot;
pub(crate) mod spec;

/// Why a record cannot be written, or is not believed.
pub(crate) type Invalid = &'static str;
