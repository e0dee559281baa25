//! Tests a writer on a real store, with a clock that the test sets.

use std::{
    path::Path,
    sync::atomic::{AtomicI64, AtomicUsize, Ordering},
};

use tidemap_grid::spec::{GridSpec, Retention};
use tidemap_map::{
    event::{SequenceSpan, UpdateCause},
    ids::RefusalReason,
    name::{MapName, ProducerKey, StateName},
};
use tidemap_model::Zone;
use tidemap_store::StoreOptions;
use tokio::sync::{Semaphore, mpsc as events};

use tidemap_map::spec::MapSpec;

use super::*;
use crate::{
    catalog::Catalog,
    jobs::{JobCause, Phase, UpdateJob},
    protocol::{ObservationBatch, StreamData},
};

pub(super) mod backlog;
mod follower_file;
mod parts;
mod repeated;
mod replicas;
mod roles;
pub(super) mod saves;
mod scans;
mod states;
mod training;
mod traversals;
mod turns;

const HOUR: i64 = 3_600_000_000_000;
/// 2016-07-01T12:00 in London, which is then an hour ahead of UTC.
pub(super) const NOON: i64 = 1_467_370_800_000_000_000;

/// A clock that the test sets; the second number counts its reads.
#[derive(Debug)]
struct SetClock(AtomicI64, AtomicUsize);

impl Clock for SetClock {
    fn now_nanos(&self) -> i64 {
        self.1.fetch_add(1, Ordering::SeqCst);
        self.0.load(Ordering::SeqCst)
    }
}

struct Bench {
    catalog: Catalog,
    clock: Arc<SetClock>,
    jobs: Arc<Jobs>,
}

fn bench(dir: &Path, now: i64) -> Bench {
    bench_with(dir, now, |_| {})
}

fn bench_with(dir: &Path, now: i64, change: impl FnOnce(&mut Context)) -> Bench {
    let (mut context, clock) = context(dir, now);
    change(&mut context);
    let jobs = Arc::clone(&context.jobs);
    Bench { catalog: Catalog::open(context, 10, u64::MAX).expect("maps").0, clock, jobs }
}

fn context(dir: &Path, now: i64) -> (Context, Arc<SetClock>) {
    let clock = Arc::new(SetClock(AtomicI64::new(now), AtomicUsize::new(0)));
    let options = StoreOptions { new_store_id: "00".repeat(16), ..StoreOptions::default() };
    let context = Context {
        store: Arc::new(Store::open(dir, options).expect("a store")),
        jobs: Arc::new(Jobs::default()),
        clock: Arc::clone(&clock) as Arc<dyn Clock>,
        update_turns: Arc::new(crate::update_turns::UpdateTurns::new(1)),
        fatal: events::unbounded_channel().0,
        forks: events::unbounded_channel().0,
        max_states: 10,
        max_producers: 10,
        max_producers_of_client: 10,
        max_pending: PendingLimits { observations: 1000, changes: 1000 },
        update_readings_max: tidemap_map::update::UPDATE_READINGS_MAX,
        update_at_midnight: true,
        max_tiles: 20,
        tile_cache_bytes: 1 << 30,
        cluster: None,
    };
    (context, clock)
}

async fn create(bench: &Bench) -> Arc<MapHandle> {
    create_with(bench, None).await
}

async fn create_with(bench: &Bench, grid: Option<GridSpec>) -> Arc<MapHandle> {
    bench.catalog.create(spec_with(grid)).await.expect("created")
}

pub(super) fn spec_with(grid: Option<GridSpec>) -> MapSpec {
    MapSpec {
        zone: Zone::named("Europe/London").expect("known"),
        grid,
        ..MapSpec::new(MapName::new("office").expect("valid"))
    }
}

struct Robot {
    opened: Welcome,
    sent: u64,
    events: events::UnboundedReceiver<SessionEvent>,
}

async fn hello(handle: &MapHandle, name: &str, incarnation: u64, nightly: bool) -> Result<Robot, HelloError> {
    let (sender, events) = events::unbounded_channel();
    let (reply, answer) = oneshot::channel();
    let key = ProducerKey::new(name, "").expect("valid");
    assert!(handle.send(Command::Hello(Hello {
        client: String::new(),
        key,
        incarnation,
        probe: None,
        takes_over: None,
        nightly,
        sensor: None,
        events: sender,
        reply,
    })));
    let opened = answer.await.expect("an answer")?;
    Ok(Robot { sent: opened.durable_sequence, opened, events })
}

