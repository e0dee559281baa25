//! Copies of a map between stores: they are the map, whatever its number, or they are refused and leave nothing.

use std::{fs, path::Path, sync::Arc};

use rand::{SeedableRng as _, rngs::SmallRng};
use tidemap_map::{snapshot::MapSnapshot, spec::MapSpec};

use super::{
    example::{append, event, options},
    grid_example::{piece, snapshot, spec},
};
use crate::{CopyError, CopyPart, CopyTotal, MapId, Mode, OpenedMap, Repair, Store, StoreOptions, check};

const UID: u64 = 0x7EA;

/// A snapshot whose update has learned a day, with the history of that day.
fn learned(spec: &MapSpec, position: u64, generation: u64) -> MapSnapshot {
    let mut random = SmallRng::seed_from_u64(generation);
    let piece = Arc::new(piece(generation, 19_000 + generation as i32, &mut random));
    let (newest_nanos, history) = (piece.to_nanos, vec![piece]);
    MapSnapshot { history, newest_nanos, generation, ..snapshot(spec, position, 2) }
}

/// A store with a map of short segments, 40 records, a checkpoint at 25 and history.
fn giver(folder: &Path) -> (Store, MapSpec) {
    let spec = spec("office");
    let store = Store::open(folder, StoreOptions { segment_bytes: 300, ..options() }).expect("opens");
    let map = store.create_shared_map(&spec, UID).expect("creates");
    let log = store.open_map(map, &spec).expect("opens").log;
    for position in 1..=40 {
        append(&log, &event(position)).expect("appends");
    }
    store.save(map, &learned(&spec, 20, 1)).expect("saves");
    store.save(map, &learned(&spec, 25, 2)).expect("saves");
    (store, spec)
}

fn parts(store: &Store) -> (Vec<CopyPart>, CopyTotal) {
    let source = store.copy_source(MapId(1)).expect("a copy");
    let total = source.total();
    (source.map(|part| part.expect("readable")).collect(), total)
}

/// A store whose first map is another one.
fn taker(folder: &Path) -> Store {
    let store = Store::open(folder, options()).expect("opens");
    store.create_map(&spec("other")).expect("creates");
    store
}

fn take(store: &Store, spec: &MapSpec, replaces: Option<MapId>, given: &(Vec<CopyPart>, CopyTotal)) -> MapId {
    let mut copy = store.begin_copy(spec, UID, replaces).expect("begins");
    given.0.iter().for_each(|part| copy.take(part).expect("takes"));
    copy.check(given.1).expect("whole");
    assert_eq!(copy.end(), 40);
    copy.install().expect("installs").0
}

/// Position and generation of the snapshot that a map was opened with.
fn version(opened: &OpenedMap) -> Option<(u64, u64)> {
    opened.snapshot.as_ref().map(|snapshot| (snapshot.position, snapshot.generation))
}

fn names(folder: &Path) -> Vec<String> {
    let entries = fs::read_dir(folder.join("maps")).expect("there");
    let mut names: Vec<_> =
        entries.map(|entry| entry.expect("an entry").file_name().into_string().expect("text")).collect();
    names.sort();
    names
}

#[test]
fn a_copy_is_the_map_under_another_number_and_goes_on() {
    let work = tempfile::tempdir().expect("a folder");
    let (from, to) = (work.path().join("from"), work.path().join("to"));
    let (given, spec) = giver(&from);
    let parts = parts(&given);
    let store = taker(&to);
    let map = take(&store, &spec, None, &parts);
    assert_eq!(map, MapId(2));
    let opened = store.open_map(map, &spec).expect("opens");
    assert_eq!((opened.log.end(), version(&opened)), (40, Some((25, 2))));
    assert_eq!(opened.replay.last().map(|entry| entry.expect("whole")), Some((40, event(40))));
    assert_eq!(store.shared(map).expect("readable"), Some(UID));
    let chain = |store: &Store, map| store.group_log(map).expect("open").end();
    assert_eq!(chain(&store, map), chain(&given, MapId(1)));
    assert_eq!(append(&opened.log, &event(41)), Ok(41));
    store.close();
    drop((opened.log, store));
    let checked = check(&to, Mode::Look).expect("checks");
    assert_eq!(checked.findings.iter().filter(|finding| !finding.is_spare).count(), 0, "{:?}", checked.findings);
    let again = Store::open(&to, options()).expect("opens");
    assert_eq!(again.open_map(map, &spec).expect("opens").log.end(), 41);
    let history = again.history(map).expect("there").sizes().expect("readable");
    assert_eq!(history, given.history(MapId(1)).expect("there").sizes().expect("readable"));
    assert!(history.files > 0);
}

