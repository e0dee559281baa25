//! Messages of ROS 2 as bytes: CDR, version 1, in little-endian order.
//!
//! Invariant: a number stands at a multiple of its size, counted from behind the four bytes of the header.

use super::{MapRecordingError, messages::percents};
use crate::MapPicture;

const SEC_NANOS: i64 = 1_000_000_000;
/// Plain CDR in little-endian order, without options.
const HEADER: [u8; 4] = [0, 1, 0, 0];

struct Cdr(Vec<u8>);

impl Cdr {
    /// Appends a number, aligned to its size.
    fn number<const N: usize>(&mut self, bytes: [u8; N]) {
        while !(self.0.len() - HEADER.len()).is_multiple_of(N) {
            self.0.push(0);
        }
        self.0.extend(bytes);
    }

    /// Appends a text with its length, which counts the zero at its end.
    fn text(&mut self, text: &str) {
        self.count(text.len() + 1);
        self.0.extend(text.as_bytes());
        self.0.push(0);
    }

    fn count(&mut self, count: usize) {
        self.number(u32::try_from(count).unwrap_or(u32::MAX).to_le_bytes());
    }

    fn time(&mut self, nanos: i64) -> Result<(), MapRecordingError> {
        let sec = i32::try_from(nanos.div_euclid(SEC_NANOS)).map_err(|_| MapRecordingError::TooLate(nanos))?;
        let nanosec = u32::try_from(nanos.rem_euclid(SEC_NANOS)).unwrap_or_default();
        self.number(sec.to_le_bytes());
        self.number(nanosec.to_le_bytes());
        Ok(())
    }
}

/// A map as a `nav_msgs/msg/OccupancyGrid`.
///
/// # Errors
/// The map is invalid or not flat, or its time is out of range.
#[allow(clippy::cast_possible_truncation, reason = "the resolution of the message is a single")]
pub(super) fn occupancy_grid(time_nanos: i64, frame: &str, picture: &MapPicture) -> Result<Vec<u8>, MapRecordingError> {
    let cells = percents(picture)?;
    let mut cdr = Cdr(Vec::with_capacity(cells.len() + frame.len() + 128));
    cdr.0.extend(HEADER);
    cdr.time(time_nanos)?;
    cdr.text(frame);
    cdr.time(time_nanos)?;
    cdr.number((picture.resolution_m as f32).to_le_bytes());
    let [width, height, _] = picture.size_cells;
    cdr.number(width.to_le_bytes());
    cdr.number(height.to_le_bytes());
    let [x, y, _] = picture.origin_m;
    for number in [x, y, 0.0, 0.0, 0.0, 0.0, 1.0_f64] {
        cdr.number(number.to_le_bytes());
    }
    cdr.count(cells.len());
    cdr.0.extend(cells.iter().map(|percent| percent.to_le_bytes()[0]));
    Ok(cdr.0)
}
