//! Predicts a grid, or a part of it, at one time, tile by tile: cells that never changed as masks, others as numbers.
//!
//! Invariant: each known cell of the region is reported with the value that [`GridView::predict_tile`] gives it, and no
//! other cell is reported. The cost of an answer follows the existing tiles, not the size of the region.

use tidemap_model::{
    InstantPhasors, entropy_bits,
    selector::{ModelKind, ModelSelector},
};

use crate::{
    blend::blend_cell,
    index::{CellBox, CellIndex, TILE_CELLS, TILE_EDGE, TileId, TileIndex},
    live_tile::LiveTile,
    mask::Mask,
    sensors::Sensors,
    tempering::answers,
    tile::{ModelSlot, TileModel, TileUnavailable},
    view::GridView,
};

mod project;

#[cfg(test)]
mod tests;

use project::Columns;

/// The output for each cell.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub enum CellOutput {
    /// Probability that the cell is occupied.
    #[default]
    Probability,
    /// Entropy of that probability in bits.
    Entropy,
    /// 1 where the probability is at least this, else 0 (T-RO 2017, eq. 9).
    Threshold(f32),
}

impl CellOutput {
    /// The output for a probability.
    pub fn of(self, probability: f32) -> f32 {
        match self {
            CellOutput::Probability => probability,
            CellOutput::Entropy => entropy_bits(f64::from(probability)) as f32,
            CellOutput::Threshold(threshold) => f32::from(u8::from(probability >= threshold)),
        }
    }
}

/// A query of the whole grid, or a region of it.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct GridQuestion {
    /// Nanoseconds UTC.
    pub utc_nanos: i64,
    /// The model that predicts.
    pub selector: ModelSelector,
    /// The cells to predict; `None`: all.
    pub region: Option<CellBox>,
    /// Whether a column along z is reduced to its most probable known cell; ties: the lowest.
    pub project: bool,
    /// The output for each cell, or for each column's most probable cell.
    pub output: CellOutput,
}

/// The tiles that overlap the region of a query.
#[derive(Clone, Debug, PartialEq)]
pub struct GridSelection {
    /// The region cut to [`GridView::region`]; with projection, the layer z = 0.
    pub region: CellBox,
    /// The tiles, in the order of the answer.
    pub tiles: Vec<(TileIndex, TileId)>,
    /// Cells of these tiles within the region; with projection, of all its layers.
    pub cells: u64,
    /// Tiles of the answer: fewer than `tiles` where projected.
    pub tile_count: u64,
    /// Maximum number of values in the answer.
    pub values_at_most: u64,
}

/// The answer for the cells of one tile. A tile of a projection has only the places 0 to 63, with z = 0.
#[derive(Clone, Debug, PartialEq)]
pub struct TileCells {
    /// The index of the tile.
    pub index: TileIndex,
    /// Cells that were ever observed.
    pub known: Mask,
    /// Known cells that have been read as both free and occupied.
    pub changed: Mask,
    /// Known cells that have not changed and have the higher of the two values.
    pub high: Mask,
    /// Values of the changed cells, by place; if `all_values` is true, values of all known cells.
    pub values: Vec<f32>,
    /// Whether `values` has a value for each known cell.
    pub all_values: bool,
}

/// The prediction of a cell.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub enum CellPrediction {
    /// The cell was never observed.
    #[default]
    Unknown,
    /// The value of a cell that was always read the same.
    Static(f32),
    /// The value of a cell that has changed.
    Changing(f32),
}

impl CellPrediction {
    /// The value; `None` for an unknown cell.
    #[must_use]
    pub fn value(self) -> Option<f32> {
        match self {
            Self::Unknown => None,
            Self::Static(value) | Self::Changing(value) => Some(value),
        }
    }
}

impl TileCells {
    /// The places of the known cells with their predictions, by place. `levels`: the outputs of cells that have not
    /// changed and have no value of their own, the lower and the higher.
    pub fn known_cells(&self, levels: (f32, f32)) -> impl Iterator<Item = (u16, CellPrediction)> + '_ {
        let mut values = self.values.iter().copied();
        self.known.cells().map(move |cell| {
            let is_changed = self.changed.contains(cell);
            let value = match (is_changed || self.all_values, self.high.contains(cell)) {
                (true, _) => values.next().unwrap_or_default(),
                (false, true) => levels.1,
                (false, false) => levels.0,
            };
            (cell, if is_changed { CellPrediction::Changing(value) } else { CellPrediction::Static(value) })
        })
    }
}

/// The cells of a tile, by kind of value.
struct Shape {
    known: Mask,
    learned: Mask,
    changed: Mask,
    high: Mask,
    all_values: bool,
}

