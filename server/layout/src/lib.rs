//! The layout of a data folder, format 1: every byte that tidemap writes to the disk.
//!
//! | file in the data directory | layout |
//! | --- | --- |
//! | `MANIFEST` | text, `manifest.rs` of `tidemap-migrations` |
//! | `MAPS` | the maps, and the next unused number of a map: [`lists::MapList`] |
//! | `LOSSES` | the lost data that was accepted as lost; only if there is any: [`lists::LossList`] |
//! | `index/` | a sled 0.34 database, [`index`]; always rebuilt from checkpoints if it is not complete |
//!
//! | file below the folder of a map, `maps/00000001` | layout |
//! | --- | --- |
//! | `MAP` | [`file::FileHeader`], one record [`map::MapSpec`] |
//! | `CHECKPOINTS` | the checkpoints, and the begin of the log: [`lists::CheckpointList`] |
//! | `HISTORY` | the history files: [`lists::FileList`] |
//! | `ERASE` | the observations to erase; only until they are erased: [`lists::ErasureOrder`] |
//! | `ERASURES` | the number of erasures; only after the first erasure: [`lists::ErasureCount`] |
//! | `log/00000000000000000001.log` | [`log::SegmentHeader`], frames of [`event`], [`site`] and [`cluster`] messages |
//! | `log/NEWEST` | the newest segment: [`lists::NewestSegment`] |
//! | `checkpoints/00000000000000000007.tmc` | [`mod@file`]: [`map::Snapshot`], producers, [`map::State`]s, an |
//! | | [`site::TableRow`]s and, for a map with a grid, [`grid`] records |
//! | `history/00000000000000000007.states.tmh` | [`mod@file`] with [`history`] records |
//! | `history/00000000000000000007.grid.tmh` | [`mod@file`] with [`history`] records |
//! | `SHARED`, `forks/` | only in a map of a cluster: [`cluster`] |
//!
//! Every list of files or maps exists from the creation of the first of them, so a missing list is a loss. Segments
//! chain to each other, and a checkpoint names the record that it needs, so a list of the newest segment is enough. A
//! deleted map leaves no folder; `MAPS` prevents its number from being used again.
//!
//! Fixed layouts are little-endian. Variable layouts are protocol buffer messages. Numbers with a fraction are stored
//! as the bits of an IEEE 754 double in a `fixed64`, because protocol buffers drop the sign of a zero. A CRC-32C covers
//! every byte.
//!
//! A learned state is a message inside these messages, as bytes. Its fields stand beside its type in `tidemap-model`
//! (`StoredFields`), so that each is written down once; tags and forms are bound by the same rule as this crate.
//!
//! `tidemap-store` converts these messages to the types of the domain, and defines their meaning. Invariant: from the
//! first release on, nothing in this crate changes meaning, tag, name or size; `golden.rs` in `tidemap-store` checks
//! this. For a new format, a copy of this format is frozen in `tidemap-migrations`, beside the step that leads to the
//! new format.

#![allow(missing_docs, reason = "the names of the fields are sufficient")]

pub mod cluster;
pub mod event;
pub mod file;
pub mod grid;
pub mod history;
pub mod index;
pub mod landmark;
pub mod lists;
pub mod log;
pub mod map;
pub mod rows;
pub mod site;
pub mod task;
pub mod topology;

/// The number of this format.
pub const FORMAT: u32 = 1;

/// Reads a little-endian number of four bytes.
pub(crate) fn u32_at(bytes: &[u8], offset: usize) -> u32 {
    bytes.get(offset..offset + 4).and_then(|four| four.try_into().ok()).map_or(0, u32::from_le_bytes)
}

/// Reads a little-endian number of eight bytes.
pub(crate) fn u64_at(bytes: &[u8], offset: usize) -> u64 {
    bytes.get(offset..offset + 8).and_then(|eight| eight.try_into().ok()).map_or(0, u64::from_le_bytes)
}
