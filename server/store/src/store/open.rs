//! Opening a data directory.
//!
//! Invariant: the format is checked before anything is created or written, and again once the lock is held.

use std::{
    fs::{self, File},
    io,
    path::{Path, PathBuf},
    sync::{Arc, Mutex},
    thread,
};

use tidemap_layout::lists::MAPS_FILE;
use tidemap_migrations::{
    FORMAT,
    manifest::{self, Manifest, ManifestError},
    plan::{self, MigrateError, STEPS},
};

use super::{Lock, MapEntry, Maps, OpenStore, Store, catalogue, lists, map_copy};
use crate::{
    MapId,
    committer::Committer,
    disk::{Disk, RealDisk},
    erasure,
    error::{OpenError, Repair, open_io},
    folders,
    index::{Index, IndexInUse, is_present},
    list_file,
    options::StoreOptions,
};

/// The parts of a store.
pub(crate) struct Parts {
    pub(crate) disk: Arc<dyn Disk>,
    pub(crate) directory: PathBuf,
    pub(crate) options: StoreOptions,
    pub(crate) store_id: String,
    /// Whether the store was created just now.
    pub(crate) is_new: bool,
    pub(crate) index: Index,
    pub(crate) committer: Arc<Committer>,
    pub(crate) repairs: Vec<Repair>,
    /// `None` for a simulated disk.
    pub(crate) lock: Option<Arc<Lock>>,
}

impl Store {
    /// Opens a data directory, or creates one if the directory is empty or does not exist.
    ///
    /// # Errors
    /// [`OpenError`]. A directory that is in use, of a newer format or without its manifest has not been changed.
    pub fn open(directory: &Path, options: StoreOptions) -> Result<Store, OpenError> {
        Store::open_on(Arc::new(RealDisk), directory, options)
    }

    /// Like [`Self::open`], with the maps on another disk. The manifest, the lock and the index stay on the real one.
    ///
    /// # Errors
    /// See [`Self::open`].
    pub fn open_on(disk: Arc<dyn Disk>, directory: &Path, options: StoreOptions) -> Result<Store, OpenError> {
        let found = manifest::read(directory, FORMAT)?;
        if let Some(expected) = &options.expected_store_id
            && found.as_ref().map(|found| &found.store_id) != Some(expected)
        {
            let (expected, found) = (expected.clone(), found.map(|found| found.store_id));
            return Err(OpenError::OtherStore { directory: directory.to_owned(), expected, found });
        }
        let is_new = found.is_none();
        if is_new {
            if is_present(&directory.join("maps")) || is_present(&directory.join("index")) {
                return Err(OpenError::ManifestMissing { directory: directory.to_owned() });
            }
            if !manifest::is_store_id(&options.new_store_id) {
                return Err(ManifestError::StoreId(options.new_store_id).into());
            }
            create_directory(directory).map_err(open_io(directory))?;
        }
        let lock = Lock::take(directory)?;
        // Checked again: another process may have created or migrated it meanwhile.
        let manifest = match manifest::read(directory, FORMAT)? {
            Some(manifest) => plan::migrate(directory, manifest, FORMAT, STEPS).map_err(not_migrated(directory))?,
            None => {
                // First, so that a data directory has its list of maps from its creation on.
                lists::make_first(&*disk, directory)?;
                let manifest = Manifest { format: FORMAT, store_id: options.new_store_id.clone() };
                manifest::write(directory, &manifest)?;
                manifest
            }
        };
        let maps = folders::maps_folder(directory);
        if !maps.exists() {
            fs::create_dir(&maps).map_err(open_io(&maps))?;
        }
        // The folder is synced even if it existed: its name, and that of the manifest, may not be durable yet.
        File::open(directory).and_then(|folder| folder.sync_all()).map_err(open_io(directory))?;

        let opened = Index::open(directory.join("index"), options.index_cache_bytes);
        // A process that has the index open uses the folder, whatever became of the lock.
        let in_use = |IndexInUse| OpenError::Locked { directory: directory.to_owned(), pid: None };
        let (index, set_aside) = opened.map_err(in_use)?;
        let mut repairs = Vec::new();
        if let Some((folder, reason)) = set_aside {
            repairs.push(Repair::IndexSetAside { folder, reason });
        }
        if let Some(reason) = index.failure() {
            repairs.push(Repair::IndexUnavailable { reason });
        }
        let committer = Arc::new(Committer::default());
        let directory = directory.to_owned();
        let store_id = manifest.store_id;
        let lock = Some(Arc::new(lock));
        let parts = Parts { disk, directory, options, store_id, is_new, index, committer, repairs, lock };
        let store = Store::assemble(parts)?;
        store.start().map_err(open_io(&store.inner.directory))?;
        Ok(store)
    }