impl Robot {
    /// Sends one observation of state `s` and waits until it is acknowledged.
    async fn observe(&mut self, handle: &MapHandle, time: i64) {
        let permit = || Arc::new(Semaphore::new(1)).try_acquire_owned().expect("free");
        let first = self.sent == self.opened.durable_sequence;
        self.sent += 1;
        let batch = ObservationBatch {
            span: SequenceSpan { first: self.sent, last: self.sent, content_crc: 1 },
            new_names: if first { vec![Some(StateName::new("s").expect("valid").into())] } else { Vec::new() },
            table_indices: vec![0],
            times_nanos: vec![time],
            values: vec![1.0],
            ..ObservationBatch::default()
        };
        let budget = vec![permit(), permit()];
        assert!(
            handle.send(Command::StreamData {
                session: self.opened.session,
                data: StreamData::Observations(batch, budget)
            })
        );
        let expected = SessionEvent::Ack { durable_sequence: self.sent, refused: Vec::new() };
        assert_eq!(self.events.recv().await, Some(expected));
    }
}

/// Waits until an update has been published.
async fn generation(handle: &MapHandle, generation: u64) {
    for _ in 0..6_000 {
        if handle.view().generation() == generation {
            return;
        }
        tokio::time::sleep(Duration::from_millis(5)).await;
    }
    panic!("generation {} is not {generation}", handle.view().generation());
}

/// Returns when the writer has read the clock and has started what is due, without waiting for its tick. The writer
/// reads the clock once after each burst of commands, so after the third read a whole round has passed.
async fn schedule_checked(bench: &Bench, handle: &MapHandle) {
    schedule_checked_by(&bench.clock, handle).await;
}

async fn schedule_checked_by(clock: &SetClock, handle: &MapHandle) {
    let before = clock.1.load(Ordering::SeqCst);
    while clock.1.load(Ordering::SeqCst) < before + 3 {
        let (reply, answer) = oneshot::channel();
        assert!(handle.send(Command::ListProducers(reply)));
        answer.await.expect("an answer");
    }
}

fn update_cause(job: &UpdateJob) -> Option<UpdateCause> {
    match job.cause {
        JobCause::Update(cause) => Some(cause),
        JobCause::Erasure | JobCause::Backup => None,
    }
}

/// Waits until `count` updates have ended; returns their causes, oldest first.
async fn ended(bench: &Bench, count: usize) -> Vec<UpdateCause> {
    ended_of(&bench.jobs, count).await
}

async fn ended_of(jobs: &Jobs, count: usize) -> Vec<UpdateCause> {
    for _ in 0..600 {
        let jobs = jobs.list();
        let done: Vec<_> = jobs.iter().filter(|job| matches!(job.status().phase, Phase::Done(_))).collect();
        if done.len() >= count {
            return done.iter().rev().filter_map(|job| update_cause(job)).collect();
        }
        tokio::time::sleep(Duration::from_millis(50)).await;
    }
    panic!("{count} updates have not ended: {:?}", jobs.list());
}

#[tokio::test]
async fn the_nightly_update_runs_once_at_the_local_midnight() {
    let dir = tempfile::tempdir().expect("temporary folder");
    let bench = bench(dir.path(), NOON);
    let handle = create(&bench).await;
    let mut robot = hello(&handle, "r", 0, false).await.expect("accepted");
    robot.observe(&handle, NOON - 90 * 24 * HOUR).await;
    robot.observe(&handle, NOON).await;
    // The time is 23:30 in London, 22:30 UTC: the day is not over, even for observations of months ago.
    bench.clock.0.store(NOON + 11 * HOUR + HOUR / 2, Ordering::SeqCst);
    schedule_checked(&bench, &handle).await;
    assert_eq!(bench.jobs.list().len(), 0);
    // The time is 00:30 in London, 23:30 UTC.
    bench.clock.0.store(NOON + 12 * HOUR + HOUR / 2, Ordering::SeqCst);
    assert_eq!(ended(&bench, 1).await, [UpdateCause::Midnight]);
    let view = handle.view();
    assert_eq!((view.generation(), view.pending()), (1, 0));
    assert_eq!(view.cut_nanos(), Some(NOON + 12 * HOUR), "midnight in London");
    robot.observe(&handle, NOON + 12 * HOUR + HOUR / 2).await;
    schedule_checked(&bench, &handle).await;
    assert_eq!(bench.jobs.list().len(), 1, "once a night");
}

