//! Runs of slots, flips and masks as the wire packs them, and back.
//!
//! Invariant: unpacking what was packed gives the same; numbers that the wire cannot mean are told, never wrapped.

use tidemap_proto::v1::TileScan;

use super::{MASK_BYTES, Mask, TileError, TileMasks};

/// Slots in a row.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Run {
    /// The first.
    pub start: u32,
    /// How many, at least 1.
    pub len: u32,
}

impl Run {
    /// The slots.
    pub fn slots(&self) -> std::ops::Range<u32> {
        self.start..self.start.saturating_add(self.len)
    }
}

/// The runs of slots that ascend.
#[must_use]
pub fn runs_of(slots: impl Iterator<Item = u32>) -> Vec<Run> {
    let mut runs: Vec<Run> = Vec::new();
    for slot in slots {
        match runs.last_mut() {
            Some(run) if run.start + run.len == slot => run.len += 1,
            _ => runs.push(Run { start: slot, len: 1 }),
        }
    }
    runs
}

/// Runs as pairs: slots between, slots of the run.
#[must_use]
pub fn runs_to_wire(runs: &[Run]) -> Vec<u32> {
    let mut end = 0;
    let mut pairs = Vec::with_capacity(runs.len() * 2);
    for run in runs {
        pairs.extend([run.start - end, run.len]);
        end = run.start + run.len;
    }
    pairs
}

/// The runs of pairs; `None` where there are none, which means those of the scan before.
pub(super) fn runs_from_wire(seen: &[u32]) -> Result<Option<Vec<Run>>, TileError> {
    if seen.is_empty() {
        return Ok(None);
    }
    let (pairs, rest) = seen.as_chunks::<2>();
    if !rest.is_empty() {
        return Err(TileError::Runs(seen.len()));
    }
    let mut runs = Vec::with_capacity(pairs.len());
    let mut end = 0_u32;
    for &[between, len] in pairs {
        if len == 0 {
            return Err(TileError::EmptyRun);
        }
        let beyond = || TileError::Slot { slot: u64::from(end) + u64::from(between) + u64::from(len), tiles: 0 };
        let start = end.checked_add(between).ok_or_else(beyond)?;
        end = start.checked_add(len).ok_or_else(beyond)?;
        runs.push(Run { start, len });
    }
    Ok(Some(runs))
}

/// The cells of packed flips.
pub(crate) fn flips(packed: &[u32]) -> impl Iterator<Item = u64> {
    packed.iter().scan(0_u64, |cell, &step| {
        *cell += u64::from(step);
        Some(*cell)
    })
}

/// Packs cells, which ascend.
pub(crate) fn flips_to_wire(cells: &[u64]) -> Vec<u32> {
    let mut before = 0;
    // The numbers of cells are below 512 times the greatest slot; a table of 2^23 tiles and more cannot be sent.
    cells.iter().map(|&cell| u32::try_from(cell - std::mem::replace(&mut before, cell)).unwrap_or(u32::MAX)).collect()
}

/// The mask at an index of masks in a row; nothing where it is cut off.
pub(super) fn mask_at(bytes: &[u8], index: usize) -> Mask {
    let mut mask = [0; 8];
    let bytes = bytes.get(index * MASK_BYTES..(index + 1) * MASK_BYTES).unwrap_or_default();
    for (word, eight) in mask.iter_mut().zip(bytes.as_chunks::<8>().0) {
        *word = u64::from_le_bytes(*eight);
    }
    mask
}

/// Writes masks of slots, which ascend, in place of those that the scan has.
pub(crate) fn masks_to_wire(scan: &mut TileScan, masks: &[(u32, TileMasks)]) {
    let bytes = |side: fn(&TileMasks) -> &Mask| -> Vec<u8> {
        masks.iter().flat_map(|(_, masks)| side(masks).map(u64::to_le_bytes)).flatten().collect()
    };
    scan.masked = masks.iter().map(|(slot, _)| *slot).collect();
    let all_observed = masks.iter().all(|(_, masks)| masks.observed == [u64::MAX; 8]);
    scan.observed = if all_observed { Vec::new() } else { bytes(|masks| &masks.observed) };
    scan.occupied = bytes(|masks| &masks.occupied);
}
