//! Tests when a writer saves, and what it does while saves fail.

use std::sync::atomic::AtomicU64;

use tidemap_map::event::Event;

use super::{backlog::bare, *};
use crate::update_schedule::DueUpdate;

/// The unsaved snapshot of an update of an empty map.
pub(in super::super) fn snapshot() -> MapSnapshot {
    let mut map = LiveMap::new(Arc::new(spec_with(None)));
    let start = map.plan_update(None, NOON, UpdateCause::Request);
    let work = map.apply(1, &Event::UpdateStart(start)).expect("consistent").expect("an update");
    map.finish_update(work.run(&AtomicU64::new(0)).expect("in memory"))
}

#[tokio::test]
async fn a_save_that_has_failed_waits_and_holds_no_update_up() {
    let dir = tempfile::tempdir().expect("temporary folder");
    let mut bare = bare(dir.path(), NOON, None);
    let mut robot = bare.robot("r").await;
    bare.observe(&mut robot, vec![NOON]);
    bare.go_on(|writer| writer.appends.is_empty());
    let writer = &mut bare.writer;
    assert!(writer.is_save_due());
    writer.saves.set_history_bytes(usize::MAX);
    writer.saved(Err(("the disk is full".to_owned(), snapshot())));
    assert_eq!(writer.saves.history_bytes(), 0, "counted anew");
    // This holds for any amount of unsaved history.
    writer.saves.set_history_bytes(usize::MAX);
    assert!(!writer.is_save_due() && writer.saves.has_unsaved());
    writer.pump();
    assert!(!writer.saves.is_saving());
    assert!(*writer.saturated.borrow(), "streams wait while history cannot be saved");
    // The retry is now due: an update still goes first, and the unsaved snapshot is kept until it starts.
    writer.saves.forget_last_save();
    assert!(writer.is_save_due());
    let job = bare.bench.jobs.create(bare.handle.spec.name.clone(), UpdateCause::Request, NOON);
    writer.updates.schedule.push(DueUpdate { until_nanos: None, cause: UpdateCause::Request, job });
    writer.pump();
    assert!(writer.appends.is_update_starting() && !writer.saves.is_saving() && writer.saves.has_unsaved());
    bare.go_on(|writer| writer.map.generation() == 1 && !writer.saves.is_saving());
    assert_eq!(bare.writer.saves.failures(), 0, "the save of the update has gone well");
    assert!(!bare.writer.saves.has_unsaved() && !*bare.writer.saturated.borrow());
}

#[tokio::test]
async fn no_save_starts_while_the_writer_stops() {
    let dir = tempfile::tempdir().expect("temporary folder");
    let mut bare = bare(dir.path(), NOON, None);
    bare.writer.saves.push(snapshot());
    assert!(bare.writer.is_save_due());
    let (done, _stopped) = oneshot::channel();
    bare.writer.handle(Command::Stop { ending: Ending::MapDeleted, done });
    bare.writer.pump();
    assert!(!bare.writer.saves.is_saving() && bare.writer.saves.has_unsaved());
}