#[tokio::test]
async fn a_missed_night_is_caught_up_after_a_restart() {
    let dir = tempfile::tempdir().expect("temporary folder");
    {
        let bench = bench(dir.path(), NOON);
        let handle = create(&bench).await;
        hello(&handle, "r", 0, false).await.expect("accepted").observe(&handle, NOON).await;
        bench.catalog.stop().await;
        bench.catalog.context().store.close();
    }
    let bench = bench(dir.path(), NOON + 3 * 24 * HOUR);
    assert_eq!(ended(&bench, 1).await, [UpdateCause::Midnight]);
    let view = bench.catalog.get("office").expect("there").view();
    assert_eq!((view.generation(), view.pending(), view.observations()), (1, 0, 1));
}

#[tokio::test]
async fn a_day_of_imported_data_closes_when_every_announcing_stream_has_passed_it() {
    let dir = tempfile::tempdir().expect("temporary folder");
    let bench = bench(dir.path(), NOON);
    let handle = create(&bench).await;
    let (mut a, mut b) =
        (hello(&handle, "a", 0, true).await.expect("accepted"), hello(&handle, "b", 0, true).await.expect("accepted"));
    let day = |day: i64| NOON - 30 * 24 * HOUR + day * 24 * HOUR;
    a.observe(&handle, day(0)).await;
    a.observe(&handle, day(1)).await;
    b.observe(&handle, day(0)).await;
    schedule_checked(&bench, &handle).await;
    assert_eq!(bench.jobs.list().len(), 0, "b is not past the day");
    b.observe(&handle, day(1)).await;
    assert_eq!(ended(&bench, 1).await, [UpdateCause::DataTime]);
    let view = handle.view();
    assert_eq!(view.cut_nanos(), Some(day(1) - 12 * HOUR), "midnight between the days");
    assert_eq!(view.pending(), 2);
    // One stream ends on purpose: the other continues alone.
    assert!(handle.send(Command::StreamData { session: b.opened.session, data: StreamData::End { clean: true } }));
    a.observe(&handle, day(2)).await;
    assert_eq!(ended(&bench, 2).await.len(), 2);
}

#[tokio::test]
async fn too_much_pending_starts_an_update() {
    let dir = tempfile::tempdir().expect("temporary folder");
    let bench = bench(dir.path(), NOON);
    let handle = create(&bench).await;
    let mut robot = hello(&handle, "r", 0, false).await.expect("accepted");
    for minute in 0..1001 {
        robot.observe(&handle, NOON - minute * HOUR / 60).await;
    }
    assert_eq!(ended(&bench, 1).await, [UpdateCause::PendingLimit]);
    assert!(handle.view().pending() < 1000);
}

#[tokio::test]
async fn one_stream_of_a_key_at_a_time() {
    let dir = tempfile::tempdir().expect("temporary folder");
    let bench = bench(dir.path(), NOON);
    let handle = create(&bench).await;
    let mut first = hello(&handle, "r", 0, false).await.expect("accepted");
    first.observe(&handle, NOON).await;
    let second = hello(&handle, "r", 0, false).await.err();
    assert!(matches!(second, Some(HelloError::AlreadyStreaming { open: None, .. })));
    let again = hello(&handle, "r", first.opened.incarnation, false).await.expect("a reconnection");
    assert_eq!(again.opened.durable_sequence, 1);
    assert_eq!(first.events.recv().await, Some(SessionEvent::End(Ending::Superseded)));
    let higher = hello(&handle, "r", 9, false).await.expect("a newer self");
    assert_eq!(higher.opened.incarnation, 9);
    let fenced = hello(&handle, "r", 8, false).await.err();
    assert!(matches!(fenced, Some(HelloError::Fenced { got: 8, current: 9, .. })));
    assert!(hello(&handle, "other", 0, false).await.is_ok());
}

