//! The raster of a flow.
//!
//! Invariant: cell (x, y) has the index x + y · `counts[0]`.

/// Square cells over a rectangle.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct FlowRaster {
    /// The lower corner, x and y in metres.
    pub low_m: [f64; 2],
    /// Edge of a cell in metres, above 0.
    pub edge_m: f64,
    /// Number of cells along x and y.
    pub counts: [usize; 2],
}

impl FlowRaster {
    /// Number of cells.
    pub fn cells(&self) -> usize {
        self.counts[0].saturating_mul(self.counts[1])
    }

    /// The cell of a place; `None` outside the raster.
    pub fn cell(&self, place_m: [f64; 2]) -> Option<usize> {
        let mut at = [0; 2];
        for axis in 0..2 {
            let steps = ((place_m[axis] - self.low_m[axis]) / self.edge_m).floor();
            if !(steps >= 0.0 && steps < self.counts[axis] as f64) {
                return None;
            }
            at[axis] = steps as usize;
        }
        Some(at[0] + at[1] * self.counts[0])
    }

    /// The middle of a cell, x and y in metres.
    pub fn middle_m(&self, cell: usize) -> [f64; 2] {
        let width = self.counts[0].max(1);
        let middle = |axis: usize, at: usize| self.low_m[axis] + (at as f64 + 0.5) * self.edge_m;
        [middle(0, cell % width), middle(1, cell / width)]
    }
}
