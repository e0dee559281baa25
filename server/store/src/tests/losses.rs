//! No loss is quiet: a list that is lost hides nothing, until an operator accepts what is lost with it.

use std::{
    fs,
    path::{Path, PathBuf},
};

use tidemap_map::{ids::StateId, snapshot::MapSnapshot};

use super::{
    example::{append, content, copy, event, fill, options, snapshot, spec as plain_spec},
    golden,
    grid_example::spec,
    missing::with_history,
};
use crate::{
    Finding, HistoryError, MapId, Mode, OpenError, Outcome, Repair, Store, StoreError, StoreOptions, Trouble, check,
    restore,
};

const MAP: MapId = MapId(1);
const HISTORY: &str = "maps/00000001/HISTORY";
const NEWEST: &str = "maps/00000001/log/NEWEST";
const CHECKPOINTS: &str = "maps/00000001/CHECKPOINTS";
const ACCEPT: Mode = Mode::AcceptLoss { now_nanos: 1_700_000_000_000_000_000 };

fn findings(data: &Path, mode: Mode) -> Vec<Finding> {
    check(data, mode).expect("checks").findings
}

/// Files of the folder without the lock and the index, which a check changes.
fn files(data: &Path) -> Vec<(PathBuf, Option<Vec<u8>>)> {
    let mut all = content(data);
    all.retain(|(path, _)| !path.starts_with(data.join("index")) && !path.ends_with("LOCK"));
    all
}

/// Checks that a loss is reported, and hidden neither by a check nor by a repair; then accepts it.
fn accept(data: &Path, lost: &[&str]) {
    let before = files(data);
    for mode in [Mode::Look, Mode::Repair] {
        let found = findings(data, mode);
        let open: Vec<_> = found.iter().filter(|found| !found.is_spare).collect();
        assert_eq!(open.iter().map(|found| found.file.to_str().expect("text")).collect::<Vec<_>>(), lost, "{found:?}");
        assert!(open.iter().all(|found| found.outcome == Outcome::Open), "{found:?}");
        assert!(open.iter().all(|found| found.advice.contains("--accept-loss")), "{found:?}");
        assert_eq!(files(data), before, "{mode:?}");
    }
    let found = findings(data, ACCEPT);
    assert!(found.iter().all(|found| found.outcome == Outcome::Accepted), "{found:?}");
    let again = check(data, Mode::Look).expect("checks");
    assert_eq!(again.findings, []);
    assert_eq!(again.losses.iter().map(|loss| loss.file.as_str()).collect::<Vec<_>>(), lost);
    assert!(again.losses.iter().all(|loss| loss.accepted_nanos == 1_700_000_000_000_000_000), "{again:?}");
}

#[test]
fn lists_whose_files_prove_to_be_all_are_made_again_and_reported() {
    let directory = tempfile::tempdir().expect("temporary directory");
    let spec = spec("office");
    drop(with_history(directory.path(), &spec));
    let before = [HISTORY, CHECKPOINTS].map(|list| fs::read(directory.path().join(list)).expect("there"));
    for damage in [None, Some("tidemap")] {
        for list in [HISTORY, CHECKPOINTS] {
            let list = directory.path().join(list);
            fs::remove_file(&list).expect("removable");
            damage.iter().for_each(|text| fs::write(&list, text).expect("writable"));
        }
        let found = findings(directory.path(), Mode::Look);
        assert!(found.len() == 2 && found.iter().all(|found| found.is_spare), "{found:?}");
        let store = Store::open(directory.path(), options()).expect("opens");
        assert!(matches!(store.repairs(), [Repair::ListMade { .. }]), "{:?}", store.repairs());
        let repairs = store.open_map(MAP, &spec).expect("opens").repairs;
        assert!(matches!(repairs[..], [Repair::ListMade { .. }]), "{repairs:?}");
        assert_eq!(store.trouble(), []);
        drop(store);
        let after = [HISTORY, CHECKPOINTS].map(|list| fs::read(directory.path().join(list)).expect("there"));
        assert_eq!(after, before);
    }
}

