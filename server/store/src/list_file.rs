//! Reading and replacing the lists of files that must exist.
//!
//! Invariant: a list is the old one or the new one at every moment, and the new one is durable when a replacement
//! returns.

use std::{io, path::Path};

use tidemap_layout::lists::TextList;

use crate::{
    disk::{Disk, read_all},
    error::{OpenError, StoreError, open_io, store_io},
};

/// Suffix of a list that is being written.
pub(crate) const NEW_EXTENSION: &str = "new";

/// Why there is no list.
#[derive(Debug)]
pub(crate) enum Unlisted {
    /// There is no file.
    Absent,
    /// The file is damaged.
    Damaged(&'static str),
    /// The disk returned an error.
    Io(io::Error),
}

impl Unlisted {
    /// Describes what is wrong with the file.
    pub(crate) fn problem(self) -> String {
        match self {
            Unlisted::Absent => "it is missing".to_owned(),
            Unlisted::Damaged(reason) => reason.to_owned(),
            Unlisted::Io(error) => error.to_string(),
        }
    }

    /// Describes what is wrong with a list that is lost; an error of the disk gives no information about the list.
    pub(crate) fn lost(self) -> io::Result<String> {
        match self {
            Unlisted::Io(error) => Err(error),
            lost => Ok(lost.problem()),
        }
    }

    /// The error with which a change of the list fails.
    pub(crate) fn changing(self, file: &Path) -> StoreError {
        match self.lost() {
            Ok(problem) => StoreError::ListLost { file: file.to_owned(), problem },
            Err(error) => store_io(file)(error),
        }
    }

    /// The error with which data that needs the list is not opened.
    pub(crate) fn opening(self, file: &Path) -> OpenError {
        match self.lost() {
            Ok(problem) => OpenError::ListLost { file: file.to_owned(), problem },
            Err(error) => open_io(file)(error),
        }
    }
}

/// Reads a list.
pub(crate) fn read<L: TextList>(disk: &dyn Disk, file: &Path) -> Result<L, Unlisted> {
    let bytes = read_all(disk, file).map_err(|error| match error.kind() {
        io::ErrorKind::NotFound => Unlisted::Absent,
        _ => Unlisted::Io(error),
    })?;
    L::from_text(&bytes).map_err(Unlisted::Damaged)
}

/// Writes a list in the place of the old one.
pub(crate) fn replace(disk: &dyn Disk, file: &Path, list: &impl TextList) -> io::Result<()> {
    let new_file = file.with_added_extension(NEW_EXTENSION);
    let mut writer = disk.create(&new_file)?;
    writer.append(list.to_text().as_bytes())?;
    writer.sync()?;
    drop(writer);
    disk.rename(&new_file, file)?;
    disk.sync_folder(file.parent().unwrap_or(Path::new(".")))
}
