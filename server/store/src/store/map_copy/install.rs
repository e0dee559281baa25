//! How a store takes a copy: it is written to a folder that is no map's, checked, made durable, and then becomes a
//! map, a new one or in the place of one that is there.
//!
//! 1. Files arrive in the folder `NUMBER.new`, which a start removes.
//! 2. A new map: the folder gets its final name, and the map is listed.
//! 3. In the place of a map: the folder is renamed to `NUMBER.copied`. From here on the copy counts, and a start goes
//!    on. The old folder is renamed to `NUMBER.replaced-N`, which nothing opens, and the new one takes its place.
//!
//! Invariant: at every moment a start finds the map in exactly one folder that it uses. A folder that was replaced
//! stays until an operator removes it.

use std::{
    path::{Path, PathBuf},
    sync::{Arc, PoisonError},
};

use tidemap_layout::{
    cluster::FORKS_FOLDER,
    lists::{CHECKPOINTS_FILE, NEWEST_FILE, NewestSegment},
};
use tidemap_map::spec::MapSpec;

use super::{ArrivedNames, CopiedFile, CopyError, CopyPart, CopyTotal, arriving::ArrivingFile, invalid};
use crate::{
    MapId, Store,
    checkpoint::Checkpoints,
    disk::{Disk, read_all},
    error::{OpenError, Repair, StoreError, open_io, store_io},
    folders,
    history::History,
    index::Index,
    list_file,
    log::recovery::{self, Expectation},
    store::{MapEntry, catalogue},
};

const COPIED_SUFFIX: &str = ".copied";

/// A copy that arrives. Dropped before it is installed, it is removed.
pub struct MapCopy {
    store: Store,
    map: MapId,
    is_new: bool,
    spec: MapSpec,
    uid: u64,
    folder: PathBuf,
    arrived: ArrivedNames,
    open: Option<ArrivingFile>,
    bytes: u64,
    /// Position of the last record, once the copy is checked.
    end: Option<u64>,
    is_installed: bool,
}

impl Store {
    /// Begins to take a copy of a map of a cluster: a new map, or what is to replace one. One at a time of each map.
    ///
    /// # Errors
    /// [`StoreError`].
    pub fn begin_copy(&self, spec: &MapSpec, uid: u64, replaces: Option<MapId>) -> Result<MapCopy, StoreError> {
        let inner = self.inner();
        let map = match replaces {
            Some(map) => inner.entry(map).map(|_| map).ok_or(StoreError::UnknownMap(map))?,
            None => inner.take_number(),
        };
        let (disk, folder) = (&*inner.disk, catalogue::new_folder(&inner.directory, map));
        match disk.remove_folder(&folder) {
            Err(error) if error.kind() != std::io::ErrorKind::NotFound => return Err(store_io(&folder)(error)),
            _ => {}
        }
        let create = || {
            disk.create_folder(&folder)?;
            CopiedFile::ALL.into_iter().try_for_each(|kind| disk.create_folder(&folder.join(kind.folder())))
        };
        create().map_err(store_io(&folder))?;
        Ok(MapCopy {
            store: self.clone(),
            map,
            is_new: replaces.is_none(),
            spec: spec.clone(),
            uid,
            folder,
            arrived: ArrivedNames::default(),
            open: None,
            bytes: 0,
            end: None,
            is_installed: false,
        })
    }
}

impl MapCopy {
    /// The map that the copy becomes.
    #[must_use]
    pub fn map(&self) -> MapId {
        self.map
    }

    /// Position of the last record of a copy that was checked; 0 before.
    #[must_use]
    pub fn end(&self) -> u64 {
        self.end.unwrap_or(0)
    }

    /// The amount of data that has arrived.
    #[must_use]
    pub fn arrived(&self) -> CopyTotal {
        CopyTotal { files: self.arrived.0.len() as u64, bytes: self.bytes }
    }

