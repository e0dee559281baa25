//! Life cycle of a store: opening, locking, formats, creating, deleting, closing.

use std::fs;

use tidemap_migrations::{
    FORMAT,
    manifest::{Manifest, ManifestError, to_text},
};

use super::example::{STORE_ID, append, content, event, fill, options, snapshot, spec};
use crate::{AppendError, MapId, OpenError, Source, Store, StoreError, StoreOptions};

#[test]
fn a_map_is_the_same_after_a_restart() {
    let directory = tempfile::tempdir().expect("temporary directory");
    let example = fill(directory.path(), 23, &[5, 10, 15], 64 << 20);
    let opened = example.check(directory.path()).expect("opens");
    assert_eq!(opened.source, Source::Checkpoint);
    assert_eq!(opened.repairs, []);
    assert_eq!(opened.snapshot.as_ref(), example.snapshots.last());
}

#[test]
fn a_map_without_a_snapshot_is_its_whole_log() {
    let directory = tempfile::tempdir().expect("temporary directory");
    let example = fill(directory.path(), 7, &[], 64 << 20);
    let opened = example.check(directory.path()).expect("opens");
    assert_eq!(opened.source, Source::Log);
    assert_eq!(opened.replay.records(), 7);
}

#[test]
fn short_segments_make_one_log() {
    let directory = tempfile::tempdir().expect("temporary directory");
    let example = fill(directory.path(), 60, &[20, 30], 300);
    assert!(fs::read_dir(directory.path().join("maps/00000001/log")).expect("readable").count() > 5);
    example.check(directory.path()).expect("opens");
}

#[test]
fn a_restarted_log_goes_on() {
    let directory = tempfile::tempdir().expect("temporary directory");
    let mut example = fill(directory.path(), 3, &[], 64 << 20);
    for end in 4..9 {
        let opened = example.check(directory.path()).expect("opens");
        drop(opened);
        let store = Store::open(directory.path(), options()).expect("opens");
        let opened = store.open_map(MapId(1), &example.spec).expect("opens");
        assert_eq!(append(&opened.log, &event(end)), Ok(end));
        example.end = end;
    }
    example.check(directory.path()).expect("opens");
}

#[test]
fn only_the_requested_number_of_checkpoints_is_kept() {
    let directory = tempfile::tempdir().expect("temporary directory");
    fill(directory.path(), 30, &[5, 10, 15, 20], 64 << 20);
    let folder = directory.path().join("maps/00000001/checkpoints");
    let mut names: Vec<_> =
        fs::read_dir(folder).expect("readable").map(|entry| entry.expect("entry").file_name()).collect();
    names.sort();
    assert_eq!(names, ["00000000000000000015.tmc", "00000000000000000020.tmc"]);
}

#[test]
fn a_second_opener_gets_the_name_of_the_first() {
    let directory = tempfile::tempdir().expect("temporary directory");
    let store = Store::open(directory.path(), options()).expect("opens");
    let before = content(directory.path());
    let error = Store::open(directory.path(), options()).expect_err("in use");
    assert!(matches!(error, OpenError::Locked { pid: Some(pid), .. } if pid == std::process::id()), "{error}");
    assert_eq!(content(directory.path()), before);
    // The first is unharmed.
    store.create_map(&spec("office")).expect("creates");
    drop(store);
    Store::open(directory.path(), options()).expect("free again");
}

#[test]
fn a_newer_format_is_refused_and_nothing_is_touched() {
    let directory = tempfile::tempdir().expect("temporary directory");
    fill(directory.path(), 5, &[5], 64 << 20);
    let manifest = Manifest { format: FORMAT + 1, store_id: STORE_ID.to_owned() };
    fs::write(directory.path().join("MANIFEST"), to_text(&manifest)).expect("writable");
    fs::write(directory.path().join("index/snap.0000.generating"), "left over").expect("writable");
    let before = content(directory.path());
    let error = Store::open(directory.path(), options()).expect_err("too new");
    let OpenError::Manifest(ManifestError::TooNew { found, supported, .. }) = &error else { panic!("{error}") };
    assert_eq!((*found, *supported), (FORMAT + 1, FORMAT));
    assert_eq!(content(directory.path()), before);
}

