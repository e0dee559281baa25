//! Encodes a day of scans for history, and decodes it, whole or cell by cell.
//!
//! Invariant: decoding returns exactly what was encoded.

use rayon::prelude::*;
use tidemap_grid::{
    day::{DayTile, GridDay},
    generation::Generation,
    index::TileId,
    mask::Mask,
    tile::ModelSlot,
};
use tidemap_model::Periodicities;

use super::{
    HistoryDay, HistoryPiece, OutlierModel, Reading, Subject,
    choose::choose,
    exchange::{Rows, exchange},
    phasors::DayPhasors,
    seen::{Seen, flips_of, order},
};

impl HistoryDay {
    /// Encodes a day. Cells are kept against small models where that takes fewer bytes. `levels` are the values of a
    /// free and an occupied reading. Runs on the current rayon pool.
    pub fn encode(
        mut day: GridDay,
        generation: &Generation,
        periodicities: &Periodicities,
        levels: (f64, f64),
    ) -> HistoryDay {
        let phasors = DayPhasors::new(periodicities, &day.scans);
        let presence = day.presence_by_tile();
        let tiles = std::mem::take(day.tiles_mut());
        let encode = |rows: &mut Rows, id: TileId, tile: Box<DayTile>, ranges: &[(u32, u32)]| {
            // A tile whose model cannot be read now is kept unchanged, and so are flips that would be decoded in
            // another order.
            let model = generation.model(id).and_then(|slot| ModelSlot::get(slot).ok());
            let model = model.filter(|_| tile.flips.is_sorted_by_key(order));
            let Some(model) = model else { return ((id, tile), None) };
            let seen = Seen::new(ranges, phasors.scans());
            let models = choose(&tile, &seen, &model, levels, &phasors, rows);
            if models.is_empty() {
                return ((id, tile), None);
            }
            let outliers = exchange(&tile, &seen, &models, &phasors, rows);
            ((id, Box::new(outliers)), Some((id, models)))
        };
        let encoded: Vec<_> = tiles
            .into_par_iter()
            .zip(presence)
            .map_init(Rows::default, |rows, ((id, tile), ranges)| encode(rows, id, tile, &ranges))
            .collect();
        let mut models = Vec::new();
        for (tile, of_tile) in encoded {
            day.tiles_mut().push(tile);
            models.extend(of_tile);
        }
        HistoryDay { outliers: day, models }
    }

    /// The exact day. Runs on the current rayon pool.
    pub fn decode(&self, periodicities: &Periodicities) -> GridDay {
        let mut day = self.outliers.clone();
        if self.models.is_empty() {
            return day;
        }
        let phasors = DayPhasors::new(periodicities, &day.scans);
        let presence = day.presence_by_tile();
        day.tiles_mut().par_iter_mut().zip(presence).for_each_init(Rows::default, |rows, ((id, tile), ranges)| {
            let models = self.models_of(*id);
            if !models.is_empty() {
                let seen = Seen::new(&ranges, phasors.scans());
                **tile = exchange(tile, &seen, models, &phasors, rows);
            }
        });
        day
    }

    /// The models of a tile's cells.
    pub(crate) fn models_of(&self, tile: TileId) -> &[OutlierModel] {
        let found = self.models.binary_search_by_key(&tile, |(tile, _)| *tile).ok();
        found.and_then(|at| self.models.get(at)).map_or(&[], |(_, models)| models)
    }

    /// The readings of a cell, occupied or not, at each scan that observed it: nanoseconds UTC and reading, in order of
    /// arrival.
    pub fn readings(&self, tile: TileId, cell: u16, periodicities: &Periodicities) -> Vec<(i64, bool)> {
        let model = self.models_of(tile).iter().find(|model| model.cell == cell);
        readings(&self.outliers, tile, cell, model, periodicities)
    }
}

/// The readings of a cell in a day of scans, occupied or not, at each scan that observed it: nanoseconds UTC and
/// reading, in order of arrival.
pub(crate) fn day_readings(day: &GridDay, tile: TileId, cell: u16, periodicities: &Periodicities) -> Vec<(i64, bool)> {
    readings(day, tile, cell, None, periodicities)
}

fn readings(
    day: &GridDay,
    id: TileId,
    cell: u16,
    model: Option<&OutlierModel>,
    periodicities: &Periodicities,
) -> Vec<(i64, bool)> {
    let Some(tile) = day.tile(id) else { return Vec::new() };
    let saw = day.presence.iter().filter(|run| run.seen.binary_search(&id).is_ok());
    let ranges: Vec<(u32, u32)> = saw.map(|run| (run.first, run.first.saturating_add(run.count))).collect();
    let seen = Seen::new(&ranges, day.scans.len());
    let mut cells = Mask::EMPTY;
    cells.insert(cell);
    let Some(flips) = flips_of(tile, &seen, cells).pop() else { return Vec::new() };
    let mut rows = Rows::default();
    rows.cell.fill(tile, cell, &flips, &seen);
    let occupied = match model {
        None => &rows.cell.occupied,
        Some(model) => {
            let phasors = DayPhasors::new(periodicities, &day.scans);
            rows.sum.start(model.mean, &phasors);
            model.components.iter().for_each(|component| rows.sum.add(component, &phasors));
            rows.compare(&seen);
            &rows.differing
        }
    };
    let reading = |at: u32| {
        let scan = day.scans.get(seen.scan(at) as usize)?;
        Some((scan.utc_nanos, occupied.get(at as usize)))
    };
    rows.cell.observed.ones().filter_map(reading).collect()
}

impl HistoryPiece {
    /// The readings of a state or cell from one instant until before another, in order of arrival.
    pub fn readings(
        &self,
        subject: Subject,
        from_nanos: i64,
        to_nanos: i64,
        periodicities: &Periodicities,
    ) -> Vec<Reading> {
        let within = from_nanos..to_nanos;
        match subject {
            Subject::State(state) => {
                let samples = self.states.iter().filter(|(id, _)| *id == state).flat_map(|(_, samples)| samples);
                let samples = samples.filter(|sample| within.contains(&sample.utc_nanos));
                samples.map(|sample| (sample.utc_nanos, sample.value)).collect()
            }
            Subject::Cell(tile, cell) => {
                let is_requested =
                    |day: &&HistoryDay| day.outliers.scans.iter().any(|scan| within.contains(&scan.utc_nanos));
                let days = self.days.iter().filter(is_requested);
                let all = days.flat_map(|day| day.readings(tile, cell, periodicities));
                cell_readings(all.filter(|(nanos, _)| within.contains(nanos))).collect()
            }
        }
    }
}

/// Readings of a cell as values: 0 where it was free, 1 where it was occupied.
pub fn cell_readings(readings: impl IntoIterator<Item = (i64, bool)>) -> impl Iterator<Item = Reading> {
    readings.into_iter().map(|(nanos, is_occupied)| (nanos, f64::from(u8::from(is_occupied))))
}
