//! The scans of one stream: decoded, cast where they are readings, and handed over in parcels.
//!
//! Invariant: a parcel is about as large as [`PARCEL_BYTES`], or holds a single scan, however much a message unpacks to.
//! Scans that were taken before are handed over too, only to be remembered: later ones refer to them.

use std::sync::Arc;

use tidemap_map::{
    event::RefusalReason,
    grid::{
        raycast::{CastError, CastLimits, Readings, cast},
        spec::GridSpec,
    },
};
use tidemap_proto::{
    convert::{
        InvalidField,
        scans::{DecodedScan, ScanContent, ScanDecoder, ScanLimits, ScanRefusal, content_crc},
    },
    v1::{ScanBatch, scan::Content},
};

use super::{Intake, IntakeError, cast_table::CastTable, last_sequence, shortened};
use crate::ingest::protocol::{Refused, ScanOrigin, ScanParcel, TakenScan};

/// Memory of a parcel at which it is handed over.
const PARCEL_BYTES: usize = 256 << 10;
/// Memory of a scan beside its flips, about.
const SCAN_BYTES: usize = 160;
/// Memory of a refusal, about.
const REFUSED_BYTES: usize = 300;
/// Cells that one ray may pass.
const RAY_CELLS_MAX: u64 = 100_000;
/// Cells that the rays of one scan may pass.
const CAST_CELLS_MAX: u64 = 200_000_000;
/// Readings of a message from which on casting them is no work for a stream's task.
const READINGS_AT_ONCE: usize = 2000;

/// What a stream has shown by scans.
#[derive(Debug)]
pub(super) struct ScanIntake {
    spec: Option<GridSpec>,
    decoder: ScanDecoder,
    cast_table: CastTable,
    limits: ScanLimits,
    /// What the message at hand adds to the stream's table, until it is handed over.
    new_tiles: Vec<tidemap_map::grid::index::TileIndex>,
    /// Readings of a scan that goes on.
    open_readings: usize,
    /// What the parcel before saw, shared by scans that saw the same.
    seen: Option<Arc<[u32]>>,
}

impl ScanIntake {
    pub fn new(grid: Option<&GridSpec>, limits: ScanLimits) -> ScanIntake {
        ScanIntake {
            spec: grid.cloned(),
            decoder: ScanDecoder::new(grid, limits),
            cast_table: CastTable::new(limits.tiles),
            limits,
            new_tiles: Vec::new(),
            open_readings: 0,
            seen: None,
        }
    }

    pub fn open_sequence(&self) -> Option<u64> {
        self.decoder.open_sequence()
    }

    /// What readings say of the grid, as flips against the scans that were cast before.
    fn cast(&mut self, utc_nanos: i64, readings: &Readings) -> Result<super::cast_table::CastScan, ScanRefusal> {
        let limits = CastLimits { ray_cells: RAY_CELLS_MAX, cells: CAST_CELLS_MAX, tiles: self.limits.tiles };
        let tiles = self.spec.as_ref().map_or(Ok(Vec::new()), |spec| cast(spec, readings, limits));
        let tiles = tiles.map_err(|error: CastError| refusal(RefusalReason::Scan, error.to_string()))?;
        if tiles.is_empty() {
            let detail = "no ray passes the grid's extent, or every reading is nearer than min_range_m";
            return Err(refusal(RefusalReason::Empty, detail.to_owned()));
        }
        Ok(self.cast_table.show(utc_nanos, &tiles))
    }
}

fn refusal(reason: RefusalReason, detail: String) -> ScanRefusal {
    ScanRefusal { reason, detail }
}

