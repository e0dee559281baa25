//! A scan that spans messages, while it is incomplete.
//!
//! Invariant: it takes no more memory than its limits allow; the columns of its parts are joined. For readings that
//! will not be ray-cast, only the checksum is kept.

use super::{
    ScanError, ScanLimits,
    digest::{floats_crc, pose_crc},
    table::join_part,
};
use crate::{
    convert::{InvalidField, OverLimit},
    v1::{TileScan, scan::Content},
};

/// Memory that an incomplete scan of tiles may take per tile, bytes: its slot, its masks and some flips.
const TILE_BYTES: usize = 192;
/// Memory that it may always take, bytes.
const SCAN_BYTES_MIN: usize = 1 << 20;

/// The parts that have arrived.
#[derive(Debug)]
pub(super) struct Parts {
    pub sequence: u64,
    pub utc_nanos: i64,
    pub content: Option<Content>,
    /// Readings that are not kept.
    pub dropped: Option<DroppedReadings>,
}

/// Checksum and number of readings that are not kept.
#[derive(Clone, Copy, Debug)]
pub(super) struct DroppedReadings {
    crc: u32,
    numbers: usize,
}

impl DroppedReadings {
    /// The digest of the readings.
    pub(crate) fn digest(self) -> u64 {
        u64::from(self.crc)
    }
}

impl Parts {
    /// Appends the next part.
    pub(crate) fn join(&mut self, sequence: u64, utc_nanos: i64, part: Option<Content>) -> Result<(), ScanError> {
        if sequence != self.sequence {
            let text = format!("{sequence}: scan {} is unfinished, and its next part needs its number", self.sequence);
            return Err(InvalidField::new("scans.first_sequence", text).into());
        }
        if utc_nanos != self.utc_nanos {
            let text = format!("{utc_nanos}: the parts of scan {sequence} have its time, {}", self.utc_nanos);
            return Err(InvalidField::new("scans.first_time_nanos", text).into());
        }
        join_part(&mut self.content, part).map_err(|_| {
            let text = format!("the parts of scan {sequence} are not of one kind");
            InvalidField::new("scans.scans[0].content", text).into()
        })
    }

    /// Replaces readings by their checksum and number.
    pub(crate) fn fold(&mut self) {
        let (pose, numbers) = match &mut self.content {
            Some(Content::Cloud(cloud)) => (cloud.pose.as_ref(), std::mem::take(&mut cloud.xyz_m)),
            Some(Content::Ranges(scan)) => (scan.pose.as_ref(), std::mem::take(&mut scan.ranges_m)),
            _ => return,
        };
        let before = self.dropped.unwrap_or_else(|| DroppedReadings { crc: pose_crc(pose), numbers: 0 });
        let crc = floats_crc(before.crc, &numbers);
        self.dropped = Some(DroppedReadings { crc, numbers: before.numbers + numbers.len() });
    }

    /// Approximate memory, bytes.
    pub(crate) fn bytes(&self) -> usize {
        match &self.content {
            None => 0,
            Some(Content::Tiles(scan)) => tile_bytes(scan),
            Some(Content::Cloud(cloud)) => 4 * cloud.xyz_m.len() + cloud.frame_id.len(),
            Some(Content::Ranges(scan)) => 4 * scan.ranges_m.len() + scan.frame_id.len(),
        }
    }

    /// Checks the size of the parts.
    pub(crate) fn check(&self, limits: &ScanLimits) -> Result<(), ScanError> {
        let dropped = self.dropped.map_or(0, |dropped| dropped.numbers);
        let (what, got, max, setting) = match &self.content {
            None => return Ok(()),
            Some(Content::Tiles(scan)) => {
                let max = limits.tiles.saturating_mul(TILE_BYTES).max(SCAN_BYTES_MIN);
                ("bytes of one scan's tiles", tile_bytes(scan), max, "setting max_scan_tiles")
            }
            Some(Content::Cloud(cloud)) => {
                ("points of one scan", (dropped + cloud.xyz_m.len()) / 3, limits.points, "setting max_scan_points")
            }
            Some(Content::Ranges(scan)) => {
                ("rays of one scan", dropped + scan.ranges_m.len(), limits.points, "setting max_scan_points")
            }
        };
        Ok(OverLimit::check(what, got, max, setting)?)
    }
}

fn tile_bytes(scan: &TileScan) -> usize {
    let numbers = scan.seen.len() + scan.masked.len() + scan.observed_flips.len() + scan.occupied_flips.len();
    4 * numbers + scan.observed.len() + scan.occupied.len()
}
