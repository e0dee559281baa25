//! Finds readings of cells that the model did not expect, as scans arrive.
//!
//! Invariant: the judgement of a reading equals that of [`super::anomalies`] for the reading later with the same model.

use tidemap_model::selector::ModelSelector;

use super::{Anomaly, Confidence, is_anomalous};

use tidemap_grid::{
    follower::{CellFollower, CellReading},
    index::CellIndex,
    scan::Scans,
    tile::TileUnavailable,
};

use crate::view::MapView;

/// Number of scans that are judged at once.
const SCANS: usize = 64;

impl MapView {
    /// Passes an event to a follower, and judges the readings by the models of this view. The anomalies come by scan,
    /// then by tile and place.
    ///
    /// # Errors
    /// [`TileUnavailable`] where a tile cannot be read from the disk; the follower has passed the event.
    pub fn unexpected_cells(
        &self,
        follower: &mut CellFollower,
        event: &Scans,
        selector: ModelSelector,
        confidence: Confidence,
    ) -> Result<Vec<(CellIndex, Anomaly)>, TileUnavailable> {
        let mut found = Vec::new();
        let mut failed = None;
        let mut readings: Vec<(CellReading, usize)> = Vec::new();
        let mut judge = |first: usize, readings: &mut Vec<(CellReading, usize)>| {
            if failed.is_none()
                && let Err(error) = self.judge_cells(event, first, readings, (selector, confidence), &mut found)
            {
                failed = Some(error);
            }
            readings.clear();
        };
        let mut first = 0;
        follower.pass(event, |scan, reading| {
            if scan >= first + SCANS {
                judge(first, &mut readings);
                first = scan;
            }
            readings.push((reading, scan));
        });
        judge(first, &mut readings);
        failed.map_or(Ok(found), Err)
    }

    /// Judges readings of at most [`SCANS`] scans, of which `first` is the earliest.
    fn judge_cells(
        &self,
        event: &Scans,
        first: usize,
        readings: &mut [(CellReading, usize)],
        (selector, confidence): (ModelSelector, Confidence),
        found: &mut Vec<(CellIndex, Anomaly)>,
    ) -> Result<(), TileUnavailable> {
        let Some(grid) = self.grid().filter(|_| !readings.is_empty()) else { return Ok(()) };
        let scans = event.scans.get(first..).unwrap_or_default();
        let nanos: Vec<i64> = scans.iter().take(SCANS).map(|scan| scan.utc_nanos).collect();
        let times = self.prepare(&nanos);
        let mut expected = vec![0.0; times.len()];
        let mut unexpected = Vec::new();
        readings.sort_unstable_by_key(|(reading, scan)| (reading.tile, reading.cell, *scan));
        for of_tile in readings.chunk_by(|(one, _), (next, _)| one.tile == next.tile) {
            let Some((CellReading { tile, index, .. }, _)) = of_tile.first().copied() else { continue };
            let model = grid.model(tile)?;
            for of_cell in of_tile.chunk_by(|(one, _), (next, _)| one.cell == next.cell) {
                let Some((CellReading { cell, .. }, _)) = of_cell.first().copied() else { continue };
                let description = grid.describe_learned(&model, cell);
                self.predict_cell_into(&description, &times, selector, &mut expected);
                for &(reading, scan) in of_cell {
                    let at = scan - first;
                    let (Some(&probability), Some(&utc_nanos)) = (expected.get(at), nanos.get(at)) else { continue };
                    let value = f64::from(u8::from(reading.is_occupied));
                    if is_anomalous(value, probability, confidence) {
                        let anomaly = Anomaly { utc_nanos, value, probability };
                        unexpected.push((scan, index.cell(cell), anomaly));
                    }
                }
            }
        }
        // The sort is stable: the anomalies of a scan stay ordered by tile and place.
        unexpected.sort_by_key(|(scan, ..)| *scan);
        found.extend(unexpected.into_iter().map(|(_, cell, anomaly)| (cell, anomaly)));
        Ok(())
    }
}
