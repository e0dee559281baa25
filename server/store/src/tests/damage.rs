//! Damaged checkpoints and a damaged index lose no data; they are reported.

use std::{
    fs,
    path::{Path, PathBuf},
};

use tidemap_layout::index::{GENERATIONS, Mark, PRODUCERS, STATES, encode_value, map_key, part_key};

use super::example::{Example, fill, options, snapshot};
use crate::{MapId, OpenedMap, Repair, Source, Store};

fn example(directory: &Path) -> Example {
    fill(directory, 23, &[5, 10, 15], 64 << 20)
}

fn checkpoint(directory: &Path, position: u64) -> PathBuf {
    directory.join(format!("maps/00000001/checkpoints/{position:020}.tmc"))
}

fn remove_index(directory: &Path) {
    fs::remove_dir_all(directory.join("index")).expect("removable");
}

/// Checks that after a repair the next start finds nothing to repair and everything in the index. The start after it
/// does so where a database of sled that was given up was still at work, on a busy machine: the rows that it spoils are
/// written again once more.
fn check_repaired(example: &Example, directory: &Path) {
    let mut opened = example.check(directory).expect("opens");
    if let [Repair::IndexRebuilt { .. }] = opened.repairs[..] {
        assert_eq!(opened.source, Source::Checkpoint);
        opened = example.check(directory).expect("opens");
    }
    assert_eq!((opened.source, opened.repairs), (Source::Checkpoint, vec![]));
}

fn set_aside(opened: &OpenedMap) -> usize {
    opened.repairs.iter().filter(|repair| matches!(repair, Repair::CheckpointSetAside { .. })).count()
}

#[test]
fn a_lost_index_is_written_again_from_the_newest_checkpoint() {
    let directory = tempfile::tempdir().expect("temporary directory");
    let example = example(directory.path());
    remove_index(directory.path());
    let opened = example.check(directory.path()).expect("opens");
    assert_eq!(opened.source, Source::Checkpoint);
    assert_eq!(opened.snapshot.as_ref(), example.snapshots.last());
    check_repaired(&example, directory.path());
}

#[test]
fn damaged_checkpoints_are_set_aside_one_after_the_other() {
    let directory = tempfile::tempdir().expect("temporary directory");
    let example = example(directory.path());
    remove_index(directory.path());
    fs::write(checkpoint(directory.path(), 15), "nonsense").expect("writable");
    let opened = example.check(directory.path()).expect("opens");
    assert_eq!((opened.source, set_aside(&opened)), (Source::Checkpoint, 1));
    assert_eq!(opened.snapshot.as_ref(), Some(&example.snapshots[1]));
    assert!(checkpoint(directory.path(), 15).with_added_extension("damaged").exists());

    remove_index(directory.path());
    fs::write(checkpoint(directory.path(), 10), "").expect("writable");
    let opened = example.check(directory.path()).expect("opens");
    assert_eq!((opened.source, set_aside(&opened)), (Source::Log, 1));
    assert_eq!(opened.snapshot, None);
}

#[test]
fn a_checkpoint_that_is_newer_than_the_index_wins() {
    let directory = tempfile::tempdir().expect("temporary directory");
    let mut example = example(directory.path());
    let index = directory.path().join("index");
    let old = directory.path().join("kept");
    super::example::copy(&index, &old);
    let newest = snapshot(&example.spec, 20, 3);
    {
        let store = Store::open(directory.path(), options()).expect("opens");
        store.open_map(MapId(1), &example.spec).expect("opens");
        store.save(MapId(1), &newest).expect("saves");
    }
    example.snapshots.push(newest.clone());
    fs::remove_dir_all(&index).expect("removable");
    fs::rename(&old, &index).expect("renamable");
    let opened = example.check(directory.path()).expect("opens");
    assert_eq!((opened.source, opened.snapshot.as_ref()), (Source::Checkpoint, Some(&newest)));
    assert!(matches!(opened.repairs[..], [Repair::IndexRebuilt { .. }]), "{:?}", opened.repairs);
    check_repaired(&example, directory.path());

    // Where that checkpoint is damaged, the one before it is used, and the index follows it.
    fs::write(checkpoint(directory.path(), 20), "nonsense").expect("writable");
    let opened = example.check(directory.path()).expect("opens");
    assert_eq!(opened.snapshot.as_ref(), Some(&example.snapshots[2]));
    assert!(opened.repairs.iter().any(|repair| matches!(repair, Repair::IndexRebuilt { .. })), "{:?}", opened.repairs);
    check_repaired(&example, directory.path());
}

#[test]
fn an_interrupted_save_leaves_the_map_as_it_was() {
    let directory = tempfile::tempdir().expect("temporary directory");
    let example = example(directory.path());
    let left = directory.path().join("maps/00000001/checkpoints/00000000000000000020.tmc.new");
    fs::write(&left, "half").expect("writable");
    let opened = example.check(directory.path()).expect("opens");
    assert_eq!(opened.repairs, [Repair::LeftoverRemoved { file: left.clone() }]);
    assert!(!left.exists());
}

#[test]
fn a_snapshot_that_sled_was_writing_does_not_stop_it() {
    let directory = tempfile::tempdir().expect("temporary directory");
    let example = example(directory.path());
    fs::write(directory.path().join("index/snap.0000000000000001.generating"), "half").expect("writable");
    check_repaired(&example, directory.path());
}

