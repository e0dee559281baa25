//! A map that daemons share, while it shows the generation that the index publishes and is not open yet.

use tidemap_map::{
    event::{Event, NewState, StateKind, UpdateCause, UpdateStart},
    ids::StateId,
    live_map::LiveMap,
    name::StateName,
};

use tidemap_model::selector::ModelSelector;
use tidemap_proto::convert::query::selector_to_wire;

use super::*;

/// The number of the map among those of the daemons.
const UID: u64 = 7;

/// A folder with the shared map `office`, which has the state `door`; the index publishes its generation 1.
fn published() -> tempfile::TempDir {
    let dir = tempfile::tempdir().expect("temporary folder");
    let store = store(dir.path());
    let id = store.create_shared_map(&spec(), UID).expect("created");
    let log = store.open_map(id, &spec()).expect("opened").log;
    let mut map = LiveMap::new(Arc::new(spec()));
    let door = NewState::sampled(StateId(0), StateName::new("door").expect("valid"), StateKind::Probability);
    let start = UpdateStart { generation: 1, cut_nanos: 1_700_000_000_000_000_000, cause: UpdateCause::Request };
    let mut learned = None;
    for (position, event) in (1..).zip([Event::AddState(door), Event::UpdateStart(start)]) {
        let (sender, appended) = std::sync::mpsc::channel();
        log.append(&event, Box::new(move |result| sender.send(result).expect("waiting"))).expect("queued");
        assert_eq!(appended.recv().expect("answered"), Ok(position));
        learned = map.apply(position, &event).expect("consistent");
    }
    let learned = learned.expect("an update").run(&std::sync::atomic::AtomicU64::new(0)).expect("no tiles");
    store.save(id, &map.finish_update(learned)).expect("saved");
    dir
}

/// Daemons `a`, in which the map is not open, and `b`, which writes it.
async fn opening_and_writer() -> (Member, Vec<UnopenedMap>, Member) {
    let (a, unopened) = Member::start_in("a", published(), 0, Access::Anybody).await;
    assert_eq!(unopened.len(), 1);
    let b = Member::start("b").await;
    b.create().await;
    b.notify(ReplicaEvent::Writing { epoch: 1 }).await;
    a.knows("b", &b.address);
    (a, unopened, b)
}

impl Member {
    /// The token that the reply of a prediction of the door contains.
    async fn predict(&self, allows_stale: bool, at_least: Option<ReadToken>) -> Result<ReadToken, Status> {
        let mut request = tonic::Request::new(v1::PredictStatesRequest {
            map: "office".to_owned(),
            states: vec!["door".to_owned()],
            times_nanos: vec![1_700_000_000_000_000_000],
            // The model of the last update, which the index has.
            model: Some(selector_to_wire(ModelSelector::default().long_term())),
            ..Default::default()
        });
        mark(&mut request, at_least);
        if allows_stale {
            request.metadata_mut().insert("tidemap-allow-stale", "1".parse().expect("a value"));
        }
        let mut queries = v1::query_service_client::QueryServiceClient::new(self.channel().await);
        Ok(shown(queries.predict_states(request).await?.metadata()))
    }
}

#[tokio::test]
async fn the_writer_answers_for_a_map_that_is_being_opened() {
    let (a, _unopened, b) = opening_and_writer().await;
    for refused in [a.predict(false, None).await.map(drop), a.add_state("window").await.map(drop)] {
        let refused = refused.expect_err("no writer is known");
        assert_eq!(reason(&refused), (Code::Unavailable, "NO_WRITER".to_owned()), "{refused:?}");
    }
    *a.known.writer_of_held.lock().expect("not poisoned") = Some("b".to_owned());
    a.add_state("window").await.expect("the writer takes it");
    assert_eq!(b.handle().view().len(), 1, "it did not wait here");
    assert_eq!(a.states(None).await.expect("the writer responds").0, ["window"]);
    let unknown = a.predict(false, None).await.expect_err("the writer has no door");
    assert_eq!(reason(&unknown), (Code::NotFound, "UNKNOWN_STATE".to_owned()));
    assert_eq!(a.predict(true, None).await.expect("this daemon has one").generation, 1);
}

#[tokio::test]
async fn what_was_seen_of_a_map_that_is_gone_is_asked_of_none_that_has_its_name() {
    let (a, _unopened, _b) = opening_and_writer().await;
    let shown = a.predict(true, None).await.expect("it may be old");
    assert_eq!((shown.map_uid, shown.generation), (UID, 1));
    let before = ReadToken { map_uid: UID + 1, position: 500, generation: 9 };
    assert_eq!(a.predict(true, Some(before)).await.expect("another map"), shown);
    let more = a.predict(true, Some(ReadToken { map_uid: UID, ..before })).await.expect_err("nobody has so much");
    assert_eq!(more.code(), Code::Unavailable, "{more:?}");
}

#[tokio::test]
async fn a_follower_that_does_not_know_the_writer_asks_the_cluster() {
    let (a, b) = Member::pair().await;
    a.notify(ReplicaEvent::Following { writer: None }).await;
    *a.known.writer_of_held.lock().expect("not poisoned") = Some("b".to_owned());
    a.add_state("door").await.expect("the writer takes it");
    assert_eq!(b.handle().view().len(), 1);
}
