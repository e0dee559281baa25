//! Columns as runs of equal items: the first item of each run, and the lengths of the runs as numbers.
//!
//! Invariant: no run is empty, and the lengths add up to the number of items, which limits the allocation.

use super::{
    Invalid,
    varint::{push_varint, take_u32},
};

const LENGTHS: Invalid = "the runs of a column are not as long as the column";

/// The first item of each run, and the lengths.
pub(super) fn encode<T: Copy>(items: &[T], is_equal: impl Fn(&T, &T) -> bool) -> (Vec<T>, Vec<u8>) {
    let (mut firsts, mut lengths) = (Vec::new(), Vec::new());
    for run in items.chunk_by(is_equal) {
        firsts.extend(run.first());
        push_varint(&mut lengths, run.len() as u64);
    }
    (firsts, lengths)
}

/// Decodes the lengths of runs that have `count` items together.
pub(super) fn decode(mut bytes: &[u8], count: usize) -> Result<Vec<usize>, Invalid> {
    let (mut lengths, mut rest) = (Vec::new(), count);
    while !bytes.is_empty() {
        let length = take_u32(&mut bytes)? as usize;
        rest = rest.checked_sub(length).filter(|_| length > 0).ok_or(LENGTHS)?;
        lengths.push(length);
    }
    if rest == 0 { Ok(lengths) } else { Err(LENGTHS) }
}

/// The items of runs.
pub(super) fn expand<T: Copy>(firsts: &[T], lengths: &[usize]) -> Vec<T> {
    firsts.iter().zip(lengths).flat_map(|(&first, &length)| std::iter::repeat_n(first, length)).collect()
}
