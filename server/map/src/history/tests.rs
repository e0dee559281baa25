//! History returns the data that was put in, and is small where models are right.

use std::sync::Arc;

use proptest::prelude::*;
use tidemap_grid::{
    day::{Bit, ScanTime},
    generation::Generation,
    mask::{Mask, TileMasks},
    scan::ScanSource,
    sensors::SensorId,
    tile::{CellModel, Group, ModelSlot, TileModel},
};
use tidemap_model::{Component, LocalDay, OrderErrors, Periodicities, SpectralModel};

use super::{
    bits::Bits,
    phasors::{DayPhasors, Sum},
    *,
};

const SECOND: i64 = 1_000_000_000;
const HOUR: i64 = 3600 * SECOND;
const MIDNIGHT: i64 = 16_800 * 24 * HOUR;

fn cell_model(cell: u16, order: u8, mean: f64, components: Vec<Component>) -> CellModel {
    let spectral = SpectralModel::from_parts(mean, 100, components).expect("valid");
    CellModel { cell, occupied: 50, spectral, order, errors: OrderErrors::default(), alarm_day: None }
}

fn tile_model(cells: Vec<CellModel>, always_occupied: Mask) -> ModelSlot {
    let group =
        Group { cells: Mask::FULL, observations: 100, first_nanos: 0, last_nanos: MIDNIGHT, ..Group::default() };
    ModelSlot::Resident(Arc::new(TileModel { groups: vec![group], always_occupied, cells, sensors: None }))
}

/// A mask of a few cells of a tile, most of them in a row.
fn some_mask() -> impl Strategy<Value = Mask> {
    (any::<[u64; 2]>(), 0..8_usize).prop_map(|(words, at)| {
        let mut mask = Mask::EMPTY;
        mask.0[at] = words[0];
        mask.0[7 - at] |= words[1] & 0xff;
        mask
    })
}

/// The content of one scan: the time since the scan before, and the masks of each tile that it sees.
type Shown = (i64, Vec<(u32, Mask, Mask)>);

fn some_scans() -> impl Strategy<Value = Vec<Shown>> {
    let base = (some_mask(), some_mask());
    let tile = (0..3_u32, base, any::<u8>()).prop_map(|(id, (observed, occupied), how)| match how % 4 {
        0 => (id, Mask::FULL, occupied),
        1 => (id, Mask::FULL.without(observed), Mask::FULL),
        2 => (id, observed, observed),
        _ => (id, observed | occupied, occupied),
    });
    let seen = proptest::collection::vec(tile, 0..3).prop_map(|mut tiles| {
        tiles.sort_unstable_by_key(|(id, ..)| *id);
        tiles.dedup_by_key(|(id, ..)| *id);
        tiles
    });
    // Each stretch consists of scans with the same masks.
    let stretch = (seen, 1..40_usize, prop_oneof![Just(5 * SECOND), Just(HOUR), -HOUR..2 * HOUR]);
    proptest::collection::vec(stretch, 1..30).prop_map(|stretches| {
        let repeat = |(seen, count, step): (Vec<_>, usize, i64)| std::iter::repeat_n((step, seen), count);
        stretches.into_iter().flat_map(repeat).collect()
    })
}

fn some_models() -> impl Strategy<Value = Vec<ModelSlot>> {
    let component = (0..200_u32, -1.0..1.0_f64, -1.0..1.0_f64)
        .prop_map(|(periodicity, gamma_re, gamma_im)| Component { periodicity, gamma_re, gamma_im });
    let cell = (0..512_u16, 0..16_u8, 0.0..1.0_f64, proptest::collection::vec(component, 0..15));
    let tile = (proptest::collection::vec(cell, 0..60), some_mask()).prop_map(|(mut cells, always)| {
        cells.sort_by_key(|(cell, ..)| *cell);
        cells.dedup_by_key(|(cell, ..)| *cell);
        let cells = cells.into_iter().map(|(cell, order, mean, parts)| cell_model(cell, order, mean, parts)).collect();
        tile_model(cells, always)
    });
    proptest::collection::vec(tile, 0..4)
}

/// The day of some scans.
fn day_of(scans: &[Shown]) -> GridDay {
    let mut day = GridDay::new(LocalDay::of_civil_nanos(MIDNIGHT));
    let mut utc_nanos = MIDNIGHT;
    for (step, seen) in scans {
        utc_nanos += step;
        let tiles: Arc<[TileId]> = seen.iter().map(|(id, ..)| TileId(*id)).collect();
        let scan = day.push(
            ScanTime {
                utc_nanos,
                offset_secs: 3600,
                source: ScanSource::Cells,
                sensor: SensorId(u8::from(utc_nanos % 3 == 0)),
            },
            &tiles,
        );
        for &(id, observed, occupied) in seen {
            day.show(scan, TileId(id), TileMasks::clipped(observed, occupied));
        }
    }
    day
}

