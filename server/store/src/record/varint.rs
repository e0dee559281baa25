//! Variable-length numbers: seven bits a byte, the lowest first; the highest bit is set if more bytes follow.
//!
//! Invariant: reading never goes beyond the bytes given, and never panics.

use prost::encoding::{decode_varint, encode_varint};

use super::Invalid;

pub(super) const CUT: Invalid = "a column is cut off";

/// Appends a number.
#[inline]
pub(super) fn push_varint(out: &mut Vec<u8>, number: u64) {
    encode_varint(number, out);
}

/// Reads a number from the front.
#[inline]
pub(super) fn take_varint(bytes: &mut &[u8]) -> Result<u64, Invalid> {
    decode_varint(bytes).map_err(|_| "a column is cut off, or has a number that is too long")
}

/// Reads a number below 2^32 from the front.
#[inline]
pub(super) fn take_u32(bytes: &mut &[u8]) -> Result<u32, Invalid> {
    u32::try_from(take_varint(bytes)?).map_err(|_| "a number in a column is too large")
}

/// A signed number as an unsigned one that is small if the number is near 0.
pub(super) fn zigzag(number: i64) -> u64 {
    ((number << 1) ^ (number >> 63)) as u64
}

/// The inverse of [`zigzag`].
pub(super) fn unzigzag(number: u64) -> i64 {
    (number >> 1) as i64 ^ -((number & 1) as i64)
}
