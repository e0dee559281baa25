//! Gaps between ascending steps as bytes: seven bits each, the lowest first; the top bit is set if more bytes follow.
//!
//! Invariant: `decode` reads what `push` wrote and refuses everything else.

use crate::InvalidParts;

const MORE: u8 = 0x80;

/// Appends a gap.
pub(super) fn push(bytes: &mut Vec<u8>, mut gap: u32) {
    while gap >= u32::from(MORE) {
        bytes.push(gap as u8 | MORE);
        gap >>= 7;
    }
    bytes.push(gap as u8);
}

/// The steps at the ends of the gaps, counted from 0: ascending, below `steps`, each once.
pub(super) fn decode(bytes: &[u8], steps: u32) -> Result<Vec<u32>, InvalidParts> {
    let (mut found, mut step, mut gap, mut shift) = (Vec::new(), 0_u64, 0_u64, 0);
    for &byte in bytes {
        gap |= u64::from(byte & !MORE) << shift;
        shift += 7;
        if byte & MORE != 0 && shift < 35 {
            continue;
        }
        step += gap;
        let repeats = gap == 0 && !found.is_empty();
        if byte & MORE != 0 || repeats || step >= u64::from(steps) {
            return Err(InvalidParts::OutOfRange { field: "outlier", found: step as f64 });
        }
        found.push(step as u32);
        (gap, shift) = (0, 0);
    }
    if shift > 0 {
        return Err(InvalidParts::OutOfRange { field: "end of the outlier set", found: bytes.len() as f64 });
    }
    Ok(found)
}
