//! The positions of the cells of a region, in metres and in memory.
//!
//! Invariant: around the region lies a border of one cell (none below and above a flat one), so that steps from cell to
//! neighbouring cell reach the border before they leave the memory. x runs fastest, z slowest.

use tidemap_grid::{
    index::{CellBox, CellIndex},
    spec::GridSpec,
};

use super::PredictError;

/// The cells of a region.
#[derive(Clone, Debug, PartialEq)]
pub struct Lattice {
    region: CellBox,
    size: [usize; 3],
    /// Cells of the border on each side.
    border: [usize; 3],
    resolution_m: f64,
    origin_m: [f64; 3],
    is_flat: bool,
}

impl Lattice {
    /// The cells of a region of a grid; for a flat grid the cells of the layer z = 0.
    ///
    /// # Errors
    /// [`PredictError::EmptyRegion`], and [`PredictError::TooManyCells`] if more than `max_cells` must be stored, the
    /// border included. [`PredictError::Grid`] for invalid properties of the grid.
    pub fn new(spec: &GridSpec, region: CellBox, max_cells: u64) -> Result<Lattice, PredictError> {
        spec.check()?;
        let region = region.intersection(&spec.allowed());
        if region.is_empty() {
            return Err(PredictError::EmptyRegion);
        }
        let border = [1, 1, usize::from(!spec.is_flat)];
        let cells =
            region.size().iter().zip(border).map(|(&size, border)| u128::from(size) + 2 * border as u128).product();
        // Offsets between cells have to fit an i32.
        let max = max_cells.min(i32::MAX as u64);
        if cells > u128::from(max) {
            return Err(PredictError::TooManyCells { cells, max });
        }
        Ok(Lattice {
            region,
            size: region.size().map(|size| size as usize),
            border,
            resolution_m: spec.resolution_m,
            origin_m: spec.origin_m,
            is_flat: spec.is_flat,
        })
    }

    /// The cells of the region.
    #[must_use]
    pub fn region(&self) -> CellBox {
        self.region
    }

    /// Number of cells of the region along x, y, z.
    #[must_use]
    pub fn size(&self) -> [usize; 3] {
        self.size
    }

    /// Length of a cell's edge, metres.
    #[must_use]
    pub fn resolution_m(&self) -> f64 {
        self.resolution_m
    }

    /// Whether z = 0 is the only layer.
    #[must_use]
    pub fn is_flat(&self) -> bool {
        self.is_flat
    }

    /// Number of stored cells, the border included.
    #[must_use]
    pub fn held(&self) -> usize {
        (0..3).map(|axis| self.held_along(axis)).product()
    }

    fn held_along(&self, axis: usize) -> usize {
        self.size[axis] + 2 * self.border[axis]
    }

    /// The distance in memory between neighbours along x, y, z.
    pub(crate) fn strides(&self) -> [usize; 3] {
        [1, self.held_along(0), self.held_along(0) * self.held_along(1)]
    }

    /// Place of a cell in memory; `None` outside the region.
    #[must_use]
    pub fn place(&self, cell: CellIndex) -> Option<usize> {
        if !self.region.contains(cell) {
            return None;
        }
        let along = [
            cell.x.abs_diff(self.region.min.x),
            cell.y.abs_diff(self.region.min.y),
            cell.z.abs_diff(self.region.min.z),
        ];
        let strides = self.strides();
        Some((0..3).map(|axis| (along[axis] as usize + self.border[axis]) * strides[axis]).sum())
    }

    /// The cell at a place in memory; `None` for the border and beyond.
    #[must_use]
    pub fn cell(&self, place: usize) -> Option<CellIndex> {
        let [_, row, layer] = self.strides();
        let along = [place % row, place % layer / row, place / layer];
        let mut index = [self.region.min.x, self.region.min.y, self.region.min.z];
        for (axis, index) in index.iter_mut().enumerate() {
            let inside = along[axis].checked_sub(self.border[axis]).filter(|&inside| inside < self.size[axis])?;
            *index += inside as i32;
        }
        Some(CellIndex { x: index[0], y: index[1], z: index[2] })
    }

    /// Places of the cells of each row along x, by z, then y ascending.
    pub(crate) fn rows(&self) -> impl Iterator<Item = std::ops::Range<usize>> {
        let (strides, border, size) = (self.strides(), self.border, self.size);
        let start = move |z: usize, y: usize| (z + border[2]) * strides[2] + (y + border[1]) * strides[1] + border[0];
        (0..size[2]).flat_map(move |z| (0..size[1]).map(move |y| start(z, y)..start(z, y) + size[0]))
    }

    /// The cell that holds a point of the map's frame, metres; `None` outside the region, and for numbers that are not
    /// finite. A flat grid ignores z.
    #[must_use]
    pub fn cell_at(&self, point_m: [f64; 3]) -> Option<CellIndex> {
        let mut index = [0; 3];
        for (axis, index) in index.iter_mut().enumerate() {
            if axis == 2 && self.is_flat {
                continue;
            }
            let cell = ((point_m[axis] - self.origin_m[axis]) / self.resolution_m).floor();
            if !(f64::from(i32::MIN)..=f64::from(i32::MAX)).contains(&cell) {
                return None;
            }
            *index = cell as i32;
        }
        let cell = CellIndex { x: index[0], y: index[1], z: index[2] };
        self.region.contains(cell).then_some(cell)
    }

    /// Centre of a cell in the map's frame, metres.
    #[must_use]
    pub(crate) fn centre_m(&self, cell: CellIndex) -> [f64; 3] {
        let along = |axis: usize, index: i32| self.origin_m[axis] + (f64::from(index) + 0.5) * self.resolution_m;
        [along(0, cell.x), along(1, cell.y), along(2, cell.z)]
    }
}
