//! The folders of the maps: listing, creating and deleting them.
//!
//! Invariant: a map's folder has its final name only when everything in it is durable. A deleted map leaves an empty
//! folder, so that its number is never used again.

use std::{
    collections::{BTreeMap, BTreeSet},
    io,
    path::{Path, PathBuf},
};

use tidemap_map::spec::MapSpec;
use tidemap_migrations::{
    v1::file::{FileHeader, MAP_MAGIC},
    v2::{file::RecordKind, map as v2},
};

use crate::{
    MapId,
    disk::Disk,
    error::{OpenError, Report, StoreError, open_io, store_io},
    log::writer::create_log,
    record,
    record_file::{RecordReader, RecordWriter},
};

const NEW_SUFFIX: &str = ".new";
const DELETED_SUFFIX: &str = ".deleted";

/// The content of a map's MAP file.
#[derive(Clone, Debug, PartialEq)]
pub(super) struct Catalogued {
    pub(super) spec: MapSpec,
    /// Whether history files replace the beginning of the log.
    pub(super) history_complete: bool,
}

/// The maps of a store.
pub(super) struct Catalogue {
    pub(super) maps: BTreeMap<MapId, Catalogued>,
    /// Deleted maps, which may still have files.
    pub(super) deleted: BTreeSet<MapId>,
    /// The next unused number.
    pub(super) next: u32,
}

/// Folder of all maps.
pub(super) fn maps_folder(directory: &Path) -> PathBuf {
    directory.join("maps")
}

/// Folder of a map.
pub(super) fn map_folder(directory: &Path, map: MapId) -> PathBuf {
    maps_folder(directory).join(format!("{:08}", map.0))
}

/// Folder of a map's log.
pub(super) fn log_folder(directory: &Path, map: MapId) -> PathBuf {
    map_folder(directory, map).join("log")
}

/// Folder of a map's checkpoints.
pub(super) fn checkpoints_folder(directory: &Path, map: MapId) -> PathBuf {
    map_folder(directory, map).join("checkpoints")
}

/// Folder of a map's history.
pub(super) fn history_folder(directory: &Path, map: MapId) -> PathBuf {
    map_folder(directory, map).join("history")
}

fn with_suffix(folder: &Path, suffix: &str) -> PathBuf {
    folder.with_extension(&suffix[1..])
}

fn map_number(name: &str) -> Option<MapId> {
    let is_number = name.len() >= 8 && name.bytes().all(|byte| byte.is_ascii_digit());
    if is_number { name.parse().ok().filter(|&number| number > 0).map(MapId) } else { None }
}

/// Lists the maps, and removes leftovers of interrupted creations.
pub(super) fn read(disk: &dyn Disk, directory: &Path, reports: &mut Vec<Report>) -> Result<Catalogue, OpenError> {
    let folder = maps_folder(directory);
    let mut catalogue = Catalogue { maps: BTreeMap::new(), deleted: BTreeSet::new(), next: 1 };
    for name in disk.list(&folder).map_err(open_io(&folder))? {
        let path = folder.join(&name);
        if let Some(map) = name.strip_suffix(NEW_SUFFIX).and_then(map_number) {
            // The creation never succeeded, so its number is free.
            disk.remove_folder(&path).map_err(open_io(&path))?;
            reports.push(Report::LeftoverRemoved { file: path });
            catalogue.next = catalogue.next.max(map.0);
        } else if let Some(map) = name.strip_suffix(DELETED_SUFFIX).and_then(map_number) {
            catalogue.deleted.insert(map);
            catalogue.next = catalogue.next.max(map.0.saturating_add(1));
        } else if let Some(map) = map_number(&name) {
            let file = path.join("MAP");
            let spec = read_spec(disk, &file, map).map_err(|reason| OpenError::Damaged { file, reason })?;
            catalogue.maps.insert(map, spec);
            catalogue.next = catalogue.next.max(map.0.saturating_add(1));
        }
    }
    Ok(catalogue)
}