#[test]
fn lost_history_is_refused_until_it_is_accepted() {
    let directory = tempfile::tempdir().expect("temporary directory");
    let (data, spec) = (directory.path(), spec("office"));
    drop(with_history(data, &spec));
    fs::remove_file(data.join(HISTORY)).expect("removable");
    fs::remove_file(data.join("maps/00000001/history/00000000000000000002.states.tmh")).expect("removable");

    let store = Store::open(data, options()).expect("the map is served");
    let lost = Trouble::ListLost { file: HISTORY.into(), problem: "it is missing".to_owned() };
    assert_eq!(store.trouble(), [lost]);
    let log = store.open_map(MAP, &spec).expect("opens").log;
    let history = store.history(MAP).expect("known");
    assert!(matches!(history.state(StateId(0), 0, i64::MAX), Err(HistoryError::Damaged { .. })));
    append(&log, &event(6)).expect("observations are taken");
    // A save that needs the list fails, and the log keeps everything.
    let piece = super::grid_example::piece(4, 19_004, &mut rand::SeedableRng::seed_from_u64(4));
    let newest = MapSnapshot {
        newest_nanos: piece.to_nanos,
        history: vec![std::sync::Arc::new(piece)],
        generation: 4,
        ..super::grid_example::snapshot(&spec, 6, 2)
    };
    assert!(matches!(store.save(MAP, &newest), Err(StoreError::ListLost { .. })));
    assert!(!data.join(HISTORY).exists());
    drop((log, history, store));

    accept(data, &[HISTORY]);
    let store = Store::open(data, options()).expect("opens");
    assert_eq!((store.trouble(), store.losses().expect("readable").len()), (vec![], 1));
    assert!(store.history(MAP).expect("known").state(StateId(0), 0, i64::MAX).is_ok());
    store.open_map(MAP, &spec).expect("opens");
    store.save(MAP, &newest).expect("saves");
}

#[test]
fn a_lost_list_of_maps_is_no_empty_store() {
    let directory = tempfile::tempdir().expect("temporary directory");
    let data = directory.path();
    let store = Store::open(data, options()).expect("opens");
    let maps = ["one", "two"].map(|name| store.create_map(&plain_spec(name)).expect("creates"));
    drop(store);
    fs::remove_file(data.join("MAPS")).expect("removable");
    fs::remove_dir_all(data.join("maps/00000002")).expect("removable");

    let store = Store::open(data, options()).expect("opens");
    assert!(matches!(&store.trouble()[..], [Trouble::ListLost { .. }]), "{:?}", store.trouble());
    store.open_map(maps[0], &plain_spec("one")).expect("what is found is served");
    assert!(matches!(store.create_map(&plain_spec("two")), Err(StoreError::ListLost { .. })));
    assert!(matches!(store.delete_map(maps[0]), Err(StoreError::ListLost { .. })));
    assert!(store.backup(&directory.path().with_extension("backup")).is_err());
    drop(store);
    assert!(data.join("maps/00000001").exists() && !data.join("MAPS").exists());

    accept(data, &["MAPS"]);
    let store = Store::open(data, options()).expect("opens");
    assert_eq!((store.trouble(), store.maps().len()), (vec![], 1));
    assert!(store.create_map(&plain_spec("two")).is_ok());
}

#[test]
fn a_missing_map_and_a_missing_history_file_are_accepted_without_their_names() {
    let directory = tempfile::tempdir().expect("temporary directory");
    let data = directory.path();
    drop(with_history(data, &spec("office-of-eve")));
    fs::remove_file(data.join("maps/00000001/history/00000000000000000002.grid.tmh")).expect("removable");
    accept(data, &["maps/00000001/history/00000000000000000002.grid.tmh"]);
    fs::remove_dir_all(data.join("maps/00000001")).expect("removable");
    let found = findings(data, ACCEPT);
    assert!(found[0].problem.contains("office-of-eve"), "{found:?}");
    let store = Store::open(data, options()).expect("opens");
    assert_eq!((store.maps(), store.set_aside()), (vec![], vec![]));
    let losses = fs::read_to_string(data.join("LOSSES")).expect("readable");
    assert!(losses.contains("maps/00000001 ") && !losses.contains("eve"), "{losses}");
}

