//! Tests a map with a shared log: what it accepts and does as a follower and as the writer, and between.

use tidemap_cluster::replica::ReplicaEvent;
use tidemap_map::{
    event::{Envelope, Epoch, Event, Observations, StateKind, UpdateDone, UpdateStart},
    ids::{NewProducer, StateId},
    site::SiteEdit,
};
use tidemap_model::Sample;
use tidemap_proto::convert::vectors::DeclaredState;

use super::{
    backlog::bare,
    replicas::{Replica, SharedMemory, compared, keep_busy},
    *,
};
use crate::{
    protocol::{AddState, AddStateError, EditSite, EditSiteError},
    role::{MapRole, NotWriter},
};

fn replica(dir: &Path) -> (Replica, Arc<SharedMemory>) {
    let log = Arc::new(SharedMemory::default());
    (Replica::open(dir, &spec_with(None), Some(Arc::clone(&log) as Arc<dyn EventLog>)), log)
}

fn refusal(writer: Option<&str>) -> NotWriter {
    NotWriter { map: MapName::new("office").expect("valid"), writer: writer.map(str::to_owned) }
}

fn moved(writer: &str) -> Option<SessionEvent> {
    Some(SessionEvent::End(Ending::Moved { writer: Some(writer.to_owned()) }))
}

/// Observations of state `s` that a robot sent to another daemon: sequence numbers and times.
fn observed(sequences: std::ops::RangeInclusive<u64>, time: i64) -> Event {
    let (first, last) = (*sequences.start(), *sequences.end());
    let mut observations = Observations::default();
    if first == 1 {
        observations.new_states.push(tidemap_map::event::NewState {
            id: StateId(0),
            name: StateName::new("s").expect("valid"),
            shape: StateKind::Probability.into(),
            labels: Vec::new(),
            sensor: None,
            reporting: Default::default(),
        });
    }
    for sequence in sequences {
        let sample = Sample { utc_nanos: time + sequence as i64, offset_secs: 3600, value: 1.0 };
        observations.push(StateId(0), sample);
    }
    let key = ProducerKey::new("r", "").expect("valid");
    let envelope = Envelope {
        producer: ProducerId(0),
        new_producer: (first == 1).then_some(NewProducer { key, sensor: None, introduced_by: String::new() }),
        incarnation: 1,
        span: SequenceSpan { first, last, content_crc: 1 },
        received_nanos: NOON,
        refused: Vec::new(),
    };
    Event::Observations(envelope, observations)
}

fn begun(generation: u64) -> Event {
    let cut_nanos = NOON + generation as i64 + 1;
    Event::UpdateStart(UpdateStart { generation, cut_nanos, cause: UpdateCause::Midnight })
}

fn add(handle: &MapHandle, name: &str) -> oneshot::Receiver<Result<(), AddStateError>> {
    let (reply, answer) = oneshot::channel();
    let (name, shape) = (StateName::new(name).expect("valid"), StateKind::Count.into());
    let state = DeclaredState { name, shape, labels: Vec::new(), sensor: None, reporting: None };
    assert!(handle.send(Command::AddState(AddState { state, client: String::new(), reply })));
    answer
}

fn edit(handle: &MapHandle) -> oneshot::Receiver<Result<(), EditSiteError>> {
    let (reply, answer) = oneshot::channel();
    let edit = SiteEdit::Charger(Some([1.0, 2.0]));
    assert!(handle.send(Command::EditSite(EditSite { edit, reply })));
    answer
}

async fn failed(job: &UpdateJob) -> String {
    match job.watch().wait_for(|status| status.phase.has_ended()).await.expect("a job").phase.clone() {
        Phase::Failed(_, reason) => reason,
        phase => panic!("{phase:?}"),
    }
}

#[tokio::test]
async fn a_follower_takes_nothing_from_clients_and_shows_what_the_log_has() {
    let dir = tempfile::tempdir().expect("temporary folder");
    let (replica, log) = replica(dir.path());
    let handle = &replica.handle;
    assert_eq!(handle.role(), MapRole::Following { writer: None });
    assert_eq!(hello(handle, "r", 0, false).await.err(), Some(HelloError::NotWriter(refusal(None))));
    replica.follow("b");
    let not_writer = || refusal(Some("b"));
    assert_eq!(hello(handle, "r", 0, false).await.err(), Some(HelloError::NotWriter(not_writer())));
    assert_eq!(handle.role(), MapRole::Following { writer: Some("b".to_owned()) });
    assert_eq!(add(handle, "x").await, Ok(Err(AddStateError::NotWriter(not_writer()))));
    assert_eq!(edit(handle).await, Ok(Err(EditSiteError::NotWriter(not_writer()))));
    assert_eq!(failed(&replica.update()).await, "this daemon does not write map office; b does");

    let (reply, answer) = oneshot::channel();
    assert!(handle.send(Command::Watch(reply)));
    let (mut feed, _) = answer.await.expect("an answer");
    let elsewhere = log.append_elsewhere(vec![observed(1..=2, NOON), observed(3..=3, NOON)]);
    replica.send_events(elsewhere).await.expect("applied");
    assert_eq!((handle.position(), handle.generation(), handle.view().observations()), (2, 0, 3));
    assert_eq!(replica.marks().await[0].durable_sequence, 3);
    assert!(feed.try_recv().is_ok(), "the watchers are notified");
    replica.stop().await;
}

