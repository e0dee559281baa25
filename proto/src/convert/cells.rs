//! Predictions of a grid: requests, headers, tiles and descriptions of cells.
//!
//! Invariant: a tile on the wire has a value for each known cell, from its masks and levels or from its list.

use std::cmp::Ordering;

use prost::Message as _;
use tidemap_grid::{
    index::{CellBox, CellIndex, TILE_CELLS, TileIndex},
    mask::Mask,
    predict::{CellOutput, GridQuestion, GridSelection, TileCells},
    spec::GridSpec,
    view::{CellDescription, GridView},
};
use tidemap_map::view::MapView;
use tidemap_model::ORDER_MAX;

use super::{
    InvalidField,
    grid::{cell_box_from_wire, cell_box_to_wire, grid_from_wire, grid_to_wire},
    query::{check_for_cells, components_to_wire, date_or_empty, selector_from_wire, selector_to_wire},
    time::{instant_from_wire, timestamp},
};
use crate::v1;

/// Bytes of a mask of a tile, and of a projected tile.
const MASK_BYTES: usize = TILE_CELLS / 8;
const LAYER_BYTES: usize = 8;
/// Maximum number of bytes of a tile on the wire without its masks and values: place, levels, lengths.
const TILE_OVERHEAD: u64 = 48;

/// A request for a prediction of the grid.
///
/// # Errors
/// A time before 1970, an unknown output, a threshold that is not in (0, 1] or belongs to another output, or an invalid
/// model.
pub fn question_from_wire(wire: &v1::PredictGridRequest) -> Result<GridQuestion, InvalidField> {
    let utc_nanos = instant_from_wire("time", wire.time)?;
    let output = match v1::GridOutput::try_from(wire.output) {
        Ok(v1::GridOutput::Unspecified | v1::GridOutput::Probability) => CellOutput::Probability,
        Ok(v1::GridOutput::Entropy) => CellOutput::Entropy,
        // 0 is what proto3 sends for "not set".
        Ok(v1::GridOutput::Threshold) if wire.threshold == 0.0 => CellOutput::Threshold(0.5),
        Ok(v1::GridOutput::Threshold) => CellOutput::Threshold(wire.threshold as f32),
        Err(_) => return Err(InvalidField::new("output", format!("{} is not known", wire.output))),
    };
    let threshold = match output {
        CellOutput::Threshold(threshold) => f64::from(threshold),
        _ => wire.threshold,
    };
    if matches!(output, CellOutput::Threshold(_)) {
        // A threshold that becomes 0 as a single would be reached by every cell.
        if !(threshold > 0.0 && wire.threshold <= 1.0) {
            let text = format!("threshold {} is not above 0 and at most 1", wire.threshold);
            return Err(InvalidField::new("threshold", text));
        }
    } else if threshold != 0.0 {
        let text = format!("threshold {threshold} was given, but the output has none: use GRID_OUTPUT_THRESHOLD");
        return Err(InvalidField::new("threshold", text));
    }
    let selector = selector_from_wire("model", wire.model)?;
    check_for_cells("model", selector)?;
    Ok(GridQuestion {
        utc_nanos,
        selector,
        region: wire.region.as_ref().map(cell_box_from_wire),
        project: wire.project,
        output,
    })
}

/// The cell of a name; `None`: it is not the name of a cell.
///
/// # Errors
/// A name that begins as that of a cell and is none.
pub fn cell_from_wire(field: &str, name: &str) -> Result<Option<CellIndex>, InvalidField> {
    CellIndex::from_name(name).transpose().map_err(|error| InvalidField::new(field, error))
}

/// A request for a prediction of the grid of a map. `estimate_only`: it requests only the header.
#[must_use]
pub fn question_to_wire(map: &str, question: &GridQuestion, estimate_only: bool) -> v1::PredictGridRequest {
    let GridQuestion { utc_nanos, selector, region, project, output } = *question;
    let (output, threshold) = match output {
        CellOutput::Probability => (v1::GridOutput::Probability, 0.0),
        CellOutput::Entropy => (v1::GridOutput::Entropy, 0.0),
        CellOutput::Threshold(threshold) => (v1::GridOutput::Threshold, f64::from(threshold)),
    };
    v1::PredictGridRequest {
        map: map.to_owned(),
        time: Some(timestamp(utc_nanos)),
        model: Some(selector_to_wire(selector)),
        region: region.as_ref().map(cell_box_to_wire),
        project,
        output: output.into(),
        threshold,
        estimate_only,
    }
}

/// The header of a reply.
#[derive(Clone, Debug, PartialEq)]
pub struct GridHeader {
    /// The grid.
    pub grid: GridSpec,
    /// The cells of the tiles; z from 0 to 1 if projected; empty if nothing was observed.
    pub region: CellBox,
    /// Number of tiles to come.
    pub tiles: u64,
    /// Number of cells of these tiles.
    pub cells: u64,
    /// Maximum number of bytes of all tiles.
    pub bytes: u64,
    /// Number of updates published at the time of the reply.
    pub generation: u64,
}

