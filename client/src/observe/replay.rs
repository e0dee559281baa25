//! What a daemon would have after receiving a file of scans, computed without sending it.
//!
//! Invariant: numbers, checksum and tiles are those of a producer that sent the same scans.

use tidemap_proto::{
    convert::scans::{TileError, TileTable},
    v1,
};

use super::{scan::Scan, window::Window};

/// Follows scans, from the first.
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

    fn follow(&mut self, number: u64) {
        self.0.sent(1);
        // What was just sent can be acknowledged.
        let _ = self.0.acknowledged(number);
    }

    /// Number of scans so far.
    #[must_use]
    pub fn scans(&self) -> u64 {
        self.0.durable()
    }

    /// Checksum of the durable scans.
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
