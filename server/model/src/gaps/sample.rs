//! The sample of [`Gaps`](super::Gaps) in a fixed place, which takes many gaps at a time.
//!
//! Which gaps are kept follows from their number alone. So of many gaps only the few that are kept are looked at, and
//! their numbers need no place. Invariant: the same sequence of gaps leaves the same sample as in
//! [`Gaps`](super::Gaps), for the first 2³² gaps; later ones are counted only.

use std::sync::OnceLock;

use super::{KEPT, hash, median_nanos, regular_nanos, whole_secs};
use crate::InvalidParts;

/// Gaps with a number of more bits are not kept.
const NUMBER_BITS: usize = 32;

/// The numbers below a power of two, and not below the one before, that are kept when they come; ascending.
static KEPT_NUMBERS: [OnceLock<Vec<u64>>; NUMBER_BITS] = [const { OnceLock::new() }; NUMBER_BITS];

/// A sample of the times between readings, in a fixed place.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Default)]
pub struct GapSample {
    count: u64,
    /// Kept gaps in whole seconds, by the hash of their number; 0 where there are fewer.
    secs: [u32; KEPT],
}

impl GapSample {
    /// Adds the next `more` gaps; `nanos_of` gives the length of each by its place among them, from 0.
    pub fn observe_many(&mut self, more: u64, nanos_of: impl Fn(u64) -> u64) {
        let first = self.count;
        let end = first.saturating_add(more);
        self.count = end;
        let mut kept: Option<Vec<u64>> = None;
        for bits in bits_of(first)..=bits_of(end.saturating_sub(1)).min(NUMBER_BITS - 1) {
            for &number in kept_numbers(bits).iter().filter(|&&number| (first..end).contains(&number)) {
                let kept = kept.get_or_insert_with(|| kept_before(first));
                let place = kept.partition_point(|&other| hash(other) < hash(number));
                kept.insert(place, number);
                kept.truncate(KEPT);
                if let Some(moved) = self.secs.get_mut(place..) {
                    moved.rotate_right(1);
                    moved[0] = whole_secs(nanos_of(number - first));
                }
            }
        }
    }

    /// Gaps so far.
    pub fn count(&self) -> u64 {
        self.count
    }

    /// As [`Gaps::median_nanos`](super::Gaps::median_nanos).
    pub fn median_nanos(&self) -> u64 {
        median_nanos(&self.sorted())
    }

    /// As [`Gaps::regular_nanos`](super::Gaps::regular_nanos).
    pub fn regular_nanos(&self) -> Option<u64> {
        regular_nanos(&self.sorted())
    }

    /// The kept gaps in whole seconds, in an order of their own, to store.
    pub fn kept_secs(&self) -> &[u32] {
        &self.secs[..kept_of(self.count)]
    }

    /// A sample from the number of gaps and the stored ones.
    ///
    /// # Errors
    /// [`InvalidParts`] where the number of those does not follow from the number of all.
    pub fn from_kept(count: u64, kept_secs: &[u32]) -> Result<GapSample, InvalidParts> {
        if kept_secs.len() != kept_of(count) {
            return Err(InvalidParts::OutOfRange { field: "number of kept gaps", found: kept_secs.len() as f64 });
        }
        let mut secs = [0; KEPT];
        secs[..kept_secs.len()].copy_from_slice(kept_secs);
        Ok(GapSample { count, secs })
    }

    fn sorted(&self) -> Vec<u32> {
        let mut secs = self.kept_secs().to_vec();
        secs.sort_unstable();
        secs
    }
}

/// How many of so many gaps are kept.
fn kept_of(count: u64) -> usize {
    usize::try_from(count).map_or(KEPT, |count| count.min(KEPT))
}

/// Bits of a number after its first; 0 of 0 and 1.
fn bits_of(number: u64) -> usize {
    number.max(1).ilog2() as usize
}

/// The numbers below `count` that are kept then, by hash.
fn kept_before(count: u64) -> Vec<u64> {
    let blocks = 0..bits_of(count.max(1)).saturating_add(1).min(NUMBER_BITS);
    let below = |&&number: &&u64| number < count;
    let mut kept: Vec<u64> = blocks.flat_map(|bits| kept_numbers(bits).iter().filter(below)).copied().collect();
    kept.sort_unstable_by_key(|&number| hash(number));
    kept.truncate(KEPT);
    kept
}

/// The numbers with so many bits after the first that are kept when they come. Computed once.
fn kept_numbers(bits: usize) -> &'static [u64] {
    let Some(numbers) = KEPT_NUMBERS.get(bits) else { return &[] };
    numbers.get_or_init(|| {
        let first = if bits == 0 { 0 } else { 1 << bits };
        let lower = (0..bits).flat_map(|bits| kept_numbers(bits).iter());
        let mut hashes: Vec<u64> = lower.map(|&number| hash(number)).collect();
        hashes.sort_unstable();
        hashes.truncate(KEPT);
        let mut numbers = Vec::new();
        for number in first..2 << bits {
            let hash = hash(number);
            if hashes.len() < KEPT || hashes.last().is_some_and(|&highest| hash < highest) {
                hashes.insert(hashes.partition_point(|&other| other < hash), hash);
                hashes.truncate(KEPT);
                numbers.push(number);
            }
        }
        numbers
    })
}
