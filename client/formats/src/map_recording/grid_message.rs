//! Maps as messages of ROS 2.
//!
//! Invariant: the fields are the fields of the definition that the recording holds, in the order of the definition.

use super::{MapRecordingError, messages::percents};
use crate::{
    MapPicture,
    cdr::{Cdr, TooLate},
};

impl From<TooLate> for MapRecordingError {
    fn from(TooLate(nanos): TooLate) -> Self {
        Self::TooLate(nanos)
    }
}

/// A map as a `nav_msgs/msg/OccupancyGrid`.
///
/// # Errors
/// The map is invalid or not flat, or its time is out of range.
#[allow(clippy::cast_possible_truncation, reason = "the resolution of the message is a single")]
pub(super) fn occupancy_grid(time_nanos: i64, frame: &str, picture: &MapPicture) -> Result<Vec<u8>, MapRecordingError> {
    let cells = percents(picture)?;
    let mut cdr = Cdr::with_capacity(cells.len() + frame.len() + 128);
    cdr.time(time_nanos)?;
    cdr.text(frame);
    cdr.time(time_nanos)?;
    cdr.number((picture.resolution_m as f32).to_le_bytes());
    let [width, height, _] = picture.size_cells;
    cdr.number(width.to_le_bytes());
    cdr.number(height.to_le_bytes());
    let [x, y, _] = picture.origin_m;
    cdr.doubles(&[x, y, 0.0, 0.0, 0.0, 0.0, 1.0]);
    cdr.count(cells.len());
    cdr.bytes(cells.iter().map(|percent| percent.to_le_bytes()[0]));
    Ok(cdr.into_bytes())
}
