//! Format 4, frozen: what it adds to [format 3](crate::v3).
//!
//! | file in the data directory | names |
//! | --- | --- |
//! | `maps/00000001/CHECKPOINTS` | the checkpoints of a map, and where its log begins: [`lists::CheckpointList`] |
//! | `LOSSES` | what was lost, and accepted as lost; only if there is any: [`lists::LossList`] |
//!
//! From this format on every list of what must exist is there from the creation of what it lists, so that a list that
//! is missing is a loss.
//!
//! Invariant: nothing in this module changes meaning, tag, name or size.

pub mod lists;

/// The number of this format.
pub const FORMAT: u32 = 4;