#[test]
fn maps_without_a_manifest_are_not_taken_for_a_new_directory() {
    let directory = tempfile::tempdir().expect("temporary directory");
    fill(directory.path(), 5, &[], 64 << 20);
    fs::remove_file(directory.path().join("MANIFEST")).expect("removable");
    let before = content(directory.path());
    let error = Store::open(directory.path(), options()).expect_err("no manifest");
    assert!(matches!(error, OpenError::ManifestMissing { .. }), "{error}");
    assert_eq!(content(directory.path()), before);
}

#[test]
fn a_first_start_that_ended_before_the_manifest_is_repeated() {
    let directory = tempfile::tempdir().expect("temporary directory");
    // The manifest cannot be written.
    let obstacle = directory.path().join("MANIFEST.new");
    fs::create_dir(&obstacle).expect("creatable");
    let error = Store::open(directory.path(), options()).expect_err("no manifest");
    assert!(matches!(error, OpenError::Manifest(ManifestError::Io { .. })), "{error}");
    assert!(directory.path().join("MAPS").exists());
    fs::remove_dir(&obstacle).expect("removable");
    assert_eq!(Store::open(directory.path(), options()).expect("opens").store_id(), STORE_ID);
}

#[test]
fn a_new_directory_needs_an_identity_and_is_created() {
    let directory = tempfile::tempdir().expect("temporary directory");
    let new = directory.path().join("a/b");
    let error = Store::open(&new, StoreOptions::default()).expect_err("no identity");
    assert!(matches!(error, OpenError::Manifest(ManifestError::StoreId(_))), "{error}");
    assert!(!new.exists());
    assert_eq!(Store::open(&new, options()).expect("opens").store_id(), STORE_ID);
    // The identity of the first time stays.
    assert_eq!(Store::open(&new, StoreOptions::default()).expect("opens").store_id(), STORE_ID);
}

#[test]
fn a_deleted_map_is_gone_and_its_number_is_never_given_again() {
    let directory = tempfile::tempdir().expect("temporary directory");
    let (spec_a, spec_b) = (spec("a"), spec("b"));
    {
        let store = Store::open(directory.path(), options()).expect("opens");
        let (a, b) = (store.create_map(&spec_a).expect("creates"), store.create_map(&spec_b).expect("creates"));
        let opened = store.open_map(a, &spec_a).expect("opens");
        store.open_map(b, &spec_b).expect("opens");
        append(&opened.log, &event(1)).expect("appends");
        for map in [a, b] {
            store.save(map, &snapshot(&spec_a, 0, 3)).expect("saves");
        }
        store.delete_map(a).expect("deletes");
        assert_eq!(append(&opened.log, &event(2)), Err(AppendError::Closed));
        assert!(matches!(store.delete_map(a), Err(StoreError::UnknownMap(MapId(1)))));
        assert!(matches!(store.save(a, &snapshot(&spec_a, 0, 3)), Err(StoreError::UnknownMap(MapId(1)))));
        assert!(matches!(store.open_map(a, &spec_a), Err(OpenError::UnknownMap(MapId(1)))));
        assert_eq!(store.maps(), [(b, spec_b.clone())]);
        let names: Vec<_> = fs::read_dir(directory.path().join("maps")).expect("there").collect();
        assert_eq!(names.len(), 1, "a deleted map leaves no folder: {names:?}");
    }
    let store = Store::open(directory.path(), options()).expect("opens");
    let opened = store.open_map(MapId(2), &spec_b).expect("opens");
    assert_eq!(opened.source, Source::Checkpoint, "the other map is untouched");
    store.delete_map(MapId(2)).expect("deletes");
    drop((store, opened));
    let store = Store::open(directory.path(), options()).expect("opens");
    assert_eq!(store.create_map(&spec_a).expect("creates"), MapId(3));
}

