//! Ascending numbers as differences: runs of slots, and changed cells.
//!
//! Invariant: unpacked numbers ascend strictly; anything else is an error.

use super::{ScanRefusal, TileError};

/// Reads cells that are sent as differences, one after the other.
#[derive(Debug)]
pub(super) struct FlipReader<'a> {
    field: &'static str,
    rest: std::slice::Iter<'a, u32>,
    /// The cell that comes next.
    next: Option<u32>,
}

impl<'a> FlipReader<'a> {
    pub(super) fn new(field: &'static str, sent: &'a [u32]) -> FlipReader<'a> {
        let mut rest = sent.iter();
        let next = rest.next().copied();
        FlipReader { field, rest, next }
    }

    /// The slot of the next cell.
    pub(super) fn slot(&self) -> Option<u32> {
        self.next.map(|cell| cell >> 9)
    }

    /// The next cell if it belongs to this slot.
    pub(super) fn next_of(&mut self, slot: u32) -> Result<Option<u32>, ScanRefusal> {
        let Some(cell) = self.next.filter(|cell| cell >> 9 == slot) else { return Ok(None) };
        self.next = match self.rest.next() {
            None => None,
            Some(0) => {
                return Err(ScanRefusal::malformed(format!("{}: cell {cell} is named twice", self.field)));
            }
            Some(&further) => Some(cell.checked_add(further).ok_or_else(|| {
                ScanRefusal::malformed(format!("{}: {further} after cell {cell} is beyond any cell", self.field))
            })?),
        };
        Ok(Some(cell))
    }
}

/// Slots in a row: the first, and the one beyond the last.
pub(super) type SlotRun = (u32, u32);

/// Reads runs of slots that are sent as gaps and lengths, joined where they touch.
pub(super) fn unpack_runs(sent: &[u32], table: usize, runs: &mut Vec<SlotRun>) -> Result<(), TileError> {
    runs.clear();
    let (pairs, rest) = sent.as_chunks::<2>();
    if !rest.is_empty() {
        return Err(TileError::Runs(sent.len()));
    }
    let mut end = 0u32;
    for &[gap, length] in pairs {
        if length == 0 {
            return Err(TileError::EmptyRun);
        }
        let first = u64::from(end) + u64::from(gap);
        let run = u32::try_from(first).ok().and_then(|first| Some((first, first.checked_add(length)?)));
        let run = run.filter(|(_, beyond)| *beyond as usize <= table);
        let (first, beyond) = run.ok_or(TileError::RunBeyond { first, length, tiles: table })?;
        match runs.last_mut() {
            Some((_, last)) if *last == first => *last = beyond,
            _ => runs.push((first, beyond)),
        }
        end = beyond;
    }
    Ok(())
}

/// The runs of ascending slots.
pub(super) fn runs_of(slots: impl IntoIterator<Item = u32>) -> Vec<SlotRun> {
    let mut runs: Vec<SlotRun> = Vec::new();
    for slot in slots {
        match runs.last_mut() {
            Some((_, beyond)) if *beyond == slot => *beyond = slot.saturating_add(1),
            _ => runs.push((slot, slot.saturating_add(1))),
        }
    }
    runs
}

/// Runs as the wire has them: gaps and lengths.
pub(super) fn pack_runs(runs: &[SlotRun]) -> Vec<u32> {
    let mut end = 0;
    let pair = |&(first, beyond): &SlotRun| [first.saturating_sub(std::mem::replace(&mut end, beyond)), beyond - first];
    runs.iter().flat_map(pair).collect()
}

/// Ascending slots as the wire has them: gaps and lengths of runs.
#[must_use]
pub fn pack_seen(slots: impl IntoIterator<Item = u32>) -> Vec<u32> {
    pack_runs(&runs_of(slots))
}

/// Ascending cells as the wire has them: the first, then differences.
#[must_use]
pub fn pack_flips(cells: &[u32]) -> Vec<u32> {
    let mut before = 0;
    cells.iter().map(|&cell| cell.wrapping_sub(std::mem::replace(&mut before, cell))).collect()
}

/// The cells of flips whose slots were checked.
pub fn unpack_flips(packed: &[u32]) -> impl Iterator<Item = u32> {
    packed.iter().scan(0_u32, |cell, &step| {
        *cell = cell.saturating_add(step);
        Some(*cell)
    })
}
