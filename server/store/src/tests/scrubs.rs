//! A store in use is read again: damage of any file is found, and its end too; what is sound is never suspected.

use std::{fs, path::PathBuf};

use super::{
    example::{append, event},
    grid_example::spec,
    missing::with_history,
};
use crate::{MapId, Store, Trouble};

const MAP: MapId = MapId(1);

fn damaged(store: &Store) -> Vec<PathBuf> {
    let file = |trouble| match trouble {
        Trouble::Damaged { file, .. } => Some(file),
        _ => None,
    };
    store.trouble().into_iter().filter_map(file).collect()
}

#[test]
fn a_flipped_byte_is_found_in_every_kind_of_file_and_forgotten_when_it_is_mended() {
    let directory = tempfile::tempdir().expect("temporary directory");
    let spec = spec("office");
    let store = with_history(directory.path(), &spec);
    let opened = store.open_map(MAP, &spec).expect("opens");
    let mut bytes_read = 0;
    let mut pace = |bytes| {
        bytes_read += bytes;
        true
    };
    assert_eq!(store.scrub(&mut pace), Some(0), "{:?}", store.trouble());
    let (history, checkpoints) = (store.sizes(MAP).history_bytes, store.sizes(MAP).checkpoint_bytes);
    assert!(bytes_read > (history + checkpoints) / 2, "{bytes_read} of {history} and {checkpoints}");

    for file in [
        "maps/00000001/history/00000000000000000002.states.tmh",
        "maps/00000001/history/00000000000000000001.grid.tmh",
        "maps/00000001/checkpoints/00000000000000000005.tmc",
        "maps/00000001/log/00000000000000000001.log",
        "maps/00000001/HISTORY",
        "MAPS",
    ] {
        let path = directory.path().join(file);
        let sound = fs::read(&path).expect("readable");
        for place in [0, sound.len() / 3, sound.len() / 2, sound.len() - 1] {
            let mut flipped = sound.clone();
            flipped[place] ^= 0x10;
            fs::write(&path, &flipped).expect("writable");
            assert_eq!(store.scrub(&mut |_| true), Some(1), "{file}, byte {place}");
            assert_eq!(damaged(&store), [PathBuf::from(file)], "byte {place}");
            fs::write(&path, &sound).expect("writable");
            assert_eq!(store.scrub(&mut |_| true), Some(0), "{file}: {:?}", store.trouble());
            assert_eq!(damaged(&store), Vec::<PathBuf>::new());
        }
    }
    // The log goes on meanwhile.
    append(&opened.log, &event(6)).expect("appends");
    assert_eq!(store.scrub(&mut |_| true), Some(0), "{:?}", store.trouble());
}

#[test]
fn a_missing_file_is_found_and_a_round_can_be_ended() {
    let directory = tempfile::tempdir().expect("temporary directory");
    let store = with_history(directory.path(), &spec("office"));
    let file = PathBuf::from("maps/00000001/history/00000000000000000003.states.tmh");
    fs::remove_file(directory.path().join(&file)).expect("removable");
    assert_eq!(store.scrub(&mut |_| true), Some(1));
    assert_eq!(damaged(&store), vec![file.clone()]);
    assert!(store.trouble()[0].to_string().contains("it is missing"));
    assert_eq!(store.scrub(&mut |_| false), None);
    assert_eq!(damaged(&store), [file], "what an ended round did not read is not forgotten");
    store.delete_map(MAP).expect("deletes");
    assert_eq!(store.scrub(&mut |_| true), Some(0));
    assert_eq!(damaged(&store), Vec::<PathBuf>::new());
}
