//! The list of the history files that must exist.
//!
//! Invariant: a file is listed before the checkpoint that lets the log forget what is in it, and no longer listed
//! before it is deleted.

use std::path::{Path, PathBuf};

use tidemap_grid::spec::Retention;
use tidemap_layout::lists::{FileList, HISTORY_FILE, ListedFile};
use tidemap_map::spec::MapSpec;

use super::{History, Part};
use crate::{
    error::{HistoryError, OpenError, StoreError, open_io, store_io},
    list_file::{self, Unlisted},
};

impl History {
    pub(crate) fn list_path(&self) -> PathBuf {
        self.folder.with_file_name(HISTORY_FILE)
    }

    /// The files that must exist.
    pub(crate) fn listed(&self) -> Result<FileList, HistoryError> {
        let file = self.list_path();
        list_file::read(&*self.disk, &file).map_err(|unlisted| match unlisted {
            Unlisted::Io(source) => HistoryError::Io { file, source },
            lost => {
                HistoryError::Damaged { file, reason: format!("{}, so what must be there is unknown", lost.problem()) }
            }
        })
    }

    /// An error if a file that does not exist should, and may have observations of the range.
    pub(super) fn check_missing(
        &self,
        generation: u64,
        part: Part,
        from_nanos: i64,
        to_nanos: i64,
    ) -> Result<(), HistoryError> {
        let name = part.name(generation);
        match self.listed()?.files.into_iter().find(|file| file.name == name) {
            Some(file) if file.from_nanos < to_nanos && file.to_nanos >= from_nanos => Err(HistoryError::Missing {
                file: self.path(generation, part),
                from_nanos: file.from_nanos,
                to_nanos: file.to_nanos,
            }),
            _ => Ok(()),
        }
    }

    /// The entry of a file.
    pub(super) fn entry(&self, path: &Path, name: String, generation: u64) -> Result<ListedFile, HistoryError> {
        let file = super::HistoryFile::open(&*self.disk, path, self.map.0, generation)?;
        let length = self.disk.length(path).map_err(|source| HistoryError::Io { file: path.to_owned(), source })?;
        Ok(ListedFile {
            name,
            from_nanos: file.end.from_nanos,
            to_nanos: file.end.to_nanos,
            length,
            total_crc: file.total_crc,
        })
    }

    pub(super) fn add_to_list(&self, written: Vec<ListedFile>) -> Result<(), StoreError> {
        let path = self.list_path();
        let mut list: FileList = list_file::read(&*self.disk, &path).map_err(|unlisted| unlisted.changing(&path))?;
        // A save that is repeated after a crash writes the same file again.
        list.files.retain(|listed| written.iter().all(|file| file.name != listed.name));
        list.files.extend(written);
        list.files.sort();
        list_file::replace(&*self.disk, &path, &list).map_err(store_io(path))
    }

    pub(crate) fn remove_from_list(&self, forgotten: &[PathBuf]) -> Result<(), HistoryError> {
        let mut list = self.listed()?;
        let names: Vec<_> = forgotten.iter().filter_map(|path| path.file_name()).collect();
        list.files.retain(|file| !names.iter().any(|name| *name == file.name.as_str()));
        let file = self.list_path();
        list_file::replace(&*self.disk, &file, &list).map_err(|source| HistoryError::Io { file, source })
    }

    /// Makes the list again of the files that exist. A file that cannot be read is not listed; reading it is an error
    /// anyway.
    pub(crate) fn make_list(&self) -> Result<(), OpenError> {
        let path = self.list_path();
        let names = self.names().map_err(open_io(&self.folder))?;
        let entry = |name: String| {
            let (generation, _) = Part::of(&name)?;
            self.entry(&self.folder.join(&name), name, generation).ok()
        };
        let mut list = FileList { files: names.into_iter().filter_map(entry).collect() };
        list.files.sort();
        list_file::replace(&*self.disk, &path, &list).map_err(open_io(path))
    }

    /// Whether the files that exist prove to be all, without a list: nothing is kept, or there is a sound file of each
    /// part for every generation up to the newest that is saved; `None`: none is saved yet.
    pub(crate) fn is_whole(&self, spec: &MapSpec, newest: Option<u64>) -> bool {
        let grid = spec.grid.as_ref().map_or(Retention::None, |grid| grid.retention);
        let Ok(names) = self.names() else { return false };
        let newest = newest.unwrap_or(0);
        [(Part::States, spec.retention), (Part::Grid, grid)].into_iter().all(|(part, retention)| match retention {
            Retention::None => true,
            // Files that are too old may have been deleted.
            Retention::Duration(_) => newest == 0,
            Retention::Forever => (1..=newest).all(|generation| {
                names.contains(&part.name(generation))
                    && self.entry(&self.path(generation, part), part.name(generation), generation).is_ok()
            }),
        })
    }
}
