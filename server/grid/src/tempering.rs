//! Tempers the predictions for a tile's changed cells by how well the hour of the prediction is known.
//!
//! Only the default model is tempered: a model that is requested by name predicts as published. Invariant: a cell that
//! has never changed is not tempered.

use tidemap_model::{Evidence, InstantPhasors, selector::ModelSelector};

use crate::{
    index::TILE_CELLS,
    tile::{CellModel, TileModel},
};

/// The evidence of a tile's changed cells at one time.
#[derive(Debug)]
pub(crate) struct Tempering {
    of_groups: Vec<Evidence>,
    group_of: [u16; TILE_CELLS],
}

impl Tempering {
    /// Gathers the evidence at a local civil time, in nanoseconds since 1970-01-01T00:00 local; `None` where no
    /// prediction is changed.
    fn new(model: &TileModel, selector: ModelSelector, civil_nanos: i64) -> Option<Tempering> {
        if !selector.leaves_choice() || model.cells.is_empty() {
            return None;
        }
        let of_groups: Vec<Evidence> = model.groups.iter().map(|group| group.seen.at(civil_nanos)).collect();
        if of_groups.iter().all(|evidence| evidence.is_whole()) {
            return None;
        }
        let mut tempering = Tempering { of_groups, group_of: [u16::MAX; TILE_CELLS] };
        let changed = model.changed();
        for (number, group) in (0..).zip(&model.groups) {
            for cell in (group.cells & changed).cells() {
                tempering.group_of[usize::from(cell)] = number;
            }
        }
        Some(tempering)
    }

    fn temper(&self, cell: &CellModel, answer: f64) -> f64 {
        let group = self.group_of.get(usize::from(cell.cell)).and_then(|&group| self.of_groups.get(usize::from(group)));
        group.map_or(answer, |evidence| evidence.temper(cell.spectral.mean(), answer))
    }
}

/// Returns the predictor for the changed cells of a tile at a time, by their spectral models: from a cell and its order
/// it computes the probability that the cell is occupied.
pub(crate) fn answers<'a>(
    model: &TileModel,
    selector: ModelSelector,
    phasors: &'a InstantPhasors,
) -> impl Fn(&CellModel, usize) -> f64 + use<'a> {
    let tempering = Tempering::new(model, selector, phasors.civil_nanos());
    move |cell, order| {
        let answer = cell.spectral.predict_at(order, phasors);
        tempering.as_ref().map_or(answer, |tempering| tempering.temper(cell, answer))
    }
}