#[test]
fn a_lost_end_of_a_log_is_refused_until_it_is_accepted() {
    let directory = tempfile::tempdir().expect("temporary directory");
    let (data, folder) = (directory.path(), directory.path().join("maps/00000001/log"));
    let example = fill(data, 60, &[], 300);
    let last = fs::read_dir(&folder).expect("readable").map(|entry| entry.expect("entry").path());
    let newest = last.filter(|path| path.extension().is_some_and(|it| it == "log")).max().expect("several");
    fs::remove_file(&newest).expect("removable");
    fs::remove_file(data.join(NEWEST)).expect("removable");
    let error = example.check(data).expect_err("records may be missing");
    assert!(matches!(error, OpenError::ListLost { .. }), "{error}");
    assert!(!data.join(NEWEST).exists());
    accept(data, &[NEWEST]);
    let store = Store::open(data, options()).expect("opens");
    let end = store.open_map(MAP, &example.spec).expect("opens").log.end();
    assert!((1..60).contains(&end), "{end}");
}

#[test]
fn a_missing_newest_segment_and_a_damaged_history_file_are_refused_until_they_are_accepted() {
    let work = tempfile::tempdir().expect("temporary directory");
    let data = &work.path().join("log");
    let example = fill(data, 60, &[], 300);
    let segments = fs::read_dir(data.join("maps/00000001/log")).expect("readable");
    let segments = segments.map(|entry| entry.expect("entry").path());
    let newest = segments.filter(|path| path.extension().is_some_and(|it| it == "log")).max().expect("several");
    fs::remove_file(&newest).expect("removable");
    assert!(matches!(example.check(data), Err(OpenError::CorruptLog { .. })));
    accept(data, &[newest.strip_prefix(data).expect("within").to_str().expect("text")]);
    let store = Store::open(data, options()).expect("opens");
    assert!(store.open_map(MAP, &example.spec).expect("opens").log.end() < 60);

    let data = &work.path().join("history");
    drop(with_history(data, &spec("office")));
    let file = "maps/00000001/history/00000000000000000002.states.tmh";
    let mut bytes = fs::read(data.join(file)).expect("readable");
    bytes[40] ^= 1;
    fs::write(data.join(file), bytes).expect("writable");
    accept(data, &[file]);
    assert!(!data.join(file).exists());
    let store = Store::open(data, options()).expect("opens");
    assert_eq!(store.trouble(), []);
    assert!(store.history(MAP).expect("known").state(StateId(0), 0, i64::MAX).is_ok());
}

/// A map with two checkpoints, whose log has lost its beginning to them.
fn shortened(data: &Path) -> (super::example::Example, PathBuf, PathBuf) {
    let example = fill(data, 60, &[20, 40], 300);
    let log = fs::read_dir(data.join("maps/00000001/log")).expect("readable");
    let log = log.map(|entry| entry.expect("entry").path());
    let first = log.filter(|path| path.extension().is_some_and(|it| it == "log")).min().expect("several");
    (example, data.join("maps/00000001/checkpoints/00000000000000000040.tmc"), first)
}

#[test]
fn a_missing_checkpoint_or_first_segment_is_reported_until_it_is_needed_no_longer() {
    let directory = tempfile::tempdir().expect("temporary directory");
    for what in ["checkpoint", "segment"] {
        let data = &directory.path().join(what);
        let (example, checkpoint, segment) = shortened(data);
        let file = if what == "checkpoint" { checkpoint } else { segment };
        fs::remove_file(&file).expect("removable");
        let name = file.strip_prefix(data).expect("within").to_owned();
        let found = findings(data, Mode::Look);
        assert!(found.iter().any(|found| found.file == name && found.is_spare), "{what}: {found:?}");

        let store = Store::open(data, options()).expect("opens");
        let repairs = store.open_map(MAP, &example.spec).expect("opens").repairs;
        assert!(repairs.contains(&Repair::SpareMissing { file }), "{what}: {repairs:?}");
        let is_reported = |store: &Store| {
            store.trouble().iter().any(|it| matches!(it, Trouble::Damaged { file, .. } if *file == name))
        };
        assert!(is_reported(&store), "{:?}", store.trouble());
        store.scrub(&mut |_| true);
        assert!(is_reported(&store), "the background check finds it too: {:?}", store.trouble());
        for position in [50, 60] {
            store.save(MAP, &snapshot(&example.spec, position, 3)).expect("saves");
        }
        assert_eq!(store.trouble(), [], "{what}");
        drop(store);
        assert_eq!(findings(data, Mode::Look), []);
    }
}

