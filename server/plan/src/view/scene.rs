//! A region of a grid at one time, prepared for views.
//!
//! Invariant: cells outside the region are invisible, and rays end there.

use std::sync::Arc;

use tidemap_grid::index::CellIndex;
use tidemap_model::{EarlyStop, StopSignal};

use super::{Fan, Sensor, ViewError, Viewpoint};
use crate::{
    information::Certainty,
    predicted::{Lattice, PredictedGrid},
};

/// An opaque cell.
pub(super) const OPAQUE: u8 = 1;
/// A place that is not a cell of the region.
pub(super) const OUTSIDE: u8 = 2;

/// The options of a scene.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct SceneOptions {
    /// The certainty of an observed cell. Default 0.95.
    pub certainty: Certainty,
    /// Cells with a higher probability stop rays; the threshold is in [0, 1]. Default 0.5.
    pub threshold: f64,
}

impl Default for SceneOptions {
    fn default() -> SceneOptions {
        SceneOptions { certainty: Certainty::default(), threshold: 0.5 }
    }
}

/// A threshold that is not a probability.
#[derive(Clone, Copy, Debug, PartialEq, thiserror::Error)]
#[error("threshold {0}: it must be between 0 and 1")]
pub struct InvalidThreshold(pub f64);

/// The reason why predictions are not prepared for views.
#[derive(Clone, Copy, Debug, PartialEq, thiserror::Error)]
pub enum SceneError {
    /// The threshold is invalid.
    #[error(transparent)]
    Threshold(#[from] InvalidThreshold),
    /// The work received the signal to stop.
    #[error(transparent)]
    Stop(#[from] EarlyStop),
}

impl SceneOptions {
    pub(super) fn check(&self) -> Result<(), InvalidThreshold> {
        if (0.0..=1.0).contains(&self.threshold) { Ok(()) } else { Err(InvalidThreshold(self.threshold)) }
    }

    pub(super) fn stops(&self, probability: f32) -> bool {
        let probability = if probability.is_nan() { 0.5 } else { f64::from(probability) };
        probability > self.threshold
    }

    /// Flags and information of each place; NaN is unknown. If the signal is set, some places are missing.
    pub(super) fn judge(&self, lattice: &Lattice, probabilities: &[f32], stop: StopSignal<'_>) -> (Vec<u8>, Vec<f64>) {
        let mut flags = vec![OPAQUE | OUTSIDE; lattice.held()];
        let mut bits = vec![0.0; lattice.held()];
        // Neighbouring cells are mostly equal.
        let mut last = (f32::NAN, self.certainty.most_bits());
        for place in lattice.rows().take_while(|_| !stop.is_set()).flatten() {
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

/// A region of a grid at one time, prepared for views.
#[derive(Clone, Debug)]
pub struct Scene {
    lattice: Arc<Lattice>,
    flags: Vec<u8>,
    bits: Vec<f64>,
}

/// The result of a view.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct ViewGain {
    /// Expected information, bits.
    pub information_bits: f64,
    /// Number of visible cells, including unknown ones and the viewpoint's own.
    pub cells: u64,
}

impl Scene {
    /// Prepares a prediction for views. Takes 9 bytes a cell.
    ///
    /// # Errors
    /// [`InvalidThreshold`]
    pub fn new(grid: &PredictedGrid, options: &SceneOptions) -> Result<Scene, InvalidThreshold> {
        Scene::until(grid, options, StopSignal::NEVER)
    }

    /// Does the same as [`Scene::new`]; if the signal was set, the result must not be used.
    pub(crate) fn until(
        grid: &PredictedGrid,
        options: &SceneOptions,
        stop: StopSignal<'_>,
    ) -> Result<Scene, InvalidThreshold> {
        options.check()?;
        let (flags, bits) = options.judge(grid.lattice(), grid.probabilities(), stop);
        Ok(Scene { lattice: Arc::clone(grid.lattice()), flags, bits })
    }

    /// The lattice of the cells.
    #[must_use]
    pub fn lattice(&self) -> &Arc<Lattice> {
        &self.lattice
    }

    /// Expected information of observing a cell, bits; 0 outside the region.
    #[must_use]
    pub fn bits(&self, cell: CellIndex) -> f64 {
        self.lattice.place(cell).map_or(0.0, |place| self.bits[place])
    }

    /// Whether a cell is probably occupied; cells outside the region count as occupied.
    #[must_use]
    pub fn is_occupied(&self, cell: CellIndex) -> bool {
        self.lattice.place(cell).is_none_or(|place| self.flags[place] & OPAQUE != 0)
    }

    pub(super) fn flags_at(&self, place: usize) -> u8 {
        self.flags[place]
    }

    pub(crate) fn bits_at(&self, place: usize) -> f64 {
        self.bits[place]
    }

    /// The cell of a viewpoint.
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

/// Evaluates views of scenes one after the other; holds the memory of one view.
#[derive(Clone, Debug)]
pub struct ViewScorer {
    /// For each cell of the fan twice the number of the last view that saw it, plus one if it is opaque.
    marks: Vec<u8>,
    view: u8,
}

impl ViewScorer {
    /// Memory for the rays of a fan.
    #[must_use]
    pub fn new(fan: &Fan) -> ViewScorer {
        ViewScorer { marks: vec![0; fan.cells()], view: 0 }
    }

    /// The view from the centre of a cell of the region, occupied or not; empty outside the region, and for rays of a
    /// region of another size.
    #[must_use]
    pub fn view(&mut self, scene: &Scene, fan: &Fan, from: CellIndex) -> ViewGain {
        let mut seen = ViewGain::default();
        self.each(scene, fan, from, |place| {
            seen.information_bits += scene.bits[place];
            seen.cells += 1;
        });
        seen
    }

    /// The visible cells from the centre of a cell of the region, in the order of the rays.
    #[must_use]
    pub fn cells(&mut self, scene: &Scene, fan: &Fan, from: CellIndex) -> Vec<CellIndex> {
        let mut cells = Vec::new();
        self.each(scene, fan, from, |place| cells.extend(scene.lattice.cell(place)));
        cells
    }

    /// Calls `see` with the place of each visible cell, once.
    pub(crate) fn each(&mut self, scene: &Scene, fan: &Fan, from: CellIndex, mut seen: impl FnMut(usize)) {
        let Some(start) = scene.lattice.place(from).filter(|_| fan.fits(&scene.lattice)) else { return };
        if self.marks.len() < fan.cells() {
            self.marks.resize(fan.cells(), 0);
        }
        self.view += 1;
        if self.view == 128 {
            self.marks.fill(0);
            self.view = 1;
        }
        let (view, marks) = (self.view, &mut self.marks[..fan.cells()]);
        let mut at = 0;
        while let Some(&cell) = fan.nodes.get(at) {
            let cell = cell as usize;
            let mut mark = marks[cell];
            if mark >> 1 != view {
                let place = start.wrapping_add_signed(fan.offsets[cell] as isize);
                let flags = scene.flags[place];
                mark = view << 1 | flags & OPAQUE;
                marks[cell] = mark;
                if flags & OUTSIDE == 0 {
                    seen(place);
                }
            }
            at = if mark & OPAQUE == 0 { at + 1 } else { fan.skips[at] as usize };
        }
    }
}
