//! Tests failures of appends, and the memory of appends in flight.

use tidemap_grid::{index::TileIndex, scan::Scans};
use tidemap_map::{
    event::{Envelope, SequenceSpan, UpdateCause, UpdateStart},
    ids::ProducerId,
    name::MapName,
};

use super::*;
use crate::jobs::Jobs;

impl Appends {
    pub(in crate::writer) fn set_bytes_max(&mut self, bytes: usize) {
        self.bytes_max = bytes;
    }

    pub(in crate::writer) fn bytes(&self) -> usize {
        self.bytes
    }

    pub(in crate::writer) fn len(&self) -> usize {
        self.in_flight.len()
    }

    /// Whether all appends in flight are starts of updates.
    pub(in crate::writer) fn are_update_starts(&self) -> bool {
        self.in_flight.iter().all(|append| matches!(append, InFlight::UpdateStart { .. }))
    }
}

fn update(generation: u64) -> InFlight {
    let job = Jobs::default().create(MapName::new("office").expect("valid"), UpdateCause::Request, 0);
    let event = Event::UpdateStart(UpdateStart { generation, cut_nanos: 0, cause: UpdateCause::Request });
    InFlight::UpdateStart { event, job }
}

fn scans(new_tiles: usize) -> InFlight {
    let event = Event::Scans(
        Envelope {
            producer: ProducerId(0),
            new_producer: None,
            incarnation: 1,
            span: SequenceSpan { first: 1, last: 1, content_crc: 0 },
            received_nanos: 0,
            refused: Vec::new(),
        },
        Scans { new_tiles: vec![TileIndex::default(); new_tiles], scans: Vec::new(), ..Scans::default() },
    );
    let permit = || Arc::new(tokio::sync::Semaphore::new(1)).try_acquire_owned().expect("free");
    let _budget = Arc::new(vec![permit(), permit()]);
    InFlight::Stream { session: SessionId(1), event, refused: Vec::new(), tiles_ahead: 0, _budget }
}

fn generations(appends: &[InFlight]) -> Vec<u64> {
    let generation = |append: &InFlight| match append.event() {
        Event::UpdateStart(start) => start.generation,
        _ => 0,
    };
    appends.iter().map(generation).collect()
}

#[test]
fn appends_behind_a_failure_fail_with_it_and_in_order() {
    let mut appends = Appends::default();
    (1..=2).for_each(|generation| appends.push(update(generation)));
    // The log refuses the third append at once, because the first has failed; the completion of the first is
    // outstanding.
    assert!(appends.fail(AppendError::AfterFailure, update(3)).is_none());
    assert!(appends.failure().is_none() && !appends.has_room());
    let first = appends.pop().expect("in flight");
    let failure = appends.fail(AppendError::DiskFull, first).expect("the failure");
    assert_eq!((failure.cause, failure.is_first, failure.is_newly_fatal), (AppendError::DiskFull, true, false));
    assert_eq!(generations(&failure.appends), [1, 3]);
    assert!(!appends.end_failure(), "the second gets no reply");
    let second = appends.pop().expect("in flight");
    let failure = appends.fail(AppendError::AfterFailure, second).expect("the failure");
    assert_eq!(
        (failure.cause, failure.is_first),
        (AppendError::DiskFull, false),
        "all fail because of the first error"
    );
    assert!(appends.end_failure() && appends.failure().is_none() && appends.has_room());
    assert!(!appends.end_failure());
}

#[test]
fn a_fatal_error_replaces_one_that_is_not() {
    let fatal = AppendError::Poisoned { file: "log".into(), reason: "sync".to_owned() };
    let mut appends = Appends::default();
    appends.push(update(1));
    assert!(appends.fail(AppendError::DiskFull, update(2)).is_some_and(|failure| !failure.is_newly_fatal));
    let failure = appends.fail(fatal.clone(), update(3)).expect("a failure");
    assert_eq!((failure.cause, failure.is_first, failure.is_newly_fatal), (fatal.clone(), false, true));
    let failure = appends.fail(fatal, update(4)).expect("a failure");
    assert!(!failure.is_newly_fatal, "reported once");
}

#[test]
fn scans_in_flight_are_limited_by_their_memory() {
    let mut appends = Appends::default();
    appends.set_bytes_max(10 * size_of::<TileIndex>());
    appends.push(scans(10));
    assert!(appends.has_room());
    appends.push(scans(1));
    assert!(!appends.has_room());
    assert!(appends.pop().is_some() && appends.has_room());
    assert!(appends.pop().is_some() && appends.is_empty());
    assert_eq!(appends.bytes(), 0);
}
