//! Sending scans.
//!
//! Invariant: scans and observations of a producer share one sequence and one window.

use tidemap_proto::{
    convert::scans::{TileError, TileTable},
    v1,
};

use super::{Producer, ProducerError};
use crate::observe::{scan::Scan, window::Window};

impl Producer {
    /// Accepts a scan and returns its number; waits while the window is full. The scan is durable once
    /// [`super::Progress::durable_sequence`] has reached the number.
    ///
    /// # Errors
    /// [`ProducerError`]; the scan is then not accepted.
    pub async fn send_scan(&mut self, time_nanos: i64, scan: Scan) -> Result<u64, ProducerError> {
        self.push_scan(time_nanos, |window| window.push_scan(time_nanos, scan)).await
    }

    /// Does the same as [`Producer::send_scan`], with a scan in wire form: its slots number the tiles so far, including
    /// `new_tiles` (x, y, z of each).
    ///
    /// # Errors
    /// [`ProducerError`]; the scan is then not accepted.
    pub async fn send_wire_scan(
        &mut self,
        time_nanos: i64,
        new_tiles: &[i32],
        scan: v1::Scan,
    ) -> Result<u64, ProducerError> {
        self.push_scan(time_nanos, |window| window.push_wire_scan(time_nanos, new_tiles, scan)).await
    }

    async fn push_scan(
        &mut self,
        time_nanos: i64,
        push: impl FnOnce(&mut Window) -> Result<u64, TileError>,
    ) -> Result<u64, ProducerError> {
        if time_nanos < 0 {
            return Err(ProducerError::TimeBefore1970(time_nanos));
        }
        self.room().await?;
        let pushed = self.shared.state().window.as_mut().map(push);
        let sequence = pushed.ok_or(ProducerError::Closed)??;
        self.shared.more.notify_one();
        Ok(sequence)
    }

    /// Continues from the tiles of the last scan that the daemon has, so that later scans can be sent as differences.
    /// Call it before the first scan, with everything durable.
    ///
    /// # Errors
    /// [`ProducerError`]
    pub async fn go_on_from(&mut self, tiles: TileTable) -> Result<(), ProducerError> {
        self.flush().await?;
        self.room().await?;
        if let Some(window) = &mut self.shared.state().window {
            window.go_on_from(tiles);
        }
        Ok(())
    }
}
