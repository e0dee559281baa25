//! Tests when a save is due, and what happens to the history of unsaved snapshots.

use tidemap_map::ids::StateId;
use tidemap_model::Sample;

use super::*;
use crate::writer::tests::{NOON, saves::snapshot};

impl Saves {
    pub(in crate::writer) fn set_history_bytes(&mut self, bytes: usize) {
        self.history_bytes = bytes;
    }

    pub(in crate::writer) fn history_bytes(&self) -> usize {
        self.history_bytes
    }

    pub(in crate::writer) fn forget_last_save(&mut self) {
        self.last_save = None;
    }

    pub(in crate::writer) fn failures(&self) -> u32 {
        self.failures
    }
}

fn saves() -> Saves {
    Saves::new(None, Arc::new(AtomicU64::new(0)))
}

/// A snapshot of the generation, with history of one observation.
fn of_generation(generation: u64) -> MapSnapshot {
    let states = vec![(StateId(0), vec![Sample { utc_nanos: NOON, offset_secs: 0, value: 1.0 }])];
    let piece = HistoryPiece { generation, from_nanos: NOON, to_nanos: NOON, states, ..HistoryPiece::new(generation) };
    MapSnapshot { generation, history: vec![Arc::new(piece)], ..snapshot() }
}

fn generations(saves: &Saves) -> Vec<u64> {
    saves.history().map(|piece| piece.generation).collect()
}

#[test]
fn failing_saves_are_tried_ever_more_rarely() {
    let secs: Vec<u64> = (1..9).map(|failures| retry_pause(failures).as_secs()).collect();
    assert_eq!(secs, [20, 40, 80, 160, 320, 600, 600, 600]);
    assert_eq!(retry_pause(u32::MAX).as_secs(), 600);
}

#[test]
fn a_save_is_due_after_its_interval_or_when_much_is_unsaved() {
    let mut saves = saves();
    let now = Instant::now();
    assert!(saves.is_due(now, 0), "the first save");
    saves.push(of_generation(1));
    assert!(saves.begin().is_some());
    saves.end(now, Ok(None));
    assert!(!saves.is_due(now, 0));
    assert!(saves.is_due(now, TAIL_BYTES) && saves.is_due(now + SAVE_INTERVAL, 0));
    saves.set_history_bytes(HISTORY_BYTES);
    assert!(saves.is_due(now, 0));
}

#[test]
fn after_a_failed_save_only_its_pause_counts() {
    let mut saves = saves();
    let now = Instant::now();
    saves.push(of_generation(1));
    let failed = saves.begin().expect("a snapshot");
    saves.end(now, Err(failed));
    saves.set_history_bytes(HISTORY_BYTES_MAX);
    assert!(saves.has_failed() && saves.is_history_too_large());
    assert!(!saves.is_due(now, TAIL_BYTES));
    assert!(saves.is_due(now + retry_pause(1), 0));
}

#[test]
fn history_is_kept_until_a_save_has_stored_it() {
    let mut saves = saves();
    saves.push(of_generation(1));
    // The next update needs the memory of the snapshot.
    saves.drop_unsaved();
    assert!(!saves.has_unsaved() && saves.begin().is_none());
    saves.push(of_generation(2));
    let first = saves.begin().expect("a snapshot");
    assert_eq!(first.history.iter().map(|piece| piece.generation).collect::<Vec<_>>(), [1, 2]);
    assert_eq!(generations(&saves), [1, 2], "while it is saved");
    saves.push(of_generation(3));
    assert!(saves.begin().is_none(), "one save at a time");
    saves.end(Instant::now(), Err(first));
    assert_eq!(generations(&saves), [1, 2, 3]);
    assert_eq!(saves.history_bytes(), saves.history().map(|piece| piece.bytes()).sum::<usize>());
    let second = saves.begin().expect("a snapshot");
    assert_eq!(second.generation, 3, "the newer snapshot, with the history of both");
    saves.end(Instant::now(), Ok(None));
    assert_eq!((generations(&saves), saves.history_bytes(), saves.failures()), (Vec::new(), 0, 0));
}

#[test]
fn history_of_a_save_that_could_not_begin_is_kept() {
    let mut saves = saves();
    saves.push(of_generation(1));
    assert!(saves.begin().is_some());
    saves.cancel();
    assert!(!saves.is_saving() && !saves.has_unsaved());
    assert_eq!(generations(&saves), [1]);
}
