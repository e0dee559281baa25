//! The folders of the maps: listing, creating and deleting them.
//!
//! Invariant: a map's folder has its final name only when everything in it is durable. A created map is listed in
//! `MAPS` before it is acknowledged, and a deleted one is no longer listed before its files go; the list keeps its
//! number from being used again.

use std::{
    collections::{BTreeMap, BTreeSet},
    path::{Path, PathBuf},
};

use tidemap_layout::{
    cluster::SHARED_FILE,
    file::{FileHeader, MAP_MAGIC, RecordKind},
    lists::{CHECKPOINTS_FILE, CheckpointList, FileList, HISTORY_FILE, MAPS_FILE, MapList},
    map as layout,
};
use tidemap_map::spec::MapSpec;

use crate::{
    MapId,
    disk::{Disk, read_all},
    error::{OpenError, Repair, StoreError, open_io, store_io},
    failure::ReadFailure,
    folders, list_file,
    log::writer::create_log,
    record,
    record_file::{RecordReader, RecordWriter},
};

const NEW_SUFFIX: &str = ".new";
const DELETED_SUFFIX: &str = ".deleted";

/// A map that cannot be used. Its files are left as they are.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct SetAside {
    /// The number of the map, from 1.
    pub id: MapId,
    /// Name of the map, where it is known.
    pub name: Option<String>,
    /// Description of the damage.
    pub reason: String,
}

/// The maps of a store.
pub(crate) struct Catalogue {
    /// Maps by number, as their MAP files define them.
    pub(crate) maps: BTreeMap<MapId, MapSpec>,
    /// Maps whose folder is missing or whose MAP file is damaged.
    pub(crate) set_aside: BTreeMap<MapId, SetAside>,
    /// Whether `MAPS` has other contents.
    pub(crate) is_list_old: bool,
    /// The fault of `MAPS`, if it is lost: the maps that must exist are not known then.
    pub(crate) lost_list: Option<String>,
    /// Deleted maps, which may still have files.
    pub(crate) deleted: BTreeSet<MapId>,
    /// The next unused number.
    pub(crate) next: u32,
}

/// Lists the maps, and removes leftovers of interrupted creations.
pub(crate) fn read(disk: &dyn Disk, directory: &Path, repairs: &mut Vec<Repair>) -> Result<Catalogue, OpenError> {
    let remove = |path: &Path| disk.remove_folder(path).map_err(open_io(path));
    read_with(disk, directory, repairs, &remove)
}

/// Lists the maps, and those that cannot be used, and changes nothing.
pub(crate) fn read_only(disk: &dyn Disk, directory: &Path) -> Result<Catalogue, OpenError> {
    read_with(disk, directory, &mut Vec::new(), &|_| Ok(()))
}

fn read_with(
    disk: &dyn Disk,
    directory: &Path,
    repairs: &mut Vec<Repair>,
    remove: &dyn Fn(&Path) -> Result<(), OpenError>,
) -> Result<Catalogue, OpenError> {
    let folder = folders::maps_folder(directory);
    let file = directory.join(MAPS_FILE);
    let (list, lost_list) = match list_file::read::<MapList>(disk, &file) {
        Ok(list) => (Some(list), None),
        Err(unlisted) => (None, Some(unlisted.lost().map_err(open_io(&file))?)),
    };
    let known = list.clone().unwrap_or_default();
    let name_of = |map: MapId| known.maps.iter().find(|(number, _)| *number == map.0).map(|(_, name)| name.clone());
    let mut catalogue = Catalogue {
        maps: BTreeMap::new(),
        set_aside: BTreeMap::new(),
        is_list_old: false,
        lost_list,
        deleted: BTreeSet::new(),
        next: known.next.max(1),
    };
    for name in disk.list(&folder).map_err(open_io(&folder))? {
        let path = folder.join(&name);
        if let Some(map) = name.strip_suffix(NEW_SUFFIX).and_then(folders::map_number) {
            // The creation never succeeded, so its number is free.
            remove(&path)?;
            repairs.push(Repair::LeftoverRemoved { file: path });
            catalogue.next = catalogue.next.max(map.0);
        } else if let Some(map) = name.strip_suffix(DELETED_SUFFIX).and_then(folders::map_number) {
            catalogue.deleted.insert(map);
            catalogue.next = catalogue.next.max(map.0.saturating_add(1));
        } else if let Some(map) = folders::map_number(&name) {
            match read_spec(disk, &path.join("MAP"), map) {
                Ok(spec) => {
                    if list.is_some() && name_of(map).is_none() {
                        repairs.push(Repair::MapListed { map });
                    }
                    catalogue.maps.insert(map, spec);
                }
                Err(failure) => {
                    if let Some(error) = failure.shortage() {
                        return Err(open_io(path.join("MAP"))(error));
                    }
                    let reason = match failure {
                        ReadFailure::Damaged(reason) => format!("its file MAP cannot be used: {reason}. {RESTORE}"),
                        ReadFailure::Disk(reason) => format!("its file MAP cannot be read: {reason}. {CHECK_THE_DISK}"),
                    };
                    catalogue.set_aside.insert(map, SetAside { id: map, name: name_of(map), reason });
                }
            }
            catalogue.next = catalogue.next.max(map.0.saturating_add(1));
        }
    }
    for (number, name) in &known.maps {
        let map = MapId(*number);
        let is_known = catalogue.maps.contains_key(&map) || catalogue.set_aside.contains_key(&map);
        if !is_known && !catalogue.deleted.contains(&map) {
            let reason = format!("its folder is missing. {RESTORE}");
            catalogue.set_aside.insert(map, SetAside { id: map, name: Some(name.clone()), reason });
        }
    }
    catalogue.is_list_old = list.is_some_and(|list| list != catalogue.list());
    Ok(catalogue)
}

