//! The sample of [`Gaps`](super::Gaps) in a fixed amount of memory. It adds many gaps at a time.
//!
//! The number of a gap alone decides whether the gap is kept. So only the few gaps that are kept are read, and their
//! numbers need not be stored. Invariant: an equal sequence of gaps leaves a sample equal to that in
//! [`Gaps`](super::Gaps), for the first 2³² gaps; later gaps are counted only.

use std::sync::OnceLock;

use super::{KEPT, hash, median_nanos, regular_nanos, whole_secs};
use crate::InvalidParts;

/// Gaps with a number of more bits are not kept.
const NUMBER_BITS: usize = 32;

/// The number of a gap that enters the sample, and the numbers of the sample from then on, by hash.
struct GapStep {
    number: u64,
    kept: Vec<u64>,
}

/// The steps of the numbers from each power of two up to the next; ascending.
static STEPS: [OnceLock<Vec<GapStep>>; NUMBER_BITS] = [const { OnceLock::new() }; NUMBER_BITS];

/// A sample of the times between readings, in a fixed amount of memory.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Hash, Default)]
pub struct GapSample {
    count: u64,
    /// Kept gaps in whole seconds, by the hash of their number; 0 where there are fewer.
    secs: [u32; KEPT],
}

impl GapSample {
    /// Adds the next `more` gaps; `nanos_of` returns the length of each by its index among them, from 0.
    pub fn observe_many(&mut self, more: u64, nanos_of: impl Fn(u64) -> u64) {
        let first = self.count;
        let end = first.saturating_add(more);
        self.count = end;
        let (before, after) = (kept_before(first), kept_before(end));
        if before == after {
            return;
        }
        // The gaps that stay are in the same order.
        let mut known = before.iter().zip(self.secs);
        for (secs, &number) in self.secs.iter_mut().zip(after) {
            *secs = match number.checked_sub(first) {
                Some(place) => whole_secs(nanos_of(place)),
                None => known.find(|(other, _)| **other == number).map_or(0, |(_, secs)| secs),
            };
        }
    }

    /// Number of gaps so far.
    pub fn count(&self) -> u64 {
        self.count
    }

    /// Returns the same gap as [`Gaps::median_nanos`](super::Gaps::median_nanos).
    pub fn median_nanos(&self) -> u64 {
        median_nanos(&self.sorted())
    }

    /// Returns the same gap as [`Gaps::regular_nanos`](super::Gaps::regular_nanos).
    pub fn regular_nanos(&self) -> Option<u64> {
        regular_nanos(&self.sorted())
    }

    /// The kept gaps in whole seconds, in the order of this sample, for storage.
    pub fn kept_secs(&self) -> &[u32] {
        &self.secs[..kept_of(self.count)]
    }

    /// A sample from the number of gaps and the stored ones.
    ///
    /// # Errors
    /// [`InvalidParts`] if the number of kept gaps does not follow from `count`.
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

/// The number of gaps that are kept of `count`.
fn kept_of(count: u64) -> usize {
    usize::try_from(count).map_or(KEPT, |count| count.min(KEPT))
}

/// The number of bits of a number after its first; 0 for 0 and 1.
fn bits_of(number: u64) -> usize {
    number.max(1).ilog2() as usize
}

/// The numbers of the gaps that are kept when there are `count` gaps, by hash.
fn kept_before(count: u64) -> &'static [u64] {
    let Some(last) = count.checked_sub(1) else { return &[] };
    let blocks = 0..bits_of(last).saturating_add(1).min(NUMBER_BITS);
    let newest = blocks.rev().find_map(|bits| {
        let steps = steps(bits);
        steps[..steps.partition_point(|step| step.number < count)].last()
    });
    newest.map_or(&[], |step| &step.kept)
}

/// The steps of the numbers with `bits` bits after the first. They are computed once.
fn steps(bits: usize) -> &'static [GapStep] {
    let Some(steps) = STEPS.get(bits) else { return &[] };
    steps.get_or_init(|| {
        let first = if bits == 0 { 0 } else { 1 << bits };
        let mut kept = kept_before(first).to_vec();
        let mut steps = Vec::new();
        for number in first..2 << bits {
            let hashed = hash(number);
            if kept.len() < KEPT || kept.last().is_some_and(|&last| hashed < hash(last)) {
                kept.insert(kept.partition_point(|&other| hash(other) < hashed), number);
                kept.truncate(KEPT);
                steps.push(GapStep { number, kept: kept.clone() });
            }
        }
        steps
    })
}
