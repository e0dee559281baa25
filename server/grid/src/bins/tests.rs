//! Compares bins with a count of every reading, and shows what a bin makes of contradicting rays.

use std::collections::BTreeMap;

use proptest::prelude::*;
use tidemap_model::LocalDay;

use super::*;
use crate::{
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
    let mut counted = BTreeMap::new();
    for scans in bins.values() {
        let sum: i128 = scans.iter().map(|(time, _)| i128::from(time.utc_nanos)).sum();
        let mean = i64::try_from(sum.div_euclid(scans.len() as i128)).expect("near");
        let mut odds: BTreeMap<(TileId, u16), f64> = BTreeMap::new();
        for (time, tiles) in scans {
            for (&tile, masks) in tiles {
                counted.entry((mean, tile)).or_insert_with(TileMasks::default);
                let RayOdds { hit, miss } = sensors.odds(time.sensor);
                for cell in masks.observed().cells() {
                    let is_hit = masks.occupied().contains(cell);
                    *odds.entry((tile, cell)).or_default() += if is_hit { hit as f64 } else { miss as f64 };
                }
            }
        }
        for ((tile, cell), odds) in odds {
            let masks = counted.get_mut(&(mean, tile)).expect("seen");
            let (observed, occupied) = (masks.observed() | Mask::of(cell), masks.occupied());
            *masks = TileMasks::clipped(observed, if odds > 0.0 { occupied | Mask::of(cell) } else { occupied });
        }
    }
    counted
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
            ((0..3 * HOUR, 0..3_u8, any::<bool>()), prop::collection::btree_map(0..3_u32, masks(), 1..3)),
            1..40,
        ),
        is_in_order in any::<bool>(),
    ) {
        let mut sensors = Sensors::new(SensorNoise { hit: 0.9, false_alarm: 0.2, prior: 0.3 });
        sensors.add(Some(ProducerSensor { hit: 0.6, false_alarm: 0.3 })).expect("a sensor");
        sensors.add(Some(ProducerSensor { hit: 1.0, false_alarm: 0.0 })).expect("a sensor");
        let mut scans: Scans = scans
            .into_iter()
            .map(|((utc_nanos, sensor, is_summer), tiles)| {
                let offset_secs = if is_summer { 3600 } else { 0 };
                let time = ScanTime { utc_nanos, offset_secs, sensor: SensorId(sensor) };
                (time, tiles.into_iter().map(|(tile, masks)| (TileId(tile), masks)).collect())
            })
            .collect();
        if is_in_order {
            scans.sort_by_key(|(time, _)| time.utc_nanos);
        }
        let binned = bins_of(&day_of(&scans), &sensors);
        prop_assert!(binned.scans.is_sorted_by_key(|time| time.utc_nanos));
        prop_assert!(binned.scans.iter().all(|time| time.sensor == SensorId::OWN));
        prop_assert_eq!(shown(&binned), counted(&scans, &sensors));
        scans.reverse();
        prop_assert_eq!(shown(&bins_of(&day_of(&scans), &sensors)), shown(&binned));
    }
}

/// Whether a cell that reads so often as occupied, then so often as free, is occupied in its bin.
fn is_occupied(hits: i64, misses: i64, noise: SensorNoise) -> bool {
    let reading = |scan: i64| {
        let time = ScanTime { utc_nanos: scan * SECOND, offset_secs: 0, sensor: SensorId::OWN };
        let occupied = if scan < hits { Mask::of(7) } else { Mask::EMPTY };
        (time, BTreeMap::from([(TileId(0), TileMasks::clipped(Mask::of(7), occupied))]))
    };
    let scans = (0..hits + misses).map(reading).collect();
    let binned = bins_of(&day_of(&scans), &Sensors::new(noise));
    assert_eq!(binned.scans.len(), 1);
    binned.tile(TileId(0)).expect("seen").first.occupied().contains(7)
}

#[test]
fn a_wall_that_many_rays_pass_stays_a_wall() {
    // OctoMap: a hit counts as .7, a miss as .4, so that two misses for each hit leave the cell occupied.
    let own = SensorNoise::default();
    assert!(is_occupied(300, 600, own) && is_occupied(1, 0, own) && is_occupied(1, 2, own));
    assert!(!is_occupied(1, 3, own) && !is_occupied(0, 1, own) && !is_occupied(300, 700, own));
    // A sensor that is stated to err alike both ways decides by the majority.
    let even = SensorNoise { hit: 0.9, false_alarm: 0.1, prior: 0.5 };
    assert!(is_occupied(2, 1, even) && !is_occupied(1, 2, even) && !is_occupied(1, 1, even));
}
