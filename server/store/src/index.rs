//! The index: the newest snapshot of every map in sled. A save rewrites only the records that have changed.
//!
//! A checkpoint holds the same data and has priority, so a damaged index is dropped and written again.
//! The index is read only when a map is opened. Invariant: a map's mark is clean only when all its records are durable,
//! and holds their number and a sum over them, so that a missing, stale or foreign record is detected.

use std::{
    collections::BTreeMap,
    fs::{self, File},
    path::{Path, PathBuf},
};

use tidemap_map::{snapshot::MapSnapshot, spec::MapSpec};

mod folder;
mod load;
mod panics;
mod rows;
mod save;

use rows::Sum;

/// The reason why an index must be replaced as a whole.
pub(crate) type Damage = String;

/// The open database.
struct Trees {
    db: sled::Db,
    states: sled::Tree,
    models: sled::Tree,
    marks: sled::Tree,
    folder: PathBuf,
}

/// The records of a map in the database: a sum for each state, for each producer and for the site.
#[derive(Default)]
struct KnownRows {
    states: Vec<Sum>,
    producers: Vec<Sum>,
    site: Sum,
}

/// The content of the index for a map.
pub(crate) enum IndexContent {
    /// The index is not used for this map.
    Unused,
    /// Nothing.
    Nothing,
    /// Records that were not completely written.
    Unfinished,
    /// A snapshot.
    Snapshot(Box<MapSnapshot>),
}

/// The index, or what is left of it.
pub(crate) struct Index {
    folder: PathBuf,
    cache_bytes: u64,
    /// `None` after a failure: the store continues without it.
    trees: Option<Trees>,
    /// Maps whose records are all known.
    written: BTreeMap<u32, KnownRows>,
}

impl Trees {
    fn open(folder: &Path, cache_bytes: u64) -> Result<Trees, Damage> {
        panics::catch(|| {
            folder::remove_unfinished_snapshots(folder).map_err(|error| error.to_string())?;
            // sled only logs a failed fsync of its own; here every flush is followed by an fsync of ours.
            let config = sled::Config::new().path(folder).cache_capacity(cache_bytes).flush_every_ms(None);
            let text = |error: sled::Error| error.to_string();
            let db = config.open().map_err(text)?;
            let tree = |name| db.open_tree(name).map_err(text);
            use tidemap_migrations::v1::index::{MARKS, MODELS, STATES};
            Ok(Trees {
                states: tree(STATES)?,
                models: tree(MODELS)?,
                marks: tree(MARKS)?,
                folder: folder.to_owned(),
                db,
            })
        })?
    }

    /// Makes everything durable: sled's flush does not fsync.
    fn flush(&self) -> Result<(), Damage> {
        self.db.flush().map_err(|error| error.to_string())?;
        File::open(self.folder.join("db")).and_then(|file| file.sync_all()).map_err(|error| error.to_string())
    }
}

impl Index {
    /// Opens the index. One that cannot be opened is renamed and an empty one created; the second value reports that.
    pub(crate) fn open(folder: PathBuf, cache_bytes: u64) -> (Index, Option<(PathBuf, Damage)>) {
        let mut index = Index { folder, cache_bytes, trees: None, written: BTreeMap::new() };
        match Trees::open(&index.folder, cache_bytes) {
            Ok(trees) => {
                index.trees = Some(trees);
                (index, None)
            }
            Err(damage) => {
                let aside = index.replace();
                let aside = aside.unwrap_or_else(|_| index.folder.clone());
                (index, Some((aside, damage)))
            }
        }
    }

    /// No index, for simulated disks.
    #[cfg(test)]
    pub(crate) fn none() -> Index {
        Index { folder: PathBuf::new(), cache_bytes: 0, trees: None, written: BTreeMap::new() }
    }

    /// Whether the index is usable.
    pub(crate) fn is_available(&self) -> bool {
        self.trees.is_some()
    }

    /// Renames the index and creates an empty one. Returns the new path of the old one.
    pub(crate) fn replace(&mut self) -> Result<PathBuf, Damage> {
        self.give_up();
        let aside = folder::set_aside(&self.folder).map_err(|error| error.to_string())?;
        self.trees = Some(Trees::open(&self.folder, self.cache_bytes)?);
        folder::sync_with_parent(&self.folder).map_err(|error| error.to_string())?;
        Ok(aside)
    }

    /// Continues without an index.
    fn give_up(&mut self) {
        self.written.clear();
        let trees = self.trees.take();
        // Closing a damaged database can panic, like any of its calls.
        let _ = panics::catch(move || drop(trees));
    }

    /// The records of a map.
    pub(crate) fn load(&mut self, map: u32, spec: &MapSpec) -> Result<IndexContent, Damage> {
        let Some(trees) = &self.trees else { return Ok(IndexContent::Nothing) };
        let (found, written) = panics::catch(|| load::load(trees, map, spec))??;
        if let Some(written) = written {
            self.written.insert(map, written);
        }
        Ok(found)
    }

    /// Saves a snapshot. An index that fails is dropped; the checkpoint holds the same data.
    pub(crate) fn save(&mut self, map: u32, snapshot: &MapSnapshot) {
        let Some(trees) = &self.trees else { return };
        let before = self.written.remove(&map);
        match panics::catch(|| save::save(trees, map, snapshot, before)).flatten() {
            Ok(written) => {
                self.written.insert(map, written);
            }
            Err(damage) => {
                tracing::warn!(map, %damage, "the index has failed and is not used until the next start");
                self.give_up();
            }
        }
    }

    /// Removes the records of a map.
    pub(crate) fn purge(&mut self, map: u32) {
        self.written.remove(&map);
        let Some(trees) = &self.trees else { return };
        if let Err(damage) = panics::catch(|| save::purge(trees, map)).flatten() {
            tracing::warn!(map, %damage, "the index has failed and is not used until the next start");
            self.give_up();
        }
    }

    /// Makes everything durable and closes the database.
    pub(crate) fn close(&mut self) {
        if let Some(trees) = &self.trees
            && let Err(damage) = panics::catch(|| trees.flush()).flatten()
        {
            tracing::warn!(%damage, "the index has failed while closing");
        }
        self.give_up();
    }
}

/// Whether a folder holds anything.
pub(crate) fn is_present(folder: &Path) -> bool {
    fs::read_dir(folder).is_ok_and(|mut entries| entries.next().is_some())
}

/// Access for tests.
#[cfg(test)]
pub(crate) mod tests_only {
    use tidemap_map::snapshot::MapSnapshot;

    use super::rows;

    /// CRC-32C over all keys and values of a snapshot.
    pub(crate) fn rows_checksum(map: u32, snapshot: &MapSnapshot) -> u32 {
        let states = (0..).zip(&snapshot.states).flat_map(|(id, state)| rows::of_state(map, id, state));
        let producers = (0..).zip(&snapshot.producers).flat_map(|(id, mark)| rows::of_producer(map, id, mark));
        let rows = states.chain(producers).chain(rows::of_site(map, &snapshot.site));
        rows.fold(0, |crc, row| crc32c::crc32c_append(crc32c::crc32c_append(crc, &row.key), &row.value))
    }
}
