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
    /// Gives a scan its number and takes charge of it; waits while the window is full. The scan is durable once
    /// [`super::Progress::durable_sequence`] has reached the number.
    ///
    /// # Errors
    /// [`ProducerError`]; the scan has then not been taken.
    pub async fn send_scan(&mut self, time_nanos: i64, scan: Scan) -> Result<u64, ProducerError> {
        self.push_scan(time_nanos, |window| window.push_scan(time_nanos, scan)).await
    }

    /// As [`Producer::send_scan`], with a scan as on the wire: its slots are those of the tiles so far, `new_tiles` (x, y,
    /// z of each) included.
    ///
    /// # Errors
    /// [`ProducerError`]; the scan has then not been taken.
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

    /// Goes on from what the last scan showed that the daemon has, so that what follows can be sent as differences. Before
    /// the first scan, with everything sent so far durable.
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
