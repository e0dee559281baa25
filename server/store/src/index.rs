//! The index: what the newest generation of every map publishes, in sled. A save rewrites only rows that have changed.
//!
//! Checkpoint and log have priority: they hold what the rows are made of, so a damaged index is dropped and written
//! again. Invariant: a map's mark is clean only when all its rows are durable, and holds their number and a sum over
//! them, so that a generation is whole or absent: a missing, stale or foreign row is detected.

use std::{
    collections::BTreeMap,
    fs::{self, File},
    io,
    path::{Path, PathBuf},
    sync::Weak,
    time::{Duration, Instant},
};

use tidemap_grid::tile::TileModel;
use tidemap_layout::index::{GENERATIONS, Total};
use tidemap_map::{snapshot::MapSnapshot, spec::MapSpec};

mod cells;
mod folder;
mod panics;
mod read;
mod rewrite;
mod rows;
mod save;

use read::MarkState;
use rows::{Kind, Sum};

use crate::failure::ReadFailure;

/// Number of tries to open an index that is still locked at a start, and the pause between two tries.
const LOCK_TRIES: usize = 250;
const LOCK_PAUSE: Duration = Duration::from_millis(20);

/// An index that the disk or the machine refused is tried again after the first pause; every further pause is twice as
/// long, up to the second.
const RETRY_FIRST: Duration = Duration::from_secs(5);
const RETRY_MAX: Duration = Duration::from_secs(60);

/// Why an index is not opened.
#[derive(Debug)]
pub(crate) enum Unopened {
    /// Somebody has it open, which is no damage.
    InUse,
    /// The index is damaged, or the disk or the machine refuses.
    Failed(ReadFailure),
}

impl From<ReadFailure> for Unopened {
    fn from(failure: ReadFailure) -> Self {
        Unopened::Failed(failure)
    }
}

impl From<io::Error> for Unopened {
    fn from(error: io::Error) -> Self {
        Unopened::Failed(error.into())
    }
}

impl From<sled::Error> for Unopened {
    fn from(error: sled::Error) -> Self {
        Unopened::Failed(error.into())
    }
}

impl From<Unopened> for ReadFailure {
    fn from(unopened: Unopened) -> Self {
        match unopened {
            // The process that has the index open will end.
            Unopened::InUse => ReadFailure::Disk("it is still in use".to_owned()),
            Unopened::Failed(failure) => failure,
        }
    }
}

/// Another process has the index open, which is no damage.
#[derive(Debug)]
pub(crate) struct IndexInUse;

/// An index that was damaged: its new path, and why.
pub(crate) type ReplacedIndex = (PathBuf, String);

/// The time at which an index that failed is tried again.
#[derive(Clone, Copy)]
struct Retry {
    at: Instant,
    pause: Duration,
}

/// The open database.
struct Trees {
    db: sled::Db,
    /// The rows, in the order of [`Kind::ALL`].
    rows: [sled::Tree; Kind::ALL.len()],
    generations: sled::Tree,
    folder: PathBuf,
}

/// The rows of a map in the database.
#[derive(Default)]
struct KnownRows {
    /// The items by [`Kind`], a sum for each item.
    items: [Vec<Sum>; Kind::ALL.len()],
    /// The models of tiles that were written, by tile.
    models: Vec<Weak<TileModel>>,
}

impl KnownRows {
    fn of(&self, kind: Kind) -> &Vec<Sum> {
        &self.items[kind as usize]
    }

    fn take(&mut self, kind: Kind) -> Vec<Sum> {
        std::mem::take(&mut self.items[kind as usize])
    }

    fn put(&mut self, kind: Kind, sums: Vec<Sum>) {
        self.items[kind as usize] = sums;
    }

    fn totals(&self) -> Vec<Total> {
        self.items.iter().map(|sums| rows::total(sums)).collect()
    }
}

/// Whether the rows of a map are those of its newest snapshot.
#[derive(Clone, Debug, PartialEq, Eq)]
pub(crate) enum RowsState {
    /// The rows are whole, and of the snapshot at this log position and this generation.
    Whole {
        /// Log position of the snapshot.
        position: u64,
        /// Number of the generation.
        generation: u64,
    },
    /// There are no rows.
    Nothing,
    /// The rows were not completely written.
    Unfinished,
}

