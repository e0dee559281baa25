//! Variable-length numbers: seven bits a byte, the lowest first; the highest bit is set if more bytes follow.
//!
//! Invariant: reading never goes beyond the bytes given, and never panics.

use super::Invalid;

pub(super) const CUT: Invalid = "a column is cut off";

/// Appends a number.
#[inline]
pub(super) fn push_varint(out: &mut Vec<u8>, mut number: u64) {
    while number >= 0x80 {
        out.push(number as u8 | 0x80);
        number >>= 7;
    }
    out.push(number as u8);
}

/// Reads a number from the front.
#[inline]
pub(super) fn take_varint(bytes: &mut &[u8]) -> Result<u64, Invalid> {
    // Most numbers are differences below 16,384.
    match **bytes {
        [one, ref rest @ ..] if one < 0x80 => {
            *bytes = rest;
            Ok(u64::from(one))
        }
        [low, high, ref rest @ ..] if high < 0x80 => {
            *bytes = rest;
            Ok(u64::from(low & 0x7F) | u64::from(high) << 7)
        }
        _ => take_long_varint(bytes),
    }
}

fn take_long_varint(bytes: &mut &[u8]) -> Result<u64, Invalid> {
    let mut number = 0_u64;
    for shift in (0..64).step_by(7) {
        let (&byte, rest) = bytes.split_first().ok_or(CUT)?;
        *bytes = rest;
        number |= u64::from(byte & 0x7F) << shift;
        if byte < 0x80 {
            return Ok(number);
        }
    }
    Err("a number in a column is too long")
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