    /// Takes the next part. Waits for the disk.
    ///
    /// # Errors
    /// [`CopyError`]; the copy cannot be used then.
    pub fn take(&mut self, part: &CopyPart) -> Result<(), CopyError> {
        let mut file = match self.open.take() {
            Some(file) => file,
            None => {
                self.arrived.add(&part.name)?;
                ArrivingFile::create(&*self.store.inner().disk, &self.folder, self.map.0, &part.name)?
            }
        };
        file.take(part, &self.folder.join(&file.name))?;
        self.bytes += part.bytes.len() as u64;
        if !part.is_last {
            self.open = Some(file);
        }
        Ok(())
    }

    /// Makes the copy complete, and checks it: whether all has come, whether the log can be read and follows the
    /// checkpoint. Durable when this returns.
    ///
    /// # Errors
    /// [`CopyError`]; the copy cannot be used then.
    pub fn check(&mut self, total: CopyTotal) -> Result<(), CopyError> {
        if self.open.is_some() || self.arrived() != total {
            return Err(invalid("", format!("{:?} was expected, and {:?} arrived", total, self.arrived())));
        }
        let store = self.store.clone();
        let disk = &store.inner().disk;
        let folder = |kind: CopiedFile| self.folder.join(kind.folder());
        for kind in CopiedFile::ALL {
            disk.sync_folder(&folder(kind)).map_err(store_io(folder(kind)))?;
        }
        let log = folder(CopiedFile::Segment);
        let checkpoints = Checkpoints { disk: &**disk, folder: folder(CopiedFile::Checkpoint), map: self.map };
        let present = checkpoints.present(&log).map_err(open_io(&log))?;
        let known = present.checkpoints.last().copied().unwrap_or(0);
        let replay_from = checkpoints.replay_from(1).map_err(open_io(&checkpoints.folder))?;
        if self.arrived.count(CopiedFile::Segment) == 0 || replay_from.is_some() != (known > 0) {
            return Err(invalid("", "it has no log, or a checkpoint that cannot be read"));
        }
        let names = disk.list(&log).map_err(open_io(&log))?;
        let newest = names.iter().filter_map(|name| crate::log::segment_position(name)).next_back().unwrap_or(1);
        let list = log.join(NEWEST_FILE);
        list_file::replace(&**disk, &list, &NewestSegment { first_position: newest }).map_err(store_io(&list))?;
        let list = self.folder.join(CHECKPOINTS_FILE);
        list_file::replace(&**disk, &list, &present).map_err(store_io(&list))?;
        let history = History::at(Arc::clone(disk), folder(CopiedFile::History), self.map);
        history.make_list()?;
        // A file that cannot be read is not listed.
        if history.listed()?.files.len() != self.arrived.count(CopiedFile::History) {
            return Err(invalid("history", "a file cannot be read"));
        }
        let expected =
            Expectation { map: self.map.0, replay_from: replay_from.unwrap_or(1).max(1), known, is_listed: true };
        let end = recovery::read(&**disk, &log, &expected)?.cursor.position - 1;
        catalogue::write_properties(&**disk, &self.folder, self.map, &self.spec, Some(self.uid))?;
        self.end = Some(end);
        Ok(())
    }

    /// Makes the copy a map that can be opened; durable when this returns. A map in whose place it comes must have been
    /// stopped; its folder is set aside, and its path is given.
    ///
    /// # Errors
    /// [`CopyError`]. A map in whose place it comes is as it was then; [`CopyError::Unfinished`]: the next start puts
    /// the copy in its place, and the map must not be used before.
    pub fn install(mut self) -> Result<(MapId, Option<PathBuf>), CopyError> {
        if self.end.is_none() {
            return Err(invalid("", "it was not checked"));
        }
        let store = self.store.clone();
        let (inner, map) = (store.inner(), self.map);
        if self.is_new {
            inner.add_copied(map, &self.spec)?;
            self.is_installed = true;
            return Ok((map, None));
        }
        let entry = inner.close_log(map).ok_or(StoreError::UnknownMap(map))?;
        let _busy = entry.busy.lock().unwrap_or_else(PoisonError::into_inner);
        let (disk, copied) = (&*inner.disk, copied_folder(&inner.directory, map));
        keep_forks(disk, &folders::map_folder(&inner.directory, map), &self.folder)?;
        disk.rename(&self.folder, &copied).map_err(store_io(&copied))?;
        self.is_installed = true;
        let maps = folders::maps_folder(&inner.directory);
        let placed = disk.sync_folder(&maps).map_err(store_io(maps)).and_then(|()| {
            inner.index().purge(map.0);
            put_in_place(disk, &inner.directory, map)
        });
        Ok((map, placed.map_err(CopyError::Unfinished)?))
    }
}

