//! A scan that spans messages, while it is not whole.
//!
//! Invariant: it takes no more memory than its limits allow; the columns of its parts are put one behind the other. Of
//! readings that nobody will cast only the checksum is kept.

use super::{
    ScanError, ScanLimits,
    digest::{floats_crc, pose_crc},
    table::join_part,
};
use crate::{
    convert::{InvalidField, OverLimit},
    v1::{TileScan, scan::Content},
};

/// Memory that a scan of tiles may take per tile while it is not whole: its slot, its masks and some flips.
const TILE_BYTES: usize = 192;
/// Memory that it may take however few tiles there may be.
const LEAST_BYTES: usize = 1 << 20;

/// What has come of a scan.
#[derive(Debug)]
pub(super) struct Parts {
    pub sequence: u64,
    pub utc_nanos: i64,
    pub content: Option<Content>,
    /// Readings that are not kept.
    pub folded: Option<Folded>,
}

/// What is left of readings that are not kept.
#[derive(Clone, Copy, Debug)]
pub(super) struct Folded {
    crc: u32,
    numbers: usize,
}

impl Folded {
    /// The digest of the readings.
    pub fn digest(self) -> u64 {
        u64::from(self.crc)
    }
}

impl Parts {
    /// Puts the next part behind those that have come.
    pub fn join(&mut self, sequence: u64, utc_nanos: i64, part: Option<Content>) -> Result<(), ScanError> {
        if sequence != self.sequence {
            let text = format!("{sequence}: scan {} goes on, and its next part has its number", self.sequence);
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

    /// Keeps no more of readings than their checksum and how many they are.
    pub fn fold(&mut self) {
        let (pose, numbers) = match &mut self.content {
            Some(Content::Cloud(cloud)) => (cloud.pose.as_ref(), std::mem::take(&mut cloud.xyz_m)),
            Some(Content::Ranges(scan)) => (scan.pose.as_ref(), std::mem::take(&mut scan.ranges_m)),
            _ => return,
        };
        let before = self.folded.unwrap_or_else(|| Folded { crc: pose_crc(pose), numbers: 0 });
        let crc = floats_crc(before.crc, &numbers);
        self.folded = Some(Folded { crc, numbers: before.numbers + numbers.len() });
    }

    /// Memory that it takes, about.
    pub fn bytes(&self) -> usize {
        match &self.content {
            None => 0,
            Some(Content::Tiles(scan)) => tile_bytes(scan),
            Some(Content::Cloud(cloud)) => 4 * cloud.xyz_m.len() + cloud.frame_id.len(),
            Some(Content::Ranges(scan)) => 4 * scan.ranges_m.len() + scan.frame_id.len(),
        }
    }

    /// Checks the size of what has come.
    pub fn check(&self, limits: &ScanLimits) -> Result<(), ScanError> {
        let folded = self.folded.map_or(0, |folded| folded.numbers);
        let (what, got, max, setting) = match &self.content {
            None => return Ok(()),
            Some(Content::Tiles(scan)) => {
                let max = limits.tiles.saturating_mul(TILE_BYTES).max(LEAST_BYTES);
                ("bytes of one scan's tiles", tile_bytes(scan), max, "setting max_scan_tiles")
            }
            Some(Content::Cloud(cloud)) => {
                ("points of one scan", (folded + cloud.xyz_m.len()) / 3, limits.points, "setting max_scan_points")
            }
            Some(Content::Ranges(scan)) => {
                ("rays of one scan", folded + scan.ranges_m.len(), limits.points, "setting max_scan_points")
            }
        };
        Ok(OverLimit::check(what, got, max, setting)?)
    }
}

fn tile_bytes(scan: &TileScan) -> usize {
    let numbers = scan.seen.len() + scan.masked.len() + scan.observed_flips.len() + scan.occupied_flips.len();
    4 * numbers + scan.observed.len() + scan.occupied.len()
}
