//! Tests which handover may be taken next.

use tokio::sync::Semaphore;

use super::*;
use crate::protocol::{BufferBudget, ObservationBatch, ReportBatch};

impl Backlog {
    pub(in crate::writer) fn len(&self) -> usize {
        self.handovers.len()
    }

    pub(in crate::writer) fn oldest(&self) -> Option<&StreamData> {
        self.handovers.front().map(|(_, handover)| handover)
    }

    pub(in crate::writer) fn newest(&self) -> Option<&StreamData> {
        self.handovers.back().map(|(_, handover)| handover)
    }
}

fn budget() -> BufferBudget {
    let permit = || Arc::new(Semaphore::new(1)).try_acquire_owned().expect("free");
    vec![permit(), permit()]
}

const A: SessionId = SessionId(1);
const B: SessionId = SessionId(2);

#[test]
fn handovers_are_taken_in_their_order_and_when_there_is_room() {
    let mut backlog = Backlog::default();
    backlog.push(A, StreamData::Observations(ObservationBatch::default(), budget()));
    backlog.push(B, StreamData::End { clean: true });
    assert!(backlog.next(false, false).is_none(), "the end of B waits behind the observations of A");
    assert!(matches!(backlog.next(true, false), Some((A, StreamData::Observations(..)))));
    assert!(matches!(backlog.next(false, true), Some((B, StreamData::End { clean: true }))), "an end needs no room");
    assert!(backlog.is_empty() && backlog.next(true, false).is_none());
}

#[test]
fn traversals_wait_while_the_site_changes() {
    let mut backlog = Backlog::default();
    backlog.push(A, StreamData::Reports(ReportBatch::default(), budget()));
    assert!(backlog.next(true, true).is_none());
    assert!(backlog.next(false, false).is_none());
    assert!(backlog.next(true, false).is_some());
}

#[test]
fn the_end_of_a_stream_is_found_behind_its_observations() {
    let mut backlog = Backlog::default();
    backlog.push(A, StreamData::Observations(ObservationBatch::default(), budget()));
    assert!(backlog.has(A) && !backlog.has_end(A) && !backlog.has(B));
    backlog.push(A, StreamData::End { clean: false });
    assert!(backlog.has_end(A) && !backlog.has_end(B));
    backlog.clear();
    assert!(!backlog.has(A));
}