/// The index, or what is left of it.
pub(crate) struct Index {
    folder: PathBuf,
    cache_bytes: u64,
    /// `None` after a failure: the store continues without it, until it is opened again.
    trees: Option<Trees>,
    /// The reason why there are no trees.
    failure: Option<ReadFailure>,
    retry: Option<Retry>,
    /// Maps whose rows are all known.
    written: BTreeMap<u32, KnownRows>,
}

impl Trees {
    fn open(folder: &Path, cache_bytes: u64, lock_tries: usize) -> Result<Trees, Unopened> {
        panics::catch(|| {
            folder::remove_unfinished_snapshots(folder)?;
            folder::check_settings(folder)?;
            // sled only logs a failed fsync of its own; here every flush is followed by an fsync of ours.
            let config = sled::Config::new().path(folder).cache_capacity(cache_bytes).flush_every_ms(None);
            let db = open_unlocked(&config, lock_tries)
                .map_err(|error| if is_in_use(&error) { Unopened::InUse } else { error.into() })?;
            let tree = |kind: Kind| db.open_tree(kind.name());
            let [states, tiles, cells, tables, producers] = Kind::ALL.map(tree);
            Ok(Trees {
                rows: [states?, tiles?, cells?, tables?, producers?],
                generations: db.open_tree(GENERATIONS)?,
                folder: folder.to_owned(),
                db,
            })
        })?
    }

    fn of(&self, kind: Kind) -> &sled::Tree {
        &self.rows[kind as usize]
    }

    /// Makes everything durable: sled's flush does not fsync.
    fn flush(&self) -> Result<(), ReadFailure> {
        self.db.flush()?;
        Ok(File::open(self.folder.join("db")).and_then(|file| file.sync_all())?)
    }
}

/// Opens the database. The threads of one that this process has just closed may hold its lock for a moment; another
/// process cannot, because the lock of the data folder is ours.
fn open_unlocked(config: &sled::Config, tries: usize) -> sled::Result<sled::Db> {
    let mut opened = config.open();
    for _ in 1..tries {
        if !opened.as_ref().is_err_and(is_in_use) {
            break;
        }
        std::thread::sleep(LOCK_PAUSE);
        opened = config.open();
    }
    opened
}

fn is_in_use(error: &sled::Error) -> bool {
    matches!(error, sled::Error::Io(error) if error.to_string().contains("could not acquire lock"))
}

impl Index {
    fn closed(folder: PathBuf, cache_bytes: u64) -> Index {
        Index { folder, cache_bytes, trees: None, failure: None, retry: None, written: BTreeMap::new() }
    }

    /// Opens the index. One that is damaged is renamed and an empty one created; the second value is its new path, and
    /// why. One that the disk or the machine refuses stays as it is, and is tried again by [`Self::reopen`].
    ///
    /// # Errors
    /// [`IndexInUse`]; nothing is changed.
    pub(crate) fn open(folder: PathBuf, cache_bytes: u64) -> Result<(Index, Option<ReplacedIndex>), IndexInUse> {
        let mut index = Index::closed(folder, cache_bytes);
        match index.try_open(LOCK_TRIES) {
            Ok(replaced) => Ok((index, replaced)),
            Err(Unopened::InUse) => Err(IndexInUse),
            Err(Unopened::Failed(failure)) => {
                index.note(failure);
                Ok((index, None))
            }
        }
    }

    /// Opens it, and replaces it where it is damaged.
    fn try_open(&mut self, lock_tries: usize) -> Result<Option<ReplacedIndex>, Unopened> {
        rewrite::remove_leftovers(&self.folder)?;
        match Trees::open(&self.folder, self.cache_bytes, lock_tries) {
            Ok(trees) => {
                self.trees = Some(trees);
                self.failure = None;
                Ok(None)
            }
            Err(Unopened::Failed(ReadFailure::Damaged(damage))) => Ok(Some((self.replace()?, damage))),
            Err(unopened) => Err(unopened),
        }
    }

    /// Whether the index is to be opened again now.
    pub(crate) fn is_retry_due(&self, now: Instant) -> bool {
        self.trees.is_none() && self.failure.is_some() && self.retry.is_none_or(|retry| now >= retry.at)
    }

    /// Opens an index that has failed; whether it is open now, and what was replaced. Its rows must be checked then.
    pub(crate) fn reopen(&mut self) -> (bool, Option<ReplacedIndex>) {
        if self.trees.is_some() || self.failure.is_none() {
            return (false, None);
        }
        match self.try_open(1) {
            Ok(replaced) => (true, replaced),
            Err(unopened) => {
                self.note(unopened.into());
                (false, None)
            }
        }
    }

