//! The times between successive readings of a state, as a small random sample.
//!
//! The sixteen gaps with the lowest hash of their number are kept. So the sample is exact up to sixteen gaps and fair
//! afterwards. Invariant: the sample depends on the sequence of readings alone, not on how they were batched; the kept
//! gaps ascend by hash, and no two have the same number.

use crate::InvalidParts;

mod sample;
#[cfg(test)]
mod tests;

pub use sample::GapSample;

/// Number of gaps that are kept.
const KEPT: usize = 16;
/// With fewer gaps, no regular gap is reported.
const REGULAR_MIN: usize = 8;
/// A gap is regular if hardly any is shorter than this share of the median.
const REGULAR_SHARE: f64 = 0.9;
const SEC_NANOS: u64 = 1_000_000_000;

/// A sample of the times between readings.
#[derive(Clone, Debug, PartialEq, Eq, Default)]
pub struct Gaps {
    parts: GapsParts,
}

/// The parts of [`Gaps`], for storage.
#[derive(Clone, Debug, PartialEq, Eq, Default)]
pub struct GapsParts {
    /// Number of gaps so far.
    pub count: u64,
    /// The kept gaps: the number of each, from 0, and its length in whole seconds.
    pub kept: Vec<(u64, u32)>,
}

impl Gaps {
    /// Adds the next gap.
    pub(crate) fn observe(&mut self, nanos: u64) {
        let number = self.parts.count;
        self.parts.count = number.saturating_add(1);
        let kept = &mut self.parts.kept;
        let hash = hash(number);
        if kept.len() >= KEPT && kept.last().is_some_and(|&(last, _)| hash > self::hash(last)) {
            return;
        }
        let at = kept.partition_point(|&(other, _)| self::hash(other) < hash);
        kept.insert(at, (number, whole_secs(nanos)));
        debug_assert!(
            kept[..at].last().is_none_or(|&(before, _)| self::hash(before) < hash),
            "kept gaps ascend by hash"
        );
        kept.truncate(KEPT);
    }

    /// The median gap in nanoseconds; the shorter of the middle two if the number is even; 0 without gaps.
    pub fn median_nanos(&self) -> u64 {
        median_nanos(&self.sorted())
    }

    /// The gap of regular readings in nanoseconds; `None` if there are few gaps, or if some gaps are shorter.
    pub fn regular_nanos(&self) -> Option<u64> {
        regular_nanos(&self.sorted())
    }

    fn sorted(&self) -> Vec<u32> {
        let mut secs: Vec<u32> = self.parts.kept.iter().map(|&(_, secs)| secs).collect();
        secs.sort_unstable();
        secs
    }

    /// The parts to store.
    pub fn to_parts(&self) -> GapsParts {
        self.parts.clone()
    }

    /// Gaps from stored parts.
    ///
    /// # Errors
    /// Returns [`InvalidParts`] if too many gaps are kept, a gap has a number that is too high, or they are out of
    /// order.
    pub fn from_parts(parts: GapsParts) -> Result<Gaps, InvalidParts> {
        let found = parts.kept.len();
        if found > KEPT || (found as u64) > parts.count {
            return Err(InvalidParts::OutOfRange { field: "number of kept gaps", found: found as f64 });
        }
        let is_wrong = |&&(number, _): &&(u64, u32)| number >= parts.count;
        if let Some((number, _)) = parts.kept.iter().find(is_wrong) {
            return Err(InvalidParts::OutOfRange { field: "number of a gap", found: *number as f64 });
        }
        if let Some(pair) = parts.kept.windows(2).find(|pair| hash(pair[0].0) >= hash(pair[1].0)) {
            return Err(InvalidParts::OutOfRange { field: "order of kept gaps", found: pair[1].0 as f64 });
        }
        Ok(Gaps { parts })
    }
}

/// Converts to the nearest second.
fn whole_secs(nanos: u64) -> u32 {
    u32::try_from((nanos.saturating_add(SEC_NANOS / 2)) / SEC_NANOS).unwrap_or(u32::MAX)
}

/// The median of ascending gaps.
fn median_nanos(secs: &[u32]) -> u64 {
    secs.get(secs.len().saturating_sub(1) / 2).map_or(0, |&secs| u64::from(secs) * SEC_NANOS)
}

/// The gap of regular readings, from ascending gaps.
fn regular_nanos(secs: &[u32]) -> Option<u64> {
    // One gap in sixteen may be shorter, because of a reading out of turn.
    let short = *secs.get(1).filter(|_| secs.len() >= REGULAR_MIN)?;
    let median = median_nanos(secs);
    (f64::from(short) * SEC_NANOS as f64 >= REGULAR_SHARE * median as f64 && median > 0).then_some(median)
}

/// A bijection that scatters numbers (the finaliser of SplitMix64).
fn hash(number: u64) -> u64 {
    let mixed = number.wrapping_add(0x9E37_79B9_7F4A_7C15);
    let mixed = (mixed ^ (mixed >> 30)).wrapping_mul(0xBF58_476D_1CE4_E5B9);
    let mixed = (mixed ^ (mixed >> 27)).wrapping_mul(0x94D0_49BB_1331_11EB);
    mixed ^ (mixed >> 31)
}
