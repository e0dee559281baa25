//! The last value of a cell in its prediction.
//!
//! Invariant: cells blend as named states do, with the same formulas of the model's crate.

use tidemap_model::{MemoryBasis, Persistence};

use crate::selector::ModelSelector;

/// A cell's prediction `p` for a time, with its last value blended in.
pub(super) fn blend_cell(persistence: &Persistence, mean: f64, p: f64, utc_nanos: i64, selector: ModelSelector) -> f64 {
    if selector.persistence {
        return persistence.blend(p, utc_nanos);
    }
    // The first scan of a cell is not stored beside its last value; scans are frequent compared with changes.
    persistence.remember(MemoryBasis { usual_change: 1.0, mean, first_nanos: None }, p, utc_nanos)
}