impl Shape {
    fn new(
        model: &TileModel,
        live: Option<&LiveTile>,
        within: Mask,
        selector: ModelSelector,
        sensors: &Sensors,
    ) -> Shape {
        let (seen, occupied) = live.map_or((Mask::EMPTY, Mask::EMPTY), |live| (live.known, live.occupied));
        let learned = model.observed();
        let known = (learned | seen) & within;
        let changed = model.changed() & within;
        let fixed = known.without(changed);
        let has_other_readers = || live.is_some_and(|live| live.has_other_readers(sensors));
        if selector.kind == ModelKind::Latest {
            return Shape { known, learned, changed, high: fixed & occupied, all_values: has_other_readers() };
        }
        let high = fixed & model.always_occupied;
        // A cell that never changed stays at its level, however recent the reading is, unless another sensor made it.
        let has_changed = || !(seen & fixed & (occupied ^ model.always_occupied)).is_empty();
        let blended = selector.is_blended() && (has_changed() || has_other_readers());
        let has_own_levels = blended || model.has_own_levels();
        Shape { known, learned, changed, high, all_values: has_own_levels || !known.without(learned).is_empty() }
    }

    fn values(&self) -> u32 {
        if self.all_values { self.known.count() } else { self.changed.count() }
    }
}

impl GridView {
    /// The tiles of a query.
    pub fn select(&self, question: &GridQuestion) -> GridSelection {
        let whole = self.region();
        let mut region = question.region.map_or(whole, |region| region.intersection(&whole));
        let mut tiles = match &question.region {
            None => self.ids.iter().map(|(&index, &id)| (index, id)).collect(),
            Some(_) => self.tiles_reaching(&region),
        };
        tiles.sort_unstable_by_key(|&(index, _)| match question.project {
            false => (index.z, index.y, index.x),
            true => (index.y, index.x, index.z),
        });
        let none = CellBox { min: CellIndex::default(), max: CellIndex::default() };
        if region.is_empty() || tiles.is_empty() {
            (region, tiles) = (none, Vec::new());
        }
        let within = |(index, _): &(TileIndex, TileId)| index.cells().intersection(&region).count() as u64;
        let cells = tiles.iter().map(within).sum();
        let (values_at_most, tile_count) = if question.project {
            let columns = tiles.chunk_by(|(one, _), (next, _)| same_column(*one, *next)).count() as u64;
            (region.min.z, region.max.z) = if tiles.is_empty() { (0, 0) } else { (0, 1) };
            (columns * (TILE_EDGE * TILE_EDGE) as u64, columns)
        } else {
            let of_tile = |&(index, id): &(TileIndex, TileId)| self.values_of(index, id, question);
            (tiles.iter().map(of_tile).sum(), tiles.len() as u64)
        };
        GridSelection { region, tiles, cells, tile_count, values_at_most }
    }

    /// The tiles that reach into a box. The index of tiles or the list of all tiles is searched, whichever is less
    /// work.
    fn tiles_reaching(&self, region: &CellBox) -> Vec<(TileIndex, TileId)> {
        if region.is_empty() {
            return Vec::new();
        }
        let first = |cell: i32| cell.div_euclid(TILE_EDGE);
        let end = |cell: i32| (cell - 1).div_euclid(TILE_EDGE) + 1;
        let (min, max) = (region.min, region.max);
        let x = first(min.x)..end(max.x);
        let y = first(min.y)..end(max.y);
        let z = first(min.z)..end(max.z);
        if x.len() as u128 * y.len() as u128 * z.len() as u128 > self.ids.len() as u128 {
            let reaches = |index: &TileIndex| x.contains(&index.x) && y.contains(&index.y) && z.contains(&index.z);
            return self.ids.iter().filter(|(index, _)| reaches(index)).map(|(&index, &id)| (index, id)).collect();
        }
        let indices = z.flat_map(|z| {
            let x = &x;
            y.clone().flat_map(move |y| x.clone().map(move |x| TileIndex { x, y, z }))
        });
        indices.filter_map(|index| Some((index, self.find(index)?))).collect()
    }

    /// Maximum number of values in the answer for a tile. A tile outside of memory is not read for this.
    fn values_of(&self, index: TileIndex, id: TileId, question: &GridQuestion) -> u64 {
        let within = within(index, question.region.as_ref());
        let live = self.live(id);
        match self.generation.model(id) {
            Some(ModelSlot::Cold(_)) => live.map_or(TILE_CELLS as u64, |live| u64::from((live.known & within).count())),
            Some(ModelSlot::Resident(model)) => {
                u64::from(Shape::new(model, live, within, question.selector, &self.sensors).values())
            }
            None => {
                u64::from(Shape::new(&TileModel::default(), live, within, question.selector, &self.sensors).values())
            }
        }
    }

