//! Many views of a scene in one pass over the rays.
//!
//! A bit for each viewpoint goes along the rays: it is set where the viewpoint still sees. So a node of the tree of
//! rays costs the same for 64 viewpoints as for one, and only a cell that a viewpoint sees for the first time costs an
//! access to the scene.
//!
//! Invariant: each viewpoint sees the cells that [`super::ViewScorer`] returns, in the same order.

use tidemap_grid::index::CellIndex;
use tidemap_model::StopSignal;

use super::{
    Fan, NODES_PER_CHECK, Scene,
    scene::{OPAQUE, OUTSIDE},
};

/// Maximum number of viewpoints of a pass.
pub(crate) const GROUP_MAX: usize = 64;

/// A cell of the fan in a pass.
#[derive(Clone, Copy, Debug, Default)]
struct GroupMark {
    /// The viewpoints that have seen the cell.
    seen: u64,
    /// The viewpoints that have seen the cell and see through it.
    clear: u64,
}

/// Evaluates views of scenes in groups; holds the memory of one group.
#[derive(Clone, Debug, Default)]
pub(crate) struct GroupScorer {
    marks: Vec<GroupMark>,
    /// The nodes above the current one: the ends of their branches, and the viewpoints that see through them.
    above: Vec<(usize, u64)>,
}

impl GroupScorer {
    /// Calls `seen` with the number of a viewpoint and the place of a cell that it sees, once for each. Viewpoints
    /// beyond the first [`GROUP_MAX`] are not evaluated; a viewpoint outside the region sees nothing. If the signal is
    /// set, some cells are missing.
    pub(crate) fn each(
        &mut self,
        scene: &Scene,
        fan: &Fan,
        from: &[CellIndex],
        stop: StopSignal<'_>,
        mut seen: impl FnMut(usize, usize),
    ) {
        if !fan.fits(scene.lattice()) {
            return;
        }
        let mut starts = [0; GROUP_MAX];
        let mut all = 0_u64;
        for (number, (start, &cell)) in starts.iter_mut().zip(from).enumerate() {
            if let Some(place) = scene.lattice().place(cell) {
                *start = place;
                all |= 1 << number;
            }
        }
        self.marks.clear();
        self.marks.resize(fan.cells(), GroupMark::default());
        self.above.clear();
        // The viewpoints that see as far as the current node, up to the end of its branch.
        let (mut until, mut who) = (usize::MAX, all);
        let (mut at, mut passed) = (0, 0_usize);
        while let Some(&cell) = fan.nodes.get(at) {
            passed += 1;
            if passed.is_multiple_of(NODES_PER_CHECK) && stop.is_set() {
                return;
            }
            while at >= until {
                (until, who) = self.above.pop().unwrap_or((usize::MAX, all));
            }
            let mark = &mut self.marks[cell as usize];
            let mut new = who & !mark.seen;
            if new != 0 {
                mark.seen |= new;
                let offset = fan.offsets[cell as usize] as isize;
                while new != 0 {
                    let number = new.trailing_zeros() as usize;
                    let place = starts[number].wrapping_add_signed(offset);
                    let flags = scene.flags_at(place);
                    mark.clear |= u64::from(flags & OPAQUE == 0) << number;
                    if flags & OUTSIDE == 0 {
                        seen(number, place);
                    }
                    new &= new - 1;
                }
            }
            let through = who & mark.clear;
            let end = fan.skips[at] as usize;
            if through == 0 {
                at = end;
                continue;
            }
            at += 1;
            if through != who && at < end {
                self.above.push((until, who));
                (until, who) = (end, through);
            }
        }
    }
}