#[test]
fn a_map_that_was_moved_away_leaves_nothing_behind() {
    let directory = tempfile::tempdir().expect("temporary directory");
    let example = fill(directory.path(), 5, &[5], 64 << 20);
    fs::remove_dir_all(directory.path().join("maps/00000001")).expect("removable");
    let store = Store::open(directory.path(), options()).expect("opens");
    let map = store.create_map(&example.spec).expect("creates");
    let opened = store.open_map(map, &example.spec).expect("opens");
    assert_eq!((opened.source, opened.snapshot), (Source::Empty, None));
}

#[test]
fn interrupted_creations_and_deletions_are_finished() {
    let directory = tempfile::tempdir().expect("temporary directory");
    let example = fill(directory.path(), 5, &[5], 64 << 20);
    let maps = directory.path().join("maps");
    fs::create_dir_all(maps.join("00000002.new/log")).expect("writable");
    fs::create_dir_all(maps.join("00000003.deleted/log")).expect("writable");
    fs::write(maps.join("00000003.deleted/MAP"), "rest").expect("writable");
    example.check(directory.path()).expect("opens");
    assert!(!maps.join("00000002.new").exists());
    assert!(!maps.join("00000003.deleted").exists());
    let store = Store::open(directory.path(), options()).expect("opens");
    assert_eq!(store.create_map(&spec("new")).expect("creates"), MapId(4));
}

#[test]
fn a_map_is_opened_once_and_a_closed_store_accepts_nothing() {
    let directory = tempfile::tempdir().expect("temporary directory");
    let store = Store::open(directory.path(), options()).expect("opens");
    let spec = spec("office");
    let map = store.create_map(&spec).expect("creates");
    let opened = store.open_map(map, &spec).expect("opens");
    assert!(matches!(store.open_map(map, &spec), Err(OpenError::AlreadyOpen(MapId(1)))));
    append(&opened.log, &event(1)).expect("appends");
    assert!(opened.log.tail_bytes() > 0);
    assert!(store.sizes(map).log_bytes > 32);
    assert_eq!(store.sync_stats().count, 1);
    store.close();
    store.close();
    assert_eq!(append(&opened.log, &event(2)), Err(AppendError::Closed));
}

#[test]
fn the_tail_is_what_no_snapshot_covers() {
    let directory = tempfile::tempdir().expect("temporary directory");
    let store = Store::open(directory.path(), options()).expect("opens");
    let spec = spec("office");
    let map = store.create_map(&spec).expect("creates");
    let log = store.open_map(map, &spec).expect("opens").log;
    for position in 1..=5 {
        append(&log, &event(position)).expect("appends");
    }
    store.save(map, &snapshot(&spec, 5, 3)).expect("saves");
    assert_eq!(log.tail_bytes(), 0);
    append(&log, &event(6)).expect("appends");
    let tail = log.tail_bytes();
    assert!(tail > 0);
    drop((store, log));
    let store = Store::open(directory.path(), options()).expect("opens");
    assert_eq!(store.open_map(map, &spec).expect("opens").log.tail_bytes(), tail);
}

#[test]
fn an_event_that_could_not_be_read_back_is_not_written() {
    let directory = tempfile::tempdir().expect("temporary directory");
    let store = Store::open(directory.path(), options()).expect("opens");
    let spec = spec("office");
    let map = store.create_map(&spec).expect("creates");
    let log = store.open_map(map, &spec).expect("opens").log;
    let tidemap_map::event::Event::Observations(envelope, good) = event(1) else { panic!("observations") };
    for value in [-f64::NAN, -1.1e12, 1e300, f64::INFINITY] {
        let mut bad = good.clone();
        bad.values[0] = value;
        let error = append(&log, &tidemap_map::event::Event::Observations(envelope.clone(), bad));
        assert!(matches!(error, Err(AppendError::InvalidEvent(_))), "{value}");
    }
    let mut bad = good.clone();
    bad.times_nanos.pop();
    let error = append(&log, &tidemap_map::event::Event::Observations(envelope.clone(), bad));
    assert!(matches!(error, Err(AppendError::InvalidEvent(_))));
    assert_eq!(append(&log, &event(1)), Ok(1), "the log goes on");
}
