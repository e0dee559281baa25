//! Chooses which cells of a tile are kept against a small model: the cells that take fewer bytes with one.
//!
//! Invariant: a chosen model makes the cell's part of the history smaller, in the form in which the store writes it,
//! about.

use tidemap_grid::{
    day::{Bit, DayTile},
    mask::Mask,
    tile::TileModel,
};

use super::{
    OutlierComponent, OutlierModel,
    exchange::Rows,
    phasors::DayPhasors,
    seen::{Seen, flips_of},
};

/// Bytes of a model: its cell, mean and number of components.
const MODEL_BYTES: usize = 7;
/// Bytes of a component.
const COMPONENT_BYTES: usize = 10;
/// Bytes of a cell that has flips, besides the flips.
const FLIPS_BYTES: usize = 2;
/// Minimum number of flips for which a model pays off.
const FLIPS_MIN: u16 = 3;
/// Maximum number of components to try.
const COMPONENTS_TRIED: usize = 3;

/// The models of a tile's cells, ascending; `levels` are the values of a free and an occupied reading.
pub(super) fn choose(
    tile: &DayTile,
    seen: &Seen,
    model: &TileModel,
    levels: (f64, f64),
    phasors: &DayPhasors,
    rows: &mut Rows,
) -> Vec<OutlierModel> {
    let mut count = [0_u16; 512];
    for flip in tile.flips.iter().filter(|flip| flip.bit() == Bit::Occupied) {
        let count = &mut count[usize::from(flip.cell())];
        *count = count.saturating_add(1);
    }
    let known = model.changed() | model.always_occupied;
    let mut cells = Mask::EMPTY;
    known.cells().filter(|&cell| count[usize::from(cell)] >= FLIPS_MIN).for_each(|cell| cells.insert(cell));
    let mut chosen = Vec::new();
    for (cell, flips) in cells.cells().zip(flips_of(tile, seen, cells)) {
        let plain = flips_bytes(flips.occupied.iter().copied(), usize::MAX);
        if plain <= MODEL_BYTES {
            continue;
        }
        rows.cell.fill(tile, cell, &flips, seen);
        let whole = small_model(model, cell, levels);
        rows.sum.start(whole.mean, phasors);
        let mut least = plain;
        let mut best = None;
        for order in 0..=whole.components.len() {
            let model_bytes = MODEL_BYTES + order * COMPONENT_BYTES;
            if model_bytes >= least {
                break;
            }
            if let Some(component) = order.checked_sub(1).and_then(|at| whole.components.get(at)) {
                rows.sum.add(component, phasors);
            }
            rows.compare(seen);
            let bytes = model_bytes + flips_bytes(rows.differing.toggles(), least - model_bytes);
            if bytes < least {
                (least, best) = (bytes, Some(order));
            }
        }
        if let Some(order) = best {
            let OutlierModel { mean, mut components, .. } = whole;
            components.truncate(order);
            chosen.push(OutlierModel { cell, mean, components });
        }
    }
    chosen
}

/// The learned model of a cell in f32, for readings 0 and 1.
fn small_model(model: &TileModel, cell: u16, levels: (f64, f64)) -> OutlierModel {
    let Some(learned) = model.cell(cell) else {
        return OutlierModel { cell, mean: 1.0, components: Vec::new() };
    };
    let scale = 1.0 / (levels.1 - levels.0);
    let mean = ((learned.spectral.mean() - levels.0) * scale) as f32;
    let tried = usize::from(learned.order).max(COMPONENTS_TRIED);
    let components = learned.spectral.components().iter().take(tried);
    let components = components.filter_map(|component| {
        Some(OutlierComponent {
            periodicity: u16::try_from(component.periodicity).ok()?,
            gamma_re: (component.gamma_re * scale) as f32,
            gamma_im: (component.gamma_im * scale) as f32,
        })
    });
    OutlierModel { cell, mean, components: components.collect() }
}

/// Bytes of the flips at these places, ascending. If the number reaches `enough`, the result may be any value of at
/// least `enough`.
fn flips_bytes(places: impl Iterator<Item = u32>, enough: usize) -> usize {
    let (mut bytes, mut before) = (0, 0);
    for place in places {
        if bytes == 0 {
            bytes = FLIPS_BYTES;
        }
        // A byte holds seven bits of the distance.
        bytes += match place.abs_diff(before) {
            ..128 => 1,
            128..16_384 => 2,
            16_384.. => 3,
        };
        before = place;
        if bytes >= enough {
            break;
        }
    }
    bytes
}
