//! Compares bins with a count of every reading, and shows what a bin makes of contradicting rays.

use std::collections::BTreeMap;

use proptest::prelude::*;
use tidemap_model::LocalDay;

use super::*;
use crate::{
    scan::ScanSource,
    sensors::ProducerSensor,
    spec::SensorNoise,
    tests::{HOUR, SECOND},
};

/// A scan with the masks of the tiles that it saw.
type Scan = (ScanTime, BTreeMap<TileId, TileMasks>);
/// The scans of a day.
type Scans = Vec<Scan>;

fn day_of(scans: &Scans) -> GridDay {
    let mut day = GridDay::new(LocalDay(0));
    for (time, tiles) in scans {
        let scan = day.push(*time, &tiles.keys().copied().collect());
        for (&tile, &masks) in tiles {
            day.show(scan, tile, masks);
        }
    }
    day
}

/// The masks of each tile in each scan of a day, by the time of the scan.
fn shown(day: &GridDay) -> BTreeMap<(i64, TileId), TileMasks> {
    let mut shown = BTreeMap::new();
    for ((id, tile), ranges) in day.tiles().zip(day.presence_by_tile()) {
        for (scan, masks) in tile.scans(&ranges) {
            shown.insert((day.scans[scan as usize].utc_nanos, id), masks);
        }
    }
    shown
}

/// The masks of each tile in each bin, from each reading of each cell alone.
fn counted(scans: &Scans, sensors: &Sensors) -> BTreeMap<(i64, TileId), TileMasks> {
    let mut bins: BTreeMap<(i64, i32), Vec<&Scan>> = BTreeMap::new();
    for scan in scans {
        let key = (scan.0.civil_nanos().div_euclid(BIN_NANOS), scan.0.offset_secs);
        bins.entry(key).or_default().push(scan);
    }
    let mean = |scans: &[&Scan]| {
        let sum: i128 = scans.iter().map(|(time, _)| i128::from(time.utc_nanos)).sum();
        i64::try_from(sum.div_euclid(scans.len() as i128)).expect("near")
    };
    let mut bins: Vec<_> = bins.into_iter().map(|(key, scans)| (mean(&scans), key, scans)).collect();
    bins.sort_by_key(|(mean, key, _)| (*mean, *key));
    let mut counted = BTreeMap::new();
    // Whether each source last read each cell as occupied.
    let mut last: BTreeMap<(TileId, u16, ScanSource), bool> = BTreeMap::new();
    for (mean, _, scans) in bins {
        let mut odds: BTreeMap<(TileId, u16, ScanSource), f64> = BTreeMap::new();
        for (time, tiles) in scans {
            for (&tile, masks) in tiles {
                counted.entry((mean, tile)).or_insert_with(TileMasks::default);
                let RayOdds { hit, miss } = sensors.odds(time.sensor, time.source);
                for cell in masks.observed().cells() {
                    let is_hit = masks.occupied().contains(cell);
                    *odds.entry((tile, cell, time.source)).or_default() += if is_hit { hit } else { miss } as f64;
                }
            }
        }
        last.extend(odds.iter().map(|(place, odds)| (*place, *odds > 0.0)));
        for &(tile, cell, _) in odds.keys() {
            let masks = counted.get_mut(&(mean, tile)).expect("seen");
            let of_cell = |place: &(TileId, u16, ScanSource)| (place.0, place.1) == (tile, cell);
            let is_read = odds.iter().any(|(place, odds)| of_cell(place) && *odds > 0.0);
            let stands = last.iter().any(|(place, is_occupied)| of_cell(place) && *is_occupied);
            if is_read || !stands {
                let occupied = if is_read { masks.occupied() | Mask::of(cell) } else { masks.occupied() };
                *masks = TileMasks::clipped(masks.observed() | Mask::of(cell), occupied);
            }
        }
    }
    counted
}

/// The bins of a day before which no scan was made.
fn first_bins(scans: &Scans, sensors: &Sensors) -> GridDay {
    let day = day_of(scans);
    let mut standing = vec![Standing::default(); day.tiles().len()];
    bins_of(&day, sensors, &mut standing)
}

