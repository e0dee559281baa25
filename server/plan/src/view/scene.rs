//! A region of a grid at one time, ready to be looked into.
//!
//! Invariant: outside the region nothing is seen, and nothing is seen through it.

use std::sync::Arc;

use tidemap_map::grid::index::CellIndex;

use super::{Fan, Sensor, ViewError, Viewpoint};
use crate::{
    information::Certainty,
    predicted::{Lattice, PredictedGrid},
};

/// A cell through which nothing is seen.
pub(super) const OPAQUE: u8 = 1;
/// No cell of the region.
pub(super) const OUTSIDE: u8 = 2;

/// How a prediction is looked into.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct SceneOptions {
    /// How surely a look tells a cell. Default 0.95.
    pub certainty: Certainty,
    /// A cell of a higher probability stops rays; in [0, 1]. Default 0.5.
    pub threshold: f64,
}

impl Default for SceneOptions {
    fn default() -> SceneOptions {
        SceneOptions { certainty: Certainty::default(), threshold: 0.5 }
    }
}

/// A threshold that is no probability.
#[derive(Clone, Copy, Debug, PartialEq, thiserror::Error)]
#[error("threshold {0}: it must be between 0 and 1")]
pub struct InvalidThreshold(pub f64);

impl SceneOptions {
    pub(super) fn check(&self) -> Result<(), InvalidThreshold> {
        if (0.0..=1.0).contains(&self.threshold) { Ok(()) } else { Err(InvalidThreshold(self.threshold)) }
    }

    pub(super) fn stops(&self, probability: f32) -> bool {
        let probability = if probability.is_nan() { 0.5 } else { f64::from(probability) };
        probability > self.threshold
    }

    /// Flags and information of each place; NaN is unknown.
    pub(super) fn judge(&self, lattice: &Lattice, probabilities: &[f32]) -> (Vec<u8>, Vec<f64>) {
        let mut flags = vec![OPAQUE | OUTSIDE; lattice.held()];
        let mut bits = vec![0.0; lattice.held()];
        // Neighbours are mostly alike.
        let mut last = (f32::NAN, self.certainty.most_bits());
        for place in lattice.rows().flatten() {
            let probability = probabilities[place];
            if probability.to_bits() != last.0.to_bits() {
                last = (probability, self.certainty.bits(f64::from(probability)));
            }
            flags[place] = if self.stops(probability) { OPAQUE } else { 0 };
            bits[place] = last.1;
        }
        (flags, bits)
    }
}

/// A region of a grid at one time, ready to be looked into.
#[derive(Clone, Debug)]
pub struct Scene {
    lattice: Arc<Lattice>,
    flags: Vec<u8>,
    bits: Vec<f64>,
}

/// What is seen from a place.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct ViewGain {
    /// Information expected from it, bits.
    pub information_bits: f64,
    /// Cells seen, unknown ones and the viewpoint's own among them.
    pub cells: u64,
}

impl Scene {
    /// A prediction to be looked into. 9 bytes a cell.
    ///
    /// # Errors
    /// [`InvalidThreshold`]
    pub fn new(grid: &PredictedGrid, options: &SceneOptions) -> Result<Scene, InvalidThreshold> {
        options.check()?;
        let (flags, bits) = options.judge(grid.lattice(), grid.probabilities());
        Ok(Scene { lattice: Arc::clone(grid.lattice()), flags, bits })
    }

    /// The lattice of the cells.
    #[must_use]
    pub fn lattice(&self) -> &Arc<Lattice> {
        &self.lattice
    }

    /// Information expected from observing a cell, bits; 0 outside the region.
    #[must_use]
    pub fn bits(&self, cell: CellIndex) -> f64 {
        self.lattice.place(cell).map_or(0.0, |place| self.bits[place])
    }

    /// Whether a cell is probably occupied; what lies outside the region counts as that.
    #[must_use]
    pub fn is_occupied(&self, cell: CellIndex) -> bool {
        self.lattice.place(cell).is_none_or(|place| self.flags[place] & OPAQUE != 0)
    }

    pub(crate) fn bits_at(&self, place: usize) -> f64 {
        self.bits[place]
    }

    /// Where a viewpoint lies.
    ///
    /// # Errors
    /// [`ViewError`]
    pub fn stand(&self, sensor: &Sensor, at: &Viewpoint) -> Result<CellIndex, ViewError> {
        let cell = at.cell(sensor, &self.lattice)?;
        if self.is_occupied(cell) {
            return Err(ViewError::Occupied { x_m: at.x_m, y_m: at.y_m, cell });
        }
        Ok(cell)
    }
}

/// Looks into scenes from one viewpoint after the other; has the memory that one look needs.
#[derive(Clone, Debug)]
pub struct ViewScorer {
    /// Of each cell of the fan the number of the look that saw it last, twice, and one more if it is opaque.
    marks: Vec<u8>,
    look: u8,
}

impl ViewScorer {
    /// For the rays of a fan.
    #[must_use]
    pub fn new(fan: &Fan) -> ViewScorer {
        ViewScorer { marks: vec![0; fan.cells()], look: 0 }
    }

    /// What is seen from the centre of a cell of the region, whether or not that is occupied; nothing from outside, and
    /// by rays that were made for a region of another size.
    #[must_use]
    pub fn look(&mut self, scene: &Scene, fan: &Fan, from: CellIndex) -> ViewGain {
        let mut seen = ViewGain::default();
        self.each(scene, fan, from, |place| {
            seen.information_bits += scene.bits[place];
            seen.cells += 1;
        });
        seen
    }

    /// The cells that are seen from the centre of a cell of the region, in the order of the rays.
    #[must_use]
    pub fn cells(&mut self, scene: &Scene, fan: &Fan, from: CellIndex) -> Vec<CellIndex> {
        let mut cells = Vec::new();
        self.each(scene, fan, from, |place| cells.extend(scene.lattice.cell(place)));
        cells
    }

    /// Tells the place of each cell that is seen, once.
    pub(crate) fn each(&mut self, scene: &Scene, fan: &Fan, from: CellIndex, mut seen: impl FnMut(usize)) {
        let Some(start) = scene.lattice.place(from).filter(|_| fan.fits(&scene.lattice)) else { return };
        if self.marks.len() < fan.cells() {
            self.marks.resize(fan.cells(), 0);
        }
        self.look += 1;
        if self.look == 128 {
            self.marks.fill(0);
            self.look = 1;
        }
        let (look, marks) = (self.look, &mut self.marks[..fan.cells()]);
        let mut at = 0;
        while let Some(&cell) = fan.nodes.get(at) {
            let cell = cell as usize;
            let mut mark = marks[cell];
            if mark >> 1 != look {
                let place = start.wrapping_add_signed(fan.offsets[cell] as isize);
                let flags = scene.flags[place];
                mark = look << 1 | flags & OPAQUE;
                marks[cell] = mark;
                if flags & OUTSIDE == 0 {
                    seen(place);
                }
            }
            at = if mark & OPAQUE == 0 { at + 1 } else { fan.skips[at] as usize };
        }
    }
}
