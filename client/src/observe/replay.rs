//! The state that a daemon would have after receiving the scans and observations of a file, computed without sending
//! them.
//!
//! Invariant: numbers, checksum and tiles are equal to those of a producer that sent the same data.

use tidemap_model::Position;
use tidemap_proto::{
    convert::{
        scans::{TileError, TileTable},
        traversals::TraversalReport,
    },
    v1,
};

use super::{producer::label_name, scan::Scan, window::Window};

/// Follows scans and observations, from the first.
#[derive(Debug)]
pub struct Replay(Window);

impl Default for Replay {
    fn default() -> Self {
        Self(Window::new(1, 0, 0))
    }
}

impl Replay {
    /// The next scan.
    ///
    /// # Errors
    /// [`TileError`]
    pub fn scan(&mut self, time_nanos: i64, scan: Scan) -> Result<(), TileError> {
        let number = self.0.push_scan(time_nanos, scan)?;
        self.follow(number);
        Ok(())
    }

    /// The next scan, as on the wire.
    ///
    /// # Errors
    /// [`TileError`]
    pub fn wire_scan(&mut self, time_nanos: i64, new_tiles: &[i32], scan: v1::Scan) -> Result<(), TileError> {
        let number = self.0.push_wire_scan(time_nanos, new_tiles, scan)?;
        self.follow(number);
        Ok(())
    }

    /// The next observation, of a value.
    pub fn value(&mut self, state: &str, time_nanos: i64, value: f64) {
        let number = self.0.push(state, time_nanos, value);
        number.into_iter().for_each(|number| self.follow(number));
    }

    /// The next observation, of a label.
    pub fn label(&mut self, state: &str, time_nanos: i64, label: &str) {
        let number = self.0.push_label(&label_name(state, label), time_nanos);
        number.into_iter().for_each(|number| self.follow(number));
    }

    /// Adds the next observation, of a position. An observation without two or three coordinates is not counted.
    pub fn position(&mut self, state: &str, time_nanos: i64, coordinates: &[f64]) {
        let number = Position::of(coordinates).and_then(|position| self.0.push_position(state, time_nanos, position));
        number.into_iter().for_each(|number| self.follow(number));
    }

    /// The next traversal.
    pub fn traversal(&mut self, report: &TraversalReport) {
        let number = self.0.push_report(report.to_report());
        number.into_iter().for_each(|number| self.follow(number));
    }

    fn follow(&mut self, number: u64) {
        self.0.sent(1);
        // The items that were just sent can be acknowledged.
        let _ = self.0.acknowledged(number);
    }

    /// Number of scans and observations so far.
    #[must_use]
    pub fn count(&self) -> u64 {
        self.0.durable()
    }

    /// Checksum of all scans and observations so far.
    #[must_use]
    pub fn content_crc(&self) -> u32 {
        self.0.content_crc()
    }

    /// The tiles that the last scan has shown.
    #[must_use]
    pub fn into_tiles(self) -> TileTable {
        self.0.into_tiles()
    }
}
