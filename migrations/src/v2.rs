//! Format 2, frozen: what it adds to [format 1](crate::v1), whose layouts stay in use unchanged.
//!
//! | file below the folder of a map, `maps/00000001` | layout |
//! | --- | --- |
//! | `MAP` | as before, with one record [`map::MapSpec`] |
//! | `log/00000000000000000001.log` | as before, also with frames of [`event::Scans`] and [`site::SiteEdit`] |
//! | `checkpoints/00000000000000000007.tmc` | as before, with a [`map::Snapshot`], an optional [`site::Site`] and, |
//! | | for a map with a grid, [`grid`] records |
//! | `checkpoints/update-00000000000000000008.tmu` | what an update had done when it was killed: no longer written or |
//! | | read; removed when the map opens |
//! | `history/00000000000000000007.states.tmh` | [`mod@file`] with [`history`] records |
//! | `history/00000000000000000007.grid.tmh` | [`mod@file`] with [`history`] records |
//!
//! The records of states in checkpoints are [`map::State`]. The index holds what a generation publishes: [`published`].
//! Indexes of earlier builds held whole snapshots, in the trees of [`crate::v1::index::OLD_TREES`]. An index is always
//! rebuilt from a checkpoint, so such a one is dropped.
//!
//! The containers (segments, frames, files, records, trailers) are those of format 1 and still say 1. A log of a map
//! that was created under this format may begin at a later record than the first.
//!
//! Invariant: nothing in this module changes meaning, tag, name or size; `golden.rs` in `tidemap-store` holds it.

#![allow(missing_docs, reason = "fields whose name says it all")]

pub mod event;
pub mod file;
pub mod fits;
pub mod grid;
pub mod history;
pub mod log;
pub mod map;
pub mod published;
pub mod site;
pub mod topology;

/// The number of this format.
pub const FORMAT: u32 = 2;