#[tokio::test]
async fn what_was_not_acknowledged_when_another_daemon_writes_is_not_in_the_map() {
    let dir = tempfile::tempdir().expect("temporary folder");
    let (replica, log) = replica(dir.path());
    let handle = &replica.handle;
    replica.write(1);
    let mut busy = hello(handle, "r", 0, false).await.expect("accepted");
    let mut idle = hello(handle, "idle", 0, false).await.expect("accepted");
    busy.observe(handle, NOON).await;

    log.hold();
    send(handle, &mut busy, vec![NOON + 1]);
    send(handle, &mut busy, vec![NOON + 2]);
    let (added, also_added, edited, waiting_edit) = (add(handle, "x"), add(handle, "x"), edit(handle), edit(handle));
    let job = replica.update();
    log.holds(5).await;
    log.depose("b");
    replica.follow("b");
    assert_eq!(busy.events.recv().await, moved("b"));
    assert_eq!(idle.events.recv().await, moved("b"));
    for added in [added, also_added] {
        assert_eq!(added.await, Ok(Err(AddStateError::NotWriter(refusal(Some("b"))))));
    }
    for edited in [edited, waiting_edit] {
        assert_eq!(edited.await, Ok(Err(EditSiteError::NotWriter(refusal(Some("b"))))));
    }
    assert_eq!(failed(&job).await, "this daemon does not write the map, b does: send it to the writer");
    send(handle, &mut busy, vec![NOON + 3]);
    assert_eq!(hello(handle, "r", 0, false).await.err(), Some(HelloError::NotWriter(refusal(Some("b")))));
    assert_eq!((handle.position(), handle.view().observations(), handle.view().len()), (1, 1, 1));

    // The robot sends these to the other daemon.
    replica.send_events(log.append_elsewhere(vec![observed(2..=3, NOON)])).await.expect("applied");
    assert_eq!((handle.position(), handle.view().observations()), (2, 3));
    log.reinstate();
    replica.write(3);
    let mut again = hello(handle, "r", 1, false).await.expect("accepted");
    assert_eq!((again.opened.durable_sequence, handle.role()), (3, MapRole::Writing { epoch: 3 }));
    again.observe(handle, NOON + 4).await;
    assert_eq!(add(handle, "x").await, Ok(Ok(())));
    assert_eq!(edit(handle).await, Ok(Ok(())));
    assert_eq!((handle.view().observations(), log.events().len()), (4, 5));
    replica.stop().await;
}

#[tokio::test]
async fn a_writer_that_may_have_been_replaced_reports_to_nobody_how_far_a_sequence_is_durable() {
    let dir = tempfile::tempdir().expect("temporary folder");
    let (replica, log) = replica(dir.path());
    replica.write(1);
    log.set_stale(true);
    assert_eq!(hello(&replica.handle, "r", 0, false).await.err(), Some(HelloError::NotWriter(refusal(None))));
    log.set_stale(false);
    let opened = hello(&replica.handle, "r", 0, false).await.expect("accepted").opened;
    assert_eq!(opened.durable_sequence, 0);
    replica.stop().await;
}

#[tokio::test]
async fn a_stream_receives_what_is_in_the_log_before_it_learns_of_another_writer() {
    let dir = tempfile::tempdir().expect("temporary folder");
    let mut bare = bare(dir.path(), NOON, None);
    bare.writer.follower = Follower::new(watch::channel(MapRole::default()).0, true);
    bare.writer.handle(Command::Replica(ReplicaEvent::Writing { epoch: 1 }));
    let mut robot = bare.robot("r").await;
    send(&bare.handle, &mut robot, vec![NOON]);
    // The data that the robot sends, and the completion by the log.
    for _ in 0..2 {
        let command = bare.inbox.recv_timeout(Duration::from_secs(60)).expect("a command");
        bare.writer.handle(command);
    }
    bare.writer.handle(Command::Replica(ReplicaEvent::Following { writer: Some("b".to_owned()) }));
    assert_eq!(robot.events.recv().await, Some(SessionEvent::Ack { durable_sequence: 1, refused: Vec::new() }));
    assert_eq!(robot.events.recv().await, moved("b"));
}