#[tokio::test]
async fn the_last_midnight_of_an_import_counts_although_its_stream_ends_at_once() {
    let dir = tempfile::tempdir().expect("temporary folder");
    let bench = bench(dir.path(), NOON);
    let handle = create(&bench).await;
    for round in 0..8 {
        let mut robot = hello(&handle, &format!("r{round}"), 0, true).await.expect("accepted");
        let day = |day: i64| NOON - 300 * 24 * HOUR + (10 * round + day) * 24 * HOUR;
        send(&handle, &mut robot, vec![day(0), day(1)]);
        // This batch is in flight before the update that the first batch makes due, and passes another midnight.
        std::thread::sleep(Duration::from_micros(100));
        send(&handle, &mut robot, vec![day(2)]);
        loop {
            match robot.events.recv().await {
                Some(SessionEvent::Ack { durable_sequence: 3, .. }) => break,
                Some(SessionEvent::Ack { .. }) => {}
                other => panic!("{other:?}"),
            }
        }
        assert!(
            handle.send(Command::StreamData { session: robot.opened.session, data: StreamData::End { clean: true } })
        );
        for _ in 0..200 {
            if handle.view().pending() == 1 {
                break;
            }
            tokio::time::sleep(Duration::from_millis(50)).await;
        }
        assert_eq!(handle.view().pending(), 1, "what came after the last midnight");
    }
}

/// Sends observations of one state without waiting.
fn send(handle: &MapHandle, robot: &mut Robot, times: Vec<i64>) {
    let values = vec![1.0; times.len()];
    send_values(handle, robot, times, values);
}

/// Sends observations of one state with these values, without waiting.
fn send_values(handle: &MapHandle, robot: &mut Robot, times: Vec<i64>, values: Vec<f64>) {
    let permit = || Arc::new(Semaphore::new(1)).try_acquire_owned().expect("free");
    let first = robot.sent == robot.opened.durable_sequence;
    let count = times.len();
    let first_sequence = robot.sent + 1;
    robot.sent += count as u64;
    let batch = ObservationBatch {
        span: SequenceSpan { first: first_sequence, last: robot.sent, content_crc: 1 },
        new_names: if first { vec![Some(StateName::new("s").expect("valid").into())] } else { Vec::new() },
        table_indices: vec![0; count],
        values,
        times_nanos: times,
        ..ObservationBatch::default()
    };
    let budget = vec![permit(), permit()];
    assert!(
        handle
            .send(Command::StreamData { session: robot.opened.session, data: StreamData::Observations(batch, budget) })
    );
}

#[tokio::test]
async fn an_append_that_is_refused_at_once_does_not_take_the_answer_of_another() {
    let dir = tempfile::tempdir().expect("temporary folder");
    let bench = bench(dir.path(), NOON);
    let handle = create(&bench).await;
    let mut a = hello(&handle, "a", 0, false).await.expect("accepted");
    let mut b = hello(&handle, "b", 0, false).await.expect("accepted");
    a.observe(&handle, NOON).await;
    b.observe(&handle, NOON).await;
    send(&handle, &mut a, vec![NOON + 7_000]);
    // The log refuses a negative time, which intake never passes, before the event joins its queue.
    send(&handle, &mut b, vec![-1]);
    assert_eq!(a.events.recv().await, Some(SessionEvent::Ack { durable_sequence: 2, refused: Vec::new() }));
    assert!(matches!(b.events.recv().await, Some(SessionEvent::End(Ending::Storage(_)))));
    assert_eq!(handle.view().observations(), 3);
}

#[tokio::test]
async fn no_midnight_updates_a_map_whose_operator_turned_that_off() {
    let dir = tempfile::tempdir().expect("temporary folder");
    let bench = bench_with(dir.path(), NOON, |context| context.update_at_midnight = false);
    let handle = create(&bench).await;
    let mut robot = hello(&handle, "r", 0, false).await.expect("accepted");
    robot.observe(&handle, NOON).await;
    bench.clock.0.store(NOON + 13 * HOUR, Ordering::SeqCst);
    schedule_checked(&bench, &handle).await;
    assert_eq!(bench.jobs.list().len(), 0);
}

