//! An answer about a grid contains, for each cell, the prediction of [`GridView::predict_tile`], and no other cell.

use std::{collections::HashMap, sync::Arc};

use proptest::prelude::*;
use tidemap_model::{Component, OrderErrors, Periodicities, SpectralModel, Zone, selector::Blend};

use super::*;
use crate::{
    day::ScanTime,
    generation::Generation,
    live::TILE_CHUNK,
    live_tile::{LiveTile, ReadingRule, ScanRun},
    mask::TileMasks,
    scan::ScanSource,
    sensor_sums::SensorWeights,
    sensors::{ProducerSensor, SensorId, Sensors, Weights},
    spec::{GridSpec, SensorNoise},
    tile::{CellModel, Group, ModelSlot},
};

const HOUR: i64 = 3_600_000_000_000;

/// One tile: the learned data, and the readings since.
#[derive(Clone, Debug)]
struct Tile {
    learned: Mask,
    always: Mask,
    cells: Vec<(u16, u8, f64, f64)>,
    /// The observed and occupied cells of each scan, and its sensor.
    seen: Vec<(Mask, Mask, u8)>,
    /// The number of learned readings that are of another sensor.
    learned_others: Option<u8>,
}

fn mask() -> impl Strategy<Value = Mask> {
    (any::<u64>(), any::<u64>(), 0..8_usize).prop_map(|(one, other, at)| {
        let mut mask = Mask::EMPTY;
        mask.0[at] = one & other;
        mask.0[(at + 1) % 8] = other;
        mask
    })
}

fn tile() -> impl Strategy<Value = Tile> {
    let learned = prop_oneof![Just(Mask::EMPTY), Just(Mask::FULL), mask()];
    let cells = proptest::collection::vec((0..512_u16, 0..4_u8, 0.0..1.0_f64, -0.4..0.4_f64), 0..40);
    let seen = proptest::collection::vec((mask(), mask(), 0..3_u8), 0..3);
    (learned, mask(), cells, seen, proptest::option::of(0..9_u8)).prop_map(
        |(learned, always, mut cells, seen, learned_others)| {
            cells.retain(|(cell, ..)| learned.contains(*cell));
            cells.sort_by_key(|(cell, ..)| *cell);
            cells.dedup_by_key(|(cell, ..)| *cell);
            let mut changed = Mask::EMPTY;
            cells.iter().for_each(|(cell, ..)| changed.insert(*cell));
            Tile { learned, always: (always & learned).without(changed), cells, seen, learned_others }
        },
    )
}

/// The phasors of an instant in London.
fn instant(utc_nanos: i64) -> InstantPhasors {
    let zone = Zone::named("Europe/London").expect("known");
    let civil = utc_nanos + i64::from(zone.offset_secs(utc_nanos)) * 1_000_000_000;
    InstantPhasors::new(&Periodicities::harmonics(24 * HOUR, 12).expect("valid"), civil)
}

