//! A scan that spans messages, while it is not whole.
//!
//! Invariant: it takes no more memory than its limits allow; the columns of its parts are put one behind the other.

use super::{ScanError, ScanLimits};
use crate::{convert::InvalidField, v1::scan::Content};

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
        match (&mut self.content, part) {
            (Some(Content::Tiles(known)), Some(Content::Tiles(part))) => {
                known.seen.extend(part.seen);
                known.masked.extend(part.masked);
                known.observed.extend(part.observed);
                known.occupied.extend(part.occupied);
                known.observed_flips.extend(part.observed_flips);
                known.occupied_flips.extend(part.occupied_flips);
            }
            (Some(Content::Cloud(known)), Some(Content::Cloud(part))) => known.xyz_m.extend(part.xyz_m),
            (Some(Content::Ranges(known)), Some(Content::Ranges(part))) => known.ranges_m.extend(part.ranges_m),
            _ => {
                let text = format!("the parts of scan {sequence} are not of one kind");
                return Err(InvalidField::new("scans.scans[0].content", text).into());
            }
        }
        Ok(())
    }

    /// Checks the size of what has come.
    pub fn check(content: Option<&Content>, limits: &ScanLimits) -> Result<(), ScanError> {
        let (what, got, max, setting) = match content {
            None => return Ok(()),
            Some(Content::Tiles(scan)) => {
                let numbers =
                    scan.seen.len() + scan.masked.len() + scan.observed_flips.len() + scan.occupied_flips.len();
                let bytes = 4 * numbers + scan.observed.len() + scan.occupied.len();
                let max = limits.tiles.saturating_mul(TILE_BYTES).max(LEAST_BYTES);
                ("bytes of one scan's tiles", bytes, max, "setting max_scan_tiles")
            }
            Some(Content::Cloud(cloud)) => {
                ("points of one scan", cloud.xyz_m.len() / 3, limits.points, "setting max_scan_points")
            }
            Some(Content::Ranges(scan)) => {
                ("rays of one scan", scan.ranges_m.len(), limits.points, "setting max_scan_points")
            }
        };
        if got > max {
            return Err(ScanError::Limit { what, got: got as u64, max: max as u64, setting });
        }
        Ok(())
    }
}
