//! The parts of a scan that spans messages, put together.
//!
//! Invariant: the columns of the parts are put one behind the other, as the daemon does; pose, frame and limits are those
//! of the first part.

use tidemap_proto::v1::{Scan, scan::Content};

use super::TileError;

/// Adds a part to the parts before it.
pub(crate) fn join(whole: &mut Scan, part: Scan) -> Result<(), TileError> {
    match (&mut whole.content, part.content) {
        (Some(Content::Tiles(whole)), Some(Content::Tiles(part))) => {
            whole.seen.extend(part.seen);
            whole.masked.extend(part.masked);
            whole.observed.extend(part.observed);
            whole.occupied.extend(part.occupied);
            whole.observed_flips.extend(part.observed_flips);
            whole.occupied_flips.extend(part.occupied_flips);
        }
        (Some(Content::Cloud(whole)), Some(Content::Cloud(part))) => whole.xyz_m.extend(part.xyz_m),
        (Some(Content::Ranges(whole)), Some(Content::Ranges(part))) => whole.ranges_m.extend(part.ranges_m),
        _ => return Err(TileError::Parts),
    }
    Ok(())
}