/// The readings of a cell, scan by scan.
fn naive_readings(scans: &[Shown], tile: u32, cell: u16) -> Vec<(i64, bool)> {
    let mut utc_nanos = MIDNIGHT;
    let mut readings = Vec::new();
    for (step, seen) in scans {
        utc_nanos += step;
        if let Some((_, _, occupied)) = seen.iter().find(|(id, o, _)| *id == tile && o.contains(cell)) {
            readings.push((utc_nanos, occupied.contains(cell)));
        }
    }
    readings
}

#[track_caller]
fn check(scans: &[Shown], models: Vec<ModelSlot>, periodicities: &Periodicities, levels: (f64, f64)) {
    let day = day_of(scans);
    let kept = HistoryDay::encode(day.clone(), &Generation { models }, periodicities, levels);
    assert_eq!(kept.decode(periodicities), day);
    assert!(kept.models.is_sorted_by_key(|(tile, _)| *tile));
    for tile in 0..4 {
        assert!(kept.models_of(TileId(tile)).is_sorted_by_key(|model| model.cell));
        for cell in (0..512).step_by(61).chain(kept.models_of(TileId(tile)).iter().map(|model| model.cell)) {
            let expected = naive_readings(scans, tile, cell);
            assert_eq!(kept.readings(TileId(tile), cell, periodicities), expected, "tile {tile} cell {cell}");
            assert_eq!(day_readings(&day, TileId(tile), cell, periodicities), expected);
        }
    }
}

proptest! {
    #![proptest_config(ProptestConfig::with_cases(200))]

    #[test]
    fn any_day_comes_back_exactly(scans in some_scans(), models in some_models()) {
        check(&scans, models, &Periodicities::default(), (0.0, 1.0));
    }

    #[test]
    fn any_day_comes_back_exactly_in_any_periodicities(
        scans in some_scans(), models in some_models(), period in 2 * SECOND..400 * 24 * HOUR
    ) {
        let list = Periodicities::list(vec![period, period / 2 + 1, 24 * HOUR + 1]).expect("valid");
        check(&scans, models, &list, (0.1, 0.7));
    }
}

#[test]
fn a_day_of_one_scan_comes_back() {
    let component = Component { periodicity: 6, gamma_re: 0.3, gamma_im: -0.1 };
    for shown in [Mask::FULL, Mask::EMPTY] {
        let models = vec![tile_model(vec![cell_model(3, 1, 0.5, vec![component])], Mask::FULL)];
        check(&[(0, vec![(0, Mask::FULL, shown)])], models, &Periodicities::default(), (0.0, 1.0));
    }
    check(&[(0, Vec::new())], Vec::new(), &Periodicities::default(), (0.0, 1.0));
}

/// A scan a minute of two cells that are occupied when a wave with a period of a day is high, except for `wrong` of the
/// scans.
fn waves(wrong: impl Fn(usize) -> bool) -> (Vec<Shown>, Vec<ModelSlot>) {
    let component = |periodicity| Component { periodicity, gamma_re: 0.2, gamma_im: 0.1 };
    let (slow, fast) = (vec![component(6)], vec![component(6), component(167)]);
    let periodicities = Periodicities::default();
    let models = [slow, fast].map(|parts| SpectralModel::from_parts(0.5, 10, parts).expect("valid"));
    let scans = (0..1440).map(|minute: usize| {
        let civil = MIDNIGHT + HOUR + (minute as i64 + 1) * 60 * SECOND;
        let mut occupied = Mask::EMPTY;
        for (cell, model) in (0..).zip(&models) {
            if (model.predict(&periodicities, 2, civil) >= 0.5) != wrong(minute) {
                occupied.insert(cell);
            }
        }
        (60 * SECOND, vec![(0, Mask::FULL, occupied)])
    });
    let cells = (0..)
        .zip(&models)
        .map(|(cell, model)| CellModel { spectral: model.clone(), ..cell_model(cell, 2, 0.5, Vec::new()) });
    (scans.collect(), vec![tile_model(cells.collect(), Mask::EMPTY)])
}

fn occupied_flips(day: &GridDay) -> usize {
    day.tiles().flat_map(|(_, tile)| &tile.flips).filter(|flip| flip.bit() == Bit::Occupied).count()
}