#[test]
fn without_any_checkpoint_the_beginning_of_the_log_is_missed() {
    let directory = tempfile::tempdir().expect("temporary directory");
    let (example, checkpoint, _) = shortened(directory.path());
    for checkpoint in [checkpoint.clone(), checkpoint.with_file_name("00000000000000000020.tmc")] {
        fs::remove_file(checkpoint).expect("removable");
    }
    assert!(example.check(directory.path()).is_err());
    let found = findings(directory.path(), Mode::Repair);
    assert!(found.iter().filter(|found| !found.is_spare).count() >= 2, "{found:?}");
    assert!(found.iter().all(|found| found.outcome == Outcome::Open || found.is_spare), "{found:?}");
}

#[test]
fn a_missing_or_emptied_index_is_found_and_lost_without_loss() {
    let directory = tempfile::tempdir().expect("temporary directory");
    let data = directory.path();
    let example = fill(data, 23, &[5, 10], 64 << 20);
    assert_eq!(findings(data, Mode::Look), []);
    let database = data.join("index/db");
    let length = fs::metadata(&database).expect("there").len();
    fs::write(&database, vec![0x5A; length as usize]).expect("writable");
    let found = findings(data, Mode::Look);
    assert!(found.len() == 1 && found[0].is_spare && found[0].file == Path::new("index"), "{found:?}");
    fs::remove_dir_all(data.join("index")).expect("removable");
    let found = findings(data, Mode::Look);
    assert!(found.len() == 1 && found[0].is_spare && found[0].advice.contains("nothing is lost"), "{found:?}");
    example.check(data).expect("opens");
    assert_eq!(findings(data, Mode::Look), []);
}

#[test]
fn an_index_in_use_is_not_taken_for_damaged() {
    let directory = tempfile::tempdir().expect("temporary directory");
    let data = directory.path();
    drop(fill(data, 23, &[5, 10], 64 << 20));
    let other = sled::open(data.join("index")).expect("opens");
    assert!(matches!(Store::open(data, options()), Err(OpenError::Locked { .. })));
    assert!(matches!(check(data, Mode::Repair), Err(OpenError::Locked { .. })));
    assert!(data.join("index/db").exists() && !data.join("index.damaged-1").exists());
    drop(other);
}

#[test]
fn a_sound_folder_is_sound_and_can_be_restored() {
    let work = tempfile::tempdir().expect("temporary directory");
    let [old, restored] = ["old", "restored"].map(|name| work.path().join(name));
    copy(&golden::folder(), &old);
    let checked = check(&old, Mode::Look).expect("checks");
    // A check migrates nothing.
    assert_eq!((checked.format, checked.findings), (1, vec![]));
    assert!(checked.files > 0);
    restore(&old, &restored, "ffffffffffffffffffffffffffffffff").expect("restores");
    let store = Store::open(&restored, options()).expect("opens");
    assert_eq!((store.repairs(), store.trouble()), (&[][..], vec![]));
    for (map, spec) in store.maps() {
        store.open_map(map, &spec).expect("opens");
    }
    drop(store);
    assert_eq!(check(&restored, Mode::Look).expect("checks").findings, []);
    fs::remove_file(restored.join("MAPS")).expect("removable");
    let store = Store::open(&restored, options()).expect("opens");
    assert!(matches!(&store.trouble()[..], [Trouble::ListLost { .. }]), "{:?}", store.trouble());
}

#[test]
fn another_store_than_the_expected_one_is_refused_and_none_is_created() {
    let work = tempfile::tempdir().expect("temporary directory");
    let [data, empty] = ["data", "empty"].map(|name| work.path().join(name));
    let store = Store::open(&data, options()).expect("creates");
    let id = store.store_id().to_owned();
    assert!(store.is_new());
    drop(store);
    let expecting = |id: &str| StoreOptions { expected_store_id: Some(id.to_owned()), ..options() };
    assert!(!Store::open(&data, expecting(&id)).expect("the right one").is_new());
    let error = Store::open(&data, expecting("ffffffffffffffffffffffffffffffff")).expect_err("another one");
    assert!(matches!(&error, OpenError::OtherStore { found: Some(found), .. } if *found == id), "{error}");
    fs::create_dir(&empty).expect("creates");
    for folder in [&empty, &work.path().join("none")] {
        let error = Store::open(folder, expecting(&id)).expect_err("the disk is not mounted");
        assert!(matches!(error, OpenError::OtherStore { found: None, .. }), "{error}");
    }
    assert_eq!(fs::read_dir(&empty).expect("readable").count(), 0);
    assert!(!work.path().join("none").exists());
}
