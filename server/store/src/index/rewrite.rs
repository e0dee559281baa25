//! Rewriting the index into a new folder: sled's file grows with every change, and sled frees little of it.
//!
//! Invariant: the folder of the index is whole or absent at every moment; one that is absent is built again from the
//! checkpoints.

use std::{
    fs, io,
    path::{Path, PathBuf},
};

use prost::Message as _;
use tidemap_layout::index::{GENERATIONS, Mark, decode_value};

use super::{LOCK_TRIES, Trees, folder, rows::Kind, save::RowBatch};
use crate::failure::ReadFailure;

/// Rewritten when it takes this many times its data on the disk, in percent.
const PERCENT_MAX: u64 = 350;
/// A smaller file is left alone.
const SIZE_MIN: u64 = 32 << 20;

fn beside(folder: &Path, suffix: &str) -> PathBuf {
    let name = folder.file_name().unwrap_or_default().to_string_lossy();
    folder.with_file_name(format!("{name}.{suffix}"))
}

/// Removes what an interrupted rewrite has left.
pub(super) fn remove_leftovers(folder: &Path) -> io::Result<()> {
    for suffix in ["new", "old"] {
        match fs::remove_dir_all(beside(folder, suffix)) {
            Err(error) if error.kind() != io::ErrorKind::NotFound => return Err(error),
            _ => {}
        }
    }
    Ok(())
}

/// Bytes of the rows of all maps, by their marks.
fn data_bytes(trees: &Trees) -> u64 {
    let marks = trees.generations.iter().filter_map(Result::ok);
    let marks = marks.filter_map(|(key, value)| Mark::decode(decode_value(GENERATIONS, &key, &value)?).ok());
    marks.flat_map(|mark| mark.totals).map(|total| total.bytes).sum()
}

/// Whether the database takes far more of the disk than its data needs.
pub(super) fn is_worth_it(trees: &Trees) -> bool {
    let size = trees.db.size_on_disk().unwrap_or(0);
    size >= SIZE_MIN && size > data_bytes(trees) / 100 * PERCENT_MAX
}

/// Copies all rows into a new folder, which takes the place of the old one.
pub(super) fn rewrite(old: Trees, folder: &Path, cache_bytes: u64) -> Result<Trees, ReadFailure> {
    remove_leftovers(folder)?;
    let new_folder = beside(folder, "new");
    let new = Trees::open(&new_folder, cache_bytes, LOCK_TRIES)?;
    let pairs = Kind::ALL.iter().map(|&kind| (old.of(kind), new.of(kind)));
    for (from, to) in pairs.chain([(&old.generations, &new.generations)]) {
        let mut collected = RowBatch::default();
        for row in from.iter() {
            let (key, value) = row?;
            collected.insert(to, &key, value.to_vec())?;
        }
        collected.apply(to)?;
    }
    new.flush()?;
    drop((old, new));
    let old_folder = beside(folder, "old");
    fs::rename(folder, &old_folder)?;
    fs::rename(&new_folder, folder)?;
    let trees = Trees::open(folder, cache_bytes, LOCK_TRIES)?;
    folder::sync_with_parent(folder)?;
    fs::remove_dir_all(&old_folder)?;
    Ok(trees)
}

#[cfg(test)]
mod tests {
    use crate::{
        index::{Index, RowsState},
        tests::grid_example::{snapshot, spec},
    };

    #[test]
    fn a_rewritten_index_publishes_the_same_and_leaves_nothing_behind() {
        let directory = tempfile::tempdir().expect("temporary directory");
        let folder = directory.path().join("index");
        let (mut index, repair) = Index::open(folder.clone(), 1 << 20).expect("not in use");
        assert_eq!(repair, None);
        let spec = spec("office");
        let saved = [snapshot(&spec, 10, 3), snapshot(&spec, 15, 4)];
        for (map, saved) in (1..).zip(&saved) {
            index.save(map, saved);
        }
        index.rewrite();
        for (map, saved) in (1..).zip(&saved) {
            assert_eq!(index.read(map, &spec), Ok(Some(saved.published())));
        }
        index.close();
        // The files that an interrupted rewrite leaves are removed.
        std::fs::create_dir(directory.path().join("index.new")).expect("writable");
        let (mut index, repair) = Index::open(folder, 1 << 20).expect("not in use");
        assert_eq!(repair, None);
        assert_eq!(index.check(1), Ok(RowsState::Whole { position: 10, generation: 2 }));
        assert_eq!(std::fs::read_dir(directory.path()).expect("readable").count(), 1);
    }
}