/// The header of a reply.
///
/// # Errors
/// The invalid field of the grid.
pub fn header_from_wire(header: v1::GridHeader) -> Result<GridHeader, InvalidField> {
    let v1::GridHeader { grid, region, tiles, cells, bytes, generation } = header;
    let grid = grid_from_wire(grid.unwrap_or_default())?;
    // A grid without cells has no region.
    let region = region.as_ref().map(cell_box_from_wire).unwrap_or_default();
    Ok(GridHeader { grid, region, tiles, cells, bytes, generation })
}

/// Why a tile of a reply is refused.
#[derive(Clone, Copy, Debug, PartialEq, Eq, thiserror::Error)]
#[error("{0}")]
pub struct InvalidTile(pub &'static str);

/// A tile of a reply, and the outputs of its cells that have not changed, the lower and the higher. Each value of the
/// tile belongs to a known cell, and is from 0 to 1.
///
/// # Errors
/// The tile contradicts itself.
pub fn tile_from_wire(tile: v1::PredictedTile, is_projected: bool) -> Result<(TileCells, (f32, f32)), InvalidTile> {
    let index = TileIndex { x: tile.x, y: tile.y, z: tile.z };
    if !index.is_valid() {
        return Err(InvalidTile("a tile lies outside of any grid"));
    }
    let bytes = if is_projected { LAYER_BYTES } else { MASK_BYTES };
    let mask = |wire: &[u8]| {
        // Empty masks may be left out.
        if !wire.is_empty() && wire.len() != bytes {
            return Err(InvalidTile("a mask of a tile has another length"));
        }
        let mut padded = [0; MASK_BYTES];
        padded.iter_mut().zip(wire).for_each(|(to, from)| *to = *from);
        Ok(Mask::from_bytes(&padded))
    };
    let (known, changed, high) = (mask(&tile.known)?, mask(&tile.changed)?, mask(&tile.high)?);
    let changed = changed & known;
    let (values, all_values) = (tile.values, tile.all_values);
    let wanted = if all_values { known.count() } else { changed.count() };
    match values.len().cmp(&(wanted as usize)) {
        Ordering::Less => return Err(InvalidTile("values of a tile are missing")),
        Ordering::Greater => return Err(InvalidTile("a tile has more values than cells")),
        Ordering::Equal => {}
    }
    let cells = TileCells { index, known, changed, high, values, all_values };
    let levels = (tile.static_low, tile.static_high);
    if cells.known_cells(levels).filter_map(|(_, cell)| cell.value()).any(|value| !(0.0..=1.0).contains(&value)) {
        return Err(InvalidTile("a value of a tile is not between 0 and 1"));
    }
    Ok((cells, levels))
}

/// The header of a reply, for the wire.
#[must_use]
pub fn header_to_wire(
    grid: &GridView,
    generation: u64,
    question: &GridQuestion,
    selection: &GridSelection,
) -> v1::GridHeader {
    let masks = 3 * if question.project { LAYER_BYTES } else { MASK_BYTES } as u64;
    v1::GridHeader {
        grid: Some(grid_to_wire(grid.spec())),
        region: (!selection.region.is_empty()).then(|| cell_box_to_wire(&selection.region)),
        tiles: selection.tile_count,
        cells: selection.cells,
        bytes: selection.tile_count * (masks + TILE_OVERHEAD) + selection.values_at_most * size_of::<f32>() as u64,
        generation,
    }
}

/// A tile for the wire; `levels` are the values of a free and an occupied reading.
#[must_use]
pub fn tile_to_wire(tile: TileCells, question: &GridQuestion, levels: (f64, f64)) -> v1::PredictedTile {
    let bytes = if question.project { LAYER_BYTES } else { MASK_BYTES };
    let mask = |mask: Mask| match mask.is_empty() {
        true => Vec::new(),
        false => mask.to_bytes().get(..bytes).map_or_else(Vec::new, <[u8]>::to_vec),
    };
    v1::PredictedTile {
        x: tile.index.x,
        y: tile.index.y,
        z: tile.index.z,
        known: mask(tile.known),
        changed: mask(tile.changed),
        high: if tile.all_values { Vec::new() } else { mask(tile.high) },
        static_high: question.output.of(levels.1 as f32),
        static_low: question.output.of(levels.0 as f32),
        values: tile.values,
        all_values: tile.all_values,
    }
}

/// Bytes of a tile on the wire, without its own length.
#[must_use]
pub fn tile_bytes(tile: &v1::PredictedTile) -> usize {
    tile.encoded_len()
}

/// Describes the model of a cell.
#[must_use]
pub fn cell_description_to_wire(
    view: &MapView,
    cell: CellIndex,
    description: &CellDescription,
) -> v1::DescribeModelResponse {
    let last = description.persistence.last();
    v1::DescribeModelResponse {
        state: cell.name(),
        kind: v1::StateKind::Probability.into(),
        mean: description.spectral.mean(),
        learned_observations: description.folded,
        observations: description.observations,
        order: u32::try_from(description.order).unwrap_or(u32::MAX),
        components: components_to_wire(view, &description.spectral),
        // If a cell has never changed, every order was right.
        order_errors: description.errors.unwrap_or([0.0; ORDER_MAX + 1]).to_vec(),
        persistence_tau_secs: description.persistence.tau_secs(),
        last_value: last.map(|(_, value)| value),
        last_time: last.map(|(nanos, _)| timestamp(nanos)),
        first_time: description.first_nanos.map(timestamp),
        chosen: Some(v1::ModelSelector {
            kind: v1::ModelKind::Spectral.into(),
            order: u32::try_from(description.order).ok(),
            ..v1::ModelSelector::default()
        }),
        change_date: date_or_empty(description.alarm_day),
        ..v1::DescribeModelResponse::default()
    }
}

/// A cell whose change alarm is on.
#[must_use]
pub fn cell_alarm_to_wire(cell: CellIndex, description: &CellDescription) -> v1::CellAlarm {
    let last = description.persistence.last();
    v1::CellAlarm {
        state: cell.name(),
        change_date: date_or_empty(description.alarm_day),
        mean: description.spectral.mean(),
        learned_observations: description.folded,
        order: u32::try_from(description.order).unwrap_or(u32::MAX),
        last_value: last.map(|(_, value)| value),
        last_time: last.map(|(nanos, _)| timestamp(nanos)),
    }
}

#[cfg(test)]
mod tests {
    use tidemap_grid::predict::CellPrediction;

    use super::*;

    fn request() -> v1::PredictGridRequest {
        v1::PredictGridRequest {
            map: "office".to_owned(),
            time: Some(timestamp(5)),
            ..v1::PredictGridRequest::default()
        }
    }

    fn threshold(output: v1::GridOutput, threshold: f64) -> Result<CellOutput, String> {
        let wire = v1::PredictGridRequest { output: output.into(), threshold, ..request() };
        question_from_wire(&wire).map(|question| question.output).map_err(|error| error.field)
    }

    #[test]
    fn questions_are_checked() {
        let question = question_from_wire(&request()).expect("valid");
        assert_eq!(question, GridQuestion { utc_nanos: 5, ..GridQuestion::default() });
        let field = |wire| question_from_wire(&wire).expect_err("wrong").field;
        assert_eq!(field(v1::PredictGridRequest { time: Some(timestamp(-1)), ..request() }), "time");
        assert_eq!(field(v1::PredictGridRequest { output: 99, ..request() }), "output");
        let model = v1::ModelSelector { order: Some(16), ..v1::ModelSelector::default() };
        assert_eq!(field(v1::PredictGridRequest { model: Some(model), ..request() }), "model.order");
        let model = v1::ModelSelector { kind: v1::ModelKind::Pergam.into(), ..v1::ModelSelector::default() };
        assert_eq!(field(v1::PredictGridRequest { model: Some(model), ..request() }), "model.kind");
        assert_eq!(threshold(v1::GridOutput::Threshold, 0.0), Ok(CellOutput::Threshold(0.5)));
        assert_eq!(threshold(v1::GridOutput::Threshold, 1.0), Ok(CellOutput::Threshold(1.0)));
        for wrong in [-0.5, 1.000_000_001, f64::NAN, f64::INFINITY, 1e-60] {
            assert_eq!(threshold(v1::GridOutput::Threshold, wrong), Err("threshold".to_owned()), "{wrong}");
        }
        assert_eq!(threshold(v1::GridOutput::Entropy, 0.5), Err("threshold".to_owned()));
        assert_eq!(threshold(v1::GridOutput::Probability, f64::NAN), Err("threshold".to_owned()));
    }

    #[test]
    fn questions_come_back() {
        let region = Some(CellBox { min: CellIndex { x: -1, y: 0, z: 0 }, max: CellIndex { x: 5, y: 6, z: 1 } });
        for output in [CellOutput::Probability, CellOutput::Entropy, CellOutput::Threshold(0.75)] {
            let question = GridQuestion { utc_nanos: 5, region, project: true, output, ..GridQuestion::default() };
            let wire = question_to_wire("office", &question, true);
            assert!(wire.map == "office" && wire.estimate_only);
            assert_eq!(question_from_wire(&wire), Ok(question));
        }
    }

    fn tile() -> v1::PredictedTile {
        let mask = |bits: u8| [vec![bits], vec![0; 63]].concat();
        v1::PredictedTile {
            x: 1,
            y: -2,
            z: 3,
            known: mask(0b1111),
            changed: mask(0b0101),
            high: mask(0b0010),
            static_high: 0.75,
            static_low: 0.25,
            values: vec![0.1, 0.9],
            all_values: false,
        }
    }

    fn cells(wire: v1::PredictedTile, is_projected: bool) -> Result<Vec<(u16, CellPrediction)>, InvalidTile> {
        tile_from_wire(wire, is_projected).map(|(tile, levels)| tile.known_cells(levels).collect())
    }

    #[test]
    fn cells_are_unknown_static_or_changing() {
        use CellPrediction::{Changing, Static};
        let found = cells(tile(), false);
        assert_eq!(found, Ok(vec![(0, Changing(0.1)), (1, Static(0.75)), (2, Changing(0.9)), (3, Static(0.25))]));
        let all = v1::PredictedTile { all_values: true, values: vec![0.1, 0.2, 0.3, 0.4], high: Vec::new(), ..tile() };
        let found = cells(all, false);
        assert_eq!(found, Ok(vec![(0, Changing(0.1)), (1, Static(0.2)), (2, Changing(0.3)), (3, Static(0.4))]));
    }

    #[test]
    fn a_projected_tile_has_one_layer() {
        let layer = |first: u8, second: u8| vec![first, second, 0, 0, 0, 0, 0, 0];
        let wire = v1::PredictedTile {
            known: layer(3, 1),
            changed: layer(0, 1),
            high: layer(2, 0),
            values: vec![0.5],
            ..tile()
        };
        let (read, levels) = tile_from_wire(wire, true).expect("valid");
        assert_eq!(read.index, TileIndex { x: 1, y: -2, z: 3 });
        let values: Vec<_> = read.known_cells(levels).map(|(cell, prediction)| (cell, prediction.value())).collect();
        assert_eq!(values, [(0, Some(0.25)), (1, Some(0.75)), (8, Some(0.5))]);
    }

    #[test]
    fn a_tile_that_does_not_add_up_is_an_error() {
        let wrong = |change: fn(&mut v1::PredictedTile), is_projected| {
            let mut tile = tile();
            change(&mut tile);
            tile_from_wire(tile, is_projected).is_err()
        };
        assert!(!wrong(|_| {}, false));
        assert!(wrong(|_| {}, true), "a projected tile has 8 bytes");
        assert!(wrong(|tile| tile.values.truncate(1), false));
        assert!(wrong(|tile| tile.values.push(0.5), false));
        assert!(wrong(|tile| tile.known.truncate(63), false));
        assert!(wrong(|tile| tile.values[0] = 1.5, false));
        assert!(wrong(|tile| tile.static_low = f32::NAN, false));
        assert!(wrong(|tile| tile.x = i32::MAX, false));
    }

    #[test]
    fn a_tile_is_read_as_it_was_written() {
        let (read, levels) = tile_from_wire(tile(), false).expect("valid");
        let again = tile_to_wire(read.clone(), &GridQuestion::default(), (levels.0.into(), levels.1.into()));
        assert_eq!(tile_from_wire(again, false), Ok((read, levels)));
    }

    #[test]
    fn a_tile_takes_no_more_bytes_than_its_bound() {
        let index = TileIndex { x: -1_048_576, y: 1_048_575, z: -1_048_576 };
        let values = vec![0.25; TILE_CELLS];
        let (known, changed) = (Mask::FULL, Mask::FULL);
        let tile = TileCells { index, known, changed, high: Mask::FULL, values, all_values: false };
        let question = GridQuestion::default();
        let page = v1::GridPage { tiles: vec![tile_to_wire(tile, &question, (0.1, 0.9)); 3] };
        let max_bytes = 3 * (3 * MASK_BYTES as u64 + TILE_OVERHEAD + 4 * TILE_CELLS as u64);
        assert!(page.encoded_len() as u64 <= max_bytes, "{} of {max_bytes}", page.encoded_len());
    }

    #[test]
    fn masks_of_a_projected_tile_have_8_bytes_and_empty_ones_none() {
        let layer = Mask([5, 0, 0, 0, 0, 0, 0, 0]);
        let index = TileIndex::default();
        let tile =
            TileCells { index, known: layer, changed: Mask::EMPTY, high: layer, values: Vec::new(), all_values: false };
        let question = GridQuestion { project: true, output: CellOutput::Entropy, ..GridQuestion::default() };
        let wire = tile_to_wire(tile, &question, (0.0, 0.5));
        assert_eq!((wire.known, wire.changed.len()), (vec![5, 0, 0, 0, 0, 0, 0, 0], 0));
        assert_eq!((wire.static_low, wire.static_high), (0.0, 1.0));
    }
}
