//! The number of the disk format, and the steps from one format to the next.
//!
//! Invariant: every data directory that a release has written can be opened: a new format gets a [`plan::Step`] that
//! leads to it, with a frozen copy of the layout that it reads. The layout of the present format is `tidemap-layout`.

pub mod manifest;
pub mod plan;

/// The disk format that this version reads and writes.
pub const FORMAT: u32 = tidemap_layout::FORMAT;
