//! The naive data of scans: each of them, whole.
//!
//! Invariant: scans are kept in order of arrival; those that had to wait arrive when their time has come.

use std::{collections::BTreeMap, sync::Arc};

use tidemap_grid::{
    day::{GridDay, ScanTime},
    index::{TileId, TileIndex},
    live::LiveGrid,
    mask::TileMasks,
    outcome::GridOutcome,
    scan::ScanSource,
    sensors::ProducerSensor,
};
use tidemap_model::{LocalDay, Periodicities};

use super::robot::Seen;
use crate::history::HistoryPiece;

/// A scan with the masks that it showed.
#[derive(Clone, Debug)]
struct Whole {
    utc_nanos: i64,
    offset_secs: i32,
    sensor: Option<ProducerSensor>,
    tiles: Vec<(TileIndex, TileMasks)>,
}

/// All scans that no update has folded in.
#[derive(Clone, Debug, Default)]
pub(crate) struct ScanOracle {
    pending: Vec<Whole>,
    future: Vec<Whole>,
    taken: Vec<Whole>,
    pub(crate) count: u64,
}

impl ScanOracle {
    pub(crate) fn take(&mut self, seen: &Seen, offset_secs: i32, sensor: Option<ProducerSensor>, is_ahead: bool) {
        let utc_nanos = seen.utc_nanos;
        let queue = if is_ahead { &mut self.future } else { &mut self.pending };
        queue.push(Whole { utc_nanos, offset_secs, sensor, tiles: seen.tiles.clone() });
        self.count += 1;
    }

    pub(crate) fn start_update(&mut self, cut_nanos: i64) {
        let is_due = |scan: &mut Whole| scan.utc_nanos < cut_nanos;
        let mut due: Vec<Whole> = self.future.extract_if(.., is_due).collect();
        due.sort_by_key(|scan| scan.utc_nanos);
        self.pending.append(&mut due);
        self.taken = self.pending.extract_if(.., is_due).collect();
    }

    pub(crate) fn pending(&self) -> u64 {
        (self.pending.len() + self.future.len()) as u64
    }

    /// Compares the oracle with the scans that the update reports as folded in.
    pub(crate) fn finish_update(
        &mut self,
        outcome: &GridOutcome,
        history: &[Arc<HistoryPiece>],
        periodicities: &Periodicities,
        grid: &LiveGrid,
    ) {
        let taken = std::mem::take(&mut self.taken);
        assert_eq!(outcome.scans, taken.len() as u64);
        let count = |scan: &Whole| scan.tiles.iter().map(|(_, masks)| u64::from(masks.observed().count())).sum::<u64>();
        assert_eq!(outcome.cells.observations, taken.iter().map(count).sum::<u64>());
        let [before, now] =
            [outcome.cells_by_order_before, outcome.cells_by_order].map(|cells| cells.iter().sum::<u64>());
        assert!(before <= now && now == outcome.changed_cells, "{outcome:?}");
        // The chosen order is one of the orders, cell by cell.
        let all = outcome.cells.squared_errors.iter().sum::<f64>();
        assert!((0.0..=all + 1e-9).contains(&outcome.cells.squared_error_chosen), "{outcome:?}");
        let mut by_day: BTreeMap<LocalDay, Vec<Whole>> = BTreeMap::new();
        let time = |scan: &Whole| ScanTime {
            utc_nanos: scan.utc_nanos,
            offset_secs: scan.offset_secs,
            source: ScanSource::Cells,
            sensor: grid.sensors().find(scan.sensor).expect("one of the grid's"),
        };
        for scan in taken {
            by_day.entry(LocalDay::of_civil_nanos(time(&scan).civil_nanos())).or_default().push(scan);
        }
        let days: Vec<GridDay> =
            history.iter().flat_map(|piece| &piece.days).map(|day| day.decode(periodicities)).collect();
        assert_eq!(days.len(), by_day.len(), "days");
        for (found, (day, scans)) in days.iter().zip(by_day) {
            assert_eq!((found.day, found.scans.len()), (day, scans.len()));
            let shown = unfold(found);
            for ((found, shown), scan) in found.scans.iter().zip(shown).zip(scans) {
                let id = |tile: TileIndex| grid.find(tile).expect("a tile that was seen");
                let tiles: BTreeMap<TileId, TileMasks> =
                    scan.tiles.iter().map(|&(tile, masks)| (id(tile), masks)).collect();
                assert_eq!((*found, shown), (time(&scan), tiles));
            }
        }
    }
}

/// The masks of each scan of a day.
fn unfold(day: &GridDay) -> Vec<BTreeMap<TileId, TileMasks>> {
    let mut shown = vec![BTreeMap::new(); day.scans.len()];
    for ((id, tile), ranges) in day.tiles().zip(&day.presence_by_tile()) {
        assert_eq!(day.tile(id), Some(tile));
        let mut last = tile.first;
        for (scan, masks) in tile.scans(ranges) {
            shown[scan as usize].insert(id, masks);
            last = masks;
        }
        assert_eq!(tile.last, last);
    }
    shown
}
