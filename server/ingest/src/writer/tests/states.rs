//! Tests states that are added before their first observation, and the effect of a state's kind on its observations.

use tidemap_map::{
    event::{Dimensions, Position, SequenceSpan, StateKind, StateSensor, StateShape},
    ids::StateId,
};

use tidemap_proto::convert::vectors::DeclaredState;

use super::*;
use crate::protocol::{AddState, AddStateError, NewName, NoRoom};

async fn add(handle: &MapHandle, name: &str, kind: StateKind) -> Result<(), AddStateError> {
    let (reply, answer) = oneshot::channel();
    let name = StateName::new(name).expect("valid");
    assert!(handle.send(Command::AddState(AddState {
        state: DeclaredState { name, shape: kind.into(), labels: Vec::new(), sensor: None, reporting: None },
        client: String::new(),
        reply
    })));
    answer.await.expect("an answer")
}

/// Adds a state with a sensor of this hit; `None`: not stated.
async fn add_with(handle: &MapHandle, name: &str, hit: Option<f64>) -> Result<(), AddStateError> {
    let (reply, answer) = oneshot::channel();
    let name = StateName::new(name).expect("valid");
    let sensor = hit.map(|hit| StateSensor::new(hit, 0.05).expect("a sensor"));
    assert!(handle.send(Command::AddState(AddState {
        state: DeclaredState { name, shape: StateShape::default(), labels: Vec::new(), sensor, reporting: None },
        client: String::new(),
        reply
    })));
    answer.await.expect("an answer")
}

/// Sends these values of the stream's only state; returns the refusals.
async fn send(
    handle: &MapHandle,
    robot: &mut Robot,
    kind: Option<StateKind>,
    values: &[f64],
) -> Vec<(u64, RefusalReason)> {
    let permit = || Arc::new(Semaphore::new(1)).try_acquire_owned().expect("free");
    let name =
        NewName { name: StateName::new("s").expect("valid"), shape: kind.map(StateShape::from), reporting: None };
    let first_sequence = robot.sent + 1;
    robot.sent += values.len() as u64;
    let batch = ObservationBatch {
        span: SequenceSpan { first: first_sequence, last: robot.sent, content_crc: 1 },
        new_names: vec![Some(name)],
        table_indices: vec![0; values.len()],
        times_nanos: (0..values.len() as i64).map(|i| NOON + i).collect(),
        values: values.to_vec(),
        ..ObservationBatch::default()
    };
    let budget = vec![permit(), permit()];
    assert!(
        handle
            .send(Command::StreamData { session: robot.opened.session, data: StreamData::Observations(batch, budget) })
    );
    match robot.events.recv().await {
        Some(SessionEvent::Ack { durable_sequence, refused }) if durable_sequence == robot.sent => {
            refused.into_iter().map(|refused| (refused.sequence, refused.reason)).collect()
        }
        other => panic!("{other:?}"),
    }
}

#[tokio::test]
async fn a_state_that_was_added_is_shown_and_survives_a_restart() {
    let dir = tempfile::tempdir().expect("temporary folder");
    {
        let bench = bench(dir.path(), NOON);
        let handle = create(&bench).await;
        // Two requests for the same state at once.
        let (one, two) =
            tokio::join!(add(&handle, "speed", StateKind::Continuous), add(&handle, "speed", StateKind::Continuous));
        assert_eq!((one, two), (Ok(()), Ok(())));
        let view = handle.view();
        assert_eq!(view.find("speed").map(|id| view.kind(id)), Some(StateKind::Continuous));
        let again = add(&handle, "speed", StateKind::Count).await;
        assert!(
            matches!(again, Err(AddStateError::OtherKind { found: StateShape::Scalar(StateKind::Continuous), .. })),
            "{again:?}"
        );
        for i in 1..10 {
            assert_eq!(add(&handle, &format!("s{i}"), StateKind::Count).await, Ok(()));
        }
        assert_eq!(add(&handle, "s10", StateKind::Count).await, Err(AddStateError::NoRoom(NoRoom::States { max: 10 })));
        assert_eq!(add(&handle, "s9", StateKind::Count).await, Ok(()), "it is there");
        bench.catalog.stop().await;
        bench.catalog.context().store.close();
    }
    let view = bench(dir.path(), NOON).catalog.get("office").expect("there").view();
    let kinds: Vec<StateKind> = view.infos().map(|info| info.kind).collect();
    assert_eq!(kinds[..2], [StateKind::Continuous, StateKind::Count]);
    assert_eq!(view.len(), 10);
}

#[tokio::test]
async fn the_sensor_of_a_state_never_changes() {
    let dir = tempfile::tempdir().expect("temporary folder");
    {
        let bench = bench(dir.path(), NOON);
        let handle = create(&bench).await;
        // Three requests for the same state at once.
        let answers = tokio::join!(
            add_with(&handle, "door", Some(0.9)),
            add_with(&handle, "door", Some(0.8)),
            add_with(&handle, "door", Some(0.9)),
        );
        assert!(matches!(answers, (Ok(()), Err(AddStateError::OtherSensor { .. }), Ok(()))), "{answers:?}");
        assert_eq!(add_with(&handle, "door", None).await, Ok(()), "it has the sensor that it has");
        let other = add_with(&handle, "door", Some(0.7)).await;
        assert!(matches!(other, Err(AddStateError::OtherSensor { found: Some(_), .. })), "{other:?}");
        assert_eq!(add_with(&handle, "gate", None).await, Ok(()));
        let late = add_with(&handle, "gate", Some(0.9)).await;
        assert!(matches!(late, Err(AddStateError::OtherSensor { found: None, .. })), "{late:?}");
        bench.catalog.stop().await;
        bench.catalog.context().store.close();
    }
    let view = bench(dir.path(), NOON).catalog.get("office").expect("there").view();
    let hits: Vec<Option<f64>> = view.infos().map(|info| info.sensor.map(StateSensor::hit)).collect();
    assert_eq!(hits, [Some(0.9), None]);
}