    /// Adds the probabilities of a tile's cells to `values`, and returns the cells that the values belong to: the cells
    /// that have changed, or all known cells if other cells too have values of their own.
    ///
    /// # Errors
    /// [`TileUnavailable`] where the tile cannot be read from the disk.
    pub(crate) fn predict_changed(
        &self,
        (index, id): (TileIndex, TileId),
        question: &GridQuestion,
        phasors: &InstantPhasors,
        mut values: Vec<f32>,
    ) -> Result<TileCells, TileUnavailable> {
        let model = self.model(id)?;
        let live = self.live(id);
        let selector = question.selector;
        let shape = Shape::new(&model, live, within(index, question.region.as_ref()), selector, &self.sensors);
        let levels = self.levels();
        let level = |is_high: bool| if is_high { levels.1 as f32 } else { levels.0 as f32 };
        let blend = |cell: u16, mean: f64, probability: f32| match live.filter(|_| selector.is_blended()) {
            Some(live) if live.known.contains(cell) => {
                let persistence = live.persistence(cell, self.run, &self.sensors);
                blend_cell(&persistence, mean, f64::from(probability), question.utc_nanos, selector.blend) as f32
            }
            _ => probability,
        };
        values.reserve(shape.values() as usize);
        if selector.kind == ModelKind::Latest {
            let occupied = live.map_or(Mask::EMPTY, |live| live.occupied);
            if let (true, Some(live)) = (shape.all_values, live) {
                let value = |cell| match live.known.contains(cell) {
                    true => live.value(cell, &self.sensors) as f32,
                    false => level(false),
                };
                values.extend(shape.known.cells().map(value));
            } else {
                values.extend(shape.changed.cells().map(|cell| level(occupied.contains(cell))));
            }
        } else {
            let answer = answers(&model, selector, phasors);
            let changed = model.cells.iter().filter(|cell| shape.changed.contains(cell.cell)).map(|cell| {
                let order =
                    if selector.kind == ModelKind::Mean { 0 } else { selector.order_or(usize::from(cell.order)) };
                (cell, answer(cell, order) as f32)
            });
            if shape.all_values {
                let constants = model.sensors.as_ref().map(|_| {
                    let mut constants = Box::new([0.0; TILE_CELLS]);
                    self.set_constants(&mut constants, &model);
                    constants
                });
                let constant = |cell: u16| match &constants {
                    Some(constants) => constants[usize::from(cell)],
                    None => level(shape.high.contains(cell)),
                };
                let mut changed = changed.peekable();
                values.extend(shape.known.cells().map(|cell| {
                    let learned = changed.next_if(|(model, _)| model.cell == cell);
                    let fixed = || if shape.learned.contains(cell) { constant(cell) } else { 0.5 };
                    match learned {
                        Some((model, probability)) => blend(cell, model.spectral.mean(), probability),
                        None => blend(cell, f64::from(fixed()), fixed()),
                    }
                }));
            } else if selector.is_blended() {
                values
                    .extend(changed.map(|(model, probability)| blend(model.cell, model.spectral.mean(), probability)));
            } else {
                values.extend(changed.map(|(_, probability)| probability));
            }
        }
        let Shape { known, changed, high, all_values, .. } = shape;
        Ok(TileCells { index, known, changed, high, values, all_values })
    }
}

/// The places of a tile that lie in a region.
fn within(index: TileIndex, region: Option<&CellBox>) -> Mask {
    let tile = index.cells();
    let Some(region) = region.filter(|region| region.intersection(&tile) != tile) else { return Mask::FULL };
    let part = region.intersection(&tile);
    let mut row = 0_u64;
    for x in part.min.x..part.max.x {
        row |= 1 << (x - tile.min.x);
    }
    let mut layer = 0_u64;
    for y in part.min.y..part.max.y {
        layer |= row << (8 * (y - tile.min.y));
    }
    let mut mask = Mask::EMPTY;
    for (z, word) in (tile.min.z..).zip(&mut mask.0) {
        if (part.min.z..part.max.z).contains(&z) {
            *word = layer;
        }
    }
    mask
}

fn same_column(one: TileIndex, other: TileIndex) -> bool {
    (one.x, one.y) == (other.x, other.y)
}

impl GridView {
    /// The predictions of the selected tiles, in their order, with the phasors of the question's time.
    pub fn predict<'a>(
        &'a self,
        question: &'a GridQuestion,
        selection: &'a GridSelection,
        phasors: InstantPhasors,
    ) -> impl Iterator<Item = Result<TileCells, TileUnavailable>> + 'a {
        let groups = selection.tiles.chunk_by(|(one, _), (next, _)| question.project && same_column(*one, *next));
        let mut columns = Columns::default();
        groups.filter_map(move |tiles| {
            if question.project {
                return Some(columns.project(self, tiles, question, &phasors));
            }
            let mut cells = self.predict_changed(*tiles.first()?, question, &phasors, Vec::new());
            if let (Ok(cells), false) = (&mut cells, question.output == CellOutput::Probability) {
                cells.values.iter_mut().for_each(|value| *value = question.output.of(*value));
            }
            Some(cells)
        })
    }
}
