//! Backups of a store in use, their way back, and checks that find every damage.

use std::{fs, ops::RangeInclusive, path::Path};

use tidemap_map::spec::MapSpec;

use super::{
    example::{append, event, fill, options, snapshot, spec},
    missing::with_history,
};
use crate::{
    BackupError, MapId, MapLog, Mode, Outcome, Store, StoreOptions, check, is_backup_of, link_backup, restore,
};

const MAP: MapId = MapId(1);
const OTHER_ID: &str = "ffffffffffffffffffffffffffffffff";

fn files(folder: &Path) -> Vec<String> {
    let mut found = Vec::new();
    for entry in fs::read_dir(folder).expect("readable") {
        let path = entry.expect("entry").path();
        if path.is_dir() { found.extend(files(&path)) } else { found.push(path.display().to_string()) }
    }
    found.sort();
    found
}

fn append_all(log: &MapLog, positions: RangeInclusive<u64>) {
    for position in positions {
        append(log, &event(position)).expect("appends");
    }
}

/// A new store with a map of short segments and 20 records.
fn in_use(data: &Path, spec: &MapSpec) -> (Store, MapLog) {
    let store = Store::open(data, StoreOptions { segment_bytes: 300, ..options() }).expect("opens");
    assert_eq!(store.create_map(spec).expect("creates"), MAP);
    let log = store.open_map(MAP, spec).expect("opens").log;
    append_all(&log, 1..=20);
    (store, log)
}

#[test]
fn a_backup_of_a_store_in_use_is_restored_elsewhere() {
    let work = tempfile::tempdir().expect("temporary directory");
    let [data, backup, restored] = ["data", "backup", "restored"].map(|name| work.path().join(name));
    let spec = spec("office");
    let (store, log) = in_use(&data, &spec);
    store.save(MAP, &snapshot(&spec, 10, 2)).expect("saves");
    let first = store.backup(&backup).expect("backs up");
    assert_eq!((first.maps, first.kept_files), (1, 0));

    append_all(&log, 21..=30);
    store.save(MAP, &snapshot(&spec, 25, 3)).expect("saves");
    let second = store.backup(&backup).expect("backs up");
    assert!(second.kept_files > 0 && second.copied_files < first.copied_files + 10, "{second:?}");
    // A change after the backup is not in it.
    append(&log, &event(31)).expect("appends");
    let third = store.backup(&work.path().join("whole")).expect("backs up");
    assert!(third.copied_bytes > second.copied_bytes, "{second:?} {third:?}");

    let repair = restore(&backup, &restored, OTHER_ID).expect("restores");
    assert_eq!(repair.maps, 1);
    let copy = Store::open(&restored, options()).expect("opens");
    assert_eq!((copy.store_id(), copy.repairs()), (OTHER_ID, &[][..]));
    let opened = copy.open_map(MAP, &spec).expect("opens");
    assert_eq!((opened.log.end(), opened.snapshot), (30, Some(snapshot(&spec, 25, 3))));
    let events: Vec<_> = opened.replay.map(|entry| entry.expect("whole").0).collect();
    assert_eq!(events.last(), Some(&30));
    assert_eq!(append(&opened.log, &event(31)), Ok(31));

    // A deleted map leaves the next backup.
    store.delete_map(MAP).expect("deletes");
    store.backup(&backup).expect("backs up");
    assert!(files(&backup).iter().all(|file| !file.contains("00000001")), "{:?}", files(&backup));
}

#[test]
fn a_backup_that_begins_with_the_files_of_another_leaves_that_as_it_is() {
    let work = tempfile::tempdir().expect("temporary directory");
    let [data, first, second] = ["data", "first", "second"].map(|name| work.path().join(name));
    let spec = spec("office");
    let (store, log) = in_use(&data, &spec);
    store.save(MAP, &snapshot(&spec, 10, 2)).expect("saves");
    store.backup(&first).expect("backs up");
    assert!(is_backup_of(&first, store.store_id()) && !is_backup_of(&first, OTHER_ID));
    let before: Vec<(String, Vec<u8>)> =
        files(&first).into_iter().map(|file| (file.clone(), fs::read(file).expect("readable"))).collect();
    // A partial file that an interrupted copy left is not shared, because the next copy writes into it.
    let part = first.join("maps/00000001/log/0.log.part");
    fs::write(&part, "begun").expect("writes");

    link_backup(&first, &second).expect("links");
    assert!(second.join("MANIFEST").exists() && !second.join("maps/00000001/log/0.log.part").exists());
    fs::remove_file(part).expect("removes");
    // Names that are free again get other content; old files go, new ones come, and the list of maps changes.
    append_all(&log, 21..=40);
    store.save(MAP, &snapshot(&spec, 40, 3)).expect("saves");
    store.create_map(&super::example::spec("attic")).expect("creates");
    let repair = store.backup(&second).expect("backs up");
    assert!(repair.kept_files > 0 && repair.copied_files > 0, "{repair:?}");
    let after: Vec<(String, Vec<u8>)> =
        files(&first).into_iter().map(|file| (file.clone(), fs::read(file).expect("readable"))).collect();
    assert!(before == after, "the first backup changed");
    for (backup, maps) in [(&first, 1), (&second, 2)] {
        let restored = work.path().join(format!("restored-{maps}"));
        assert_eq!(restore(backup, &restored, OTHER_ID).expect("restores").maps, maps);
    }
}

