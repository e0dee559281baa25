//! When a writer saves, and what it does while saves fail.

use std::sync::atomic::AtomicU64;

use tidemap_map::event::Event;

use super::{super::saving::retry_pause, queue::bare, *};
use crate::ingest::updates::Wanted;

/// What an update of an empty map leaves to be saved.
fn snapshot() -> MapSnapshot {
    let mut map = LiveMap::new(Arc::new(spec_with(None)));
    let start = map.plan_update(None, NOON, UpdateCause::Request);
    let work = map.apply(1, &Event::UpdateStart(start)).expect("consistent").expect("an update");
    map.finish_update(work.run(&AtomicU64::new(0)).expect("in memory"))
}

#[test]
fn failing_saves_are_tried_ever_more_rarely() {
    let secs: Vec<u64> = (1..9).map(|failures| retry_pause(failures).as_secs()).collect();
    assert_eq!(secs, [20, 40, 80, 160, 320, 600, 600, 600]);
    assert_eq!(retry_pause(u32::MAX).as_secs(), 600);
}

#[tokio::test]
async fn a_save_that_has_failed_waits_and_holds_no_update_up() {
    let dir = tempfile::tempdir().expect("temporary folder");
    let mut bare = bare(dir.path(), NOON, None);
    let mut robot = bare.robot("r").await;
    bare.observe(&mut robot, vec![NOON]);
    bare.go_on(|writer| writer.flights.is_empty());
    let writer = &mut bare.writer;
    assert!(writer.is_save_due());
    writer.history_bytes = usize::MAX;
    writer.saved(Err(("the disk is full".to_owned(), snapshot())));
    assert_eq!(writer.history_bytes, 0, "counted anew");
    // However much there is to be saved.
    writer.history_bytes = usize::MAX;
    assert!(!writer.is_save_due() && writer.unsaved.is_some());
    writer.pump();
    assert!(!writer.saving);
    assert!(*writer.saturated.borrow(), "streams wait while history cannot be saved");
    // As if its time had come: an update goes first all the same, and what is unsaved is kept until it starts.
    writer.last_save = None;
    assert!(writer.is_save_due());
    let job = bare.bench.jobs.create(bare.handle.spec.name.clone(), UpdateCause::Request, NOON);
    writer.updates.push(Wanted { until_nanos: None, cause: UpdateCause::Request, job });
    writer.pump();
    assert!(writer.is_update_starting() && !writer.saving && writer.unsaved.is_some());
    bare.go_on(|writer| writer.map.generation() == 1 && !writer.saving);
    assert_eq!(bare.writer.save_failures, 0, "the save of the update has gone well");
    assert!(bare.writer.unsaved.is_none() && !*bare.writer.saturated.borrow());
}

#[tokio::test]
async fn no_save_starts_while_the_writer_stops() {
    let dir = tempfile::tempdir().expect("temporary folder");
    let mut bare = bare(dir.path(), NOON, None);
    bare.writer.keep_unsaved(snapshot());
    assert!(bare.writer.is_save_due());
    let (done, _stopped) = oneshot::channel();
    bare.writer.handle(Command::Stop { ending: Ending::MapDeleted, done });
    bare.writer.pump();
    assert!(!bare.writer.saving && bare.writer.unsaved.is_some());
}
