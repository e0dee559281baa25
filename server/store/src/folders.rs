//! The names of the folders of maps, within a data directory.
//!
//! Invariant: a number leads to one name, and that name back to the number.

use std::path::{Path, PathBuf};

use crate::MapId;

/// Folder of all maps.
pub(crate) fn maps_folder(directory: &Path) -> PathBuf {
    directory.join("maps")
}

/// Folder of a map.
pub(crate) fn map_folder(directory: &Path, map: MapId) -> PathBuf {
    maps_folder(directory).join(format!("{:08}", map.0))
}

/// Folder of a map's log.
pub(crate) fn log_folder(directory: &Path, map: MapId) -> PathBuf {
    map_folder(directory, map).join("log")
}

/// Folder of a map's checkpoints.
pub(crate) fn checkpoints_folder(directory: &Path, map: MapId) -> PathBuf {
    map_folder(directory, map).join("checkpoints")
}

/// Folder of a map's history.
pub(crate) fn history_folder(directory: &Path, map: MapId) -> PathBuf {
    map_folder(directory, map).join("history")
}

/// The folder of a map that the copy of this number has replaced.
pub(crate) fn replaced_folder(directory: &Path, map: MapId, number: u32) -> PathBuf {
    with_suffix(&map_folder(directory, map), &format!(".replaced-{number}"))
}

/// The path of a folder with another ending; `suffix` begins with a dot.
pub(crate) fn with_suffix(folder: &Path, suffix: &str) -> PathBuf {
    folder.with_extension(&suffix[1..])
}

/// The map whose folder has this name; `None`: it is not the name of a map's folder.
pub(crate) fn map_number(name: &str) -> Option<MapId> {
    let is_number = name.len() >= 8 && name.bytes().all(|byte| byte.is_ascii_digit());
    if is_number { name.parse().ok().filter(|&number| number > 0).map(MapId) } else { None }
}
