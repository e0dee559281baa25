//! Ascending numbers as differences: runs of slots, and cells that have changed.
//!
//! Invariant: reading gives strictly ascending numbers, or says what is wrong with them.

use super::ScanRefusal;

/// Reads cells that are sent as differences, one after the other.
#[derive(Debug)]
pub(super) struct Flips<'a> {
    field: &'static str,
    rest: std::slice::Iter<'a, u32>,
    /// The cell that comes next.
    next: Option<u32>,
}

impl<'a> Flips<'a> {
    pub(super) fn new(field: &'static str, sent: &'a [u32]) -> Flips<'a> {
        let mut rest = sent.iter();
        let next = rest.next().copied();
        Flips { field, rest, next }
    }

    /// The slot of the next cell.
    pub(super) fn slot(&self) -> Option<u32> {
        self.next.map(|cell| cell >> 9)
    }

    /// The next cell where it is of this slot.
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

/// Reads runs of slots that are sent as gaps and lengths, as (first, beyond the last), joined where they touch.
pub(super) fn unpack_seen(sent: &[u32], table: usize, runs: &mut Vec<(u32, u32)>) -> Result<(), ScanRefusal> {
    runs.clear();
    let (pairs, rest) = sent.as_chunks::<2>();
    if !rest.is_empty() {
        let text = format!("seen: {} entries are not pairs of a gap and a length", sent.len());
        return Err(ScanRefusal::malformed(text));
    }
    let mut end = 0u32;
    for &[gap, length] in pairs {
        let run = end.checked_add(gap).and_then(|first| Some((first, first.checked_add(length)?)));
        match run {
            Some((first, beyond)) if length > 0 && beyond as usize <= table => {
                match runs.last_mut() {
                    Some((_, last)) if *last == first => *last = beyond,
                    _ => runs.push((first, beyond)),
                }
                end = beyond;
            }
            _ if length == 0 => return Err(ScanRefusal::malformed("seen: a run of 0 slots")),
            _ => {
                let text = format!("seen: {length} slots after {end} + {gap} are beyond the stream's {table} tiles");
                return Err(ScanRefusal::malformed(text));
            }
        }
    }
    Ok(())
}

/// Ascending slots as the wire has them: gaps and lengths of runs.
#[must_use]
pub fn pack_seen(slots: &[u32]) -> Vec<u32> {
    let mut packed: Vec<u32> = Vec::new();
    let mut end = 0;
    for &slot in slots {
        match packed.last_mut() {
            Some(length) if slot == end => *length += 1,
            _ => packed.extend([slot.saturating_sub(end), 1]),
        }
        end = slot.saturating_add(1);
    }
    packed
}

/// Ascending cells as the wire has them: the first, then differences.
#[must_use]
pub fn pack_flips(cells: &[u32]) -> Vec<u32> {
    let mut before = 0;
    cells.iter().map(|&cell| cell.wrapping_sub(std::mem::replace(&mut before, cell))).collect()
}
