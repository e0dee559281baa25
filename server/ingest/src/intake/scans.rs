//! The scans of one stream: they are decoded, ray-cast if they are readings, and handed over in batches.
//!
//! Invariant: a batch has about [`BATCH_BYTES`] and [`BATCH_CELLS`], or a single scan, for any unpacked size of a
//! message. Ray-cast tiles lie within the extent of the grid. Scans that were taken before are also handed over,
//! because later scans refer to them; they are not logged again.

use std::sync::Arc;

use tidemap_grid::{
    index::{CellBox, TileIndex},
    mask::TileMasks,
    raycast::{CastError, CastLimits, Readings, cast},
    scan::ScanSource,
    spec::GridSpec,
};
use tidemap_map::{event::SequenceSpan, ids::RefusalReason};
use tidemap_proto::convert::{
    InvalidField,
    scans::{DecodedScan, ScanContent, ScanDecoder, ScanLimits, ScanMessage, ScanRefusal, SentRays, content_crc},
};

use super::{Intake, IntakeError, cast_table::CastTable, early, shortened};
use crate::protocol::{CheckedScan, RefusedObservation, ScanBatch, ScanOrigin};

mod effort;

use effort::RayCells;

/// Memory of a batch at which it is handed over.
const BATCH_BYTES: usize = 256 << 10;
/// Memory of a scan besides its flips, approximately.
const SCAN_BYTES: usize = 160;
/// Memory of a refusal, approximately.
const REFUSED_BYTES: usize = 300;
/// Maximum number of cells that one ray passes.
const RAY_CELLS_MAX: u64 = 100_000;
/// Maximum number of cells that the rays of one scan pass.
const CAST_CELLS_MAX: u64 = 200_000_000;
/// Number of cells that the rays of a batch pass at which it is handed over.
const BATCH_CELLS: u64 = 20_000_000;
/// A message whose rays pass more cells than this is ray-cast off the async threads.
const CELLS_AT_ONCE: u64 = 20_000;

/// The state of a stream's scans.
#[derive(Debug)]
pub(super) struct ScanIntake {
    spec: Option<GridSpec>,
    decoder: ScanDecoder,
    cast_table: CastTable,
    limits: ScanLimits,
    /// Tiles that the current message adds to the stream's table, until they are handed over.
    new_tiles: Vec<TileIndex>,
    /// The cells that the scans of the current message show, until it is handed over.
    shown: CellBox,
    /// The estimate of the cost of rays; `None` without a grid.
    ray_cells: Option<RayCells>,
    /// Number of cells of an unfinished scan.
    open_cells: u64,
    /// Whether ray-casting the current message is expensive.
    is_much_work: bool,
    /// The tiles that the previous batch saw; scans that saw the same tiles share them.
    seen: Option<Arc<[u32]>>,
}

impl ScanIntake {
    pub(super) fn new(grid: Option<&GridSpec>, limits: ScanLimits) -> ScanIntake {
        ScanIntake {
            spec: grid.cloned(),
            decoder: ScanDecoder::new(grid, limits),
            cast_table: CastTable::new(limits.tiles),
            limits,
            new_tiles: Vec::new(),
            shown: CellBox::default(),
            ray_cells: grid.map(RayCells::new),
            open_cells: 0,
            is_much_work: false,
            seen: None,
        }
    }

    pub(super) fn held_bytes(&self) -> usize {
        self.decoder.held_bytes()
    }

    pub(super) fn open_sequence(&self) -> Option<u64> {
        self.decoder.open_sequence()
    }

    fn take_open_cells(&mut self) -> u64 {
        std::mem::take(&mut self.open_cells)
    }

