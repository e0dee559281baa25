//! Tests the effect of events on a map, and that a restored map equals the original.

use std::sync::atomic::AtomicU64;

use proptest::prelude::*;
use tidemap_model::{Periodicities, selector::ModelSelector, time::FUTURE_MAX_NANOS};

use super::*;
use crate::{
    event::{Envelope, NewState, Observations, OffsetRun, Reporting, SequenceSpan, StateKind, UpdateCause},
    name::{MapName, StateName},
};

mod grid;
mod kinds;
mod rename;
mod rows;
mod training;
mod vectors;

const HOUR: i64 = 3_600_000_000_000;
const NOW: i64 = 1000 * HOUR;

fn spec() -> Arc<MapSpec> {
    Arc::new(MapSpec {
        periodicities: Periodicities::harmonics(24 * HOUR, 12).expect("valid"),
        ..MapSpec::new(MapName::new("office").expect("valid"))
    })
}

/// An event of one producer with these (state, time, value); states up to `states` are known before.
fn event(map: &LiveMap, observations: &[(u32, i64, f64)]) -> Event {
    let key = ProducerKey::new("robot", "").expect("valid");
    let known = map.producer(&key).map(|(_, mark)| mark.durable_sequence);
    let state_count = observations.iter().map(|(state, ..)| *state as usize + 1).max().unwrap_or(0);
    let new_states = (map.states()..state_count)
        .map(|id| {
            NewState::sampled(
                StateId(u32::try_from(id).expect("few")),
                StateName::new(&format!("s{id}")).expect("valid"),
                StateKind::Probability,
            )
        })
        .collect();
    let first_sequence = known.unwrap_or(0) + 1;
    Event::Observations(
        Envelope {
            producer: ProducerId(0),
            new_producer: known.is_none().then_some(key.into()),
            incarnation: 1,
            span: SequenceSpan {
                first: first_sequence,
                last: first_sequence + observations.len() as u64 - 1,
                content_crc: 7,
            },
            received_nanos: NOW,
            refused: Vec::new(),
        },
        Observations {
            new_states,
            states: observations.iter().map(|(state, ..)| StateId(*state)).collect(),
            times_nanos: observations.iter().map(|(_, time, _)| *time).collect(),
            values: observations.iter().map(|(.., value)| *value).collect(),
            offsets: vec![OffsetRun { count: u32::try_from(observations.len()).expect("few"), offset_secs: 0 }],
            failures: Vec::new(),
            runs: Vec::new(),
        },
    )
}

fn apply(map: &mut LiveMap, event: &Event) -> Option<UpdateWork> {
    map.apply(map.position() + 1, event).expect("consistent")
}

fn update(map: &mut LiveMap, until: Option<i64>) -> MapSnapshot {
    let start = map.plan_update(until, NOW, UpdateCause::Request);
    let work = apply(map, &Event::UpdateStart(start)).expect("an update");
    map.finish_update(work.run(&AtomicU64::new(0)).expect("in memory"))
}

/// The prediction without the newest readings.
fn predict(view: &MapView, state: u32, time: i64) -> f64 {
    let mut out = [0.0];
    view.predict_into(StateId(state), &view.prepare(&[time]), ModelSelector::default().long_term(), &mut out);
    out[0]
}

#[test]
fn last_values_change_at_once_and_models_at_the_update() {
    let mut map = LiveMap::new(spec());
    let first = event(&map, &[(0, HOUR, 1.0), (1, HOUR, 0.0), (0, 2 * HOUR, 1.0)]);
    apply(&mut map, &first);
    let before = map.publish();
    assert_eq!(before.live(StateId(0)).persistence.last(), Some((2 * HOUR, 1.0)));
    assert_eq!((before.len(), before.observations(), before.pending()), (2, 3, 3));
    assert_eq!(predict(&before, 0, 3 * HOUR), 0.5);
    assert_eq!(before.find("s1"), Some(StateId(1)));

    update(&mut map, None);
    let after = map.publish();
    assert_eq!((after.generation(), after.pending(), after.cut_nanos()), (1, 0, Some(2 * HOUR + 1)));
    // Two readings are not enough to be sure.
    assert!((0.7..0.95).contains(&predict(&after, 0, 3 * HOUR)));
    assert_eq!(predict(&before, 0, 3 * HOUR), 0.5, "a view never changes");
}

#[test]
fn an_update_takes_what_came_before_it_and_lies_before_its_cut() {
    let mut map = LiveMap::new(spec());
    let first = event(&map, &[(0, HOUR, 1.0), (0, 30 * HOUR, 1.0)]);
    apply(&mut map, &first);
    let start = map.plan_update(Some(24 * HOUR), NOW, UpdateCause::Midnight);
    let work = apply(&mut map, &Event::UpdateStart(start)).expect("an update");
    assert_eq!((work.states(), work.observations()), (1, 1));
    // Meanwhile more observations arrive, and count as pending.
    let late = event(&map, &[(0, 2 * HOUR, 0.0), (1, 31 * HOUR, 0.0)]);
    apply(&mut map, &late);
    assert_eq!(map.publish().pending(), 4);
    let again = Event::UpdateStart(map.plan_update(None, NOW, UpdateCause::Request));
    let position = map.position() + 1;
    assert!(map.apply(position, &again).is_err(), "one update at a time");
    map.finish_update(work.run(&AtomicU64::new(0)).expect("in memory"));
    let view = map.publish();
    assert_eq!(view.pending(), 3);
    assert_eq!(view.model(StateId(0)).accumulator().observations(), 1);
    update(&mut map, Some(HOUR));
    let view = map.publish();
    assert_eq!(view.cut_nanos(), Some(24 * HOUR), "a cut never goes back");
    assert_eq!(view.model(StateId(0)).accumulator().observations(), 2);
}

