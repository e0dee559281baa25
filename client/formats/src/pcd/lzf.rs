//! LZF, the compression of PCD files.
//!
//! The data is a sequence of instructions. If the first byte of an instruction is below 32, that number of bytes plus
//! one follows as literals. Otherwise it repeats earlier output: the upper three bits are the length minus two, where 7
//! means that a byte with the rest of the length follows; the lower five bits and the next byte are the distance minus
//! one.
//!
//! Invariant: the output has exactly the announced length, or there is an error; memory is allocated only for a length
//! that the input can unpack to.

use crate::error::{FilePlace, FormatError};

/// Maximum output for a byte of input: three bytes can repeat 264.
const EXPANSION_MAX: usize = 88;

/// Unpacks data that starts at byte `at` of the file.
pub(super) fn unpack(packed: &[u8], length: usize, at: u64) -> Result<Vec<u8>, FormatError> {
    let place = |index: usize| FilePlace::Byte(at + index as u64);
    if length > packed.len().saturating_mul(EXPANSION_MAX) {
        let right = format!("at most {EXPANSION_MAX} times the packed length {}", packed.len());
        return Err(FormatError::value(place(0), "the unpacked length", length, right));
    }
    let mut out: Vec<u8> = Vec::with_capacity(length);
    let mut next = 0;
    while let Some(&first) = packed.get(next) {
        let start = next;
        next += 1;
        let ended = || FormatError::cut_off(at + start as u64, "a compressed piece", 2, 1);
        if first < 32 {
            let count = usize::from(first) + 1;
            let literal = packed.get(next..next + count).ok_or_else(ended)?;
            next += count;
            fits(out.len() + count, length, place(start))?;
            out.extend_from_slice(literal);
            continue;
        }
        let mut count = usize::from(first >> 5) + 2;
        if count == 9 {
            count += usize::from(*packed.get(next).ok_or_else(ended)?);
            next += 1;
        }
        let distance = usize::from(first & 31) * 256 + usize::from(*packed.get(next).ok_or_else(ended)?) + 1;
        next += 1;
        fits(out.len() + count, length, place(start))?;
        let Some(from) = out.len().checked_sub(distance) else {
            let right = format!("at most {}, the bytes unpacked so far", out.len());
            return Err(FormatError::value(place(start), "the distance of a repetition", distance, right));
        };
        // The source may overlap the bytes being written.
        for index in from..from + count {
            out.push(out[index]);
        }
    }
    if out.len() < length {
        return Err(FormatError::cut_off(at + next as u64, "unpacked data", length as u64, out.len() as u64));
    }
    Ok(out)
}

fn fits(unpacked: usize, length: usize, place: FilePlace) -> Result<(), FormatError> {
    if unpacked <= length {
        return Ok(());
    }
    Err(FormatError::value(place, "the length of the data unpacked so far", unpacked, format!("at most {length}")))
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn pieces_and_repetitions_are_unpacked() -> Result<(), FormatError> {
        assert_eq!(unpack(&[2, b'a', b'b', b'c'], 3, 0)?, b"abc");
        // Three bytes from a distance of three, twice over; then a byte repeated 264 times.
        assert_eq!(unpack(&[2, b'a', b'b', b'c', 4 << 5, 2], 9, 0)?, b"abcabcabc");
        let long = unpack(&[0, b'x', 7 << 5, 255, 0], 265, 0)?;
        assert!(long.len() == 265 && long.iter().all(|&byte| byte == b'x'));
        // A distance of more than 256.
        let far: Vec<u8> = (0..9).flat_map(|_| [31_u8].into_iter().chain(0..32)).chain([(1 << 5) | 1, 4]).collect();
        assert_eq!(unpack(&far, 291, 0)?[288..], [27, 28, 29]);
        Ok(())
    }

    #[test]
    fn damage_is_refused() {
        for (packed, length) in [
            (&[2, b'a'][..], 3),
            (&[0, b'a', 1 << 5], 4),
            (&[0, b'a', 7 << 5], 4),
            (&[0, b'a', 7 << 5, 0], 10),
            (&[0, b'a', 1 << 5, 1], 4),
            (&[0, b'a', 1 << 5, 0], 3),
            (&[0, b'a'], 2),
            (&[0, b'a'], 0),
            (&[0, b'a'], usize::MAX),
            (&[], 1),
        ] {
            assert!(unpack(packed, length, 0).is_err(), "{packed:?}");
        }
    }
}