#[tokio::test]
async fn observations_have_to_fit_the_kind_of_their_state() {
    let dir = tempfile::tempdir().expect("temporary folder");
    let bench = bench(dir.path(), NOON);
    let handle = create(&bench).await;
    assert_eq!(add(&handle, "s", StateKind::Count).await, Ok(()));
    let mut silent = hello(&handle, "silent", 0, false).await.expect("accepted");
    let refused = send(&handle, &mut silent, None, &[2.5, 7.0, -1.0, 0.5, 0.0]).await;
    let value = RefusalReason::Value;
    assert_eq!(refused, [(1, value), (3, value), (4, value)]);
    let mut right = hello(&handle, "right", 0, false).await.expect("accepted");
    assert_eq!(send(&handle, &mut right, Some(StateKind::Count), &[3.0]).await, []);
    let mut wrong = hello(&handle, "wrong", 0, false).await.expect("accepted");
    let kind = RefusalReason::StateKind;
    assert_eq!(send(&handle, &mut wrong, Some(StateKind::Probability), &[1.0, 0.0]).await, [(1, kind), (2, kind)]);
    let view = handle.view();
    assert_eq!((view.len(), view.observations()), (1, 3));
}

#[tokio::test]
async fn a_value_that_no_such_state_may_have_makes_none() {
    let dir = tempfile::tempdir().expect("temporary folder");
    let bench = bench(dir.path(), NOON);
    let handle = create(&bench).await;
    let mut robot = hello(&handle, "r", 0, false).await.expect("accepted");
    assert_eq!(send(&handle, &mut robot, None, &[1.5]).await, [(1, RefusalReason::Value)]);
    assert_eq!(handle.view().len(), 0);
    assert_eq!(send(&handle, &mut robot, None, &[0.5]).await, []);
    let view = handle.view();
    assert_eq!((view.len(), view.kind(view.find("s").expect("it is new"))), (1, StateKind::Probability));
}

#[tokio::test]
async fn a_position_is_one_observation_of_one_record_and_of_all_its_axes() {
    let dir = tempfile::tempdir().expect("temporary folder");
    let bench = bench(dir.path(), NOON);
    let handle = create(&bench).await;
    let mut robot = hello(&handle, "r", 0, false).await.expect("accepted");
    let permit = || Arc::new(Semaphore::new(1)).try_acquire_owned().expect("free");
    let vector = |name: &str, dimensions| {
        Some(NewName {
            name: StateName::new(name).expect("valid"),
            shape: Some(StateShape::Vector(dimensions)),
            reporting: None,
        })
    };
    let position = |coordinates: &[f64]| Position::of(coordinates).expect("2 or 3");
    // The last one needs three states, and the limit is ten.
    let mut names = vec![vector("anna", Dimensions::Two), Some(StateName::new("door").expect("valid").into())];
    names.extend(["a", "b", "c"].map(|name| vector(name, Dimensions::Three)));
    let batch = ObservationBatch {
        span: SequenceSpan { first: 1, last: 7, content_crc: 0 },
        new_names: names,
        table_indices: vec![0, 1, 0, 2, 3, 4, 1],
        times_nanos: (0..7).map(|i| NOON - 10 + i).collect(),
        values: vec![0.0, 1.0, 0.0, 0.0, 0.0, 0.0, 0.5],
        positions: vec![
            (0, position(&[1.0, 2.0])),
            (2, position(&[3.0, 4.0])),
            (3, position(&[5.0, 6.0, 7.0])),
            (4, position(&[8.0; 3])),
            (5, position(&[9.0; 3])),
        ],
        ..ObservationBatch::default()
    };
    let before = handle.view().position();
    let budget = vec![permit(), permit()];
    assert!(
        handle
            .send(Command::StreamData { session: robot.opened.session, data: StreamData::Observations(batch, budget) })
    );
    let refused = match robot.events.recv().await {
        Some(SessionEvent::Ack { durable_sequence: 7, refused }) => refused,
        other => panic!("{other:?}"),
    };
    let refused: Vec<_> = refused.iter().map(|refused| (refused.sequence, refused.reason)).collect();
    assert_eq!(refused, [(6, RefusalReason::StateLimit)]);
    let view = handle.view();
    assert_eq!(view.position(), before + 1, "one record: after a torn tail there is all of it, or nothing");
    let latest = |name: &str| view.find(name).and_then(|id| view.live(id).persistence.last());
    let names = ["anna/x", "anna/y", "door", "a/x", "a/y", "a/z", "b/z"];
    let values = names.map(|name| latest(name).map(|(_, value)| value));
    assert_eq!(values, [3.0, 4.0, 0.5, 5.0, 6.0, 7.0, 8.0].map(Some));
    assert_eq!(latest("anna/x").map(|(nanos, _)| nanos), latest("anna/y").map(|(nanos, _)| nanos));
    assert_eq!((view.len(), view.find("c/x")), (9, None));
    assert_eq!(view.shape("a"), Some((StateId(3), StateShape::Vector(Dimensions::Three))));
}