    /// The index has all that it should have: the next failure is tried again soon.
    pub(crate) fn has_recovered(&mut self) {
        if self.is_available() {
            self.retry = None;
        }
    }

    /// Opens the index as it is, to check it.
    pub(crate) fn inspect(folder: PathBuf, cache_bytes: u64) -> Result<Index, Unopened> {
        let trees = Some(Trees::open(&folder, cache_bytes, LOCK_TRIES)?);
        Ok(Index { trees, ..Index::closed(folder, cache_bytes) })
    }

    /// No index.
    pub(crate) fn none() -> Index {
        Index::closed(PathBuf::new(), 0)
    }

    /// Why the index is not used, where it should be.
    pub(crate) fn failure(&self) -> Option<String> {
        self.failure.as_ref().map(ReadFailure::to_string)
    }

    /// Whether the index is usable.
    pub(crate) fn is_available(&self) -> bool {
        self.trees.is_some()
    }

    /// Renames the index and creates an empty one. Returns the new path of the old one.
    pub(crate) fn replace(&mut self) -> Result<PathBuf, ReadFailure> {
        self.give_up();
        let aside = folder::set_aside(&self.folder)?;
        self.create().inspect_err(|_| {
            tracing::warn!(folder = %aside.display(), "a damaged index is set aside, and no new one can be made yet");
        })?;
        Ok(aside)
    }

    /// Removes the index and creates an empty one.
    fn drop_all(&mut self) -> Result<(), ReadFailure> {
        self.give_up();
        match fs::remove_dir_all(&self.folder) {
            Err(error) if error.kind() != io::ErrorKind::NotFound => return Err(error.into()),
            _ => {}
        }
        self.create()
    }

    fn create(&mut self) -> Result<(), ReadFailure> {
        let trees = Trees::open(&self.folder, self.cache_bytes, LOCK_TRIES)?;
        folder::sync_with_parent(&self.folder)?;
        self.trees = Some(trees);
        self.failure = None;
        Ok(())
    }

    /// Continues without an index.
    fn give_up(&mut self) {
        self.written.clear();
        let trees = self.trees.take();
        // Closing a damaged database can panic, like any of its calls.
        let _ = panics::catch(move || drop(trees));
    }

    /// Reads the published data of a map from its rows; `None` where they are not whole. Changes nothing.
    pub(crate) fn read(&self, map: u32, spec: &MapSpec) -> Result<Option<MapSnapshot>, ReadFailure> {
        let Some(trees) = &self.trees else { return Ok(None) };
        panics::catch(|| read::read(trees, map, spec))?
    }

    /// Reads and checks all rows of a map.
    pub(crate) fn check(&mut self, map: u32) -> Result<RowsState, ReadFailure> {
        let Some(trees) = &self.trees else { return Ok(RowsState::Nothing) };
        let checked = panics::catch(|| match read::mark(trees, map)? {
            MarkState::Nothing => Ok(Err(RowsState::Nothing)),
            MarkState::Unfinished => Ok(Err(RowsState::Unfinished)),
            MarkState::Clean(mark, _) => {
                let known = read::check(trees, map, &mark)?;
                let snapshot = mark.snapshot.unwrap_or_default();
                Ok::<_, ReadFailure>(Ok((known, snapshot.position, snapshot.generation)))
            }
        })??;
        Ok(match checked {
            Ok((known, position, generation)) => {
                self.written.insert(map, known);
                RowsState::Whole { position, generation }
            }
            Err(state) => state,
        })
    }

    /// Number and bytes of the rows of a map that was checked or saved.
    pub(crate) fn size_of(&self, map: u32) -> (u64, u64) {
        let totals = self.written.get(&map).map_or_else(Vec::new, KnownRows::totals);
        totals.iter().fold((0, 0), |(records, bytes), total| (records + total.records, bytes + total.bytes))
    }

    /// Bytes of the database on the disk.
    pub(crate) fn disk_bytes(&self) -> u64 {
        self.trees.as_ref().and_then(|trees| trees.db.size_on_disk().ok()).unwrap_or(0)
    }

