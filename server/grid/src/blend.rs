//! Blends the last value of a cell into its prediction.
//!
//! Invariant: cells are blended as named states are, with the same formulas of the model's crate.

use tidemap_model::{MemoryBasis, Persistence, selector::Blend};

/// A cell's prediction `p` for a time, with the cell's last value blended in.
pub(super) fn blend_cell(persistence: &Persistence, mean: f64, p: f64, utc_nanos: i64, blend: Blend) -> f64 {
    blend.draw(persistence, memory_basis(mean), p, utc_nanos)
}

/// The data that the memory of a cell with this mean needs beside the cell's last value. The first scan of the cell is
/// not stored; scans are frequent compared with changes.
pub(super) fn memory_basis(mean: f64) -> MemoryBasis {
    MemoryBasis { usual_change: 1.0, mean, first_nanos: None, most_likely_secs: None }
}
