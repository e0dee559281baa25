//! The disk formats: the format of a data directory, the frozen layout of each format, and the steps between them.
//!
//! Invariant: a layout that has been released never changes. A new format gets a new module beside [`v1`] and a
//! [`plan::Step`] that leads to it, so that every data directory ever written can be opened. The meaning of a layout is
//! not defined here; `tidemap-store` converts it to the types of the domain.

pub mod manifest;
pub mod plan;
pub mod v1;
pub mod v2;
pub mod v3;

/// The disk format that this version reads and writes.
pub const FORMAT: u32 = v3::FORMAT;
