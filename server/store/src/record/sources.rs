//! The sources of scans as numbers, and back.
//!
//! Invariant: nothing is written if all scans state cells.

use tidemap_grid::scan::ScanSource;

use super::{Invalid, offsets};

const NUMBER: Invalid = "the source of a scan is unknown";
/// The number of rays at height 0.
const RAYS: i32 = 129;

/// The number of a source.
pub(super) fn number(source: ScanSource) -> i32 {
    match source {
        ScanSource::Cells => 0,
        ScanSource::Rays { height } => RAYS + i32::from(height),
    }
}

/// The source with a number.
pub(super) fn source(number: i32) -> Result<ScanSource, Invalid> {
    if number == 0 {
        return Ok(ScanSource::Cells);
    }
    let height = number.checked_sub(RAYS).and_then(|height| i8::try_from(height).ok()).ok_or(NUMBER)?;
    Ok(ScanSource::Rays { height })
}

/// Lengths and sources of the runs of scans of one source.
pub(super) fn encode(sources: impl Iterator<Item = ScanSource> + Clone) -> (Vec<u32>, Vec<i32>) {
    if sources.clone().all(|source| source == ScanSource::Cells) {
        return (Vec::new(), Vec::new());
    }
    offsets::encode(sources.map(number))
}

/// One source per scan.
pub(super) fn decode(counts: &[u32], numbers: &[i32], count: usize) -> Result<Vec<ScanSource>, Invalid> {
    if counts.is_empty() && numbers.is_empty() {
        return Ok(vec![ScanSource::Cells; count]);
    }
    if counts.len() != numbers.len() || counts.iter().map(|&count| u64::from(count)).sum::<u64>() != count as u64 {
        return Err("the number of sources differs from the number of scans");
    }
    offsets::decode(counts, numbers, count)?.into_iter().map(source).collect()
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn sources_come_back_and_wrong_numbers_are_refused() {
        let rays = |height| ScanSource::Rays { height };
        let sources = [ScanSource::Cells, rays(i8::MIN), rays(0), rays(0), rays(i8::MAX)];
        let (counts, numbers) = encode(sources.iter().copied());
        assert_eq!((&counts[..], &numbers[..]), (&[1, 1, 2, 1][..], &[0, 1, 129, 256][..]));
        assert_eq!(decode(&counts, &numbers, 5), Ok(sources.to_vec()));
        assert_eq!(encode([ScanSource::Cells; 3].into_iter()), (Vec::new(), Vec::new()));
        assert_eq!(decode(&[], &[], 2), Ok(vec![ScanSource::Cells; 2]));
        for (counts, numbers, count) in [(&[2][..], &[1][..], 3), (&[1], &[257], 1), (&[1], &[-1], 1), (&[1], &[], 1)] {
            assert!(decode(counts, numbers, count).is_err(), "{counts:?} {numbers:?}");
        }
        assert!(source(i32::MIN).is_err());
    }
}
