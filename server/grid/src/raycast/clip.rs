//! The part of a ray that lies within a box, in cells.
//!
//! Invariant: the end of a ray that lies within the box keeps its cell, which is the result of
//! [`GridSpec::cell_at`](crate::spec::GridSpec::cell_at). Both ends of the clipped ray lie within the box, borders
//! included, and so do their cells, however far away the ray's own ends are.

use super::super::index::CellBox;

/// The part of a ray that is traversed.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(super) struct Clipped {
    /// Cell of its start.
    pub from: [i32; 3],
    /// Cell of its end.
    pub to: [i32; 3],
    /// Where it starts, in cells.
    pub start: [f64; 3],
    /// Where it ends, in cells.
    pub end: [f64; 3],
    /// Whether the end is the end of the ray, and not the place where the ray leaves the box.
    pub is_whole: bool,
}

/// The place where a ray crosses the box's surface: the fraction of the ray's length, 0 to 1, and the axis of the side.
type Passage = Option<(f64, usize)>;

/// Cuts the ray from `start` to `end`, both in cells from the grid's origin, to the cells of a box.
pub(super) fn clip(cells: &CellBox, start: [f64; 3], end: [f64; 3]) -> Option<Clipped> {
    let low = [cells.min.x, cells.min.y, cells.min.z];
    let high = [cells.max.x, cells.max.y, cells.max.z];
    if !start.iter().chain(&end).all(|along| along.is_finite()) {
        return None;
    }
    let (mut enters, mut leaves): (Passage, Passage) = (None, None);
    for axis in 0..3 {
        let (low, high) = (f64::from(low[axis]), f64::from(high[axis]));
        let (from, to) = (start[axis], end[axis]);
        // The upper border belongs to the cell beyond it.
        let side = |at: f64| {
            if at < low {
                Some(low)
            } else if at < high {
                None
            } else {
                Some(high)
            }
        };
        match (side(from), side(to)) {
            (Some(one), Some(other)) if one == other => return None,
            (enter, leave) => {
                if let Some(border) = enter {
                    let at = (border - from) / (to - from);
                    enters = if enters.is_none_or(|(known, _)| at > known) { Some((at, axis)) } else { enters };
                }
                if let Some(border) = leave {
                    let at = (border - from) / (to - from);
                    leaves = if leaves.is_none_or(|(known, _)| at < known) { Some((at, axis)) } else { leaves };
                }
            }
        }
    }
    if let (Some((enter, _)), Some((leave, _))) = (enters, leaves)
        && enter > leave
    {
        return None;
    }
    let is_forward = |axis: usize| end[axis] > start[axis];
    let cell = |at: [f64; 3]| std::array::from_fn(|axis| (at[axis].floor() as i32).clamp(low[axis], high[axis] - 1));
    let passing = |(at, side): (f64, usize), is_at_low: bool| -> [f64; 3] {
        std::array::from_fn(|axis| {
            let (low, high) = (f64::from(low[axis]), f64::from(high[axis]));
            // The side is known exactly, despite rounding.
            match (axis == side, is_at_low) {
                (true, true) => low,
                (true, false) => high,
                (false, _) => (start[axis] + at * (end[axis] - start[axis])).clamp(low, high),
            }
        })
    };
    let first = enters.map_or(start, |passage| passing(passage, is_forward(passage.1)));
    let last = leaves.map_or(end, |passage| passing(passage, !is_forward(passage.1)));
    Some(Clipped { from: cell(first), to: cell(last), start: first, end: last, is_whole: leaves.is_none() })
}