    /// The number of cells that the rays of a message pass, approximately.
    fn cells_of(&self, message: &ScanMessage) -> u64 {
        let Some(cells) = &self.ray_cells else { return 0 };
        let (rays, is_open) = (message.rays(), self.open_sequence().is_some());
        let last = rays.len().saturating_sub(1);
        let message_cells = |(number, rays): (usize, Option<SentRays<'_>>)| {
            let is_part = (number == 0 && is_open) || (number == last && message.continues());
            rays.map_or(0, |rays| if is_part { cells.of_part(rays) } else { cells.of_scan(rays) })
        };
        rays.enumerate().map(message_cells).fold(0, u64::saturating_add)
    }

    /// Ray-casts readings; the result is flips against the last ray-cast scan.
    fn cast(&mut self, utc_nanos: i64, readings: &Readings) -> Result<super::cast_table::CastScan, ScanRefusal> {
        let limits = CastLimits { ray_cells: RAY_CELLS_MAX, cells: CAST_CELLS_MAX, tiles: self.limits.tiles };
        let tiles = self.spec.as_ref().map_or(Ok(Vec::new()), |spec| {
            let mut tiles = cast(spec, readings, limits)?;
            cut(spec, &mut tiles);
            Ok(tiles)
        });
        let tiles = tiles.map_err(|error: CastError| refusal(RefusalReason::Scan, error.to_string()))?;
        if tiles.is_empty() {
            let detail = "no beam has a return within the grid's extent and beyond min_range_m";
            return Err(refusal(RefusalReason::Empty, detail.to_owned()));
        }
        let source = self.spec.as_ref().map_or_else(ScanSource::default, |spec| readings.source(spec));
        Ok(self.cast_table.show((utc_nanos, source), &tiles))
    }
}

/// Removes the cells outside of the grid.
fn cut(spec: &GridSpec, tiles: &mut Vec<(TileIndex, TileMasks)>) {
    let allowed = spec.allowed();
    tiles.retain_mut(|(index, masks)| {
        if !index.is_valid() {
            return false;
        }
        let cells = index.cells();
        if cells.intersection(&allowed) != cells {
            let mut observed = masks.observed();
            for place in masks.observed().cells().filter(|&place| !allowed.contains(index.cell(place))) {
                observed.flip(place);
            }
            *masks = TileMasks::clipped(observed, masks.occupied());
        }
        !masks.observed().is_empty()
    });
}

fn refusal(reason: RefusalReason, detail: String) -> ScanRefusal {
    ScanRefusal { reason, detail }
}

impl Intake {
    /// Begins a message of scans; take them with [`Intake::next_scans`] before the next message. Returns whether
    /// ray-casting them is expensive.
    ///
    /// # Errors
    /// Errors that end the stream.
    pub fn begin_scans(&mut self, message: ScanMessage) -> Result<bool, IntakeError> {
        self.check_sequences(message.sequences())?;
        let first = *message.sequences().start();
        if let Some(open) = self.scans.open_sequence()
            && open != first
        {
            let text = format!("{first}: scan {open} is unfinished, and its next part must have its number");
            return Err(InvalidField::new("scans.first_sequence", text).into());
        }
        let all = self.scans.take_open_cells().saturating_add(self.scans.cells_of(&message));
        self.scans.open_cells = if message.continues() { all } else { 0 };
        self.scans.is_much_work = all > CELLS_AT_ONCE;
        self.scans.shown = self.scans.spec.as_ref().map_or_else(CellBox::default, |spec| {
            let shown = message.shown().intersection(&spec.allowed());
            if shown.is_empty() { CellBox::default() } else { shown }
        });
        self.scans.new_tiles = self.scans.decoder.begin(message)?;
        if self.scans.spec.is_none() {
            // Without a grid no scans are handed over, so the tiles are not needed.
            self.scans.new_tiles = Vec::new();
        }
        Ok(self.scans.is_much_work)
    }