/// A view of a grid with these tiles.
fn view(tiles: &[(TileIndex, Tile)], sensor: SensorNoise, others: usize, is_flat: bool) -> GridView {
    let spec = GridSpec { is_flat, sensor, ..GridSpec::new(0.1) };
    let mut sensors = Sensors::new(sensor);
    for (hit, false_alarm) in [(0.7, 0.2), (0.99, 0.4)].into_iter().take(others) {
        sensors.add(Some(ProducerSensor { hit, false_alarm })).expect("a sensor");
    }
    let (mut ids, mut models, mut live) = (HashMap::new(), Vec::new(), Vec::new());
    for (index, tile) in tiles {
        ids.insert(*index, TileId(u32::try_from(models.len()).expect("few")));
        let component = |gamma_re| Component { periodicity: 3, gamma_re, gamma_im: 0.1 };
        let cells = tile.cells.iter().map(|&(cell, order, mean, gamma)| CellModel {
            cell,
            occupied: 3,
            spectral: SpectralModel::from_parts(mean, 9, vec![component(gamma), component(0.2)]).expect("valid"),
            order,
            errors: OrderErrors::default(),
            alarm_day: None,
        });
        let group =
            Group { cells: tile.learned, observations: 9, first_nanos: 0, last_nanos: HOUR, ..Group::default() };
        let groups = if tile.learned.is_empty() { Vec::new() } else { vec![group] };
        let weights = tile.learned_others.filter(|_| others > 0).map(|readings| {
            let (mut weights, readings) = (Weights::own(u64::from(9 - readings)), usize::from(readings));
            (0..readings).for_each(|_| weights += sensors.weights(SensorId(1)));
            Box::new(SensorWeights {
                groups: vec![weights; groups.len()],
                occupied: vec![3.0; tile.cells.len()],
                fades: Vec::new(),
            })
        });
        models.push(ModelSlot::Resident(Arc::new(TileModel {
            groups,
            always_occupied: tile.always,
            cells: cells.collect(),
            sensors: weights,
        })));
        let mut seen = LiveTile::new(*index);
        // The learned readings were also seen, with the values in the models or with other values.
        let time = |scan: i64, sensor: u8| ScanTime {
            utc_nanos: scan * HOUR,
            offset_secs: 0,
            source: ScanSource::Cells,
            sensor: SensorId(sensor.min(u8::try_from(others).expect("few"))),
        };
        let rule = ReadingRule { sensors: &sensors, steps: None };
        seen.observe(time(1, 0), TileMasks::clipped(tile.learned, tile.always), rule);
        for (scan, (observed, occupied, sensor)) in (2..).zip(&tile.seen) {
            seen.observe(time(scan, *sensor), TileMasks::clipped(*observed, *occupied), rule);
        }
        live.push(Arc::new(seen));
    }
    GridView {
        spec: Arc::new(spec),
        sensors: Arc::new(sensors),
        ids: Arc::new(ids),
        chunks: live.chunks(TILE_CHUNK).map(|chunk| Arc::new(chunk.to_vec())).collect(),
        last_seen: Arc::default(),
        run: ScanRun::default(),
        generation: Arc::new(Generation { models }),
        scans: 0,
        pending_scans: 0,
        scans_ahead: 0,
        cell_observations: 0,
        shown: CellBox::default(),
    }
}

/// Probability of each known cell of a region, and whether it has changed.
fn naive(grid: &GridView, question: &GridQuestion) -> HashMap<CellIndex, (f32, bool)> {
    let phasors = instant(question.utc_nanos);
    let mut cells = HashMap::new();
    for (&index, &id) in grid.ids.iter() {
        let tile = grid.predict_tile(id, question.utc_nanos, &phasors, question.selector).expect("in memory");
        for place in tile.known.cells() {
            let cell = index.cell(place);
            if question.region.is_none_or(|region| region.contains(cell)) {
                cells.insert(cell, (tile.probabilities[usize::from(place)], tile.changed.contains(place)));
            }
        }
    }
    cells
}

/// The value of each known cell in the answer, and whether it has changed.
fn answer_cells(grid: &GridView, question: &GridQuestion) -> HashMap<CellIndex, (f32, bool)> {
    let selection = grid.select(question);
    let levels = grid.levels();
    let mut cells = HashMap::new();
    let (mut values, mut tiles) = (0, 0);
    let mut before = None;
    for tile in grid.predict(question, &selection, instant(question.utc_nanos)) {
        let tile = tile.expect("in memory");
        let place = (tile.index.z, tile.index.y, tile.index.x);
        assert!(before.replace(place).is_none_or(|before| before < place));
        assert!(
            (tile.changed.without(tile.known) | tile.high.without(tile.known) | (tile.high & tile.changed)).is_empty()
        );
        (values, tiles) = (values + tile.values.len() as u64, tiles + 1);
        let mut own = tile.values.iter();
        for place in tile.known.cells() {
            let changed = tile.changed.contains(place);
            let value = match changed || tile.all_values {
                true => *own.next().expect("a value"),
                false => question.output.of(if tile.high.contains(place) { levels.1 } else { levels.0 } as f32),
            };
            cells.insert(tile.index.cell(place), (value, changed));
        }
        assert_eq!(own.next(), None);
    }
    assert!(values <= selection.values_at_most && tiles == selection.tile_count);
    assert!(cells.keys().all(|cell| selection.region.contains(*cell)));
    cells
}