#[test]
fn only_what_a_model_gets_wrong_is_kept() {
    let periodicities = Periodicities::default();
    let (scans, models) = waves(|_| false);
    let day = day_of(&scans);
    assert!(occupied_flips(&day) > 24);
    let kept = HistoryDay::encode(day.clone(), &Generation { models }, &periodicities, (0.0, 1.0));
    // Two flips of the slow cell are cheaper than a model.
    assert_eq!(
        kept.models_of(TileId(0)).iter().map(|model| (model.cell, model.components.len())).collect::<Vec<_>>(),
        [(1, 2)]
    );
    assert!(occupied_flips(&kept.outliers) <= 2);
    assert_eq!(kept.decode(&periodicities), day);

    let (scans, models) = waves(|minute| minute == 700 || (800..900).contains(&minute));
    let day = day_of(&scans);
    let kept = HistoryDay::encode(day.clone(), &Generation { models }, &periodicities, (0.0, 1.0));
    let outliers = kept.readings(TileId(0), 1, &periodicities);
    assert_eq!(outliers, naive_readings(&scans, 0, 1));
    let tile = kept.outliers.tile(TileId(0)).expect("seen");
    let ends: Vec<u32> = tile.flips.iter().filter(|flip| flip.cell() == 1).map(|flip| flip.scan).collect();
    assert_eq!(ends, [700, 701, 800, 900]);
}

#[test]
fn a_wall_seen_now_and_then_costs_its_observations_only() {
    let periodicities = Periodicities::default();
    let mut wall = Mask::EMPTY;
    wall.insert(9);
    let scans: Vec<Shown> =
        (0..1000).map(|i| (SECOND, vec![(0, if i % 3 == 0 { wall } else { Mask::EMPTY }, wall)])).collect();
    let kept = HistoryDay::encode(
        day_of(&scans),
        &Generation { models: vec![tile_model(Vec::new(), wall)] },
        &periodicities,
        (0.0, 1.0),
    );
    assert_eq!(occupied_flips(&kept.outliers), 0);
    assert_eq!(kept.readings(TileId(0), 9, &periodicities), naive_readings(&scans, 0, 9));
}

#[test]
fn models_that_make_no_sense_do_no_harm() {
    let (scans, _) = waves(|minute| minute % 7 == 0);
    let part = |periodicity, gamma_re| OutlierComponent { periodicity, gamma_re, gamma_im: f32::NAN };
    let models = [(0, f32::NAN, part(3, 0.1)), (1, f32::INFINITY, part(9999, 0.1)), (600, 0.2, part(2, f32::MAX))];
    let models = models.map(|(cell, mean, component)| OutlierModel { cell, mean, components: vec![component] });
    let kept =
        HistoryDay { outliers: day_of(&scans), models: vec![(TileId(0), models.to_vec()), (TileId(7), Vec::new())] };
    let periodicities = Periodicities::default();
    let day = kept.decode(&periodicities);
    assert_eq!(day_readings(&day, TileId(0), 0, &periodicities), kept.readings(TileId(0), 0, &periodicities));
    assert_eq!(kept.readings(TileId(0), 600, &periodicities), []);
    assert_eq!(kept.readings(TileId(9), 1, &periodicities), []);
}

#[test]
fn the_answer_of_a_model_has_the_bits_of_the_first_version() {
    let scans: Vec<ScanTime> = (0..20_000_i64)
        .map(|i| ScanTime {
            utc_nanos: MIDNIGHT + i * 4_321_000_007,
            offset_secs: 7200,
            source: ScanSource::Cells,
            sensor: SensorId::OWN,
        })
        .collect();
    let phasors = DayPhasors::new(&Periodicities::default(), &scans);
    let mut sum = Sum::default();
    sum.start(0.43, &phasors);
    let mut hash = 0_u64;
    let mut bits = Bits::default();
    for k in 0..15_u16 {
        let (gamma_re, gamma_im) = (0.3 / f32::from(k + 1), -0.02 * f32::from(k));
        sum.add(&OutlierComponent { periodicity: k * 11, gamma_re, gamma_im }, &phasors);
        sum.occupied(&mut bits);
        for place in bits.ones() {
            hash = hash.rotate_left(5).wrapping_mul(0x9e37_79b9_7f4a_7c15) ^ u64::from(place);
        }
    }
    // The value was computed independently of this code, with the same roundings.
    assert_eq!(hash, 14_360_750_887_227_163_264);
}
