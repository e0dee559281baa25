//! The beginning of the log is deleted once checkpoints and history hold its content.

use std::{fs, path::Path};

use super::example::{Example, append, event, fill, options, segment, snapshot, spec};
use crate::{OpenError, Repair, Source, Store, StoreOptions};

/// First positions of the segments.
fn segments(directory: &Path) -> Vec<u64> {
    let mut all: Vec<u64> = fs::read_dir(directory.join("maps/00000001/log"))
        .expect("readable")
        .filter_map(|entry| crate::log::segment_position(entry.expect("entry").file_name().to_str()?))
        .collect();
    all.sort_unstable();
    all
}

fn checkpoints(directory: &Path) -> Vec<std::path::PathBuf> {
    let mut all: Vec<_> = fs::read_dir(directory.join("maps/00000001/checkpoints"))
        .expect("readable")
        .map(|entry| entry.expect("entry").path())
        .collect();
    all.sort();
    all
}

#[test]
fn segments_that_every_checkpoint_covers_are_deleted() {
    let directory = tempfile::tempdir().expect("temporary directory");
    let example = fill(directory.path(), 60, &[20, 40], 300);
    let left = segments(directory.path());
    // The older of the two replays from record 18.
    assert!(left[0] > 1 && left[0] <= 18 && left[1] > 18, "{left:?}");
    let opened = example.check(directory.path()).expect("opens");
    assert_eq!((opened.source, opened.repairs), (Source::Checkpoint, vec![]));
    assert!(!segment(directory.path()).exists());
}

#[test]
fn one_checkpoint_alone_deletes_nothing() {
    let directory = tempfile::tempdir().expect("temporary directory");
    fill(directory.path(), 60, &[40], 300);
    assert_eq!(segments(directory.path())[0], 1);
}

#[test]
fn the_newest_segment_stays_and_the_log_goes_on() {
    let directory = tempfile::tempdir().expect("temporary directory");
    let spec = spec("office");
    let store = Store::open(directory.path(), StoreOptions { segment_bytes: 1, ..options() }).expect("opens");
    let map = store.create_map(&spec).expect("creates");
    let log = store.open_map(map, &spec).expect("opens").log;
    let mut example = Example { spec, snapshots: Vec::new(), end: 0 };
    for position in 1..=20 {
        append(&log, &event(position)).expect("appends");
        let mut saved = snapshot(&example.spec, position, 3);
        saved.replay_from = position + 1;
        store.save(map, &saved).expect("saves");
        example.snapshots.push(saved);
        example.end = position;
        assert!(segments(directory.path()).contains(&position));
    }
    // Each record has a segment of its own; the older checkpoint replays from the last one.
    assert_eq!(segments(directory.path()), [20]);
    drop((store, log));
    example.check(directory.path()).expect("opens");
    {
        let store = Store::open(directory.path(), options()).expect("opens");
        let opened = store.open_map(map, &example.spec).expect("opens");
        assert_eq!(append(&opened.log, &event(21)), Ok(21));
    }
    example.end = 21;
    example.check(directory.path()).expect("opens");
}

#[test]
fn a_damaged_checkpoint_is_replaced_by_the_one_before() {
    let directory = tempfile::tempdir().expect("temporary directory");
    let example = fill(directory.path(), 60, &[20, 40], 300);
    fs::remove_dir_all(directory.path().join("index")).expect("removable");
    fs::write(&checkpoints(directory.path())[1], "nonsense").expect("writable");
    let opened = example.check(directory.path()).expect("opens");
    assert_eq!(opened.snapshot.as_ref(), Some(&example.snapshots[0]));
    assert!(opened.repairs.iter().any(|repair| matches!(repair, Repair::CheckpointSetAside { .. })));
}

#[test]
fn without_its_beginning_a_log_is_not_opened_when_all_checkpoints_are_damaged() {
    let directory = tempfile::tempdir().expect("temporary directory");
    let example = fill(directory.path(), 60, &[20, 40], 300);
    fs::remove_dir_all(directory.path().join("index")).expect("removable");
    for file in checkpoints(directory.path()) {
        fs::write(file, "nonsense").expect("writable");
    }
    let before = super::example::content(&directory.path().join("maps"));
    match example.check(directory.path()) {
        Err(OpenError::Damaged { file, reason }) => {
            assert!(file.ends_with("maps/00000001/checkpoints"), "{}", file.display());
            assert!(reason.contains("begins at record"), "{reason}");
        }
        Err(other) => panic!("expected damaged checkpoints, not {other}"),
        Ok(_) => panic!("a map without its beginning was opened"),
    }
    assert!(super::example::content(&directory.path().join("maps")) == before, "something was changed");
    // The map is not opened even after the checkpoints were removed by hand.
    for file in checkpoints(directory.path()) {
        fs::remove_file(file).expect("removable");
    }
    assert!(matches!(example.check(directory.path()), Err(OpenError::CorruptLog { position: 1, .. })));
}
