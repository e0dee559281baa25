//! Format 3, frozen: lists of the files that must exist, so that a missing one is noticed. All else is as in
//! [format 2](crate::v2).
//!
//! | file in the data directory | names |
//! | --- | --- |
//! | `MAPS` | the maps, and the next unused number of a map: [`lists::MapList`] |
//! | `maps/00000001/HISTORY` | the history files of a map: [`lists::FileList`] |
//! | `maps/00000001/log/NEWEST` | the newest segment of a log: [`lists::NewestSegment`] |
//!
//! Segments chain to each other, and a checkpoint names the record that it needs, so the newest segment is enough.
//! A deleted map leaves no folder: `MAPS` keeps its number from being used again. Versions before this format do not
//! keep the lists, and refuse the directory for its number.
//!
//! Invariant: nothing in this module changes meaning, tag, name or size.

pub mod lists;

/// The number of this format.
pub const FORMAT: u32 = 3;