    /// A store on any disk, without a thread yet.
    pub(crate) fn assemble(parts: Parts) -> Result<Store, OpenError> {
        let Parts { disk, directory, options, store_id, is_new, mut index, committer, mut repairs, lock } = parts;
        if let Some(lock) = &lock {
            committer.hold(lock);
        }
        // Names may be in the page cache only. From here on they are used,
        // so they must be durable first.
        let maps_folder = folders::maps_folder(&directory);
        disk.sync_folder(&maps_folder).map_err(open_io(&maps_folder))?;
        erasure::complete(&*disk, &directory, &mut index, &mut repairs)?;
        map_copy::complete(&*disk, &directory, &mut index, &mut repairs)?;
        let mut catalogue = catalogue::read(&*disk, &directory, &mut repairs)?;
        committer.watch.lost(lists::lost(&disk, &directory, &mut catalogue, &mut repairs)?);
        let unfinished = catalogue.maps.iter().filter_map(|(&map, known)| {
            let repeated = erasure::repeat(&disk, &directory, &options, &mut index, map, known, &mut repairs);
            repeated.err().map(|error| (map, error))
        });
        for (map, error) in unfinished.collect::<Vec<_>>() {
            catalogue.set_aside(map, format!("an erasure has begun and cannot be completed: {error}"));
        }
        if catalogue.is_list_old {
            let file = directory.join(MAPS_FILE);
            list_file::replace(&*disk, &file, &catalogue.list()).map_err(open_io(file))?;
        }
        for &map in &catalogue.deleted {
            // Leftovers of an interrupted deletion.
            index.purge(map.0);
            if let Err(error) = catalogue::remove_deleted(&*disk, &directory, map) {
                tracing::warn!(map = map.0, %error, "a deleted map still takes space; tried again at the next start");
            }
        }
        index.purge_unknown(|map| {
            catalogue.maps.contains_key(&MapId(map)) || catalogue.set_aside.contains_key(&MapId(map))
        });
        committer.watch.indexed(index.failure());
        let entries = catalogue.maps.into_iter().map(|(map, spec)| (map, MapEntry::new(spec))).collect();
        let inner = OpenStore {
            directory,
            disk,
            options,
            store_id,
            is_new,
            repairs,
            maps: Mutex::new(Maps { entries, set_aside: catalogue.set_aside, next: catalogue.next }),
            index: Mutex::new(index),
            committer,
            backup: Mutex::default(),
            thread: Mutex::new(None),
            _lock: lock,
        };
        Ok(Store { inner: Arc::new(inner) })
    }

    /// Starts the committer's thread.
    fn start(&self) -> io::Result<()> {
        let committer = Arc::clone(&self.inner.committer);
        let thread = thread::Builder::new().name("committer".to_owned()).spawn(move || committer.run())?;
        *self.inner.thread.lock().unwrap_or_else(std::sync::PoisonError::into_inner) = Some(thread);
        Ok(())
    }
}

/// Creates a directory whose name is durable.
fn create_directory(directory: &Path) -> io::Result<()> {
    if directory.is_dir() {
        return Ok(());
    }
    fs::create_dir_all(directory)?;
    let parent = directory.parent().filter(|parent| !parent.as_os_str().is_empty());
    File::open(parent.unwrap_or(&PathBuf::from(".")))?.sync_all()
}

fn not_migrated(directory: &Path) -> impl FnOnce(MigrateError) -> OpenError {
    let directory = directory.to_owned();
    move |error| match error {
        MigrateError::Manifest(error) => error.into(),
        source => OpenError::NotMigrated { directory, source },
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_step_that_fails_is_named_with_its_format_and_its_reason() {
        let not_migrated = |error| not_migrated(Path::new("/data"))(error);
        let error = not_migrated(MigrateError::Step { from: 7, source: io::Error::other("no such file") });
        assert_eq!(error.to_string(), "/data: the step from disk format 7 has failed: no such file");
        let crowded = io::Error::from_raw_os_error(rustix::io::Errno::MFILE.raw_os_error());
        assert!(not_migrated(MigrateError::Step { from: 7, source: crowded }).is_shortage() && !error.is_shortage());
        let error = not_migrated(MigrateError::NoWay { from: 7 }).to_string();
        assert_eq!(error, "/data: it has disk format 7, from which this version cannot migrate");
    }
}
