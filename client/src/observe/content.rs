//! The checksum of the data that a producer has sent, by which both sides detect differences.
//!
//! Invariant: the bytes are the bytes that `Welcome.content_crc` in `observation.proto` defines.

use tidemap_proto::{
    convert::{reports::append_content, sightings::SightingReport, traversals::TraversalReport},
    v1,
};

/// CRC-32C over observations, scans and reports in order.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct ContentCrc(u32);

impl ContentCrc {
    /// Continues from the checksum of the daemon.
    #[must_use]
    pub fn from_value(value: u32) -> Self {
        Self(value)
    }

    /// Adds the next observation.
    pub fn add(&mut self, state: &str, time_nanos: i64, value: f64) {
        let mut tail = [0; 16];
        tail[..8].copy_from_slice(&time_nanos.to_le_bytes());
        tail[8..].copy_from_slice(&value.to_bits().to_le_bytes());
        self.0 = crc32c::crc32c_append(crc32c::crc32c_append(self.0, state.as_bytes()), &tail);
    }

    /// Adds the next observation, of a vector.
    pub fn add_position(&mut self, state: &str, time_nanos: i64, coordinates: &[f64]) {
        self.0 = crc32c::crc32c_append(self.0, state.as_bytes());
        self.0 = crc32c::crc32c_append(self.0, &time_nanos.to_le_bytes());
        for coordinate in coordinates {
            self.0 = crc32c::crc32c_append(self.0, &coordinate.to_bits().to_le_bytes());
        }
    }

    /// Adds the next scan.
    pub fn add_scan(&mut self, time_nanos: i64, digest: u64) {
        let mut both = [0; 16];
        both[..8].copy_from_slice(&time_nanos.to_le_bytes());
        both[8..].copy_from_slice(&digest.to_le_bytes());
        self.0 = crc32c::crc32c_append(self.0, &both);
    }

    /// Adds the next traversal, as it is sent.
    pub fn add_traversal(&mut self, report: &TraversalReport) {
        self.add_report(&report.to_report());
    }

    /// Adds the next sighting, as it is sent.
    pub fn add_sighting(&mut self, report: &SightingReport) {
        self.add_report(&report.to_report());
    }

    pub(super) fn add_report(&mut self, report: &v1::Report) {
        let mut bytes = Vec::new();
        append_content(report, &mut bytes);
        self.0 = crc32c::crc32c_append(self.0, &bytes);
    }

    /// The checksum so far; 0 if nothing was added.
    #[must_use]
    pub fn value(self) -> u32 {
        self.0
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_checksum_is_that_of_the_bytes_in_a_row() {
        let mut crc = ContentCrc::default();
        assert_eq!(crc.value(), 0);
        crc.add("door", 1, 0.5);
        crc.add("", 0, 1.0);
        crc.add_scan(7, 8);
        crc.add_position("anna", 2, &[0.25, 4.0]);
        let stuck = TraversalReport {
            from: "Hall".to_owned(),
            to: "Lab".to_owned(),
            start_nanos: 3,
            end_nanos: -1,
            reason: "stuck\n".to_owned(),
            ..TraversalReport::default()
        };
        crc.add_traversal(&stuck);
        let bytes = [
            b"door".as_slice(),
            &1_i64.to_le_bytes(),
            &0.5_f64.to_le_bytes(),
            &0_i64.to_le_bytes(),
            &1.0_f64.to_le_bytes(),
            &7_i64.to_le_bytes(),
            &8_u64.to_le_bytes(),
            b"anna",
            &2_i64.to_le_bytes(),
            &0.25_f64.to_le_bytes(),
            &4.0_f64.to_le_bytes(),
            b"edge/Hall/Lab",
            &3_i64.to_le_bytes(),
            &(-1_i64).to_le_bytes(),
            &[0],
            b"stuck",
        ];
        assert_eq!(crc.value(), crc32c::crc32c(&bytes.concat()));
    }
}
