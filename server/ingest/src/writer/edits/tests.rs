//! Tests the order of edits, and which clients get a reply.

use tidemap_map::{name::StateName, site::SiteEdit};
use tokio::sync::oneshot::{self, error::TryRecvError};

use super::*;

fn name(name: &str) -> StateName {
    StateName::new(name).expect("valid")
}

fn edit(location: &str) -> (EditSite, oneshot::Receiver<Result<(), EditSiteError>>) {
    let (reply, answer) = oneshot::channel();
    (EditSite { edit: SiteEdit::RemoveLocation(name(location)), reply }, answer)
}

#[test]
fn edits_are_taken_one_at_a_time_and_not_for_clients_that_have_gone() {
    let mut edits = Edits::default();
    let ((gone, answer), (first, _first), (second, _second)) = (edit("gone"), edit("first"), edit("second"));
    drop(answer);
    edits.waiting_edits.extend([gone, first, second]);
    let taken = edits.next().expect("an edit");
    assert_eq!(taken.edit, SiteEdit::RemoveLocation(name("first")));
    edits.is_in_flight = true;
    assert!(edits.next().is_none());
    edits.is_in_flight = false;
    assert!(edits.next().is_some());
}

#[test]
fn clients_are_answered_when_their_changes_are_public() {
    let mut edits = Edits::default();
    let ((edit, mut edited), (reply, mut added)) = (edit("hall"), oneshot::channel());
    edits.edited.push(edit.reply);
    edits.added.push(reply);
    let (reply, mut forgotten) = oneshot::channel();
    edits.forgotten.push((2, reply));
    assert!(matches!(forgotten.try_recv(), Err(TryRecvError::Empty)));
    assert!(matches!(edited.try_recv(), Err(TryRecvError::Empty)));
    edits.published();
    assert_eq!((edited.try_recv(), added.try_recv()), (Ok(Ok(())), Ok(Ok(()))));
    assert_eq!(forgotten.try_recv(), Ok(Ok(2)));
}