#[test]
fn a_map_that_is_replaced_is_set_aside_also_by_the_next_start() {
    let work = tempfile::tempdir().expect("a folder");
    let (from, to) = (work.path().join("from"), work.path().join("to"));
    let (given, spec) = giver(&from);
    let parts = parts(&given);
    let store = Store::open(&to, options()).expect("opens");
    let map = store.create_shared_map(&spec, UID).expect("creates");
    let log = store.open_map(map, &spec).expect("opens").log;
    append(&log, &event(1)).expect("appends");
    append(&log, &event(2)).expect("appends");
    let fork = store.set_fork_aside(map, 1).expect("readable").expect("a fork");
    store.open_map(map, &spec).expect("opens");
    assert_eq!(take(&store, &spec, Some(map), &parts), map);
    assert!(append(&log, &event(2)).is_err(), "the old log is closed");
    assert_eq!(store.forks(map).expect("readable"), [fork]);
    assert_eq!(store.open_map(map, &spec).expect("opens").log.end(), 40);
    assert_eq!(names(&to), ["00000001", "00000001.replaced-1"]);
    drop((log, store));

    // The state is as if the daemon had been killed in between.
    let maps = to.join("maps");
    fs::rename(maps.join("00000001"), maps.join("00000001.copied")).expect("renamed");
    fs::rename(maps.join("00000001.replaced-1"), maps.join("00000001")).expect("renamed");
    let store = Store::open(&to, options()).expect("opens");
    assert!(store.repairs().contains(&Repair::CopyCompleted { map }), "{:?}", store.repairs());
    assert_eq!(store.open_map(map, &spec).expect("opens").log.end(), 40);
    assert_eq!(names(&to), ["00000001", "00000001.replaced-1"]);
    // Deleting the map also deletes the data that was set aside of it.
    store.delete_map(map).expect("deleted");
    assert!(names(&to).is_empty(), "{:?}", names(&to));
}

#[test]
fn what_is_no_whole_copy_is_refused_and_leaves_nothing() {
    let work = tempfile::tempdir().expect("a folder");
    let (from, to) = (work.path().join("from"), work.path().join("to"));
    let (given, spec) = giver(&from);
    let (parts, total) = parts(&given);
    let store = taker(&to);
    let refused = |change: &dyn Fn(&mut Vec<CopyPart>)| {
        let mut changed = parts.clone();
        change(&mut changed);
        let mut copy = store.begin_copy(&spec, UID, None).expect("begins");
        let taken = changed.iter().try_for_each(|part| copy.take(part));
        let outcome = taken.and_then(|()| copy.check(total)).and_then(|_| copy.install());
        let error = outcome.err().unwrap_or_else(|| panic!("a copy that is not whole was taken"));
        assert!(matches!(error, CopyError::Invalid { .. } | CopyError::Open(_)), "{error}");
        assert_eq!(names(&to), ["00000001"], "{error}");
    };
    refused(&|parts| drop(parts.pop()));
    refused(&|parts| drop(parts.remove(1)));
    refused(&|parts| parts.push(parts[0].clone()));
    refused(&|parts| parts[0].name = "checkpoints/../../../MAP".to_owned());
    refused(&|parts| parts[0].is_last = false);
    refused(&|parts| parts[0].offset = 7);
    // Every byte of every file is covered by a checksum: those of the headers, too.
    for (at, part) in parts.iter().enumerate() {
        for byte in [0, 13, part.bytes.len() / 2, part.bytes.len() - 1] {
            // The end of the newest segment could be a torn write.
            if !part.name.starts_with("log/")
                || byte < 32
                || at + 1 < parts.len() && parts[at + 1].name.starts_with("log/")
            {
                refused(&|parts| parts[at].bytes[byte] ^= 1);
            }
        }
    }
    let mut interrupted = store.begin_copy(&spec, UID, None).expect("begins");
    interrupted.take(&parts[0]).expect("takes");
    std::mem::forget(interrupted);
    assert_eq!(names(&to).len(), 2);
    drop(store);
    // The interrupted copy still holds the store: only its folder is checked.
    let mut repairs = Vec::new();
    crate::store::catalogue::read(&crate::disk::RealDisk, &to, &mut repairs).expect("read");
    assert!(matches!(&repairs[..], [Repair::LeftoverRemoved { .. }]), "{repairs:?}");
    assert_eq!(names(&to), ["00000001"]);
}

#[test]
fn a_map_that_is_saved_while_it_is_copied_is_copied_as_it_was() {
    let work = tempfile::tempdir().expect("a folder");
    let (given, spec) = giver(&work.path().join("from"));
    let mut source = given.copy_source(MapId(1)).expect("a copy");
    let total = source.total();
    let mut parts = vec![source.next().expect("one").expect("readable")];
    // The checkpoint and the segments that are copied are deleted by this.
    for (position, generation) in [(30, 3), (38, 4)] {
        given.save(MapId(1), &learned(&spec, position, generation)).expect("saves");
    }
    parts.extend(source.map(|part| part.expect("still readable")));
    let store = taker(&work.path().join("to"));
    let map = take(&store, &spec, None, &(parts, total));
    assert_eq!(version(&store.open_map(map, &spec).expect("opens")), Some((25, 2)));
}
