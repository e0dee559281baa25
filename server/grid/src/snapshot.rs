//! A grid after an update, for the store to save and restore.
//!
//! Invariant: a snapshot and the events after its map's log position determine the grid. A snapshot contains the
//! pending scans.

use std::sync::Arc;

use crate::{
    day::{GridDay, ScanTime},
    index::{CellBox, TileId},
    live_tile::LiveTile,
    mask::TileMasks,
    tile::{ModelSlot, SumsSlot},
};

/// A scan that waits because its time is too far in the future.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct FutureScan {
    /// The time and the sensor of the scan.
    pub time: ScanTime,
    /// The tiles that the scan saw, with their masks.
    pub tiles: Vec<(TileId, TileMasks)>,
}

/// A whole grid at one log position.
#[derive(Clone, Debug, PartialEq)]
pub struct GridSnapshot {
    /// Tiles; the index is the `TileId`. All tiles are settled: none takes part in a run.
    pub tiles: Vec<Arc<LiveTile>>,
    /// The model of each tile, as long as `tiles` or shorter.
    pub models: Vec<ModelSlot>,
    /// The sums of each tile, as long as `models`.
    pub sums: Vec<SumsSlot>,
    /// The tiles of the last scan in the log.
    pub last_seen: Arc<[TileId]>,
    /// Scans that no update has learned, ascending by day.
    pub days: Vec<GridDay>,
    /// Scans that wait because their time is too far in the future.
    pub future: Vec<FutureScan>,
    /// Scans acknowledged.
    pub scans: u64,
    /// Observations of single cells in the acknowledged scans.
    pub cell_observations: u64,
    /// The smallest box of all cells that scans were stated to show; empty if no scan states any.
    pub shown: CellBox,
    /// The time at which the first of the pending scans was received, or an earlier time; nanoseconds UTC of the
    /// server's clock.
    pub received_nanos: Option<i64>,
}

impl GridSnapshot {
    /// The part of the snapshot that the generation publishes: the snapshot without the sums and the pending scans.
    #[must_use]
    pub fn published(&self) -> GridSnapshot {
        GridSnapshot {
            tiles: self.tiles.clone(),
            models: self.models.clone(),
            sums: vec![SumsSlot::default(); self.models.len()],
            last_seen: Arc::default(),
            days: Vec::new(),
            future: Vec::new(),
            scans: self.scans,
            cell_observations: self.cell_observations,
            shown: self.shown,
            received_nanos: None,
        }
    }
}