#[track_caller]
fn check(grid: &GridView, question: &GridQuestion) {
    let mut expected = naive(grid, question);
    if question.project {
        let mut columns: HashMap<CellIndex, (i32, (f32, bool))> = HashMap::new();
        for (cell, value) in expected {
            let column = columns.entry(CellIndex { z: 0, ..cell }).or_insert((cell.z, value));
            if value.0 > column.1.0 || (value.0.to_bits() == column.1.0.to_bits() && cell.z < column.0) {
                *column = (cell.z, value);
            }
        }
        expected = columns.into_iter().map(|(cell, (_, value))| (cell, value)).collect();
    }
    expected.values_mut().for_each(|(value, _)| *value = question.output.of(*value));
    let found = answer_cells(grid, question);
    assert_eq!(found.len(), expected.len(), "{question:?}");
    for (cell, (value, changed)) in expected {
        let (answer, answer_changed) = found[&cell];
        assert!(
            (answer - value).abs() < 1e-6 && changed == answer_changed,
            "{cell:?}: {answer} for {value}, {question:?}"
        );
    }
}

fn cell(x: i32, y: i32, z: i32) -> CellIndex {
    CellIndex { x, y, z }
}

proptest! {
    #![proptest_config(ProptestConfig::with_cases(96))]

    #[test]
    fn an_answer_has_for_each_cell_what_its_tile_has(
        tiles in proptest::collection::vec(((-2..2_i32, -1..1_i32, -1..2_i32), tile()), 0..7),
        corner in (-18..18_i32, -10..10_i32, -10..18_i32),
        size in (0..30_i32, 0..20_i32, 0..20_i32),
        hours in 0..200_i64,
        noisy in any::<bool>(),
        others in 0..3_usize,
        order in proptest::option::of(0..3_usize),
    ) {
        let mut tiles: Vec<(TileIndex, Tile)> =
            tiles.into_iter().map(|((x, y, z), tile)| (TileIndex { x, y, z }, tile)).collect();
        tiles.sort_by_key(|(index, _)| *index);
        tiles.dedup_by_key(|(index, _)| *index);
        let sensor = if noisy { SensorNoise { hit: 0.8, false_alarm: 0.1, prior: 0.4 } } else { SensorNoise::default() };
        let view = view(&tiles, sensor, others, false);
        let min = cell(corner.0, corner.1, corner.2);
        let part = CellBox { min, max: cell(min.x + size.0, min.y + size.1, min.z + size.2) };
        for kind in [ModelKind::Auto, ModelKind::Mean, ModelKind::Latest, ModelKind::Spectral] {
            for blend in [Blend::None, Blend::Persistence] {
                let order = order.filter(|_| matches!(kind, ModelKind::Auto | ModelKind::Spectral));
                let selector = ModelSelector { kind, order, blend };
                for region in [None, Some(part)] {
                    for output in [CellOutput::Probability, CellOutput::Entropy] {
                        for project in [false, true] {
                            check(&view, &GridQuestion { utc_nanos: hours * HOUR, selector, region, project, output });
                        }
                    }
                }
            }
        }
    }
}

#[test]
fn a_region_costs_what_there_is_in_it() {
    let tile =
        Tile { learned: Mask::FULL, always: Mask::EMPTY, cells: Vec::new(), seen: Vec::new(), learned_others: None };
    let tiles = [(TileIndex { x: 0, y: 0, z: 0 }, tile.clone()), (TileIndex { x: 40, y: -3, z: 0 }, tile)];
    let grid = view(&tiles, SensorNoise::default(), 0, false);
    let ask = |min, max| grid.select(&GridQuestion { region: Some(CellBox { min, max }), ..GridQuestion::default() });
    let all = ask(cell(i32::MIN, i32::MIN, i32::MIN), cell(i32::MAX, i32::MAX, i32::MAX));
    assert_eq!((all.tiles.len(), all.cells, all.values_at_most), (2, 1024, 0));
    assert_eq!(all.region, CellBox { min: cell(0, -24, 0), max: cell(328, 8, 8) });
    let one = ask(cell(7, 7, 7), cell(8, 8, 8));
    assert_eq!((one.tiles.len(), one.region.count()), (1, 1));
    for (min, max) in [(cell(8, 0, 0), cell(9, 1, 1)), (cell(3, 3, 3), cell(3, 9, 9)), (cell(5, 5, 5), cell(1, 1, 1))] {
        let none = ask(min, max);
        assert_eq!((none.tiles.len(), none.cells, none.region.count()), (0, 0, 0));
        assert_eq!(grid.predict(&GridQuestion::default(), &none, instant(0)).count(), 0);
    }
}

