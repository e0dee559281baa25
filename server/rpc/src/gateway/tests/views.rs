//! Queries that are fresh enough, and never show less than their client has seen.

use tidemap_ingest::protocol::Command;
use tidemap_map::event::{Event, NewState, StateKind};
use tidemap_map::{ids::StateId, name::StateName};
use tokio::sync::oneshot;

use super::*;

impl Member {
    /// Applies events that another daemon has written: states with these names, from this log position on.
    async fn follow(&self, position: u64, names: &[&str]) {
        let event = |(number, name): (u64, &&str)| {
            let state = NewState {
                id: StateId(u32::try_from(position + number - 1).expect("few")),
                name: StateName::new(name).expect("valid"),
                shape: StateKind::Probability.into(),
                labels: Vec::new(),
                sensor: None,
                reporting: Default::default(),
            };
            (position + number, Event::AddState(state))
        };
        let (applied, is_applied) = oneshot::channel();
        let events = (0..).zip(names).map(event).collect();
        self.handle().send(Command::Replica(ReplicaEvent::Followed { events, applied }));
        is_applied.await.expect("applied");
    }
}

fn at(position: u64) -> Option<ReadToken> {
    Some(ReadToken { map_uid: 0, position, generation: 0 })
}

#[tokio::test]
async fn a_follower_answers_with_the_state_of_its_copy() {
    let (a, b) = Member::pair().await;
    b.add_state("elsewhere").await.expect("added");
    a.follow(1, &["door", "window"]).await;
    let (states, shown) = a.states(None).await.expect("daemon a responds");
    assert_eq!((states, shown), (vec!["door".to_owned(), "window".to_owned()], at(2).expect("a token")));
    assert_eq!(a.states(at(2)).await.expect("it shows that").0, ["door", "window"]);
}

#[tokio::test]
async fn a_follower_without_contact_to_the_log_refuses_unless_that_is_allowed() {
    let (a, _b) = Member::pair().await;
    a.follow(1, &["door"]).await;
    *a.known.last_contact.lock().expect("not poisoned") = None;
    let refused = a.states(None).await.expect_err("stale");
    assert_eq!(reason(&refused), (Code::Unavailable, "STALE".to_owned()));
    let mut request = tonic::Request::new(v1::ListStatesRequest { map: "office".to_owned(), ..Default::default() });
    request.metadata_mut().insert("tidemap-allow-stale", "1".parse().expect("a value"));
    assert_eq!(a.maps().await.list_states(request).await.expect("allowed").into_inner().states.len(), 1);
}

#[tokio::test]
async fn a_follower_that_is_behind_waits_for_what_its_client_has_seen() {
    let (a, _b) = Member::pair().await;
    let (answer, ()) = tokio::join!(a.states(at(1)), async {
        tokio::time::sleep(Duration::from_millis(20)).await;
        a.follow(1, &["door"]).await;
    });
    // The writer has no states: it would not have answered this.
    assert_eq!(answer.expect("an answer").0, ["door"]);
}

#[tokio::test]
async fn a_follower_that_stays_behind_asks_the_writer() {
    let (a, b) = Member::pair().await;
    b.add_state("door").await.expect("added");
    let seen = shown(b.add_state("window").await.expect("added").metadata());
    let (states, shown) = a.states(Some(seen)).await.expect("the writer responds");
    assert_eq!(states, ["door", "window"]);
    assert!(shown.reaches(seen), "{shown:?} {seen:?}");
    assert!(a.states(None).await.expect("without a token").0.is_empty());
    let unseen = ReadToken { generation: 9, ..seen };
    let refused = a.states(Some(unseen)).await.expect_err("nobody has it");
    assert_eq!(reason(&refused), (Code::Unavailable, "BEHIND".to_owned()));
}

#[tokio::test]
async fn what_is_no_token_is_refused() {
    let (a, _b) = Member::pair().await;
    let mut request = tonic::Request::new(v1::ListStatesRequest { map: "office".to_owned(), ..Default::default() });
    let value = tonic::metadata::MetadataValue::from_bytes(b"short");
    request.metadata_mut().insert_bin("tidemap-at-least-bin", value);
    let refused = a.maps().await.list_states(request).await.expect_err("no token");
    assert_eq!(refused.code(), Code::InvalidArgument);
}
