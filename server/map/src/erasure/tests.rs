//! The map after an erasure equals a map that never had the states.

use std::sync::atomic::AtomicU64;

use tidemap_model::{LocalDay, Periodicities};

use super::*;
use crate::{
    event::{Dimensions, OffsetRun, SequenceSpan, StateKind, StateSensor, StateShape, UpdateCause},
    ids::ProducerId,
    live_map::LiveMap,
    name::{MapName, ProducerKey, TaskName},
    site::Location,
    spec::MapSpec,
    task::{ALL_WEEKDAYS, KeptPlan, KeptStep, KeptWork, RobotTask, TaskDays, TaskEdit},
};

mod parts;

const HOUR: i64 = 3_600_000_000_000;

fn spec() -> Arc<MapSpec> {
    Arc::new(MapSpec {
        periodicities: Periodicities::harmonics(24 * HOUR, 6).expect("valid"),
        ..MapSpec::new(MapName::new("home").expect("valid"))
    })
}

fn named(name: &str) -> StateName {
    StateName::new(name).expect("valid")
}

/// States in order of their ids: a door, a position of two axes, a lamp, and one that appears later.
fn added() -> [NewState; 4] {
    let new = |id, name, shape| NewState::sampled(StateId(id), named(name), shape);
    let scalar = StateShape::Scalar(StateKind::Probability);
    [
        new(0, "door", scalar),
        new(1, "anna", StateShape::Vector(Dimensions::Two)),
        NewState { sensor: StateSensor::new(0.9, 0.05).ok(), ..new(3, "lamp", scalar) },
        new(4, "late", scalar),
    ]
}

/// An event with ten observations of every known state, at hours from `hour`.
fn observed(number: u64, hour: i64, new_states: Vec<NewState>, states: u32) -> Event {
    let samples: Vec<(StateId, i64, f64)> = (0..10)
        .flat_map(|step: i64| (0..states).map(move |state| (step, state)))
        .map(|(step, state)| {
            let at = hour + 3 * step;
            let value = if (at / 7 + i64::from(state)) % 2 == 0 { 1.0 } else { 0.0 };
            (StateId(state), at * HOUR + i64::from(state), value)
        })
        .collect();
    let key = ProducerKey::new("robot", "").expect("valid");
    let count = samples.len() as u64;
    Event::Observations(
        Envelope {
            producer: ProducerId(0),
            new_producer: (number == 0).then(|| key.into()),
            incarnation: 1,
            span: SequenceSpan { first: number * 1000 + 1, last: (number + 1) * 1000, content_crc: 7 },
            received_nanos: 10_000 * HOUR,
            refused: Vec::new(),
        },
        Observations {
            new_states,
            states: samples.iter().map(|sample| sample.0).collect(),
            times_nanos: samples.iter().map(|sample| sample.1).collect(),
            values: samples.iter().map(|sample| sample.2).collect(),
            offsets: vec![OffsetRun { count: u32::try_from(count).expect("few"), offset_secs: 3600 }],
            failures: Vec::new(),
            runs: Vec::new(),
        },
    )
}

fn update(map: &mut LiveMap, hour: i64) -> (Event, MapSnapshot) {
    let start = map.plan_update(Some(hour * HOUR), 10_000 * HOUR, UpdateCause::Request);
    let event = Event::UpdateStart(start);
    let work = map.apply(map.position() + 1, &event).expect("consistent").expect("work");
    (event, map.finish_update(work.run(&AtomicU64::new(0)).expect("in memory")))
}

/// A task whose value a state multiplies.
fn valued(kind: &str, state: &str) -> RobotTask {
    RobotTask {
        name: TaskName::new(kind, "hall").expect("valid"),
        from_secs: 0,
        until_secs: 3600,
        duration_secs: 60,
        days: TaskDays::Weekly(ALL_WEEKDAYS),
        every_secs: None,
        value: 1.0,
        value_state: Some(StateName::stored_or_label(state).expect("valid")),
    }
}

/// A plan that explores places, one a minute.
fn kept_plan(places: &[&str]) -> KeptPlan {
    let step = |(minute, place): (i64, &&str)| KeptStep {
        departure_nanos: minute * 60_000_000_000,
        start_nanos: minute * 60_000_000_000,
        end_nanos: (minute + 1) * 60_000_000_000,
        work: KeptWork::Explore { place: (*place).to_owned(), information_bits: 1.0 },
    };
    KeptPlan { day: LocalDay(0), made_nanos: 0, steps: (0..).zip(places).map(step).collect() }
}