impl Drop for MapCopy {
    fn drop(&mut self) {
        if !self.is_installed {
            // If this fails, the next start removes the folder.
            let _ = self.store.inner().disk.remove_folder(&self.folder);
        }
    }
}

/// Copies the forks of a map, which are this store's own, from its folder to another one; durable when this returns.
fn keep_forks(disk: &dyn Disk, from: &Path, to: &Path) -> Result<(), StoreError> {
    let (from, forks) = (from.join(FORKS_FOLDER), to.join(FORKS_FOLDER));
    let names = match disk.list(&from) {
        Err(error) if error.kind() == std::io::ErrorKind::NotFound => return Ok(()),
        names => names.map_err(store_io(&from))?,
    };
    let copy = || {
        disk.create_folder(&forks)?;
        for name in names {
            let mut file = disk.create(&forks.join(&name))?;
            file.append(&read_all(disk, &from.join(&name))?)?;
            file.sync()?;
        }
        disk.sync_folder(&forks)?;
        disk.sync_folder(to)
    };
    copy().map_err(store_io(&forks))
}

fn copied_folder(directory: &Path, map: MapId) -> PathBuf {
    folders::with_suffix(&folders::map_folder(directory, map), COPIED_SUFFIX)
}

/// Gives a complete copy the name of its map, and sets what has that name aside; gives where that is now.
fn put_in_place(disk: &dyn Disk, directory: &Path, map: MapId) -> Result<Option<PathBuf>, StoreError> {
    let (folder, maps) = (folders::map_folder(directory, map), folders::maps_folder(directory));
    let names = disk.list(&maps).map_err(store_io(&maps))?;
    let is_there = |path: &Path| path.file_name().is_some_and(|name| names.iter().any(|known| name == known.as_str()));
    let mut aside = None;
    if is_there(&folder) {
        let mut places = (1..).map(|number| folders::replaced_folder(directory, map, number));
        let place = places.find(|place| !is_there(place)).unwrap_or_default();
        disk.rename(&folder, &place).map_err(store_io(&folder))?;
        aside = Some(place);
    }
    let copied = copied_folder(directory, map);
    disk.rename(&copied, &folder).map_err(store_io(&copied))?;
    disk.sync_folder(&maps).map_err(store_io(maps))?;
    Ok(aside)
}

/// Runs before the maps are listed at a start: puts copies in their places that were complete.
pub(crate) fn complete(
    disk: &dyn Disk,
    directory: &Path,
    index: &mut Index,
    repairs: &mut Vec<Repair>,
) -> Result<(), OpenError> {
    let maps = folders::maps_folder(directory);
    for name in disk.list(&maps).map_err(open_io(&maps))? {
        let Some(map) = name.strip_suffix(COPIED_SUFFIX).and_then(folders::map_number) else { continue };
        index.purge(map.0);
        put_in_place(disk, directory, map).map_err(|error| error.opening(&maps))?;
        repairs.push(Repair::CopyCompleted { map });
    }
    Ok(())
}

impl crate::store::OpenStore {
    /// Lists a new map whose folder is complete.
    fn add_copied(&self, map: MapId, spec: &MapSpec) -> Result<(), StoreError> {
        let mut maps = self.maps();
        catalogue::publish(&*self.disk, &self.directory, map, spec)?;
        maps.entries.insert(map, MapEntry::new(spec.clone()));
        Ok(())
    }
}
