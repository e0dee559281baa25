//! Grids as arrays: predicted ones, and scans to send.
//!
//! Invariant: axis order is z, y, x, from the lowest cell; a predicted cell that was never observed is NaN.

use std::collections::BTreeMap;

use numpy::{
    PyArray3,
    ndarray::{Array3, Array4, ArrayView3, Axis},
};
use pyo3::{prelude::*, types::PyDict};
use tidemap_client::{
    Client,
    maps::{CellBox, CellIndex},
    observe::{
        Producer, ProducerOptions, Replay,
        scan::Scan,
        tiles::{Mask, TileIndex, TileMasks},
    },
    queries::{CellPrediction, GridQuery, WholeGrid},
};

use crate::{
    failure,
    observe::{Outcome, SentCounts, collect, differs},
};

/// Maximum number of cells of an array, 5 GB of values and whether they change.
const CELLS_MAX: usize = 1 << 30;

/// The cells from the first three indices up to but not including the last three.
pub(crate) fn cell_box([x, y, z, to_x, to_y, to_z]: [i32; 6]) -> CellBox {
    CellBox { min: CellIndex { x, y, z }, max: CellIndex { x: to_x, y: to_y, z: to_z } }
}

/// The cells of an array: the requested cells, also where nothing was ever seen. A projected grid has one layer.
fn cells_of(answer: &WholeGrid, query: &GridQuery) -> CellBox {
    let known = answer.header.region;
    let requested = query.region.unwrap_or(known);
    if query.is_projected {
        let layer = |requested: CellIndex, known: CellIndex| CellIndex { z: known.z, ..requested };
        return CellBox { min: layer(requested.min, known.min), max: layer(requested.max, known.max) };
    }
    requested
}

/// The values, whether each cell has changed, and where the cells are.
pub(crate) fn arrays<'py>(py: Python<'py>, answer: &WholeGrid, query: &GridQuery) -> PyResult<Bound<'py, PyDict>> {
    let region = cells_of(answer, query);
    let [width, height, depth] = region.size().map(|cells| usize::try_from(cells).unwrap_or(usize::MAX));
    let cells = [width, height, depth].into_iter().try_fold(1_usize, usize::checked_mul);
    if cells.is_none_or(|cells| cells > CELLS_MAX) {
        let message = format!("a region of {width} x {height} x {depth} cells is too large for an array: reduce it");
        return Err(failure::invalid(py, &message));
    }
    let mut values = Array3::from_elem((depth, height, width), f32::NAN);
    let mut changing = Array3::from_elem((depth, height, width), false);
    let min = [region.min.x, region.min.y, region.min.z];
    for tile in &answer.tiles {
        for (place, cell) in tile.cells.iter().enumerate() {
            let Some(value) = cell.value() else { continue };
            let within = [place % 8, place / 8 % 8, place / 64];
            let at = |axis: usize| {
                let index = i64::from(tile.place[axis]) * 8 + within[axis] as i64 - i64::from(min[axis]);
                usize::try_from(index).ok()
            };
            if let (Some(x), Some(y), Some(z)) = (at(0), at(1), at(2))
                && let Some(slot) = values.get_mut((z, y, x))
            {
                *slot = value;
                changing[(z, y, x)] = matches!(cell, CellPrediction::Changing(_));
            }
        }
    }
    let grid = &answer.header.grid;
    let found = PyDict::new(py);
    found.set_item("values", PyArray3::from_owned_array(py, values))?;
    found.set_item("changing", PyArray3::from_owned_array(py, changing))?;
    found.set_item("first_cell", min)?;
    found.set_item("resolution_m", grid.resolution_m)?;
    found.set_item("origin_m", grid.origin_m)?;
    found.set_item("frame_id", &grid.frame_id)?;
    found.set_item("generation", answer.header.generation)?;
    Ok(found)
}

/// Grids that were seen, to send as scans: below 0 not seen, 0 free, above 0 occupied.
pub(crate) struct SeenGrids {
    pub(crate) times_nanos: Vec<i64>,
    /// Axes time, z, y, x.
    pub(crate) cells: Array4<i8>,
    /// Index x, y, z of the first cell.
    pub(crate) first_cell: [i32; 3],
}

impl SeenGrids {
    fn scan(&self, index: usize) -> Scan {
        Scan::Tiles(seen_tiles(self.cells.index_axis(Axis(0), index), self.first_cell))
    }
}

/// The tiles of a grid that was seen; axes z, y, x.
pub(crate) fn seen_tiles(cells: ArrayView3<'_, i8>, first_cell: [i32; 3]) -> Vec<(TileIndex, TileMasks)> {
    let mut tiles: BTreeMap<(i32, i32, i32), (Mask, Mask)> = BTreeMap::new();
    for ((z, y, x), &seen) in cells.indexed_iter() {
        if seen < 0 {
            continue;
        }
        let [x, y, z] = [(first_cell[0], x), (first_cell[1], y), (first_cell[2], z)]
            .map(|(first, index)| first.saturating_add(i32::try_from(index).unwrap_or(i32::MAX)));
        let place = [x, y, z].map(|cell| cell.rem_euclid(8) as u16);
        let place = place[0] + 8 * place[1] + 64 * place[2];
        let tile = (z.div_euclid(8), y.div_euclid(8), x.div_euclid(8));
        let (observed, occupied) = tiles.entry(tile).or_default();
        observed.insert(place);
        if seen > 0 {
            occupied.insert(place);
        }
    }
    let masks = |((z, y, x), (observed, occupied))| (TileIndex { x, y, z }, TileMasks::clipped(observed, occupied));
    tiles.into_iter().map(masks).collect()
}

/// Sends all grids and waits until they are durable; grids that the daemon has are compared.
pub(crate) async fn send(client: Client, options: ProducerOptions, grids: SeenGrids) -> Outcome {
    let (name, label) = (options.producer.clone(), options.label.clone());
    let mut producer = match Producer::open(&client, options).await {
        Ok(producer) => producer,
        Err(error) => return Outcome::Stopped(error),
    };
    let progress = producer.progress();
    let (before, count) = (progress.resumed_at, grids.times_nanos.len());
    if before > count as u64 {
        let how = format!("there are {count} grids, but {before} were sent before");
        return differs(&name, &label, &how, false);
    }
    let first = usize::try_from(before).unwrap_or(usize::MAX).min(count);
    let mut replay = Replay::default();
    for index in 0..first {
        if let Err(error) = replay.scan(grids.times_nanos[index], grids.scan(index)) {
            return Outcome::Stopped(error.into());
        }
    }
    if before > 0 {
        if replay.content_crc() != progress.content_crc {
            let how = format!("the first {before} grids are not the {before} that were sent before");
            return differs(&name, &label, &how, false);
        }
        if let Err(error) = producer.go_on_from(replay.into_tiles()).await {
            return Outcome::Stopped(error);
        }
    }
    let mut counts = SentCounts { durable: before, duplicate: before, ..SentCounts::default() };
    for index in first..count {
        if let Err(error) = producer.send_scan(grids.times_nanos[index], grids.scan(index)).await {
            return Outcome::Stopped(error);
        }
        collect(&mut producer, &mut counts);
    }
    let closed = producer.close().await;
    collect(&mut producer, &mut counts);
    let progress = match closed {
        Ok(progress) => progress,
        Err(error) => return Outcome::Stopped(error),
    };
    counts.durable = progress.durable_sequence;
    counts.accepted = progress.durable_sequence.saturating_sub(before).saturating_sub(counts.refused);
    Outcome::Whole(counts)
}
