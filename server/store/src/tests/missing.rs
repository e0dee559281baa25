//! Missing files that must exist are noticed: history files, maps, segments, and the log that is being written.

use std::{fs, path::Path, sync::Arc};

use rand::{SeedableRng as _, rngs::SmallRng};
use tidemap_map::{ids::StateId, snapshot::MapSnapshot, spec::MapSpec, training::ReadingsRequest};

use super::{
    example::{append, event, fill, options, spec as plain_spec},
    grid_example::{DAY_NANOS, piece, snapshot, spec},
};
use crate::{AppendError, HistoryError, MapId, Mode, OpenError, Store, check};

const MAP: MapId = MapId(1);
const FILE: &str = "maps/00000001/history/00000000000000000002.states.tmh";

/// A store whose map has the history of three days, each with a file of states.
pub(super) fn with_history(directory: &Path, spec: &MapSpec) -> Store {
    let mut random = SmallRng::seed_from_u64(77);
    let store = Store::open(directory, options()).expect("opens");
    store.create_map(spec).expect("creates");
    {
        let log = store.open_map(MAP, spec).expect("opens").log;
        for position in 1..=5 {
            append(&log, &event(position)).expect("appends");
        }
    }
    // Opened again, so that a test can open the map.
    drop(store);
    let store = Store::open(directory, options()).expect("opens");
    for generation in 1..=3 {
        let piece = Arc::new(piece(generation, 19_000 + generation as i32, &mut random));
        let newest_nanos = piece.to_nanos;
        let history = vec![piece];
        let snapshot = MapSnapshot { history, newest_nanos, generation, ..snapshot(spec, generation + 2, 2) };
        store.save(MAP, &snapshot).expect("saves");
    }
    store
}

#[test]
fn a_read_that_lacks_a_history_file_names_its_interval() {
    let directory = tempfile::tempdir().expect("temporary directory");
    let store = with_history(directory.path(), &spec("office"));
    let history = store.history(MAP).expect("known");
    let file = directory.path().join(FILE);
    let start = 19_001 * DAY_NANOS;
    let whole = history.state(StateId(0), 0, start).expect("whole");
    fs::remove_file(&file).expect("removable");

    let error = history.state(StateId(0), 0, i64::MAX).expect_err("lacks a file");
    let HistoryError::Missing { file: missing, from_nanos, to_nanos } = &error else { panic!("{error}") };
    assert_eq!(missing, &file);
    assert!(*from_nanos >= start + DAY_NANOS / 2 && from_nanos <= to_nanos, "{from_nanos} to {to_nanos}");
    assert!(!error.to_string().contains(directory.path().to_str().expect("text")), "{error}");
    let wanted = |from_nanos| [ReadingsRequest { state: StateId(0), from_nanos }];
    let files = history.state_files().expect("listed");
    assert!(matches!(files.readings(&wanted(i64::MIN)), Err(HistoryError::Missing { .. })));
    // Observations that the file did not hold are still found.
    files.readings(&wanted(to_nanos + 1)).expect("complete");
    assert_eq!(history.state(StateId(0), 0, start).expect("whole"), whole);

    fs::remove_file(file.with_file_name("00000000000000000002.grid.tmh")).expect("removable");
    let days: Result<Vec<_>, _> = history.grid_days(0, i64::MAX, None).collect();
    assert!(matches!(days, Err(HistoryError::Missing { .. })));
    // The map itself opens as before, and reports the same afterwards.
    store.open_map(MAP, &spec("office")).expect("opens");
    assert!(matches!(history.state(StateId(0), 0, i64::MAX), Err(HistoryError::Missing { .. })));
}

#[test]
fn a_removed_history_folder_is_no_empty_history() {
    let directory = tempfile::tempdir().expect("temporary directory");
    let history = with_history(directory.path(), &spec("office")).history(MAP).expect("known");
    fs::remove_dir_all(directory.path().join("maps/00000001/history")).expect("removable");
    assert!(matches!(history.state(StateId(0), 0, i64::MAX), Err(HistoryError::Missing { .. })));
    fs::remove_dir_all(directory.path().join("maps/00000001")).expect("removable");
    assert!(matches!(history.state(StateId(0), 0, i64::MAX), Err(HistoryError::Damaged { .. })));
}

#[test]
fn maps_that_are_missing_or_damaged_are_set_aside_and_the_others_serve() {
    let directory = tempfile::tempdir().expect("temporary directory");
    let store = Store::open(directory.path(), options()).expect("opens");
    let names = ["one", "two", "three"];
    let maps = names.map(|name| store.create_map(&plain_spec(name)).expect("creates"));
    drop(store);
    let folders = directory.path().join("maps");
    fs::remove_dir_all(folders.join("00000001")).expect("removable");
    let damaged = folders.join("00000002/MAP");
    fs::write(&damaged, "damaged").expect("writable");

    for _ in 0..2 {
        let store = Store::open(directory.path(), options()).expect("opens");
        let set_aside = store.set_aside();
        let found: Vec<_> = set_aside.iter().map(|map| (map.id, map.name.as_deref())).collect();
        assert_eq!(found, [(maps[0], Some("one")), (maps[1], Some("two"))]);
        assert!(set_aside[0].reason.contains("missing") && set_aside[1].reason.contains("MAP"), "{set_aside:?}");
        assert_eq!(store.maps().iter().map(|(map, _)| *map).collect::<Vec<_>>(), [maps[2]]);
        store.open_map(maps[2], &plain_spec("three")).expect("opens");
        assert_eq!(fs::read(&damaged).expect("there"), b"damaged");
    }
    // An operator who goes on without the maps deletes them.
    let store = Store::open(directory.path(), options()).expect("opens");
    store.delete_map(maps[0]).expect("deletes");
    store.delete_map(maps[1]).expect("deletes");
    drop(store);
    let store = Store::open(directory.path(), options()).expect("opens");
    assert_eq!((store.set_aside(), store.maps().len()), (vec![], 1));
    assert_eq!(store.create_map(&plain_spec("four")).expect("creates"), MapId(4));
}