/// Advice about a map that the disk does not give.
const CHECK_THE_DISK: &str = "It may be sound: check the disk and the permissions, and restart the daemon";
/// Advice about a map that cannot be used.
const RESTORE: &str = "Restore the folder of this map from a backup, or delete the map to continue without it";

impl Catalogue {
    /// Sets a map aside that turns out to be damaged.
    pub(crate) fn set_aside(&mut self, map: MapId, reason: String) {
        if let Some(known) = self.maps.remove(&map) {
            let name = Some(known.name.as_str().to_owned());
            self.set_aside.insert(map, SetAside { id: map, name, reason });
        }
    }

    /// The contents that `MAPS` should have.
    pub(crate) fn list(&self) -> MapList {
        let maps = self.maps.iter().map(|(map, known)| (map.0, known.name.as_str().to_owned()));
        let set_aside = self.set_aside.values().map(|map| (map.id.0, map.name.clone().unwrap_or_default()));
        let mut maps: Vec<_> = maps.chain(set_aside).collect();
        maps.sort();
        MapList { next: self.next, maps }
    }
}

/// The list of maps.
pub(crate) fn read_list(disk: &dyn Disk, directory: &Path) -> Result<MapList, StoreError> {
    let file = directory.join(MAPS_FILE);
    list_file::read(disk, &file).map_err(|unlisted| unlisted.changing(&file))
}

/// Changes the list of maps; durable when this returns.
pub(crate) fn change_list(
    disk: &dyn Disk,
    directory: &Path,
    change: impl FnOnce(&mut MapList),
) -> Result<(), StoreError> {
    let mut list = read_list(disk, directory)?;
    change(&mut list);
    list.maps.sort();
    let file = directory.join(MAPS_FILE);
    list_file::replace(disk, &file, &list).map_err(store_io(file))
}

/// Lists the maps, and changes nothing.
pub(crate) fn list(disk: &dyn Disk, directory: &Path) -> Result<Vec<(MapId, MapSpec)>, OpenError> {
    let folder = folders::maps_folder(directory);
    let mut maps = Vec::new();
    for map in disk.list(&folder).map_err(open_io(&folder))?.iter().filter_map(|name| folders::map_number(name)) {
        let file = folders::map_folder(directory, map).join("MAP");
        let found = read_spec(disk, &file, map).map_err(|failure| match failure {
            ReadFailure::Damaged(reason) => OpenError::Damaged { file, reason },
            ReadFailure::Disk(reason) => OpenError::Io { file, source: std::io::Error::other(reason) },
        })?;
        maps.push((map, found));
    }
    Ok(maps)
}

fn read_spec(disk: &dyn Disk, file: &Path, map: MapId) -> Result<MapSpec, ReadFailure> {
    let mut reader = RecordReader::open(disk, file, MAP_MAGIC, map.0)?;
    let message: layout::MapSpec = reader.record(RecordKind::Spec)?;
    reader.finish()?;
    Ok(record::spec::decode(message)?)
}

/// Creates a map's folder: durable when this returns, and complete or absent at every moment before.
pub(crate) fn create(
    disk: &dyn Disk,
    directory: &Path,
    map: MapId,
    spec: &MapSpec,
    shared: Option<u64>,
) -> Result<(), StoreError> {
    let new_folder = new_folder(directory, map);
    let write = || {
        disk.create_folder(&new_folder)?;
        create_log(disk, &new_folder.join("log"), map.0, 1)?;
        disk.create_folder(&new_folder.join("checkpoints"))?;
        disk.sync_folder(&new_folder.join("checkpoints"))?;
        list_file::replace(disk, &new_folder.join(CHECKPOINTS_FILE), &CheckpointList::default())?;
        list_file::replace(disk, &new_folder.join(HISTORY_FILE), &FileList::default())
    };
    let written = write().map_err(store_io(&new_folder));
    let written = written.and_then(|()| write_properties(disk, &new_folder, map, spec, shared));
    if let Err(error) = written {
        // Frees the space now; if this fails, the next start removes the folder.
        let _ = disk.remove_folder(&new_folder);
        return Err(error);
    }
    publish(disk, directory, map, spec)
}