#[tokio::test]
async fn a_midnight_gives_one_update_however_busy_the_map_is() {
    let dir = tempfile::tempdir().expect("temporary folder");
    let bench = bench(dir.path(), NOON);
    let handle = create(&bench).await;
    let mut robot = hello(&handle, "r", 0, false).await.expect("accepted");
    robot.observe(&handle, NOON).await;
    let late = NOON + 12 * HOUR + HOUR / 2;
    bench.clock.0.store(late, Ordering::SeqCst);
    for i in 0..200 {
        send(&handle, &mut robot, vec![late + i]);
        tokio::time::sleep(Duration::from_micros(200)).await;
    }
    assert_eq!(ended(&bench, 1).await, [UpdateCause::Midnight]);
    schedule_checked(&bench, &handle).await;
    assert_eq!(bench.jobs.list().len(), 1);
}

#[tokio::test]
async fn observations_ahead_of_the_clock_make_no_update_due_and_are_taken_in_their_time() {
    let dir = tempfile::tempdir().expect("temporary folder");
    let bench = bench(dir.path(), NOON);
    let handle = create(&bench).await;
    let mut robot = hello(&handle, "r", 0, false).await.expect("accepted");
    send(&handle, &mut robot, (0..1001).map(|i| NOON + HOUR + i).collect());
    assert_eq!(robot.events.recv().await, Some(SessionEvent::Ack { durable_sequence: 1001, refused: Vec::new() }));
    // More observations in the future are refused; observations that are not in the future are taken.
    send(&handle, &mut robot, vec![NOON + HOUR, NOON]);
    let Some(SessionEvent::Ack { durable_sequence: 1003, refused }) = robot.events.recv().await else {
        panic!("an acknowledgement");
    };
    assert_eq!(refused.iter().map(|r| (r.sequence, r.reason)).collect::<Vec<_>>(), [(1002, RefusalReason::Time)]);
    schedule_checked(&bench, &handle).await;
    assert_eq!(bench.jobs.list().len(), 0);
    bench.clock.0.store(NOON + 2 * HOUR, Ordering::SeqCst);
    let job = bench.jobs.create(handle.spec.name.clone(), UpdateCause::Request, NOON);
    assert!(handle.send(Command::Update { until_nanos: None, cause: UpdateCause::Request, job: Arc::clone(&job) }));
    ended(&bench, 1).await;
    assert_eq!(job.status().observations, 1002);
    assert_eq!(handle.view().pending(), 0);
}

#[tokio::test]
async fn a_clock_that_leapt_ahead_and_came_back_does_not_end_the_nightly_updates() {
    let dir = tempfile::tempdir().expect("temporary folder");
    let bench = bench(dir.path(), NOON);
    let handle = create(&bench).await;
    let mut robot = hello(&handle, "r", 0, false).await.expect("accepted");
    robot.observe(&handle, NOON).await;
    bench.clock.0.store(NOON + 3650 * 24 * HOUR, Ordering::SeqCst);
    ended(&bench, 1).await;
    bench.clock.0.store(NOON, Ordering::SeqCst);
    robot.observe(&handle, NOON + 1).await;
    bench.clock.0.store(NOON + 24 * HOUR, Ordering::SeqCst);
    assert_eq!(ended(&bench, 2).await, [UpdateCause::Midnight, UpdateCause::Midnight]);
    assert_eq!(handle.view().pending(), 0);
}

#[tokio::test]
async fn jobs_end_when_their_map_is_deleted() {
    let dir = tempfile::tempdir().expect("temporary folder");
    let bench = bench(dir.path(), NOON);
    let handle = create(&bench).await;
    let mut robot = hello(&handle, "r", 0, false).await.expect("accepted");
    send(&handle, &mut robot, (0..900).map(|i| NOON - i * 24 * HOUR).collect());
    for _ in 0..20 {
        let job = bench.jobs.create(handle.spec.name.clone(), UpdateCause::Request, NOON);
        assert!(handle.send(Command::Update { until_nanos: None, cause: UpdateCause::Request, job }));
    }
    bench.catalog.delete("office").await.expect("deleted");
    for _ in 0..600 {
        if bench.jobs.list().iter().all(|job| job.status().phase.has_ended()) {
            return;
        }
        tokio::time::sleep(Duration::from_millis(50)).await;
    }
    panic!("{:?}", bench.jobs.list());
}
