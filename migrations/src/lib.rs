//! The disk format: which one a data directory has, the frozen layouts of each, and the steps from one to the next.
//!
//! Invariant: a layout that has been released never changes. A new format gets a new module beside [`v1`] and a
//! [`plan::Step`] that leads to it, so that every data directory ever written can be opened. What a layout means is
//! not known here; `tidemap-store` turns it into the types of the domain.

pub mod manifest;
pub mod plan;
pub mod v1;
pub mod v2;

/// The disk format that this version reads and writes.
pub const FORMAT: u32 = 2;
