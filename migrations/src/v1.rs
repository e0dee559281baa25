//! Format 1, frozen: every byte that tidemap writes under this format number.
//!
//! | file in the data directory | layout |
//! | --- | --- |
//! | `MANIFEST` | text, [`manifest`](crate::manifest) |
//! | `maps/00000001/MAP` | [`file::FileHeader`], one record [`MapSpec`](crate::v2::map::MapSpec) |
//! | `maps/00000001/log/00000000000000000001.log` | [`log::SegmentHeader`], frames of [`event`] messages |
//! | `maps/00000001/checkpoints/00000000000000000007.tmc` | [`file::FileHeader`], records of [`map`] messages |
//! | `index/` | a sled 0.34 database, [`index`] |
//!
//! What format 2 extends stands there alone ([`v2`](crate::v2)): a message without the further fields, a frame or a
//! record of the first kinds is one of format 1. `tests/format_1.rs` keeps the old definitions to compare with.
//!
//! Fixed layouts are little-endian. Variable ones are protocol buffer messages. Numbers with a fraction are kept as
//! the bits of an IEEE 754 double in a `fixed64`, because protocol buffers drop the sign of a zero. Every byte is
//! covered by a CRC-32C.
//!
//! Invariant: nothing in this module changes meaning, tag, name or size; `golden.rs` in `tidemap-store` holds it.

#![allow(missing_docs, reason = "fields whose name says it all")]

pub mod event;
pub mod file;
pub mod index;
pub mod log;
pub mod map;

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