#[tokio::test]
async fn a_writer_welcomes_nobody_while_another_daemon_may_be_writing() {
    let dir = tempfile::tempdir().expect("temporary folder");
    let (replica, log) = replica(dir.path());
    replica.write(1);
    log.set_stale(true);
    assert_eq!(hello(&replica.handle, "r", 0, false).await.err(), Some(HelloError::NotWriter(refusal(None))));
    log.set_stale(false);
    hello(&replica.handle, "r", 0, false).await.expect("accepted");
    replica.stop().await;
}

#[tokio::test]
async fn the_log_names_its_writer() {
    let dir = tempfile::tempdir().expect("temporary folder");
    let (replica, log) = replica(dir.path());
    let epoch = Epoch { epoch: 1, writer: "b".to_owned(), version: "1".to_owned(), maths: 1 };
    replica.send_events(log.append_elsewhere(vec![Event::Epoch(epoch)])).await.expect("applied");
    assert_eq!(hello(&replica.handle, "r", 0, false).await.err(), Some(HelloError::NotWriter(refusal(Some("b")))));
    replica.stop().await;
}

#[tokio::test]
async fn streams_end_as_moved_also_where_the_log_knows_of_the_other_writer_first() {
    let dir = tempfile::tempdir().expect("temporary folder");
    let (mut replica, log) = replica(dir.path());
    replica.write(1);
    let mut robot = hello(&replica.handle, "r", 0, false).await.expect("accepted");
    log.depose("b");
    send(&replica.handle, &mut robot, vec![NOON]);
    assert_eq!(robot.events.recv().await, moved("b"));
    replica.follow("b");
    schedule_checked_by(&replica.clock, &replica.handle).await;
    assert!(replica.fatal.try_recv().is_err(), "the daemon goes on");
    replica.stop().await;
}

#[tokio::test]
async fn only_the_writer_makes_updates_due_and_logs_what_they_made_before_the_next() {
    let dir = tempfile::tempdir().expect("temporary folder");
    let (replica, log) = replica(dir.path());
    replica.follow("b");
    let many = vec![observed(1..=2500, NOON - HOUR)];
    replica.send_events(log.append_elsewhere(many)).await.expect("applied");
    replica.clock.0.store(NOON + 13 * HOUR, Ordering::SeqCst);
    schedule_checked_by(&replica.clock, &replica.handle).await;
    assert_eq!(replica.context.jobs.list().len(), 0, "neither the midnight nor the number of observations");

    replica.write(2);
    assert_eq!(ended_of(&replica.context.jobs, 1).await, [UpdateCause::Midnight]);
    let job = replica.update();
    job.watch().wait_for(|status| status.phase.has_ended()).await.expect("a job");
    let events = log.grown(5).await;
    let logged: Vec<_> = events
        .iter()
        .skip(1)
        .map(|(_, event)| match event {
            Event::UpdateStart(start) => ("start", start.generation),
            Event::UpdateDone(done) => ("done", done.generation),
            other => panic!("{other:?}"),
        })
        .collect();
    assert_eq!(logged, [("start", 1), ("done", 1), ("start", 2), ("done", 2)]);
    replica.stop().await;
}

#[tokio::test]
async fn a_midnight_whose_update_waited_when_another_daemon_took_over_is_due_again() {
    let dir = tempfile::tempdir().expect("temporary folder");
    let (replica, log) = replica(dir.path());
    replica.write(1);
    let mut robot = hello(&replica.handle, "r", 0, false).await.expect("accepted");
    robot.observe(&replica.handle, NOON).await;
    let busy = keep_busy(&replica.context);
    replica.update();
    log.grown(2).await;
    robot.observe(&replica.handle, NOON + 1).await;
    replica.clock.0.store(NOON + 13 * HOUR, Ordering::SeqCst);
    schedule_checked_by(&replica.clock, &replica.handle).await;
    assert_eq!(replica.context.jobs.list().len(), 2);
    replica.follow("b");
    assert!(failed(&replica.context.jobs.list()[0]).await.contains("b does"));
    drop(busy);
    ended_of(&replica.context.jobs, 1).await;
    replica.write(3);
    assert_eq!(ended_of(&replica.context.jobs, 2).await, [UpdateCause::Request, UpdateCause::Midnight]);
    replica.stop().await;
}