#[test]
fn an_index_that_is_no_database_is_set_aside() {
    let directory = tempfile::tempdir().expect("temporary directory");
    let example = example(directory.path());
    for number in 1..=3 {
        let file = directory.path().join("index/conf");
        let length = fs::metadata(&file).expect("there").len();
        fs::write(&file, vec![0x5A; length as usize]).expect("writable");
        let store = Store::open(directory.path(), options()).expect("opens");
        let aside = directory.path().join(format!("index.damaged-{number}"));
        let reported = matches!(store.repairs(), [Repair::IndexSetAside { folder, .. }] if *folder == aside);
        assert!(reported, "{:?}", store.repairs());
        assert!(aside.exists());
        drop(store);
        let opened = example.check(directory.path()).expect("opens");
        assert_eq!(opened.source, Source::Checkpoint);
        check_repaired(&example, directory.path());
    }
    let kept = fs::read_dir(directory.path()).expect("readable").filter(|entry| {
        entry.as_ref().is_ok_and(|entry| entry.file_name().to_string_lossy().starts_with("index.damaged"))
    });
    assert_eq!(kept.count(), 1);
}

#[test]
fn an_index_whose_records_are_gone_is_written_again() {
    let directory = tempfile::tempdir().expect("temporary directory");
    let example = example(directory.path());
    // sled takes this for an empty database.
    let file = directory.path().join("index/db");
    let length = fs::metadata(&file).expect("there").len();
    fs::write(&file, vec![0x5A; length as usize]).expect("writable");
    let opened = example.check(directory.path()).expect("opens");
    assert_eq!(opened.source, Source::Checkpoint);
    assert!(matches!(opened.repairs[..], [Repair::IndexRebuilt { .. }]), "{:?}", opened.repairs);
    check_repaired(&example, directory.path());
}

/// Changes the database behind the store's back.
fn edit(directory: &Path, change: impl FnOnce(&sled::Db)) {
    let db = sled::open(directory.join("index")).expect("opens");
    change(&db);
    db.flush().expect("flushes");
}

#[test]
fn missing_stale_foreign_and_damaged_records_are_noticed() {
    type Change = fn(&sled::Tree, &sled::Tree, &sled::Tree);
    let changes: [(&str, Change); 8] = [
        ("a state is missing", |states, _, _| drop(states.remove(part_key(1, 2, 0)).expect("removes"))),
        ("the last state is missing", |states, _, _| {
            let (key, _) = states.last().expect("reads").expect("there");
            states.remove(key).expect("removes");
        }),
        ("a producer is missing", |_, producers, _| drop(producers.remove(part_key(1, 0, 0)).expect("removes"))),
        ("all states are missing", |states, _, _| states.clear().expect("clears")),
        ("a state is in the place of another", |states, _, _| {
            let value = states.get(part_key(1, 1, 0)).expect("reads").expect("there");
            states.insert(part_key(1, 2, 0), value).expect("inserts");
        }),
        ("a bit is flipped", |states, _, _| {
            let mut value = states.get(part_key(1, 1, 0)).expect("reads").expect("there").to_vec();
            value[100] ^= 4;
            states.insert(part_key(1, 1, 0), value).expect("inserts");
        }),
        ("the mark is damaged", |_, _, marks| drop(marks.insert(map_key(1), "?").expect("inserts"))),
        ("a state too many", |states, _, _| {
            let key = part_key(1, 9, 0);
            states.insert(key, encode_value(STATES, &key, &[0; 32])).expect("inserts");
        }),
    ];
    let directory = tempfile::tempdir().expect("temporary directory");
    let example = example(directory.path());
    for (what, change) in changes {
        edit(directory.path(), |db| {
            let tree = |name| db.open_tree(name).expect("opens");
            change(&tree(STATES), &tree(PRODUCERS), &tree(GENERATIONS));
        });
        let opened = example.check(directory.path()).expect("opens");
        assert_eq!(opened.source, Source::Checkpoint, "{what}");
        let reported = opened.repairs.iter().any(|repair| matches!(repair, Repair::IndexSetAside { .. }));
        assert!(reported, "{what}: {:?}", opened.repairs);
        check_repaired(&example, directory.path());
    }
}

#[test]
fn a_save_into_the_index_that_was_cut_off_is_done_again() {
    let directory = tempfile::tempdir().expect("temporary directory");
    let example = example(directory.path());
    edit(directory.path(), |db| {
        use prost::Message as _;
        let mark = Mark { dirty: true, ..Mark::default() };
        let value = encode_value(GENERATIONS, &map_key(1), &mark.encode_to_vec());
        db.open_tree(GENERATIONS).expect("opens").insert(map_key(1), value).expect("inserts");
        db.open_tree(STATES).expect("opens").remove(part_key(1, 1, 0)).expect("removes");
    });
    let opened = example.check(directory.path()).expect("opens");
    assert_eq!(opened.source, Source::Checkpoint);
    assert!(matches!(opened.repairs[..], [Repair::IndexRebuilt { .. }]), "{:?}", opened.repairs);
    check_repaired(&example, directory.path());
}

#[test]
fn a_second_save_rewrites_what_has_changed() {
    let directory = tempfile::tempdir().expect("temporary directory");
    let mut example = example(directory.path());
    let newest = snapshot(&example.spec, 20, 4);
    {
        let store = Store::open(directory.path(), options()).expect("opens");
        store.open_map(MapId(1), &example.spec).expect("opens");
        store.save(MapId(1), &newest).expect("saves");
    }
    example.snapshots.push(newest.clone());
    let opened = example.check(directory.path()).expect("opens");
    assert_eq!((opened.source, opened.snapshot), (Source::Checkpoint, Some(newest)));
}