#[test]
fn a_backup_that_is_stopped_keeps_the_earlier_one() {
    let work = tempfile::tempdir().expect("temporary directory");
    let (data, backup) = (work.path().join("data"), work.path().join("backup"));
    let spec = spec("office");
    let (store, log) = in_use(&data, &spec);
    store.backup(&backup).expect("backs up");
    append_all(&log, 21..=40);
    for files in 0..4 {
        let calls = std::cell::Cell::new(0);
        let goes_on = || calls.replace(calls.get() + 1) < files;
        assert!(matches!(store.backup_while(&backup, &goes_on), Err(BackupError::Stopped)), "{files}");
        let restored = work.path().join(format!("restored-{files}"));
        restore(&backup, &restored, OTHER_ID).expect("restores");
    }
    store.backup(&backup).expect("completes");
}

#[test]
fn a_backup_goes_only_where_nothing_is_lost_by_it() {
    let work = tempfile::tempdir().expect("temporary directory");
    let data = work.path().join("data");
    let store = with_history(&data, &super::grid_example::spec("office"));
    let full = work.path().join("full");
    fs::create_dir(&full).expect("creates");
    fs::write(full.join("thesis.tex"), "all of it").expect("writes");
    assert!(matches!(store.backup(&full), Err(BackupError::NotEmpty(_))));
    assert!(matches!(store.backup(&data.join("backup")), Err(BackupError::Inside(_))));
    let other = work.path().join("other");
    drop(Store::open(&other, StoreOptions { new_store_id: OTHER_ID.to_owned(), ..options() }).expect("opens"));
    assert!(matches!(store.backup(&other), Err(BackupError::OtherStore(_))));
    let backup = work.path().join("backup");
    store.backup(&backup).expect("backs up");
    assert!(matches!(restore(&backup, &full, OTHER_ID), Err(BackupError::NotEmpty(_))));
    assert!(matches!(restore(&full, &work.path().join("new"), OTHER_ID), Err(BackupError::Open(_))));
    // A damaged backup is not restored.
    fs::remove_file(backup.join("maps/00000001/history/00000000000000000002.states.tmh")).expect("removes");
    assert!(matches!(restore(&backup, &work.path().join("new"), OTHER_ID), Err(BackupError::Damaged { .. })));
}

#[test]
fn a_check_finds_every_damaged_missing_and_cut_file_and_changes_nothing() {
    let work = tempfile::tempdir().expect("temporary directory");
    let data = work.path().join("data");
    drop(with_history(&data, &super::grid_example::spec("office")));
    let sound = check(&data, Mode::Look).expect("checks");
    assert_eq!(sound.findings, []);
    assert!(sound.maps == 1 && sound.files > 6, "{sound:?}");
    for file in files(&data) {
        if file.ends_with("LOCK") || file.ends_with("MANIFEST") || file.contains("/index/") {
            continue;
        }
        let good = fs::read(&file).expect("readable");
        for damage in ["flip", "cut", "remove"] {
            match damage {
                "flip" => {
                    let mut bad = good.clone();
                    bad[good.len() / 2] ^= 4;
                    fs::write(&file, bad).expect("writes");
                }
                "cut" => fs::write(&file, &good[..good.len() - 1]).expect("writes"),
                _ => fs::remove_file(&file).expect("removes"),
            }
            let found = check(&data, Mode::Look).expect("checks").findings;
            assert_eq!(found.len(), 1, "{damage} {file}: {found:?}");
            // The log, or the older one, has what was in a checkpoint. Two lists are proven by the files.
            let is_proven = file.ends_with("CHECKPOINTS") || file.ends_with("HISTORY");
            let is_spare = damage == "remove" && file.ends_with(".tmc") || is_proven;
            assert_eq!(found[0].is_spare, is_spare, "{damage} {file}: {found:?}");
            if damage == "flip" {
                assert_ne!(fs::read(&file).expect("there"), good, "nothing is repaired unasked");
            }
            fs::write(&file, &good).expect("writes");
        }
    }
    assert_eq!(check(&data, Mode::Look).expect("checks").findings, []);
}

#[test]
fn a_repair_makes_lists_and_the_index_again_and_nothing_else() {
    let work = tempfile::tempdir().expect("temporary directory");
    let data = work.path().join("data");
    let spec = super::grid_example::spec("office");
    drop(with_history(&data, &spec));
    for file in ["maps/00000001/CHECKPOINTS", "maps/00000001/HISTORY"] {
        fs::write(data.join(file), "damaged").expect("writes");
    }
    let database = data.join("index/db");
    let length = fs::metadata(&database).expect("there").len();
    fs::write(&database, vec![0x5A; length as usize]).expect("writes");
    let sound = check(&data, Mode::Repair).expect("checks").findings;
    let repaired: Vec<_> = sound.iter().map(|finding| finding.outcome).collect();
    assert_eq!(repaired, [Outcome::Repaired; 3], "{sound:?}");
    let history = data.join("maps/00000001/history/00000000000000000003.states.tmh");
    fs::write(&history, "damaged").expect("writes");
    let found = check(&data, Mode::Repair).expect("checks").findings;
    assert_eq!(found.len(), 2, "the history file, and the index, which the next start makes again: {found:?}");
    assert!(found.iter().all(|finding| finding.outcome == Outcome::Open), "{found:?}");
    assert_eq!(fs::read(&history).expect("there"), b"damaged");
}

#[test]
fn a_folder_in_use_or_none_is_not_checked() {
    let work = tempfile::tempdir().expect("temporary directory");
    let data = work.path().join("data");
    let example = fill(&data, 5, &[], 300);
    let store = Store::open(&data, options()).expect("opens");
    store.open_map(MAP, &example.spec).expect("opens");
    assert!(matches!(check(&data, Mode::Look), Err(crate::OpenError::Locked { .. })));
    assert!(check(work.path(), Mode::Look).is_err());
}