#[tokio::test]
async fn an_update_that_the_log_begins_waits_for_the_one_before() {
    let dir = tempfile::tempdir().expect("temporary folder");
    let (replica, log) = replica(dir.path());
    let busy = keep_busy(&replica.context);
    let logged = log.append_elsewhere(vec![observed(1..=2, NOON), begun(1), observed(3..=3, NOON)]);
    replica.send_events(logged).await.expect("applied while the update runs");
    let logged = log.append_elsewhere(vec![observed(4..=4, NOON), begun(2), observed(5..=5, NOON)]);
    let mut applied = replica.send_events(logged);
    schedule_checked_by(&replica.clock, &replica.handle).await;
    assert!(applied.try_recv().is_err(), "so that no more events come");
    assert_eq!((replica.handle.position(), replica.handle.generation()), (4, 0));
    let job = &replica.context.jobs.list()[0];
    assert_eq!((update_cause(job), job.status().observations), (Some(UpdateCause::Midnight), 1));
    // The daemon does not write before it has applied all events of the log.
    replica.write(2);
    assert_eq!(hello(&replica.handle, "r", 0, false).await.err(), Some(HelloError::NotWriter(refusal(None))));

    drop(busy);
    applied.await.expect("applied");
    assert_eq!(ended_of(&replica.context.jobs, 2).await, [UpdateCause::Midnight; 2]);
    assert_eq!(replica.handle.view().observations(), 5);
    let events = log.grown(7).await;
    assert!(matches!(events[6].1, Event::UpdateDone(UpdateDone { generation: 2, .. })), "{:?}", events[6]);
    hello(&replica.handle, "r", 0, false).await.expect("it writes");
    replica.stop().await;
}

#[tokio::test]
async fn a_writer_that_takes_over_logs_what_the_update_begun_before_has_made() {
    let dir = tempfile::tempdir().expect("temporary folder");
    let (replica, log) = replica(dir.path());
    let busy = keep_busy(&replica.context);
    replica.send_events(log.append_elsewhere(vec![observed(1..=2, NOON), begun(1)])).await.expect("applied");
    replica.write(2);
    let job = replica.update();
    let mut robot = hello(&replica.handle, "r", 1, false).await.expect("accepted while the update runs");
    robot.observe(&replica.handle, NOON + 5).await;
    assert_eq!(job.status().phase, Phase::Waiting);
    drop(busy);
    let events = log.grown(5).await;
    let generations: Vec<_> = events[3..5]
        .iter()
        .map(|(_, event)| match event {
            Event::UpdateDone(done) => (done.generation, true),
            Event::UpdateStart(start) => (start.generation, false),
            other => panic!("{other:?}"),
        })
        .collect();
    assert_eq!(generations, [(1, true), (2, false)]);
    replica.stop().await;
}

#[tokio::test]
async fn a_follower_compares_what_its_updates_make_with_the_log() {
    let dir = tempfile::tempdir().expect("temporary folder");
    let (writer, log) = replica(&dir.path().join("writer"));
    writer.write(1);
    let mut robot = hello(&writer.handle, "r", 0, false).await.expect("accepted");
    for round in 1..=2 {
        robot.observe(&writer.handle, NOON + round).await;
        writer.update();
        log.grown(3 * round as usize).await;
    }
    let status = writer.digest(2).await;
    assert_eq!(status.is_equal, None, "the writer is not compared with itself");
    writer.stop().await;

    let mut events = log.events();
    let Event::UpdateDone(done) = &mut events[5].1 else { panic!("{events:?}") };
    assert_eq!((done.generation, done.digest), (2, status.digest));
    done.digest.0 ^= 1;
    let (follower, _) = replica(&dir.path().join("follower"));
    let later = events.split_off(3);
    follower.send_events(events).await.expect("applied");
    compared(&follower, 1, true).await;
    follower.send_events(later).await.expect("applied");
    compared(&follower, 2, false).await;
    follower.stop().await;
}

#[tokio::test]
async fn a_map_with_records_that_the_shared_log_does_not_have_ends_and_is_reported() {
    let dir = tempfile::tempdir().expect("temporary folder");
    let (mut replica, log) = replica(dir.path());
    replica.write(1);
    let mut robot = hello(&replica.handle, "r", 0, false).await.expect("accepted");
    robot.observe(&replica.handle, NOON).await;
    let busy = keep_busy(&replica.context);
    replica.update();
    log.grown(2).await;
    let applied = replica.send_events(Vec::new());
    replica.fork(1);
    applied.await.expect("applied");
    drop(busy);
    let fork = replica.forks.recv().await.expect("a fork");
    assert_eq!(fork, ForkedMap { id: replica.id, map: replica.handle.spec.name.clone(), common: 1 });
    assert_eq!(robot.events.recv().await, Some(SessionEvent::End(Ending::Forked { common: 1 })));
    replica.handle.stop(Ending::Shutdown).await;
    let (reply, _) = oneshot::channel();
    assert!(!replica.handle.send(Command::ListProducers(reply)), "its thread has ended");
    let sizes = replica.context.store.sizes(replica.id);
    assert_eq!(sizes.checkpoint_bytes, 0, "what the shared log does not have is not saved");
    replica.context.store.close();
}
