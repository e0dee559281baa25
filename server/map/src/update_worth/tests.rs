//! Tests the extract of pending observations, and that the worth of a map is the sum of the worths of its states.

use std::sync::{Arc, atomic::AtomicU64};

use tidemap_model::{Hold, Periodicities, Reporting, StateKind, StateModel};

use super::*;
use crate::{
    event::{Envelope, Event, NewState, Observations, OffsetRun, SequenceSpan, UpdateCause},
    ids::ProducerId,
    live_map::LiveMap,
    name::{MapName, ProducerKey, StateName},
    spec::MapSpec,
};

const HOUR: i64 = 3_600_000_000_000;
const NOW: i64 = 1000 * HOUR;

/// Doors `s0`, `s1`, …; those of `reporting` other than samples report rows.
fn map_of(reporting: &[Reporting]) -> LiveMap {
    let spec = MapSpec {
        periodicities: Periodicities::harmonics(24 * HOUR, 12).expect("valid"),
        ..MapSpec::new(MapName::new("office").expect("valid"))
    };
    let mut map = LiveMap::new(Arc::new(spec));
    for (id, &reporting) in (0..).zip(reporting) {
        let name = StateName::new(&format!("s{id}")).expect("valid");
        let new = NewState { reporting, ..NewState::sampled(StateId(id), name, StateKind::Probability) };
        map.apply(map.position() + 1, &Event::AddState(new)).expect("consistent");
    }
    map
}

fn observe(map: &mut LiveMap, rows: &[(u32, i64, f64)]) {
    let key = ProducerKey::new("robot", "").expect("valid");
    let known = map.producer(&key).map(|(_, mark)| mark.durable_sequence);
    let count = rows.len() as u64;
    let first = known.unwrap_or(0) + 1;
    let envelope = Envelope {
        producer: ProducerId(0),
        new_producer: known.is_none().then_some(key.into()),
        incarnation: 1,
        span: SequenceSpan { first, last: first + count - 1, content_crc: 7 },
        received_nanos: NOW,
        refused: Vec::new(),
    };
    let observations = Observations {
        new_states: Vec::new(),
        states: rows.iter().map(|(state, ..)| StateId(*state)).collect(),
        times_nanos: rows.iter().map(|(_, time, _)| *time).collect(),
        values: rows.iter().map(|(.., value)| *value).collect(),
        offsets: vec![OffsetRun { count: u32::try_from(count).expect("few"), offset_secs: 0 }],
        failures: Vec::new(),
        runs: Vec::new(),
    };
    map.apply(map.position() + 1, &Event::Observations(envelope, observations)).expect("consistent");
}

fn update(map: &mut LiveMap) {
    let start = map.plan_update(None, NOW, UpdateCause::Request);
    let work = map.apply(map.position() + 1, &Event::UpdateStart(start)).expect("consistent").expect("an update");
    map.finish_update(work.run(&AtomicU64::new(0)).expect("in memory"));
}

#[test]
fn the_worth_of_a_map_is_the_sum_over_its_states() {
    let mut map = map_of(&[Reporting::Samples, Reporting::Samples]);
    for day in 0..20 {
        let rows: Vec<_> = (24 * day..24 * day + 24).flat_map(|hour| [0, 1].map(|door| row_of(door, hour))).collect();
        observe(&mut map, &rows);
        update(&mut map);
    }
    // One door keeps its hours; the other is now shut by day.
    let pending: Vec<_> = (480..504).flat_map(|hour| [row_of(0, hour), inverted(row_of(1, hour))]).collect();
    observe(&mut map, &pending);
    let view = map.publish();
    let extract = map.pending_extract(10, 100);
    assert_eq!(
        extract.iter().map(|(state, readings)| (state.0, readings.len())).collect::<Vec<_>>(),
        [(0, 24), (1, 24)]
    );
    let worth_of = |state: u32| {
        let samples: Vec<Sample> = extract[state as usize]
            .1
            .iter()
            .map(|&(utc_nanos, value)| Sample { utc_nanos, offset_secs: 0, value })
            .collect();
        let model: &StateModel = view.model(StateId(state));
        UpdateWorth::of_state(model, &view.spec().periodicities, &samples).expect("errors have a unit")
    };
    let mut sum = worth_of(0);
    sum.add(&worth_of(1));
    assert_eq!(view.update_worth(extract.clone(), 100), sum);
    assert!(worth_of(0).gain() < 0.1 && worth_of(1).gain() > 0.5, "{:?} {:?}", worth_of(0), worth_of(1));
    update(&mut map);
    assert_eq!(map.publish().update_worth(map.pending_extract(10, 100), 100), UpdateWorth::default());
}

/// A door that is open from nine to five.
fn row_of(door: u32, hour: i64) -> (u32, i64, f64) {
    (door, hour * HOUR, f64::from(u8::from((9..17).contains(&(hour % 24)))))
}

fn inverted((door, nanos, value): (u32, i64, f64)) -> (u32, i64, f64) {
    (door, nanos, 1.0 - value)
}

#[test]
fn an_extract_is_of_the_fullest_states_and_spread_over_what_is_pending() {
    let mut map = map_of(&[Reporting::Samples; 4]);
    let counts = [3, 10, 0, 7];
    for (door, count) in (0..).zip(counts).filter(|(_, count)| *count > 0) {
        observe(&mut map, &(0..count).map(|hour| row_of(door, hour)).collect::<Vec<_>>());
    }
    let hours = |extract: Vec<(StateId, Vec<Reading>)>| -> Vec<(u32, Vec<i64>)> {
        let hours = |readings: Vec<Reading>| readings.iter().map(|(nanos, _)| nanos / HOUR).collect();
        extract.into_iter().map(|(state, readings)| (state.0, hours(readings))).collect()
    };
    assert_eq!(hours(map.pending_extract(2, 4)), [(1, vec![0, 3, 6, 9]), (3, vec![0, 2, 4, 6])]);
    assert_eq!(hours(map.pending_extract(1, 100)), [(1, (0..10).collect())]);
    assert_eq!(map.pending_extract(0, 4), []);
    assert!(map.pending_extract(4, 0).iter().all(|(_, readings)| readings.is_empty()));
}

#[test]
fn rows_of_changes_are_judged_as_the_readings_that_they_stand_for() {
    let hold = Hold::new(48 * 3600, 3600).expect("valid");
    let mut map = map_of(&[Reporting::Changes(hold)]);
    observe(&mut map, &[(0, 0, 0.0), (0, 9 * HOUR, 1.0), (0, 17 * HOUR, 0.0)]);
    let worth = map.publish().update_worth(map.pending_extract(10, 100), 100);
    // There are observations every hour from 0 to 17, and nothing is learned: the prior is 0.5.
    assert_eq!((worth.readings, worth.gain()), (18, 0.25));
    assert_eq!(map.publish().update_worth(map.pending_extract(10, 100), 5).readings, 5);
}
