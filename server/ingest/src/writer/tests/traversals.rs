//! Traversals of edges: their observations, refusals, a restart, and waiting for edits.

use tidemap_map::{
    event::{SequenceSpan, StateKind},
    name::EdgeName,
    report::Report,
    site::SiteEdit,
    topology::{EdgeEnds, Extent, NewEdge, NewNode, TopologyEdit},
    traversal::Traversal,
};

use super::{backlog::bare, *};
use crate::protocol::{EditSite, ReportBatch};

const SEC: i64 = 1_000_000_000;

fn name(name: &str) -> StateName {
    StateName::new(name).expect("valid")
}

fn ends(action: Option<&str>) -> EdgeEnds {
    EdgeEnds { from: name("Hall"), to: name("x"), action: action.map(name), both_ways: false }
}

fn flat() -> TopologyEdit {
    let node = |text: &str| NewNode { name: name(text), pose: None, dwell_secs: None };
    let edges = vec![
        NewEdge { ends: ends(None), extent: Extent::metres(6.0) },
        NewEdge { ends: ends(Some("x")), extent: Extent::secs(3.0) },
    ];
    TopologyEdit::Load { nodes: vec![node("Hall"), node("x")], edges, replaces: true }
}

async fn edit(handle: &MapHandle, edit: TopologyEdit) {
    let (reply, answer) = oneshot::channel();
    assert!(handle.send(Command::EditSite(EditSite { edit: SiteEdit::Topology(edit), reply })));
    answer.await.expect("an answer").expect("edited");
}

/// A traversal of 4 s.
fn trip(action: &str, start_nanos: i64, success: bool) -> Traversal {
    let edge = EdgeName::new("Hall", "x", action).expect("valid");
    Traversal { edge, start_nanos, end_nanos: start_nanos + 4 * SEC, success, reason: "stuck".to_owned() }
}

fn send(handle: &MapHandle, robot: &mut Robot, traversals: Vec<Traversal>) {
    let permit = || Arc::new(Semaphore::new(1)).try_acquire_owned().expect("free");
    let first_sequence = robot.sent + 1;
    robot.sent += traversals.len() as u64;
    let batch = ReportBatch {
        span: SequenceSpan { first: first_sequence, last: robot.sent, content_crc: 1 },
        reports: (first_sequence..).zip(traversals.into_iter().map(Report::Traversal)).collect(),
        refused: Vec::new(),
    };
    let command = Command::StreamData {
        session: robot.opened.session,
        data: StreamData::Reports(batch, vec![permit(), permit()]),
    };
    assert!(handle.send(command));
}

/// Sends traversals, and waits for the refusals.
async fn refused(handle: &MapHandle, robot: &mut Robot, traversals: Vec<Traversal>) -> Vec<(u64, RefusalReason)> {
    send(handle, robot, traversals);
    match robot.events.recv().await {
        Some(SessionEvent::Ack { durable_sequence, refused }) if durable_sequence == robot.sent => {
            refused.into_iter().map(|refused| (refused.sequence, refused.reason)).collect()
        }
        other => panic!("{other:?}"),
    }
}

fn states(handle: &MapHandle) -> Vec<(String, StateKind)> {
    handle.view().infos().map(|info| (info.name.as_str().to_owned(), info.kind)).collect()
}

/// The newest value of a state.
fn latest(handle: &MapHandle, state: &str) -> Option<f64> {
    let view = handle.view();
    view.live(view.find(state)?).persistence.last().map(|(_, value)| value)
}