#[test]
fn observations_far_ahead_of_the_clock_wait() {
    let mut map = LiveMap::new(spec());
    let future = NOW + FUTURE_MAX_NANOS + 1;
    let sent = event(&map, &[(0, HOUR, 1.0), (0, future, 0.0)]);
    apply(&mut map, &sent);
    assert_eq!(map.publish().live(StateId(0)).persistence.last(), Some((HOUR, 1.0)));
    update(&mut map, None);
    update(&mut map, Some(i64::MAX));
    assert_eq!((map.pending(), map.future(), map.publish().pending()), (0, 1, 1));
    // The clock comes near the time of the observation: an update of all observations takes it, and it counts as the
    // last value.
    let start = map.plan_update(None, future, UpdateCause::Request);
    let work = apply(&mut map, &Event::UpdateStart(start)).expect("an update");
    assert_eq!(work.observations(), 1);
    map.finish_update(work.run(&AtomicU64::new(0)).expect("in memory"));
    assert_eq!(map.publish().live(StateId(0)).persistence.last(), Some((future, 0.0)));
    assert_eq!((map.future(), map.newest_nanos()), (0, future));
}

#[test]
fn events_that_do_not_follow_are_refused() {
    let mut map = LiveMap::new(spec());
    let good = event(&map, &[(0, HOUR, 1.0)]);
    assert!(map.apply(2, &good).is_err(), "a gap in the log");
    apply(&mut map, &good);
    assert!(map.apply(2, &good).is_err(), "a sequence twice, a producer twice");
    let Event::Observations(envelope, mut unknown) = event(&map, &[(0, HOUR, 1.0)]) else { panic!("observations") };
    unknown.states = vec![StateId(9)];
    assert!(map.apply(2, &Event::Observations(envelope, unknown)).is_err());
}

proptest! {
    /// A map that is restored from any of its snapshots and replays the log equals the map that went on.
    #[test]
    fn a_restored_map_is_the_same_map(
        batches in prop::collection::vec(
            (prop::collection::vec((0u32..6, prop_oneof![9 => 0i64..200, 1 => 1000i64..1010], 0u8..=4), 1..20), prop::option::of(prop_oneof![4 => 0i64..200, 1 => 990i64..1010])), 1..12),
    ) {
        let mut map = LiveMap::new(spec());
        let mut log = Vec::new();
        let mut snapshots = Vec::new();
        for (rows, until) in batches {
            let rows: Vec<_> =
                rows.iter().map(|&(state, hour, quarter)| (state, hour * HOUR, f64::from(quarter) / 4.0)).collect();
            let taken = event(&map, &rows);
            apply(&mut map, &taken);
            log.push(taken);
            if let Some(hour) = until {
                let start = map.plan_update(Some(hour * HOUR), NOW, UpdateCause::Request);
                let starting = Event::UpdateStart(start);
                let work = apply(&mut map, &starting).expect("an update");
                log.push(starting);
                snapshots.push(map.finish_update(work.run(&AtomicU64::new(0)).expect("in memory")));
            }
        }
        let expected = map.publish();
        for snapshot in snapshots {
            let (known, from) = (snapshot.position, snapshot.replay_from);
            prop_assert!(from <= known + 1);
            let mut restored = LiveMap::restore(spec(), snapshot);
            for (position, event) in (1..).zip(&log).filter(|(position, _)| *position >= from) {
                if position <= known {
                    restored.recover_pending(position, event).expect("consistent");
                } else if let Some(work) = restored.apply(position, event).expect("consistent") {
                    restored.finish_update(work.run(&AtomicU64::new(0)).expect("in memory"));
                }
            }
            let view = restored.publish();
            prop_assert_eq!(view.pending(), expected.pending());
            prop_assert_eq!(view.observations(), expected.observations());
            prop_assert_eq!((view.generation(), view.cut_nanos()), (expected.generation(), expected.cut_nanos()));
            for id in (0..6).map(StateId) {
                prop_assert_eq!(view.info(id), expected.info(id));
                prop_assert_eq!(view.live(id), expected.live(id));
                let (a, b) = (view.model(id), expected.model(id));
                prop_assert_eq!(a.accumulator().observations(), b.accumulator().observations());
                prop_assert_eq!(a.order(), b.order());
                for hour in 0..24 {
                    let (a, b) = (predict(&view, id.0, hour * HOUR), predict(&expected, id.0, hour * HOUR));
                    prop_assert!((a - b).abs() < 1e-9);
                }
            }
            prop_assert_eq!(restored.producer(&ProducerKey::new("robot", "").expect("valid")),
                map.producer(&ProducerKey::new("robot", "").expect("valid")));
        }
    }
}