impl Intake {
    /// Begins a message of scans; they are to be taken out with [`Intake::next_scans`] before the next message. Says
    /// whether that is much work.
    ///
    /// # Errors
    /// What ends the stream.
    pub fn begin_scans(&mut self, message: ScanBatch) -> Result<bool, IntakeError> {
        let first = message.first_sequence;
        self.check_sequence(first)?;
        last_sequence(first, message.scans.len())?;
        if let Some(open) = self.scans.open_sequence()
            && open != first
        {
            let text = format!("{first}: scan {open} goes on, and its next part has its number");
            return Err(InvalidField::new("scans.first_sequence", text).into());
        }
        let readings = |content: Option<&Content>| match content {
            Some(Content::Cloud(cloud)) => cloud.xyz_m.len() / 3,
            Some(Content::Ranges(scan)) => scan.ranges_m.len(),
            _ => 0,
        };
        let count: usize = message.scans.iter().map(|scan| readings(scan.content.as_ref())).sum();
        let all = self.scans.open_readings + count;
        self.scans.open_readings = if message.continues { all } else { 0 };
        self.scans.new_tiles = self.scans.decoder.begin(message)?;
        Ok(all > READINGS_AT_ONCE)
    }

    /// The next scans of the message; `None` where all are out.
    ///
    /// # Errors
    /// What ends the stream.
    pub fn next_scans(&mut self) -> Result<Option<ScanParcel>, IntakeError> {
        let new_tiles = std::mem::take(&mut self.scans.new_tiles);
        let mut parcel = ScanParcel { first_sequence: self.next_sequence, new_tiles, ..ScanParcel::default() };
        parcel.bytes = 4 * SCAN_BYTES + parcel.new_tiles.len() * SCAN_BYTES;
        let mut is_empty = parcel.new_tiles.is_empty();
        while parcel.bytes < PARCEL_BYTES {
            let Some(scan) = self.scans.decoder.next_scan()? else { break };
            is_empty = false;
            self.take_scan(scan, &mut parcel);
        }
        parcel.last_sequence = self.next_sequence - 1;
        parcel.content_crc = self.content_crc;
        Ok((!is_empty).then_some(parcel))
    }

    fn take_scan(&mut self, decoded: DecodedScan, parcel: &mut ScanParcel) {
        let DecodedScan { sequence, utc_nanos, digest, content, mut refusal } = decoded;
        let is_new = sequence == self.next_sequence;
        if is_new {
            self.content_crc = content_crc(self.content_crc, utc_nanos, digest);
            self.next_sequence += 1;
        }
        let is_taken = is_new && refusal.is_none();
        let content_crc = self.content_crc;
        let mut taken = None;
        match content {
            Some(ScanContent::Tiles(scan)) => {
                let origin = ScanOrigin::Stream;
                taken = Some(TakenScan { sequence, content_crc, origin, is_taken, scan, ..TakenScan::default() });
            }
            Some(ScanContent::Readings(readings)) if is_taken => match self.scans.cast(utc_nanos, &readings) {
                Ok(cast) => {
                    let (scan, new_tiles, restarts) = (cast.scan, cast.new_tiles, cast.restarts);
                    let origin = ScanOrigin::Cast;
                    taken = Some(TakenScan { sequence, content_crc, origin, is_taken, scan, new_tiles, restarts });
                }
                Err(refused) => refusal = Some(refused),
            },
            _ => {}
        }
        parcel.bytes += SCAN_BYTES;
        if let Some(taken) = taken {
            let scan = &taken.scan;
            parcel.bytes += 4 * (scan.observed_flips.len() + scan.occupied_flips.len());
            parcel.bytes += SCAN_BYTES * taken.new_tiles.len();
            if self.scans.seen.as_ref().is_none_or(|seen| !Arc::ptr_eq(seen, &scan.seen)) {
                // Once as slots, once as tiles of the map.
                parcel.bytes += 8 * scan.seen.len();
                self.scans.seen = Some(Arc::clone(&scan.seen));
            }
            parcel.scans.push(taken);
        }
        if let Some(ScanRefusal { reason, detail }) = refusal.filter(|_| is_new) {
            parcel.bytes += REFUSED_BYTES;
            parcel.refused.push(Refused { sequence, reason, detail: shortened(&detail) });
        }
    }
}
