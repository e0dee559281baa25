//! The list of the checkpoints that must exist, and where the log begins.
//!
//! Invariant: a checkpoint is listed when its save returns, and no longer listed before it is deleted; so is the first
//! segment of the log.

use std::path::{Path, PathBuf};

use tidemap_layout::lists::{CHECKPOINTS_FILE, CheckpointList};

use super::Checkpoints;
use crate::{
    error::{StoreError, store_io},
    list_file::{self, Unlisted},
    log::segment_position,
};

impl Checkpoints<'_> {
    pub(crate) fn list_path(&self) -> PathBuf {
        self.folder.with_file_name(CHECKPOINTS_FILE)
    }

    /// Reads the list of what must exist.
    pub(crate) fn listed(&self) -> Result<CheckpointList, Unlisted> {
        list_file::read(self.disk, &self.list_path())
    }

    /// Writes the list; durable when this returns.
    pub(crate) fn list(&self, list: &CheckpointList) -> Result<(), StoreError> {
        let path = self.list_path();
        list_file::replace(self.disk, &path, list).map_err(store_io(path))
    }

    fn change_list(&self, change: impl FnOnce(&mut CheckpointList)) -> Result<(), StoreError> {
        let before = self.listed().map_err(|unlisted| unlisted.changing(&self.list_path()))?;
        let mut list = before.clone();
        change(&mut list);
        if list == before { Ok(()) } else { self.list(&list) }
    }

    /// Lists these checkpoints, ascending, in place of those before.
    pub(crate) fn keep(&self, checkpoints: Vec<u64>) -> Result<(), StoreError> {
        self.change_list(|list| list.checkpoints = checkpoints)
    }

    /// Lists a checkpoint no longer.
    pub(super) fn unlist(&self, position: u64) -> Result<(), StoreError> {
        self.change_list(|list| list.checkpoints.retain(|&listed| listed != position))
    }

    /// Records that the log begins with the segment of this record from now on.
    pub(crate) fn begin_log(&self, first_record: u64) -> Result<(), StoreError> {
        self.change_list(|list| list.first_record = first_record)
    }

    /// Lists the existing files: all checkpoints, and the first segment in the folder of the log.
    pub(crate) fn present(&self, log: &Path) -> std::io::Result<CheckpointList> {
        let first_record = self.disk.list(log)?.iter().find_map(|name| segment_position(name)).unwrap_or(1);
        Ok(CheckpointList { first_record, checkpoints: self.positions()? })
    }
}
