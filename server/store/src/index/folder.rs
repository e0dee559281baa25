//! The folder that sled works in.
//!
//! Invariant: at most one damaged index is kept.

use std::{
    fs::{self, File},
    io,
    path::{Path, PathBuf},
};

use crate::failure::ReadFailure;

/// Removes a snapshot that sled was writing when the process was killed: sled refuses to open with it.
pub(super) fn remove_unfinished_snapshots(folder: &Path) -> io::Result<()> {
    let entries = match fs::read_dir(folder) {
        Ok(entries) => entries,
        Err(error) if error.kind() == io::ErrorKind::NotFound => return Ok(()),
        Err(error) => return Err(error),
    };
    for entry in entries {
        let entry = entry?;
        let name = entry.file_name();
        let name = name.to_string_lossy();
        if name.starts_with("snap.") && name.ends_with(".generating") {
            fs::remove_file(entry.path())?;
        }
    }
    Ok(())
}

/// Reads the settings of the database, where there is one: sled takes what is left of them for settings, or writes new
/// ones without a word.
///
/// # Errors
/// The settings cannot be read, or are not as they were written.
pub(super) fn check_settings(folder: &Path) -> Result<(), ReadFailure> {
    // An empty database has never been flushed.
    match fs::metadata(folder.join("db")) {
        Ok(database) if database.len() > 0 => {}
        Err(error) if error.kind() != io::ErrorKind::NotFound => return Err(error.into()),
        _ => return Ok(()),
    }
    let bytes = match fs::read(folder.join("conf")) {
        Err(error) if error.kind() == io::ErrorKind::NotFound => return Err("its file conf is missing".into()),
        bytes => bytes?,
    };
    match bytes.split_last_chunk::<4>() {
        Some((settings, crc)) if !settings.is_empty() && u32::from_le_bytes(*crc) == crc32fast::hash(settings) => {
            Ok(())
        }
        _ => Err("its file conf is cut or damaged".into()),
    }
}

/// Renames the folder to the next free `index.damaged-N` and removes those before.
pub(super) fn set_aside(folder: &Path) -> io::Result<PathBuf> {
    let parent = folder.parent().unwrap_or(Path::new("."));
    let name = folder.file_name().unwrap_or_default().to_string_lossy();
    let prefix = format!("{name}.damaged-");
    let mut last = 0_u32;
    for entry in fs::read_dir(parent)? {
        let entry = entry?;
        let name = entry.file_name();
        let number = name.to_str().and_then(|name| name.strip_prefix(&prefix)).and_then(|digits| digits.parse().ok());
        if let Some(number) = number {
            last = last.max(number);
            fs::remove_dir_all(entry.path())?;
        }
    }
    let aside = parent.join(format!("{prefix}{}", last.saturating_add(1)));
    if folder.exists() {
        fs::rename(folder, &aside)?;
    }
    File::open(parent)?.sync_all()?;
    Ok(aside)
}

/// Removes what was set aside.
pub(super) fn remove_set_aside(folder: &Path) -> io::Result<()> {
    let parent = folder.parent().unwrap_or(Path::new("."));
    let prefix = format!("{}.damaged", folder.file_name().unwrap_or_default().to_string_lossy());
    for entry in fs::read_dir(parent)? {
        let entry = entry?;
        if entry.file_name().to_string_lossy().starts_with(&prefix) {
            fs::remove_dir_all(entry.path())?;
        }
    }
    File::open(parent)?.sync_all()
}

/// Makes the settings, the names in the folder and its own durable.
pub(super) fn sync_with_parent(folder: &Path) -> io::Result<()> {
    File::open(folder.join("conf"))?.sync_all()?;
    File::open(folder)?.sync_all()?;
    File::open(folder.parent().unwrap_or(Path::new(".")))?.sync_all()
}
