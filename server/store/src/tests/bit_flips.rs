//! Single flipped bits anywhere in a closed store: the same content, or an explicit error.

use std::{fs, path::PathBuf};

use rand::{Rng as _, SeedableRng as _, rngs::SmallRng};

use super::example::{Example, copy, fill};
use crate::OpenError;

/// Flips one bit of a file in a fresh copy of the store and says whether it opened, with the same content.
fn flip(example: &Example, master: &std::path::Path, file: &std::path::Path, bit: usize) -> bool {
    let directory = tempfile::tempdir().expect("temporary directory");
    copy(master, directory.path());
    let target = directory.path().join(file.strip_prefix(master).expect("below"));
    let mut bytes = fs::read(&target).expect("readable");
    bytes[bit / 8] ^= 1 << (bit % 8);
    fs::write(&target, bytes).expect("writable");
    match example.check(directory.path()) {
        Ok(_) => true,
        Err(OpenError::CorruptLog { .. } | OpenError::Manifest(_) | OpenError::Damaged { .. }) => false,
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
fn every_byte_of_headers_and_a_thousand_random_bits() {
    let master = tempfile::tempdir().expect("temporary directory");
    let example = fill(master.path(), 23, &[5, 10, 15], 2000);
    let map = master.path().join("maps/00000001");
    let mut random = SmallRng::seed_from_u64(1);

    // Without the index, so that logs and checkpoints are all that there is.
    let bare = tempfile::tempdir().expect("temporary directory");
    copy(master.path(), bare.path());
    fs::remove_dir_all(bare.path().join("index")).expect("removable");
    let bare_map = bare.path().join("maps/00000001");
    for file in files(bare_map.join("log")).into_iter().chain(files(bare_map.join("checkpoints"))) {
        for byte in 0..32.min(length(&file)) {
            flip(&example, bare.path(), &file, byte * 8 + random.random_range(0..8));
        }
    }
    for file in [bare_map.join("MAP"), bare.path().join("MANIFEST")] {
        for byte in 0..length(&file) {
            assert!(!flip(&example, bare.path(), &file, byte * 8 + random.random_range(0..8)), "byte {byte}");
        }
    }
    for _ in 0..500 {
        let mut all = files(bare_map.join("log"));
        all.extend(files(bare_map.join("checkpoints")));
        let file = &all[random.random_range(0..all.len())];
        flip(&example, bare.path(), file, random.random_range(0..length(file) * 8));
    }

    // Damage to the index alone never costs anything.
    let mut index = files(master.path().join("index"));
    index.retain(|file| length(file) > 0);
    for _ in 0..500 {
        let file = &index[random.random_range(0..index.len())];
        let bit = random.random_range(0..length(file) * 8);
        assert!(flip(&example, master.path(), file, bit), "bit {bit} of {}", file.display());
    }
    for file in index {
        for byte in 0..64.min(length(&file)) {
            assert!(flip(&example, master.path(), &file, byte * 8 + random.random_range(0..8)), "byte {byte}");
        }
    }
    assert!(map.exists());
}