/// The folder of a map that is being created. A start removes it.
pub(crate) fn new_folder(directory: &Path, map: MapId) -> PathBuf {
    folders::with_suffix(&folders::map_folder(directory, map), NEW_SUFFIX)
}

/// Writes what makes a folder that of a map: its fixed properties, and its number in the cluster; durable with the
/// names when this returns.
pub(crate) fn write_properties(
    disk: &dyn Disk,
    folder: &Path,
    map: MapId,
    spec: &MapSpec,
    shared: Option<u64>,
) -> Result<(), StoreError> {
    let file = folder.join("MAP");
    let write = || {
        let header = FileHeader { magic: MAP_MAGIC, map: map.0, position: 0 };
        let mut writer = RecordWriter::create(disk, &file, &header)?;
        writer.record(RecordKind::Spec, &record::spec::encode(spec))?;
        writer.finish()?;
        if let Some(uid) = shared {
            let mut file = disk.create(&folder.join(SHARED_FILE))?;
            file.append(format!("{uid:016x}").as_bytes())?;
            file.sync()?;
        }
        disk.sync_folder(folder)
    };
    write().map_err(store_io(folder))?;
    match read_spec(disk, &file, map) {
        Ok(read) if read == *spec => Ok(()),
        Ok(_) => Err(StoreError::NotReadBack { file, reason: "the content differs".to_owned() }),
        Err(failure) => Err(StoreError::NotReadBack { file, reason: failure.into() }),
    }
}

/// Gives the complete folder of a new map its final name, and lists the map; durable when this returns.
pub(crate) fn publish(disk: &dyn Disk, directory: &Path, map: MapId, spec: &MapSpec) -> Result<(), StoreError> {
    let (folder, new_folder) = (folders::map_folder(directory, map), new_folder(directory, map));
    disk.rename(&new_folder, &folder).map_err(store_io(&folder))?;
    let maps = folders::maps_folder(directory);
    let listed = disk.sync_folder(&maps).map_err(store_io(maps)).and_then(|()| {
        change_list(disk, directory, |list| {
            list.maps.push((map.0, spec.name.as_str().to_owned()));
            list.next = list.next.max(map.0.saturating_add(1));
        })
    });
    listed.inspect_err(|_| {
        // A map whose creation has failed must not appear at the next start.
        let _ = disk.rename(&folder, &new_folder);
    })
}

/// The number in its cluster of a map that is one of a cluster.
pub(crate) fn read_shared(disk: &dyn Disk, directory: &Path, map: MapId) -> Result<Option<u64>, OpenError> {
    let file = folders::map_folder(directory, map).join(SHARED_FILE);
    let text = match read_all(disk, &file) {
        Ok(text) => text,
        Err(error) if error.kind() == std::io::ErrorKind::NotFound => return Ok(None),
        Err(error) => return Err(open_io(file)(error)),
    };
    let uid = std::str::from_utf8(&text).ok().filter(|text| text.len() == 16);
    match uid.and_then(|uid| u64::from_str_radix(uid, 16).ok()) {
        Some(uid) => Ok(Some(uid)),
        None => Err(OpenError::Damaged { file, reason: "it does not hold 16 hexadecimal digits".to_owned() }),
    }
}

/// Gives a map's folder the name of a deleted one; durable once the folder of all maps is.
pub(crate) fn mark_deleted(disk: &dyn Disk, directory: &Path, map: MapId) -> Result<(), StoreError> {
    let folder = folders::map_folder(directory, map);
    disk.rename(&folder, &folders::with_suffix(&folder, DELETED_SUFFIX)).map_err(store_io(&folder))
}

/// Removes the folder of a deleted map, which is no longer listed.
pub(crate) fn remove_deleted(disk: &dyn Disk, directory: &Path, map: MapId) -> Result<(), StoreError> {
    remove_replaced(disk, directory, map)?;
    let folder = folders::with_suffix(&folders::map_folder(directory, map), DELETED_SUFFIX);
    match disk.remove_folder(&folder) {
        Err(error) if error.kind() != std::io::ErrorKind::NotFound => Err(store_io(folder)(error)),
        _ => {
            let maps = folders::maps_folder(directory);
            disk.sync_folder(&maps).map_err(store_io(maps))
        }
    }
}

/// Removes the folders that copies of a map have replaced.
fn remove_replaced(disk: &dyn Disk, directory: &Path, map: MapId) -> Result<(), StoreError> {
    for number in 1_u32.. {
        let folder = folders::replaced_folder(directory, map, number);
        match disk.remove_folder(&folder) {
            Err(error) if error.kind() == std::io::ErrorKind::NotFound => break,
            removed => removed.map_err(store_io(folder))?,
        }
    }
    Ok(())
}