    /// The next scans of the message; `None` after the last. Waits for a permit if ray-casting is expensive.
    ///
    /// # Errors
    /// Errors that end the stream.
    pub fn next_scans(&mut self) -> Result<Option<ScanBatch>, IntakeError> {
        let new_tiles = std::mem::take(&mut self.scans.new_tiles);
        let span = SequenceSpan { first: self.next_sequence, ..SequenceSpan::default() };
        let shown = std::mem::take(&mut self.scans.shown);
        let mut batch = ScanBatch { span, new_tiles, shown, ..ScanBatch::default() };
        batch.bytes = 4 * SCAN_BYTES + batch.new_tiles.len() * SCAN_BYTES;
        let mut is_empty = batch.new_tiles.is_empty();
        let permit = self.scans.is_much_work.then(effort::permit);
        let mut cells = 0;
        while batch.bytes < BATCH_BYTES && cells < BATCH_CELLS {
            let Some(scan) = self.scans.decoder.next_scan()? else { break };
            is_empty = false;
            cells += self.take_scan(scan, &mut batch)?;
        }
        drop(permit);
        batch.span.last = self.next_sequence - 1;
        batch.span.content_crc = self.content_crc;
        if !batch.span.is_empty() {
            self.known.took(batch.span.last, self.content_crc);
        }
        Ok((!is_empty).then_some(batch))
    }

    /// Takes one scan; returns the number of cells that its rays pass, approximately.
    fn take_scan(&mut self, decoded: DecodedScan, batch: &mut ScanBatch) -> Result<u64, IntakeError> {
        let DecodedScan { sequence, utc_nanos, digest, content, mut refusal } = decoded;
        let is_new = sequence == self.next_sequence;
        if is_new {
            self.content_crc = content_crc(self.content_crc, utc_nanos, digest);
            self.next_sequence += 1;
        } else {
            self.known.repeated(sequence, |crc| content_crc(crc, utc_nanos, digest))?;
        }
        if refusal.is_none() && utc_nanos < self.earliest_nanos {
            refusal = Some(ScanRefusal { reason: RefusalReason::Time, detail: early::refusal(utc_nanos) });
        }
        let is_taken = is_new && refusal.is_none();
        let content_crc = self.content_crc;
        let (mut taken, mut cells) = (None, 0);
        match content {
            Some(ScanContent::Tiles(scan)) => {
                let origin = ScanOrigin::Stream;
                taken = Some(CheckedScan { sequence, content_crc, origin, is_taken, scan, ..CheckedScan::default() });
            }
            Some(ScanContent::Readings(readings)) if is_taken => {
                cells = self.scans.ray_cells.as_ref().map_or(0, |cells| cells.of_readings(&readings));
                match self.scans.cast(utc_nanos, &readings) {
                    Ok(cast) => {
                        let (scan, new_tiles, restarts) = (cast.scan, cast.new_tiles, cast.restarts);
                        let origin = ScanOrigin::Cast;
                        taken =
                            Some(CheckedScan { sequence, content_crc, origin, is_taken, scan, new_tiles, restarts });
                    }
                    Err(refused) => refusal = Some(refused),
                }
            }
            _ => {}
        }
        batch.bytes += SCAN_BYTES;
        if let Some(taken) = taken {
            let scan = &taken.scan;
            batch.bytes += 4 * (scan.observed_flips.len() + scan.occupied_flips.len());
            batch.bytes += SCAN_BYTES * taken.new_tiles.len();
            if self.scans.seen.as_ref().is_none_or(|seen| !Arc::ptr_eq(seen, &scan.seen)) {
                // The tiles are counted twice: as slots, and as tiles of the map.
                batch.bytes += 8 * scan.seen.len();
                self.scans.seen = Some(Arc::clone(&scan.seen));
            }
            batch.scans.push(taken);
        }
        if let Some(ScanRefusal { reason, detail }) = refusal.filter(|_| is_new) {
            batch.bytes += REFUSED_BYTES;
            batch.refused.push(RefusedObservation { sequence, reason, detail: shortened(&detail) });
        }
        Ok(cells)
    }
}