#[test]
fn a_flat_grid_has_64_cells_a_tile() {
    let mut layer = Mask::EMPTY;
    layer.0[0] = u64::MAX;
    let tile = Tile {
        learned: layer,
        always: Mask::EMPTY,
        cells: vec![(3, 0, 0.25, 0.0)],
        seen: Vec::new(),
        learned_others: None,
    };
    let grid = view(&[(TileIndex::default(), tile)], SensorNoise::default(), 0, true);
    let all = grid.select(&GridQuestion::default());
    assert_eq!((all.cells, all.region.count(), all.values_at_most), (64, 64, 1));
    let above = CellBox { min: cell(0, 0, 1), max: cell(8, 8, 8) };
    assert!(grid.select(&GridQuestion { region: Some(above), ..GridQuestion::default() }).tiles.is_empty());
}

#[test]
fn a_picture_has_the_size_of_what_is_known_and_of_what_was_shown() {
    let mut some = Mask::EMPTY;
    some.insert(2 + 8 * 3);
    some.insert(5 + 8 * 4 + 64);
    let tile = |learned| Tile {
        learned,
        always: Mask::EMPTY,
        cells: Vec::new(),
        seen: vec![(some, Mask::EMPTY, 0)],
        learned_others: None,
    };
    let at = |x, y| TileIndex { x, y, z: 0 };
    let select = |grid: &GridView, region| grid.select(&GridQuestion { region, ..GridQuestion::default() });
    let mut grid = view(&[(at(0, 0), tile(Mask::EMPTY))], SensorNoise::default(), 0, false);
    let known = CellBox { min: cell(2, 3, 0), max: cell(6, 5, 2) };
    assert_eq!(grid.region(), known, "the cells that were seen");
    // The region has four columns, two rows and two layers.
    assert_eq!((select(&grid, None).region, select(&grid, None).cells), (known, 16));
    grid.shown = CellBox { min: cell(-30, 0, 0), max: cell(5, 40, 1) };
    let both = CellBox { min: cell(-30, 0, 0), max: cell(6, 40, 2) };
    assert_eq!(grid.region(), both);
    assert_eq!((select(&grid, None).region, select(&grid, None).cells), (both, 6 * 8 * 2));
    let part = CellBox { min: cell(-10, 0, 0), max: cell(3, 99, 1) };
    assert_eq!(select(&grid, Some(part)).region, CellBox { max: cell(3, 40, 1), ..part }, "unknown cells as well");
    let extent = CellBox { min: cell(-100, -100, 0), max: cell(100, 100, 4) };
    grid.spec = Arc::new(GridSpec { extent: Some(extent), ..GridSpec::clone(&grid.spec) });
    assert_eq!(grid.region(), extent, "a grid with a size always has this size");
    let wide = CellBox { min: cell(-10_000, -10_000, 0), max: cell(10_000, 10_000, 4) };
    grid.spec = Arc::new(GridSpec { extent: Some(wide), ..GridSpec::clone(&grid.spec) });
    assert_eq!(grid.region(), both, "unless it is too large");
    let mut none = view(&[], SensorNoise::default(), 0, false);
    none.shown = both;
    assert!(none.region().is_empty() && select(&none, None).tiles.is_empty(), "nothing is known");
}

#[test]
fn outputs_are_what_they_are_called() {
    assert_eq!(CellOutput::Entropy.of(0.5), 1.0);
    assert_eq!([0.0, 0.9, 1.0].map(|p| CellOutput::Threshold(0.9).of(p)), [0.0, 1.0, 1.0]);
    assert_eq!(CellOutput::Probability.of(0.3), 0.3);
}
