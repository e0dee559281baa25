//! Tests scans that wait, and sensors, in a map that takes scans.

use std::sync::Arc;

use tidemap_grid::{
    index::{TileId, TileIndex},
    scan::{CellRef, LoggedScan, ScanSource, Scans},
    sensors::ProducerSensor,
    spec::SensorNoise,
};

use super::world::spec;
use crate::{
    event::{Envelope, Event, SequenceSpan, UpdateCause},
    ids::{NewProducer, ProducerId},
    live_map::LiveMap,
    name::ProducerKey,
};

fn scans(new_tiles: &[i32], scans: Vec<LoggedScan>) -> Scans {
    Scans { new_tiles: new_tiles.iter().map(|&x| TileIndex { x, y: 0, z: 0 }).collect(), scans, ..Scans::default() }
}

/// The first event of a producer.
fn envelope() -> Envelope {
    Envelope {
        producer: ProducerId(0),
        new_producer: Some(ProducerKey::new("robot", "").expect("valid").into()),
        incarnation: 1,
        span: SequenceSpan { first: 1, last: 9, content_crc: 0 },
        received_nanos: 1000,
        refused: Vec::new(),
    }
}

fn scan(seen: &[u32], observed: &[u32]) -> LoggedScan {
    LoggedScan {
        utc_nanos: 500,
        offset_secs: 0,
        source: ScanSource::Cells,
        seen: Some(seen.iter().map(|&tile| TileId(tile)).collect()),
        observed_flips: observed.iter().map(|&cell| CellRef(cell)).collect(),
        occupied_flips: Vec::new(),
    }
}

#[test]
fn a_restored_map_still_waits_to_fold_in_its_pending_scans() {
    let spec = Arc::new(spec(&mut 1));
    let mut map = LiveMap::new(Arc::clone(&spec));
    map.apply(1, &Event::Scans(envelope(), scans(&[0], vec![scan(&[0], &[7])]))).expect("consistent");
    let start = map.plan_update(Some(400), 1000, UpdateCause::Midnight);
    let work = map.apply(2, &Event::UpdateStart(start)).expect("consistent").expect("an update");
    let snapshot = map.finish_update(work.run(&std::sync::atomic::AtomicU64::new(0)).expect("in memory"));
    let restored = LiveMap::restore(spec, snapshot);
    assert_eq!(map.pending(), restored.pending());
    assert!(restored.pending() > 0);
    assert_eq!(restored.pending_since_nanos(), Some(500));
    assert!(restored.pending_received_nanos().is_some());
    assert_eq!(restored.pending_received_nanos(), map.pending_received_nanos());
}

#[test]
fn tiles_of_scans_that_wait_are_counted_until_their_time_has_come() {
    let spec = Arc::new(spec(&mut 1));
    let mut map = LiveMap::new(Arc::clone(&spec));
    let future = |minutes: i64| 1000 + minutes * 60_000_000_000;
    let (one, other) = (
        LoggedScan { utc_nanos: future(10), ..scan(&[0, 1], &[7]) },
        LoggedScan { utc_nanos: future(20), ..scan(&[1], &[]) },
    );
    map.apply(1, &Event::Scans(envelope(), scans(&[0, 4], vec![one, other]))).expect("consistent");
    assert_eq!(map.grid().expect("a grid").future_tiles(), 3);
    let update = |map: &mut LiveMap, position: u64, now: i64| {
        let start = map.plan_update(None, now, UpdateCause::Request);
        let work = map.apply(position, &Event::UpdateStart(start)).expect("consistent").expect("an update");
        map.finish_update(work.run(&std::sync::atomic::AtomicU64::new(0)).expect("in memory"))
    };
    let mut restored = LiveMap::restore(Arc::clone(&spec), update(&mut map, 2, 1000));
    assert_eq!((restored.pending(), restored.future()), (0, 2));
    assert!(restored.pending_received_nanos().is_some(), "makes an update due");
    assert_eq!(restored.pending_received_nanos(), map.pending_received_nanos());
    update(&mut restored, 3, future(10));
    assert_eq!(restored.grid().expect("a grid").future_tiles(), 1);
    update(&mut restored, 4, future(20));
    assert_eq!(restored.grid().expect("a grid").future_tiles(), 0);
}

#[test]
fn a_scan_of_another_sensor_changes_what_the_cells_before_it_count_as() {
    let spec = Arc::new(spec(&mut 1));
    let noise = spec.grid.as_ref().expect("a grid").sensor;
    let mut map = LiveMap::new(Arc::clone(&spec));
    let other = ProducerSensor { hit: 0.6, false_alarm: 0.3 };
    let levels = [noise.levels(), SensorNoise { hit: other.hit, false_alarm: other.false_alarm, ..noise }.levels()];
    let mut expected = tidemap_model::Persistence::default();
    // Both see the same cells with the same values, two scans each in turn.
    for (position, utc_nanos) in (1_u64..).zip((100_000_000_000..).step_by(7_000_000_000)).take(6) {
        let producer = u32::try_from(position % 2).expect("0 or 1");
        let (turn, is_first) = (position.div_ceil(2), position <= 2);
        let scan = |utc_nanos, seen: bool, observed: &[u32]| LoggedScan {
            utc_nanos,
            seen: seen.then(|| Arc::from([TileId(0)])),
            ..scan(&[], observed)
        };
        let observed: &[u32] = if position == 1 { &[7, 8] } else { &[] };
        let times = [utc_nanos, utc_nanos + 3_000_000_000];
        let key = ProducerKey::new(&format!("robot{producer}"), "").expect("valid");
        let envelope = Envelope {
            producer: ProducerId(1 - producer),
            new_producer: is_first.then_some(NewProducer {
                key,
                sensor: (producer == 0).then_some(other),
                introduced_by: String::new(),
            }),
            span: SequenceSpan { first: turn * 2 - 1, last: turn * 2, content_crc: 0 },
            received_nanos: times[1],
            ..envelope()
        };
        let scans = scans(
            if position == 1 { &[0] } else { &[] },
            vec![scan(times[0], position == 1, observed), scan(times[1], false, &[])],
        );
        map.apply(position, &Event::Scans(envelope, scans)).expect("consistent");
        for time in times {
            expected.observe(time, levels[usize::from(producer == 0)].0);
        }
        let view = map.publish();
        let cell = TileIndex { x: 0, y: 0, z: 0 }.cell(8);
        let found = view.grid().expect("a grid").describe(cell).expect("in memory").expect("observed").persistence;
        let (found, expected) = (found.to_parts(), expected.to_parts());
        assert_eq!((found.pairs, found.last), (expected.pairs, expected.last), "{position}");
        assert!((found.change_rate_sum - expected.change_rate_sum).abs() < 1e-12, "{found:?} {expected:?}");
        assert_eq!(found.change_rate_sum > 0.0, position > 1);
    }
}

#[test]
fn a_producer_that_cannot_have_its_sensor_is_refused() {
    let mut map = LiveMap::new(Arc::new(spec(&mut 1)));
    let sensor = Some(ProducerSensor { hit: 0.2, false_alarm: 0.3 });
    let key = ProducerKey::new("robot", "").expect("valid");
    let envelope =
        Envelope { new_producer: Some(NewProducer { key, sensor, introduced_by: String::new() }), ..envelope() };
    let refused = map.apply(1, &Event::Scans(envelope, Scans::default())).expect_err("refused");
    assert!(refused.reason.contains("hit 0.2, false alarm 0.3"), "{refused}");
    assert_eq!((map.producers(), map.grid().map(|grid| grid.sensors().others())), (0, Some(0)));
}