/// The events, with the snapshot after the first update.
fn story() -> (Vec<Event>, MapSnapshot, Vec<HistoryPiece>) {
    let [door, anna, lamp, late] = added();
    let mut map = LiveMap::new(spec());
    let mut events = Vec::new();
    let mut pieces = Vec::new();
    let mut snapshot = None;
    let location =
        |states: &[u32]| Location { states: states.iter().copied().map(StateId).collect(), ..Location::default() };
    let first = vec![
        observed(0, 0, vec![door, anna, lamp], 4),
        Event::EditSite(SiteEdit::SetLocation(named("hall"), location(&[0, 1]))),
        Event::EditSite(SiteEdit::SetLocation(named("bed"), location(&[1, 2]))),
        Event::EditSite(SiteEdit::Task(TaskEdit::Set(valued("greet", "anna/x")))),
        Event::EditSite(SiteEdit::Task(TaskEdit::KeepPlan(kept_plan(&["hall", "anna"])))),
    ];
    let second = vec![
        Event::AddState(late),
        Event::EditSite(SiteEdit::Charger(Some([1.0, 2.0]))),
        Event::EditSite(SiteEdit::RemoveLocation(named("bed"))),
        Event::EditSite(SiteEdit::SetLocation(named("bath"), location(&[2]))),
        Event::EditSite(SiteEdit::SetLocation(named("hall"), location(&[1]))),
        Event::EditSite(SiteEdit::Task(TaskEdit::Set(valued("wake", "anna/y")))),
        Event::EditSite(SiteEdit::Task(TaskEdit::Set(valued("light", "lamp")))),
        Event::EditSite(SiteEdit::Task(TaskEdit::KeepPlan(kept_plan(&["anna", "tour"])))),
        observed(1, 20, Vec::new(), 5),
    ];
    for (batch, until) in [(first, 24), (second, 30)] {
        for event in batch {
            map.apply(map.position() + 1, &event).expect("consistent");
            events.push(event);
        }
        let (start, published) = update(&mut map, until);
        events.push(start);
        pieces.extend(published.history.iter().map(|piece| HistoryPiece::clone(piece)));
        snapshot = snapshot.or(Some(published));
    }
    (events, snapshot.expect("an update"), pieces)
}

/// A map that is restored and replayed, with what its last update published.
fn replayed(snapshot: &MapSnapshot, events: &[Event]) -> (LiveMap, MapSnapshot) {
    let mut map = LiveMap::restore(spec(), snapshot.clone());
    let mut published = snapshot.clone();
    for (position, event) in (1..).zip(events) {
        if position <= snapshot.position {
            map.recover_pending(position, event).expect("consistent");
        } else if let Some(work) = map.apply(position, event).expect("consistent") {
            published = map.finish_update(work.run(&AtomicU64::new(0)).expect("in memory"));
        }
    }
    (map, published)
}

#[test]
fn what_is_left_is_the_map_that_never_had_the_states() {
    let (events, snapshot, pieces) = story();
    for erased in [vec![0], vec![1, 2], vec![3], vec![4], vec![0, 3, 4]] {
        let erased: Vec<StateId> = erased.into_iter().map(StateId).collect();
        let mut erasure = StateErasure::new(erased.clone());
        let after = erasure.snapshot(MapSnapshot { history: Vec::new(), ..snapshot.clone() });
        let left: Vec<Event> =
            (1..).zip(&events).map(|(position, event)| erasure.event(position, event.clone())).collect();
        // The map that never had the states: all events are applied again without them.
        let mut never = StateErasure::new(erased.clone());
        let remaining: Vec<Event> =
            (1..).zip(&events).map(|(position, event)| never.event(position, event.clone())).collect();
        let mut map = LiveMap::new(spec());
        let (mut known, mut published) = (None, None);
        for event in &remaining {
            if let Some(work) = map.apply(map.position() + 1, event).expect("consistent") {
                let of_update = map.finish_update(work.run(&AtomicU64::new(0)).expect("in memory"));
                known = known.or(Some(of_update.clone()));
                published = Some(of_update);
            }
        }
        let known = known.expect("an update");
        assert_eq!(MapSnapshot { history: Vec::new(), ..known.clone() }, after, "{erased:?}");
        let (restored, again) = replayed(&after, &left);
        assert_eq!(Some(&again), published.as_ref(), "{erased:?}");
        assert_eq!((restored.pending(), restored.states()), (map.pending(), map.states()), "{erased:?}");
        let pieces: Vec<HistoryPiece> = pieces.iter().filter_map(|piece| erasure.piece(piece)).collect();
        let of_updates = known.history.iter().chain(&again.history).map(|piece| HistoryPiece::clone(piece));
        assert_eq!(pieces, of_updates.collect::<Vec<_>>(), "{erased:?}");
    }
}

#[test]
fn nothing_of_an_erased_state_is_left_in_the_events() {
    let (events, snapshot, _) = story();
    let mut erasure = StateErasure::new(vec![StateId(1), StateId(2)]);
    let after = erasure.snapshot(snapshot);
    let left: Vec<Event> = (1..).zip(events).map(|(position, event)| erasure.event(position, event)).collect();
    let text = format!("{left:?} {after:?}");
    assert!(!text.contains("anna") && text.contains("door") && text.contains("lamp"), "{text}");
    let bed =
        |event: &Event| matches!(event, Event::EditSite(SiteEdit::SetLocation(name, _)) if name.as_str() == "bed");
    assert!(!left.iter().any(bed));
    assert_eq!(after.site.locations().keys().map(StateName::as_str).collect::<Vec<_>>(), ["hall"]);
    let plan = after.site.tasks().plan(LocalDay(0)).expect("kept");
    assert_eq!(plan.steps.len(), 1, "{plan:?}");
    // The producer continues at its old sequence number.
    assert_eq!(after.producers[0].durable_sequence, 1000);
}

#[test]
fn a_task_that_names_a_state_before_there_is_one_does_not_keep_its_name() {
    let [_, anna, ..] = added();
    let events = [
        Event::EditSite(SiteEdit::Task(TaskEdit::Set(valued("greet", "anna/x")))),
        Event::AddState(NewState { id: StateId(0), ..anna }),
    ];
    let mut erasure = StateErasure::new(vec![StateId(0), StateId(1)]);
    events.iter().for_each(|event| erasure.note(event));
    let left: Vec<Event> = (1..).zip(events).map(|(position, event)| erasure.event(position, event)).collect();
    assert!(!format!("{left:?}").contains("anna"), "{left:?}");
    assert!(format!("{left:?}").contains("greet"), "the task stays: {left:?}");
}
