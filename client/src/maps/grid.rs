//! Grids: their description and their counters.
//!
//! Invariant: cells are numbered as on the wire, from the origin of the grid; the daemon fills in what a grid leaves
//! out.

use tidemap_map::grid::spec::{Retention, SensorNoise};
use tidemap_proto::{
    convert::grid::{retention_from_wire, retention_to_wire},
    v1,
};

/// Cells from `min` up to but not including `max`.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Hash)]
pub struct CellBox {
    /// Lowest cell: x, y, z.
    pub min: [i32; 3],
    /// Beyond the highest cell.
    pub max: [i32; 3],
}

impl CellBox {
    /// Number of cells along x, y and z; 0 for an empty box.
    #[must_use]
    pub fn size(&self) -> [u32; 3] {
        std::array::from_fn(|axis| {
            let cells = i64::from(self.max[axis]) - i64::from(self.min[axis]);
            u32::try_from(cells.max(0)).unwrap_or(u32::MAX)
        })
    }

    /// Number of cells.
    #[must_use]
    pub fn cells(&self) -> u128 {
        self.size().iter().map(|&cells| u128::from(cells)).product()
    }

    pub(crate) fn to_wire(self) -> v1::CellBox {
        let Self { min: [min_x, min_y, min_z], max: [max_x, max_y, max_z] } = self;
        v1::CellBox { min_x, min_y, min_z, max_x, max_y, max_z }
    }

    pub(crate) fn from_wire(cells: &v1::CellBox) -> Self {
        Self { min: [cells.min_x, cells.min_y, cells.min_z], max: [cells.max_x, cells.max_y, cells.max_z] }
    }
}

/// An occupancy grid. Cell (x, y, z) spans origin + index * resolution to origin + (index + 1) * resolution.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct Grid {
    /// Name of the map's frame; the daemon's default if empty.
    pub frame_id: String,
    /// Whether there is only the layer z = 0.
    pub is_flat: bool,
    /// Length of a cell's edge.
    pub resolution_m: f64,
    /// Lower corner of cell (0, 0, 0) in the map's frame.
    pub origin_m: [f64; 3],
    /// The cells that the grid may have; if absent, the grid grows.
    pub extent: Option<CellBox>,
    /// Noise of the sensor; none if absent.
    pub sensor: Option<SensorNoise>,
    /// How long exact readings are kept; the daemon's default if absent.
    pub retention: Option<Retention>,
}

impl Grid {
    pub(crate) fn to_wire(&self) -> v1::Grid {
        let [origin_x_m, origin_y_m, origin_z_m] = self.origin_m;
        let noise = |SensorNoise { hit, false_alarm, prior }| v1::SensorNoise { hit, false_alarm, prior };
        v1::Grid {
            frame_id: self.frame_id.clone(),
            flat: self.is_flat,
            resolution_m: self.resolution_m,
            origin_x_m,
            origin_y_m,
            origin_z_m,
            extent: self.extent.map(CellBox::to_wire),
            sensor: self.sensor.map(noise),
            retention: self.retention.map(retention_to_wire),
        }
    }

    pub(crate) fn from_wire(grid: v1::Grid) -> Self {
        let noise = |v1::SensorNoise { hit, false_alarm, prior }| SensorNoise { hit, false_alarm, prior };
        Self {
            frame_id: grid.frame_id,
            is_flat: grid.flat,
            resolution_m: grid.resolution_m,
            origin_m: [grid.origin_x_m, grid.origin_y_m, grid.origin_z_m],
            extent: grid.extent.as_ref().map(CellBox::from_wire),
            sensor: grid.sensor.map(noise),
            retention: retention_from_wire("retention", grid.retention, Retention::None).ok(),
        }
    }
}

/// Counters of a grid.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct GridSummary {
    /// Number of tiles of 8x8x8 cells that were ever seen.
    pub tiles: u64,
    /// Number of acknowledged scans, without refused ones.
    pub scans: u64,
    /// Number of scans that no update has learned yet.
    pub pending_scans: u64,
    /// Number of observations of single cells in all scans.
    pub cell_observations: u64,
    /// The smallest box of whole tiles that contains every tile.
    pub bounds: Option<CellBox>,
}

impl GridSummary {
    pub(crate) fn from_wire(summary: &v1::GridSummary) -> Self {
        Self {
            tiles: summary.tiles,
            scans: summary.scans,
            pending_scans: summary.pending_scans,
            cell_observations: summary.cell_observations,
            bounds: summary.bounds.as_ref().map(CellBox::from_wire),
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_grid_survives_the_wire() {
        let grid = Grid {
            frame_id: "map".to_owned(),
            is_flat: true,
            resolution_m: 0.05,
            origin_m: [-1.0, 2.0, 0.0],
            extent: Some(CellBox { min: [-8, 0, 0], max: [8, 5, 1] }),
            sensor: Some(SensorNoise { hit: 0.9, false_alarm: 0.1, prior: 0.4 }),
            retention: Some(Retention::Duration(86_400_000_000_000)),
        };
        assert_eq!(Grid::from_wire(grid.to_wire()), grid);
        let bare = Grid { resolution_m: 0.1, retention: Some(Retention::None), ..Grid::default() };
        assert_eq!(Grid::from_wire(bare.to_wire()), bare);
        for retention in [Retention::None, Retention::Forever] {
            let wire = Some(retention_to_wire(retention));
            assert_eq!(retention_from_wire("retention", wire, Retention::Duration(1)), Ok(retention));
        }
    }

    #[test]
    fn a_box_counts_its_cells() {
        let cells = CellBox { min: [-8, 0, 3], max: [8, 5, 4] };
        assert_eq!((cells.size(), cells.cells()), ([16, 5, 1], 80));
        assert_eq!(CellBox { min: [3, 0, 0], max: [1, 9, 9] }.cells(), 0);
        assert_eq!(CellBox { min: [i32::MIN; 3], max: [i32::MAX; 3] }.size(), [u32::MAX; 3]);
    }
}
