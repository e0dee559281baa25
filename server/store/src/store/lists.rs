//! The lists of what must exist, when a store is opened: a list that is lost is made again only where other files prove
//! that all is there.
//!
//! Invariant: nothing that may be lost is hidden. A list that is lost and not proven stays as it is, and what it covers
//! is refused.

use std::{
    collections::BTreeMap,
    io,
    path::{Path, PathBuf},
    sync::Arc,
};

use tidemap_layout::lists::{FileList, MAPS_FILE, MapList, NEWEST_FILE, NewestSegment};
use tidemap_map::spec::MapSpec;

use super::catalogue::Catalogue;
use crate::{
    MapId,
    checkpoint::Checkpoints,
    disk::Disk,
    error::{OpenError, Repair, open_io},
    folders,
    history::History,
    list_file::{self, Unlisted},
    log::segment_position,
};

/// Makes the list of maps of a new data directory. Safe to run again: a list that is there stays.
pub(crate) fn make_first(disk: &dyn Disk, directory: &Path) -> Result<(), OpenError> {
    let file = directory.join(MAPS_FILE);
    if disk.length(&file).is_ok() {
        return Ok(());
    }
    list_file::replace(disk, &file, &MapList { next: 1, maps: Vec::new() }).map_err(open_io(file))
}

/// Lists the newest segment that exists.
pub(crate) fn make_newest(disk: &dyn Disk, directory: &Path, map: MapId) -> io::Result<()> {
    let folder = folders::log_folder(directory, map);
    let newest = disk.list(&folder)?.iter().rev().find_map(|name| segment_position(name));
    let first_position = newest.ok_or(io::ErrorKind::NotFound)?;
    list_file::replace(disk, &folder.join(NEWEST_FILE), &NewestSegment { first_position })
}

/// Lists the checkpoints that exist, and the first segment.
pub(crate) fn make_checkpoints(disk: &dyn Disk, directory: &Path, map: MapId) -> io::Result<()> {
    let checkpoints = Checkpoints { disk, folder: folders::checkpoints_folder(directory, map), map };
    let present = checkpoints.present(&folders::log_folder(directory, map))?;
    list_file::replace(disk, &checkpoints.list_path(), &present)
}

fn history(disk: &Arc<dyn Disk>, directory: &Path, map: MapId) -> History {
    History::at(Arc::clone(disk), folders::history_folder(directory, map), map)
}

/// Whether the history files of a map prove to be all, without their list.
pub(crate) fn is_history_whole(disk: &Arc<dyn Disk>, directory: &Path, map: MapId, spec: &MapSpec) -> bool {
    let checkpoints = Checkpoints { disk: &**disk, folder: folders::checkpoints_folder(directory, map), map };
    let newest = checkpoints.newest_generation();
    // Without a checkpoint nothing was saved, if none must exist.
    let is_known = newest.is_some() || checkpoints.listed().is_ok_and(|list| list.checkpoints.is_empty());
    is_known && history(disk, directory, map).is_whole(spec, newest)
}

/// Reads the lists of the maps that are found. Lists that are lost and not proven are returned, with a description of
/// the damage; a map whose list the disk cannot read is set aside.
pub(super) fn lost(
    disk: &Arc<dyn Disk>,
    directory: &Path,
    catalogue: &mut Catalogue,
    repairs: &mut Vec<Repair>,
) -> Result<BTreeMap<PathBuf, String>, OpenError> {
    let mut lost = BTreeMap::new();
    if let Some(problem) = &catalogue.lost_list {
        lost.insert(PathBuf::from(MAPS_FILE), problem.clone());
    }
    let maps: Vec<_> = catalogue.maps.iter().map(|(&map, known)| (map, known.clone())).collect();
    for (map, spec) in maps {
        let history = history(disk, directory, map);
        let file = history.list_path();
        let problem = match list_file::read::<FileList>(&**disk, &file).map_err(Unlisted::lost) {
            Ok(_) => continue,
            Err(Ok(problem)) => problem,
            Err(Err(error)) => {
                let error = open_io(&file)(error);
                if error.is_shortage() {
                    return Err(error);
                }
                catalogue.set_aside(map, error.to_string());
                continue;
            }
        };
        if is_history_whole(disk, directory, map, &spec) {
            history.make_list()?;
            repairs.push(Repair::ListMade { file, reason: problem });
        } else {
            lost.insert(file.strip_prefix(directory).unwrap_or(&file).to_owned(), problem);
        }
    }
    Ok(lost)
}
