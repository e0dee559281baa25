//! Tests rows of changes that represent more readings than one update learns: several updates follow each other, as
//! parts of one job.

use tidemap_map::{
    event::{RowKind, StateShape, StatedReporting},
    ids::StateId,
};
use tidemap_proto::convert::vectors::DeclaredState;

use super::{training::copy, *};
use crate::{
    protocol::{AddState, AddStateError, NoRoom},
    update_turns::UpdateTurns,
};

const DAY: i64 = 24 * HOUR;

/// Adds a state that reports changes, and that is read every `step_secs` seconds.
async fn add(handle: &MapHandle, name: &str, step_secs: u32) -> Result<(), AddStateError> {
    let (reply, answer) = oneshot::channel();
    let name = StateName::new(name).expect("valid");
    let reporting = StatedReporting::new(RowKind::Changes, Some(7 * 86_400), Some(step_secs)).expect("a hold");
    let shape = StateShape::default();
    let state = DeclaredState { name, shape, labels: Vec::new(), sensor: None, reporting: Some(reporting) };
    assert!(handle.send(Command::AddState(AddState { state, client: String::new(), reply })));
    answer.await.expect("an answer")
}

#[tokio::test]
async fn an_update_that_leaves_rows_goes_on_until_all_are_learned() {
    let dir = tempfile::tempdir().expect("temporary folder");
    let bench = bench_with(dir.path(), NOON, |context| context.update_readings_max = 2 * 288);
    let handle = create(&bench).await;
    add(&handle, "s", 300).await.expect("added");
    let mut robot = hello(&handle, "r", 0, false).await.expect("accepted");
    for day in 0..7 {
        robot.observe(&handle, NOON - (8 - day) * DAY).await;
    }
    let job = bench.jobs.create(handle.spec.name.clone(), UpdateCause::Request, NOON);
    assert!(handle.send(Command::Update { until_nanos: None, cause: UpdateCause::Request, job: Arc::clone(&job) }));
    let mut status = job.watch();
    let published = status.wait_for(|status| status.phase.has_ended()).await.expect("it ends").published;
    let view = handle.view();
    // There are six days, at most two in one update; readings are counted from above.
    let parts = view.generation();
    assert_eq!(published, Some((parts, view.cut_nanos().expect("a cut"))), "{:?}", job.status());
    assert!((3..=7).contains(&parts), "{parts}");
    assert_eq!((view.pending(), view.waiting_rows()), (0, 0));
    assert_eq!(bench.jobs.list().len(), 1, "one job");
    let report = job.report().expect("a report");
    let [state] = &report.states[..] else { panic!("{report:?}") };
    assert_eq!(state.outcome.scored + 144, view.model(StateId(0)).accumulator().observations(), "of all parts");
}

/// Waits until this many updates wait for their turn.
async fn waiting(turns: &UpdateTurns, updates: usize) {
    while turns.waiting() < updates {
        tokio::time::sleep(Duration::from_millis(5)).await;
    }
}

#[tokio::test]
async fn a_restart_goes_on_with_what_an_update_left() {
    let dir = tempfile::tempdir().expect("temporary folder");
    let (before, after) = (dir.path().join("before"), dir.path().join("after"));
    let mut turns = None;
    let first = bench_with(&before, NOON, |context| {
        context.update_readings_max = 0;
        turns = Some(Arc::clone(&context.update_turns));
    });
    let turns = turns.expect("the turns");
    let handle = create(&first).await;
    add(&handle, "s", 300).await.expect("added");
    let mut robot = hello(&handle, "r", 0, false).await.expect("accepted");
    for day in 0..7 {
        robot.observe(&handle, NOON - (8 - day) * DAY).await;
    }
    // The first part has its turn, and the second waits for the turn of this test.
    let busy = turns.begin();
    let job = first.jobs.create(handle.spec.name.clone(), UpdateCause::Request, NOON);
    assert!(handle.send(Command::Update { until_nanos: None, cause: UpdateCause::Request, job }));
    waiting(&turns, 1).await;
    let next = std::thread::spawn({
        let turns = Arc::clone(&turns);
        move || turns.begin()
    });
    waiting(&turns, 2).await;
    drop(busy);
    let kept = next.join().expect("no panic");
    generation(&handle, 1).await;
    let rows_left = handle.view().waiting_rows();
    assert!(rows_left > 0);
    copy(&before.join("maps"), &after.join("maps"));
    std::fs::copy(before.join("MANIFEST"), after.join("MANIFEST")).expect("copied");

    // A first part that was not saved yet is learned again, and must not learn more.
    let second = bench_with(&after, NOON, |context| context.update_readings_max = 0);
    let handle = second.catalog.get("office").expect("the map");
    for _ in 0..6_000 {
        if handle.view().generation() > 1 && handle.view().waiting_rows() == 0 {
            assert_eq!(handle.view().pending(), 0);
            return drop(kept);
        }
        schedule_checked(&second, &handle).await;
        tokio::time::sleep(Duration::from_millis(5)).await;
    }
    panic!("{} of {rows_left} rows wait", handle.view().waiting_rows());
}

#[tokio::test]
async fn states_that_stand_for_too_many_readings_a_day_are_refused() {
    let dir = tempfile::tempdir().expect("temporary folder");
    let bench = bench_with(dir.path(), NOON, |context| context.max_states = 1_000);
    let handle = create(&bench).await;
    let max = tidemap_map::live_map::ROW_READINGS_A_DAY_MAX;
    for number in 0..max / 86_400 {
        assert_eq!(add(&handle, &format!("s{number}"), 1).await, Ok(()));
    }
    assert_eq!(add(&handle, "more", 1).await, Err(NoRoom::Readings { max }.into()));
    assert_eq!(add(&handle, "less", 300).await, Ok(()), "what is read off more seldom has room");
}