    /// Saves what a snapshot publishes. An index that fails is dropped; the checkpoint holds more.
    pub(crate) fn save(&mut self, map: u32, snapshot: &MapSnapshot) {
        let Some(trees) = &self.trees else { return };
        let before = self.written.remove(&map);
        let saved = panics::catch(|| {
            let written = save::save(trees, map, snapshot, before)?;
            Ok((written, rewrite::is_worth_it(trees)))
        });
        match saved.flatten() {
            Ok((written, is_worth_it)) => {
                self.written.insert(map, written);
                if is_worth_it {
                    self.rewrite();
                }
            }
            Err(failure) => self.fail(failure),
        }
    }

    /// Copies everything into a new folder, because sled frees little of what it has used.
    fn rewrite(&mut self) {
        let (folder, cache_bytes) = (self.folder.clone(), self.cache_bytes);
        let Some(trees) = self.trees.take() else { return };
        match panics::catch(move || rewrite::rewrite(trees, &folder, cache_bytes)).flatten() {
            Ok(trees) => self.trees = Some(trees),
            Err(failure) => self.fail(failure),
        }
    }

    /// Continues without the index until it is opened again.
    pub(crate) fn fail(&mut self, failure: ReadFailure) {
        tracing::warn!(%failure, "the index has failed: it is not used, and tried again");
        self.give_up();
        self.note(failure);
    }

    fn note(&mut self, failure: ReadFailure) {
        self.failure = Some(failure);
        let pause = self.retry.map_or(RETRY_FIRST, |retry| (retry.pause * 2).min(RETRY_MAX));
        self.retry = Some(Retry { at: Instant::now() + pause, pause });
    }

    /// Removes the rows of a map.
    pub(crate) fn purge(&mut self, map: u32) {
        self.written.remove(&map);
        let Some(trees) = &self.trees else { return };
        if let Err(failure) = panics::catch(|| save::purge(trees, map)).flatten() {
            self.fail(failure);
        }
    }

    /// Removes the rows of maps that are gone. They may have gone while the index was not open.
    pub(crate) fn purge_unknown(&mut self, is_known: impl Fn(u32) -> bool) {
        let Some(trees) = &self.trees else { return };
        match panics::catch(|| read::marked(trees)).flatten() {
            Ok(maps) => maps.into_iter().filter(|&map| !is_known(map)).for_each(|map| self.purge(map)),
            Err(failure) => self.fail(failure),
        }
    }

    /// Removes everything of a map from the disk: the database is written again without its rows, or dropped where that
    /// fails, and databases that were set aside are removed.
    pub(crate) fn erase(&mut self, map: u32) -> Result<(), ReadFailure> {
        self.purge(map);
        if self.is_available() {
            self.rewrite();
        }
        if !self.folder.as_os_str().is_empty() {
            folder::remove_set_aside(&self.folder)?;
            if !self.is_available() {
                self.drop_all()?;
            }
        }
        Ok(())
    }

    /// Makes everything durable and closes the database.
    pub(crate) fn close(&mut self) {
        if let Some(trees) = &self.trees
            && let Err(failure) = panics::catch(|| trees.flush()).flatten()
        {
            tracing::warn!(%failure, "the index has failed while closing");
        }
        self.give_up();
        // Nobody opens it again.
        self.failure = None;
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
    use crate::record::tables;

    /// CRC-32C over all keys and values of what a snapshot publishes.
    pub(crate) fn rows_checksum(map: u32, snapshot: &MapSnapshot) -> u32 {
        let states = (0..).zip(&snapshot.states).flat_map(|(id, state)| rows::of_state(map, id, state));
        let producers = (0..).zip(&snapshot.producers).flat_map(|(id, mark)| rows::of_producer(map, id, mark));
        let grid = snapshot.grid.iter();
        let tiles = grid.clone().flat_map(|grid| (0..).zip(&grid.tiles));
        let tiles = tiles.flat_map(|(id, tile)| rows::of_tile(map, id, tile).expect("valid"));
        let cells = grid.flat_map(|grid| (0..).zip(&grid.models));
        let cells = cells.flat_map(|(id, model)| rows::of_cells(map, id, &model.get().expect("readable")));
        let tables = (0..).zip(tables::rows(&snapshot.site)).flat_map(|(id, row)| rows::of_table_row(map, id, &row));
        let rows = states.chain(producers).chain(tables).chain(tiles).chain(cells);
        rows.fold(0, |crc, row| crc32c::crc32c_append(crc32c::crc32c_append(crc, &row.key), &row.value))
    }
}