#[test]
fn a_missing_newest_segment_is_refused() {
    let directory = tempfile::tempdir().expect("temporary directory");
    let example = fill(directory.path(), 60, &[], 300);
    let mut logs: Vec<_> = fs::read_dir(directory.path().join("maps/00000001/log"))
        .expect("readable")
        .map(|entry| entry.expect("entry").path())
        .filter(|path| path.extension().is_some_and(|extension| extension == "log"))
        .collect();
    logs.sort();
    let newest = logs.last().expect("several");
    let content = fs::read(newest).expect("readable");
    fs::remove_file(newest).expect("removable");
    assert!(matches!(example.check(directory.path()), Err(OpenError::CorruptLog { .. })));
    // Nor is it taken for one that was just being created.
    fs::write(newest, "").expect("writable");
    assert!(matches!(example.check(directory.path()), Err(OpenError::CorruptLog { .. })));
    fs::write(newest, content).expect("writable");
    example.check(directory.path()).expect("opens");
}

/// The harm that somebody does to the data folder of a running daemon.
#[derive(Clone, Copy, Debug, PartialEq)]
enum Harm {
    RemoveAll,
    ReplaceAll,
    CutLog,
    LengthenLog,
    EmptyLog,
    RemoveLock,
    ReplaceLock,
}

#[test]
fn a_folder_that_is_no_longer_ours_acknowledges_nothing() {
    use Harm::{CutLog, EmptyLog, LengthenLog, RemoveAll, RemoveLock, ReplaceAll, ReplaceLock};
    for harm in [RemoveAll, ReplaceAll, CutLog, LengthenLog, EmptyLog, RemoveLock, ReplaceLock] {
        let directory = tempfile::tempdir().expect("temporary directory");
        let folder = directory.path().join("data");
        let store = Store::open(&folder, options()).expect("opens");
        let map = store.create_map(&plain_spec("office")).expect("creates");
        let log = store.open_map(map, &plain_spec("office")).expect("opens").log;
        assert_eq!(append(&log, &event(1)), Ok(1));
        let segment = super::example::segment(&folder);
        let content = fs::read(&segment).expect("readable");
        let lock = folder.join("LOCK");
        assert_eq!(store.verify(), None, "{harm:?}");
        match harm {
            RemoveAll | ReplaceAll => {
                fs::remove_dir_all(&folder).expect("removable");
                if harm == ReplaceAll {
                    fs::create_dir_all(segment.parent().expect("has one")).expect("creatable");
                    fs::write(&segment, content).expect("writable");
                }
            }
            CutLog => fs::write(&segment, &content[..content.len() - 1]).expect("writable"),
            LengthenLog => fs::write(&segment, [&content[..], b"x"].concat()).expect("writable"),
            EmptyLog => fs::write(&segment, "").expect("writable"),
            RemoveLock => fs::remove_file(&lock).expect("removable"),
            ReplaceLock => {
                fs::remove_file(&lock).expect("removable");
                fs::write(&lock, "1").expect("writable");
            }
        }
        // Without an append it is noticed too; here only every other time.
        if (harm as usize).is_multiple_of(2) {
            assert!(matches!(store.verify(), Some(AppendError::Poisoned { .. })), "{harm:?}");
        }
        let error = append(&log, &event(2)).expect_err("it could not be found again");
        assert!(matches!(error, AppendError::Poisoned { .. }), "{harm:?}: {error}");
        assert!(!error.to_string().contains(folder.to_str().expect("text")), "{error}");
        if matches!(harm, RemoveLock | ReplaceLock) {
            assert!(error.to_string().contains("LOCK"), "{error}");
            let second = Store::open(&folder, options()).expect_err("a daemon uses the folder");
            assert!(matches!(second, OpenError::Locked { .. }), "{harm:?}: {second}");
            assert!(matches!(check(&folder, Mode::Look), Err(OpenError::Locked { .. })), "{harm:?}");
            assert!(store.save(map, &super::example::snapshot(&plain_spec("office"), 1, 1)).is_err());
            assert!(!folder.join("index.damaged-1").exists());
        }
    }
}

#[test]
fn a_missing_folder_of_checkpoints_comes_with_advice_and_an_empty_one_is_enough() {
    let directory = tempfile::tempdir().expect("temporary directory");
    let example = super::example::fill(directory.path(), 7, &[5], 64 << 20);
    let folder = directory.path().join("maps/00000001/checkpoints");
    fs::remove_dir_all(&folder).expect("removable");
    fs::remove_dir_all(directory.path().join("index")).expect("removable");
    let error = example.check(directory.path()).expect_err("refused").to_string();
    for words in ["maps/00000001/checkpoints is damaged: it is missing", "backup", "make an empty folder"] {
        assert!(error.contains(words), "{words:?} is not in {error}");
    }
    fs::create_dir(&folder).expect("a folder");
    let opened = example.check(directory.path()).expect("opens");
    assert_eq!((opened.source, opened.snapshot), (crate::Source::Log, None));
}