fn masks() -> impl Strategy<Value = TileMasks> {
    // Few cells, so that readings of the same cell meet.
    (any::<u8>(), any::<u8>()).prop_map(|(observed, occupied)| {
        let layer = |bits: u8| Mask([u64::from(bits), 0, 0, u64::from(bits >> 4), 0, 0, 0, 0]);
        TileMasks::clipped(layer(observed), layer(occupied))
    })
}

proptest! {
    #[test]
    fn a_bin_is_the_sum_of_the_log_odds_of_its_readings(
        scans in prop::collection::vec(
            ((0..3 * HOUR, 0..3_u8, any::<bool>(), 0..3_i8), prop::collection::btree_map(0..3_u32, masks(), 1..3)),
            1..40,
        ),
        is_in_order in any::<bool>(),
    ) {
        let mut sensors = Sensors::new(SensorNoise { hit: 0.9, false_alarm: 0.2, prior: 0.3 });
        sensors.add(Some(ProducerSensor { hit: 0.6, false_alarm: 0.3 })).expect("a sensor");
        sensors.add(Some(ProducerSensor { hit: 1.0, false_alarm: 0.0 })).expect("a sensor");
        let mut scans: Scans = scans
            .into_iter()
            .map(|((utc_nanos, sensor, is_summer, height), tiles)| {
                let offset_secs = if is_summer { 3600 } else { 0 };
                let source = if height == 0 { ScanSource::Cells } else { ScanSource::Rays { height } };
                let time = ScanTime { utc_nanos, offset_secs, source, sensor: SensorId(sensor) };
                (time, tiles.into_iter().map(|(tile, masks)| (TileId(tile), masks)).collect())
            })
            .collect();
        if is_in_order {
            scans.sort_by_key(|(time, _)| time.utc_nanos);
        }
        let binned = first_bins(&scans, &sensors);
        prop_assert!(binned.scans.is_sorted_by_key(|time| time.utc_nanos));
        prop_assert!(binned.scans.iter().all(|time| time.sensor == SensorId::OWN));
        prop_assert_eq!(shown(&binned), counted(&scans, &sensors));
        scans.reverse();
        prop_assert_eq!(shown(&first_bins(&scans, &sensors)), shown(&binned));
    }
}

/// Whether a cell that reads so often as occupied, then so often as free, is occupied in its bin.
fn is_occupied((hits, misses): (i64, i64), source: ScanSource, noise: SensorNoise) -> bool {
    let reading = |scan: i64| {
        let time = ScanTime { utc_nanos: scan * SECOND, offset_secs: 0, source, sensor: SensorId::OWN };
        let occupied = if scan < hits { Mask::of(7) } else { Mask::EMPTY };
        (time, BTreeMap::from([(TileId(0), TileMasks::clipped(Mask::of(7), occupied))]))
    };
    let scans = (0..hits + misses).map(reading).collect();
    let binned = first_bins(&scans, &Sensors::new(noise));
    assert_eq!(binned.scans.len(), 1);
    binned.tile(TileId(0)).expect("seen").first.occupied().contains(7)
}

#[test]
fn a_wall_that_many_rays_pass_stays_a_wall() {
    // OctoMap: a hit counts as .7, a miss as .4, so that two misses for each hit leave the cell occupied.
    let is_wall = |readings| is_occupied(readings, ScanSource::Rays { height: 0 }, SensorNoise::default());
    assert!(is_wall((300, 600)) && is_wall((1, 0)) && is_wall((1, 2)));
    assert!(!is_wall((1, 3)) && !is_wall((0, 1)) && !is_wall((300, 700)));
    // Cells that a scan states, and a sensor that is stated to err alike both ways, decide by the majority.
    let even = SensorNoise { hit: 0.9, false_alarm: 0.1, prior: 0.5 };
    for (source, noise) in
        [(ScanSource::Cells, SensorNoise::default()), (ScanSource::Cells, even), (ScanSource::Rays { height: 0 }, even)]
    {
        let is_stated = |readings| is_occupied(readings, source, noise);
        assert!(is_stated((2, 1)) && !is_stated((1, 2)) && !is_stated((1, 1)));
    }
}
