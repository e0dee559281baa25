//! Decodes one scan of tiles against what its stream last showed.
//!
//! Invariant: a refused scan changes no masks and puts the slots that it names in doubt; flips of these slots are
//! refused until masks come. The cost of a scan depends on its changes, and on the number of slots if it sees other
//! slots than the scan before.

use tidemap_grid::{
    log_head::{SlotCell, StreamScan},
    mask::{Mask, TileMasks},
    scan::ScanSource,
};

use super::{
    MASK_BYTES, ScanRefusal,
    decoder_table::{DecoderTable, LAYER, TableSlot},
    flips::{FlipReader, unpack_runs},
};
use crate::v1;

/// Reads scans of tiles; keeps buffers that they share.
#[derive(Debug, Default)]
pub(super) struct TileScans {
    runs: Vec<(u32, u32)>,
    changes: Vec<(u32, TileMasks)>,
}

/// The masks of a message, slot by slot.
struct Masks<'a> {
    slots: std::slice::Iter<'a, u32>,
    observed: Option<std::slice::Iter<'a, [u8; MASK_BYTES]>>,
    occupied: std::slice::Iter<'a, [u8; MASK_BYTES]>,
    all: Mask,
}

impl<'a> Masks<'a> {
    fn new(scan: &'a v1::TileScan, is_flat: bool) -> Result<Masks<'a>, ScanRefusal> {
        let expected = scan.masked.len() * MASK_BYTES;
        let whole = |field: &str, bytes: &'a [u8], may_lack: bool| match bytes.len() {
            0 if may_lack => Ok([].iter()),
            length if length == expected => Ok(bytes.as_chunks::<MASK_BYTES>().0.iter()),
            length => Err(ScanRefusal::malformed(format!(
                "{field}: {length} bytes for {} tiles: it must be {MASK_BYTES} each",
                scan.masked.len()
            ))),
        };
        if let Some(pair) = scan.masked.windows(2).find(|pair| pair[0] >= pair[1]) {
            return Err(ScanRefusal::malformed(format!("masked: slot {} after slot {}", pair[1], pair[0])));
        }
        let observed = whole("observed", &scan.observed, true)?;
        Ok(Masks {
            slots: scan.masked.iter(),
            observed: (!scan.observed.is_empty()).then_some(observed),
            occupied: whole("occupied", &scan.occupied, false)?,
            all: if is_flat { LAYER } else { Mask::FULL },
        })
    }

    fn slot(&self) -> Option<u32> {
        self.slots.as_slice().first().copied()
    }

    /// The next masks if they belong to this slot: observed, occupied.
    fn next_of(&mut self, slot: u32) -> Option<(Mask, Mask)> {
        if self.slot() != Some(slot) {
            return None;
        }
        self.slots.next();
        let observed = match &mut self.observed {
            Some(observed) => Mask::from_bytes(observed.next()?),
            None => self.all,
        };
        Some((observed, Mask::from_bytes(self.occupied.next()?)))
    }
}

/// Finds ascending slots in ascending runs.
struct Within<'a> {
    runs: &'a [(u32, u32)],
}

impl Within<'_> {
    fn contains(&mut self, slot: u32) -> bool {
        if self.runs.first().is_some_and(|(_, end)| *end <= slot) {
            self.runs = &self.runs[self.runs.partition_point(|(_, end)| *end <= slot)..];
        }
        self.runs.first().is_some_and(|(first, _)| *first <= slot)
    }
}

impl TileScans {
    /// Reads a scan, and updates what the stream has shown.
    pub(super) fn read(
        &mut self,
        shown: &mut DecoderTable,
        scan: &v1::TileScan,
        utc_nanos: i64,
    ) -> Result<StreamScan, ScanRefusal> {
        let read = self.read_whole(shown, scan, utc_nanos);
        match &read {
            Ok(_) => shown.trust(&scan.masked),
            Err(_) => shown.doubt(named(scan, shown.slots.len()).as_deref()),
        }
        read
    }