/// Lists the maps, and changes nothing.
pub(super) fn list(disk: &dyn Disk, directory: &Path) -> Result<Vec<(MapId, MapSpec)>, OpenError> {
    let folder = maps_folder(directory);
    let mut maps = Vec::new();
    for map in disk.list(&folder).map_err(open_io(&folder))?.iter().filter_map(|name| map_number(name)) {
        let file = map_folder(directory, map).join("MAP");
        let found = read_spec(disk, &file, map).map_err(|reason| OpenError::Damaged { file, reason })?;
        maps.push((map, found.spec));
    }
    Ok(maps)
}

fn read_spec(disk: &dyn Disk, file: &Path, map: MapId) -> Result<Catalogued, String> {
    let mut reader = RecordReader::open(disk, file, MAP_MAGIC, map.0)?;
    let message: v2::MapSpec = reader.record(RecordKind::Spec)?;
    reader.finish()?;
    let history_complete = message.history_complete;
    Ok(Catalogued { spec: record::spec::decode(message)?, history_complete })
}

/// Creates a map's folder: durable when this returns, and complete or absent at every moment before.
pub(super) fn create(disk: &dyn Disk, directory: &Path, map: MapId, spec: &MapSpec) -> Result<(), StoreError> {
    let folder = map_folder(directory, map);
    let new_folder = with_suffix(&folder, NEW_SUFFIX);
    let file = new_folder.join("MAP");
    let write = || {
        disk.create_folder(&new_folder)?;
        let header = FileHeader { magic: MAP_MAGIC, map: map.0, position: 0 };
        let mut writer = RecordWriter::create(disk, &file, &header)?;
        writer.record(RecordKind::Spec, &record::spec::encode(spec, true))?;
        writer.finish()?;
        create_log(disk, &new_folder.join("log"), map.0)?;
        disk.create_folder(&new_folder.join("checkpoints"))?;
        disk.sync_folder(&new_folder.join("checkpoints"))?;
        disk.sync_folder(&new_folder)
    };
    let written = write().map_err(store_io(&new_folder)).and_then(|()| match read_spec(disk, &file, map) {
        Ok(read) if read.spec == *spec && read.history_complete => Ok(()),
        Ok(_) => Err(StoreError::NotReadBack { file: file.clone(), reason: "the content differs".to_owned() }),
        Err(reason) => Err(StoreError::NotReadBack { file: file.clone(), reason }),
    });
    if let Err(error) = written {
        // Frees the space now; if this fails, the next start removes the folder.
        let _ = disk.remove_folder(&new_folder);
        return Err(error);
    }
    disk.rename(&new_folder, &folder).map_err(store_io(&folder))?;
    let maps = maps_folder(directory);
    disk.sync_folder(&maps).map_err(|error| {
        // A map whose creation has failed must not appear at the next start.
        let _ = disk.rename(&folder, &new_folder);
        StoreError::from_io(maps, error)
    })
}

/// Gives a map's folder the name of a deleted one; durable once the folder of all maps is.
pub(super) fn mark_deleted(disk: &dyn Disk, directory: &Path, map: MapId) -> Result<(), StoreError> {
    let folder = map_folder(directory, map);
    disk.rename(&folder, &with_suffix(&folder, DELETED_SUFFIX)).map_err(store_io(&folder))
}

/// Removes the files of a deleted map but keeps its empty folder. Returns whether there were any.
pub(super) fn empty_deleted(disk: &dyn Disk, directory: &Path, map: MapId) -> io::Result<bool> {
    let folder = with_suffix(&map_folder(directory, map), DELETED_SUFFIX);
    let names = disk.list(&folder)?;
    for name in &names {
        let path = folder.join(name);
        if name == "MAP" { disk.remove(&path)? } else { disk.remove_folder(&path)? }
    }
    disk.sync_folder(&folder)?;
    Ok(!names.is_empty())
}
