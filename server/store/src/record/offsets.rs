//! UTC offsets as runs of equal offsets.
//!
//! Invariant: the lengths of the runs add up to the number of items, which limits the allocation.

use super::Invalid;

/// Lengths and offsets of the runs.
pub(super) fn encode(offsets: impl Iterator<Item = i32>) -> (Vec<u32>, Vec<i32>) {
    let (mut counts, mut secs): (Vec<u32>, Vec<i32>) = (Vec::new(), Vec::new());
    for offset in offsets {
        match (secs.last(), counts.last_mut()) {
            (Some(&last), Some(count)) if last == offset && *count < u32::MAX => *count += 1,
            _ => {
                secs.push(offset);
                counts.push(1);
            }
        }
    }
    (counts, secs)
}

/// One offset per item.
pub(super) fn decode(counts: &[u32], secs: &[i32], count: usize) -> Result<Vec<i32>, Invalid> {
    let total = counts.iter().map(|&count| u64::from(count)).sum::<u64>();
    if counts.len() != secs.len() || total != count as u64 {
        return Err("the UTC offsets are not as many as what they are of");
    }
    Ok(counts.iter().zip(secs).flat_map(|(&count, &secs)| std::iter::repeat_n(secs, count as usize)).collect())
}