    fn read_whole(
        &mut self,
        shown: &mut DecoderTable,
        scan: &v1::TileScan,
        utc_nanos: i64,
    ) -> Result<StreamScan, ScanRefusal> {
        let mut sees_others = false;
        if !scan.seen.is_empty() {
            unpack_runs(&scan.seen, shown.slots.len(), &mut self.runs)?;
            sees_others = self.runs != shown.runs;
        }
        let mut within = Within { runs: if sees_others { &self.runs } else { &shown.runs } };
        let mut masks = Masks::new(scan, shown.is_flat)?;
        let mut observed_flips = FlipReader::new("observed_flips", &scan.observed_flips);
        let mut occupied_flips = FlipReader::new("occupied_flips", &scan.occupied_flips);
        let (mut to_observed, mut to_occupied) =
            (Vec::with_capacity(scan.observed_flips.len()), Vec::with_capacity(scan.occupied_flips.len()));
        self.changes.clear();
        let mut in_doubt = None;
        loop {
            let next = [masks.slot(), observed_flips.slot(), occupied_flips.slot()].into_iter().flatten().min();
            let Some(number) = next else { break };
            let slot = shown.slots.get(number as usize).ok_or_else(|| {
                ScanRefusal::malformed(format!("slot {number} is beyond the stream's {} tiles", shown.slots.len()))
            })?;
            if !within.contains(number) {
                return Err(ScanRefusal::malformed(format!("slot {number} has changed and is not seen")));
            }
            let whole = masks.next_of(number);
            let (mut observed, mut occupied) = whole.unwrap_or((slot.masks.observed(), slot.masks.occupied()));
            if whole.is_none() && slot.is_in_doubt {
                in_doubt = in_doubt.or(Some(number));
            }
            // The flips can be passed on as sent, unless masks come before them or cells are clipped.
            let is_plain = whole.is_none() && slot.is_whole();
            while let Some(cell) = observed_flips.next_of(number)? {
                observed.flip((cell % 512) as u16);
                to_observed.extend(is_plain.then_some(cell));
            }
            while let Some(cell) = occupied_flips.next_of(number)? {
                occupied.flip((cell % 512) as u16);
                to_occupied.extend(is_plain.then_some(cell));
            }
            let checked = check(number, observed, occupied, shown.is_flat)?;
            if !is_plain {
                let changed = |before: Mask, now: Mask, to: &mut Vec<SlotCell>| {
                    to.extend(slot.cut(before ^ now).cells().map(|cell| number * 512 + u32::from(cell)));
                };
                let TableSlot { masks: before, .. } = slot;
                changed(before.observed(), observed, &mut to_observed);
                changed(before.occupied(), occupied, &mut to_occupied);
            }
            self.changes.push((number, checked));
        }
        if let Some(number) = in_doubt {
            let text = format!(
                "slot {number}: a malformed scan named it, so it is unknown what its flips refer to: send the slot's masks \
                 whole"
            );
            return Err(ScanRefusal::malformed(text));
        }
        shown.take(&self.changes, sees_others.then_some(&mut self.runs));
        let seen = shown.seen.clone();
        let source = ScanSource::Cells;
        Ok(StreamScan { utc_nanos, source, seen, observed_flips: to_observed, occupied_flips: to_occupied })
    }
}

/// The slots that a malformed scan names as changed; `None` if that cannot be determined.
fn named(scan: &v1::TileScan, table: usize) -> Option<Vec<u32>> {
    let max_bytes = scan.masked.len() * MASK_BYTES;
    if scan.observed.len() > max_bytes || scan.occupied.len() > max_bytes {
        return None;
    }
    let mut slots = scan.masked.clone();
    for flips in [&scan.observed_flips, &scan.occupied_flips] {
        let mut cell = 0u32;
        for &further in flips {
            cell = cell.checked_add(further)?;
            if slots.last() != Some(&(cell >> 9)) {
                slots.push(cell >> 9);
            }
        }
    }
    slots.iter().all(|slot| (*slot as usize) < table).then_some(slots)
}

fn check(slot: u32, observed: Mask, occupied: Mask, is_flat: bool) -> Result<TileMasks, ScanRefusal> {
    if is_flat && let Some(place) = (observed | occupied).without(LAYER).cells().next() {
        let text = format!("place {place} of slot {slot}: a flat grid has the places 0 to 63");
        return Err(ScanRefusal::malformed(text));
    }
    TileMasks::new(observed, occupied).ok_or_else(|| {
        let place = occupied.without(observed).cells().next().unwrap_or(0);
        ScanRefusal::malformed(format!("place {place} of slot {slot} is occupied but not observed"))
    })
}
