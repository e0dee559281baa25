//! Single flipped bits anywhere in a closed store: the content is the same, or there is an explicit error.

use std::{fs, path::PathBuf};

use rand::{Rng as _, SeedableRng as _, rngs::SmallRng};

use super::{
    example::{Example, copy, fill},
    is_full,
};
use crate::OpenError;

/// Flips one bit of a file in a fresh copy of the store and returns whether it opened with the same content.
fn flip(example: &Example, master: &std::path::Path, file: &std::path::Path, bit: usize) -> bool {
    let directory = tempfile::tempdir().expect("temporary directory");
    copy(master, directory.path());
    let target = directory.path().join(file.strip_prefix(master).expect("below"));
    let mut bytes = fs::read(&target).expect("readable");
    bytes[bit / 8] ^= 1 << (bit % 8);
    fs::write(&target, bytes).expect("writable");
    match example.check(directory.path()) {
        Ok(_) => true,
        Err(
            OpenError::CorruptLog { .. }
            | OpenError::Manifest(_)
            | OpenError::Damaged { .. }
            | OpenError::ListLost { .. },
        ) => false,
        Err(other) => panic!("bit {bit} of {}: {other}", file.display()),
    }
}

fn files(folder: PathBuf) -> Vec<PathBuf> {
    let mut files: Vec<PathBuf> =
        fs::read_dir(folder).expect("readable").map(|entry| entry.expect("entry").path()).collect();
    files.retain(|file| file.is_file());
    files.sort();
    files
}

fn length(file: &std::path::Path) -> usize {
    fs::metadata(file).expect("there").len() as usize
}

#[test]
fn logs_checkpoints_maps_and_the_manifest() {
    let master = tempfile::tempdir().expect("temporary directory");
    let example = fill(master.path(), 23, &[5, 10, 15], 2000);
    // The index is removed, so that only checkpoints and logs remain.
    fs::remove_dir_all(master.path().join("index")).expect("removable");
    let map = master.path().join("maps/00000001");
    let mut random = SmallRng::seed_from_u64(1);
    let mut all = files(map.join("log"));
    all.extend(files(map.join("checkpoints")));
    for file in &all {
        for byte in 0..32 {
            flip(&example, master.path(), file, byte * 8 + random.random_range(0..8));
        }
    }
    for file in [map.join("MAP"), master.path().join("MANIFEST")] {
        for byte in 0..length(&file) {
            let refused = !flip(&example, master.path(), &file, byte * 8 + random.random_range(0..8));
            assert!(refused, "byte {byte} of {}", file.display());
        }
    }
    let mut refused = 0;
    let flips = if is_full() { 500 } else { 100 };
    for _ in 0..flips {
        let file = &all[random.random_range(0..all.len())];
        let bit = random.random_range(0..length(file) * 8);
        refused += usize::from(!flip(&example, master.path(), file, bit));
    }
    assert!(
        (1..flips).contains(&refused),
        "flips in old checkpoints and segments are repaired, others refused: {refused}"
    );
}

#[test]
fn the_index_never_costs_anything() {
    let master = tempfile::tempdir().expect("temporary directory");
    let example = fill(master.path(), 23, &[5, 10, 15], 2000);
    let mut random = SmallRng::seed_from_u64(2);
    let mut index = files(master.path().join("index"));
    index.retain(|file| length(file) > 0);
    for file in &index {
        for byte in 0..64.min(length(file)) {
            let bit = byte * 8 + random.random_range(0..8);
            assert!(flip(&example, master.path(), file, bit), "bit {bit} of {}", file.display());
        }
    }
    for _ in 0..if is_full() { 500 } else { 100 } {
        let file = &index[random.random_range(0..index.len())];
        let bit = random.random_range(0..length(file) * 8);
        assert!(flip(&example, master.path(), file, bit), "bit {bit} of {}", file.display());
    }
}