#[tokio::test]
async fn they_become_states_of_their_edges_and_survive_a_restart() {
    let dir = tempfile::tempdir().expect("temporary folder");
    let known;
    {
        let bench = bench(dir.path(), NOON);
        let handle = create(&bench).await;
        edit(&handle, flat()).await;
        let mut robot = hello(&handle, "r", 0, false).await.expect("accepted");
        let back = Traversal { edge: EdgeName::new("x", "Hall", "").expect("valid"), ..trip("", NOON, true) };
        let swift = Traversal { end_nanos: NOON + 1, ..trip("x", NOON, true) };
        let trips = vec![trip("", NOON, true), back, trip("x", NOON - 9 * SEC, false), trip("x", NOON, true), swift];
        let refused = refused(&handle, &mut robot, trips).await;
        // 3 s of nominal time in a nanosecond means a pace of 3e9, which is a valid number.
        assert_eq!(refused, [(2, RefusalReason::Edge)]);
        let (probability, continuous) = (StateKind::Probability, StateKind::Continuous);
        let expected = [
            ("edge/Hall/x", probability),
            ("speed/Hall/x", continuous),
            ("edge/Hall/x/x", probability),
            ("pace/Hall/x/x", continuous),
        ];
        known = states(&handle);
        assert_eq!(known, expected.map(|(name, kind)| (name.to_owned(), kind)));
        assert_eq!(latest(&handle, "speed/Hall/x"), Some(1.5));
        assert_eq!(handle.view().observations(), 7);
        let rename = TopologyEdit::RenameNode { from: name("Hall"), to: name("Lobby") };
        edit(&handle, rename).await;
        bench.catalog.stop().await;
        bench.catalog.context().store.close();
    }
    let bench = bench(dir.path(), NOON);
    let handle = bench.catalog.get("office").expect("there");
    assert_eq!(states(&handle).len(), known.len());
    let view = handle.view();
    let failures: Vec<_> = view.site().failures().newest_first().collect();
    let [failure] = failures.as_slice() else { panic!("{failures:?}") };
    assert_eq!((failure.edge.to_string().as_str(), failure.reason.as_str()), ("Lobby/x/x", "stuck"));
    assert_eq!((failure.start_nanos, failure.end_nanos), (NOON - 9 * SEC, NOON - 5 * SEC));
}

#[tokio::test]
async fn a_traversal_is_taken_with_both_of_its_states_or_not_at_all() {
    let dir = tempfile::tempdir().expect("temporary folder");
    let bench = bench_with(dir.path(), NOON, |context| context.max_states = 3);
    let handle = create(&bench).await;
    edit(&handle, flat()).await;
    let mut robot = hello(&handle, "r", 0, false).await.expect("accepted");
    let trips = vec![trip("", NOON, true), trip("x", NOON, true), trip("x", NOON, false), trip("x", NOON, true)];
    let full = RefusalReason::StateLimit;
    assert_eq!(refused(&handle, &mut robot, trips).await, [(2, full), (4, full)]);
    let names: Vec<String> = states(&handle).into_iter().map(|(name, _)| name).collect();
    assert_eq!(names, ["edge/Hall/x", "speed/Hall/x", "edge/Hall/x/x"]);
    assert_eq!(handle.view().observations(), 3);
}

#[tokio::test]
async fn a_changed_length_changes_what_comes_and_not_what_was_learned() {
    let dir = tempfile::tempdir().expect("temporary folder");
    let bench = bench(dir.path(), NOON);
    let handle = create(&bench).await;
    edit(&handle, flat()).await;
    let mut robot = hello(&handle, "r", 0, false).await.expect("accepted");
    assert_eq!(refused(&handle, &mut robot, vec![trip("", NOON, true)]).await, []);
    let extent = Extent { length_m: Some(2.0), nominal_secs: Some(9.0) };
    edit(&handle, TopologyEdit::SetExtent(NewEdge { ends: ends(None), extent })).await;
    assert_eq!(latest(&handle, "speed/Hall/x"), Some(1.5));
    assert_eq!(refused(&handle, &mut robot, vec![trip("", NOON + 9 * SEC, true)]).await, []);
    assert_eq!(latest(&handle, "speed/Hall/x"), Some(0.5));
    // Without a length it is another state, with another unit.
    edit(&handle, TopologyEdit::SetExtent(NewEdge { ends: ends(None), extent: Extent::secs(8.0) })).await;
    assert_eq!(refused(&handle, &mut robot, vec![trip("", NOON + 18 * SEC, true)]).await, []);
    assert_eq!((latest(&handle, "speed/Hall/x"), latest(&handle, "pace/Hall/x")), (Some(0.5), Some(2.0)));
}

#[tokio::test]
async fn traversals_wait_while_a_change_of_the_topology_is_on_its_way() {
    let dir = tempfile::tempdir().expect("temporary folder");
    let mut bare = bare(dir.path(), NOON, None);
    let mut robot = bare.robot("r").await;
    let (reply, mut answer) = oneshot::channel();
    assert!(bare.handle.send(Command::EditSite(EditSite { edit: SiteEdit::Topology(flat()), reply })));
    send(&bare.handle, &mut robot, vec![trip("", NOON, true)]);
    bare.take_in();
    assert!(answer.try_recv().is_err(), "it is on its way");
    assert!(matches!(bare.writer.backlog.oldest(), Some(StreamData::Reports(..))));
    bare.go_on(|writer| writer.map.states() == 2);
    let expected = SessionEvent::Ack { durable_sequence: 1, refused: Vec::new() };
    assert_eq!(robot.events.recv().await, Some(expected), "the edge was there when its turn came");
}
