//! The contents of the index of a data directory, without a daemon.
//!
//! Invariant: nothing is repaired, and nothing is migrated. The directory is locked as long as the contents are held.

use std::{io, path::Path};

use tidemap_map::{snapshot::MapSnapshot, spec::MapSpec};
use tidemap_migrations::{FORMAT, manifest};

use super::{Lock, catalogue};
use crate::{
    MapId,
    disk::RealDisk,
    error::OpenError,
    failure::ReadFailure,
    index::{Index, RowsState, Unopened, is_present},
};

/// The rows of one map in the index.
#[derive(Clone, Debug, PartialEq, Eq)]
pub enum IndexedRows {
    /// The rows are a whole generation.
    Whole {
        /// Number of the generation.
        generation: u64,
        /// Number of rows.
        records: u64,
        /// Bytes of their keys and values.
        bytes: u64,
    },
    /// There are no rows.
    Nothing,
    /// The rows were not completely written when the process stopped.
    Unfinished,
    /// The rows cannot be read, for this reason.
    Damaged(String),
}

/// The index of a data directory.
pub struct IndexContents {
    index: Index,
    /// The maps of the directory, by number, with their rows.
    pub maps: Vec<(MapId, MapSpec, IndexedRows)>,
    /// Bytes of the index on the disk.
    pub disk_bytes: u64,
    _lock: Lock,
}

impl IndexContents {
    /// Opens and checks the index of a data directory that no daemon uses.
    ///
    /// # Errors
    /// [`OpenError`], also where there is no data directory or its index cannot be opened.
    pub fn open(directory: &Path, cache_bytes: u64) -> Result<IndexContents, OpenError> {
        let folder = directory.join("index");
        if manifest::read(directory, FORMAT)?.is_none() {
            let reason = "there is none: this is no data directory of tidemapd".to_owned();
            return Err(OpenError::Damaged { file: directory.join(manifest::FILE_NAME), reason });
        }
        let lock = Lock::take_to_read(directory)?;
        let index = if is_present(&folder) { Index::inspect(folder.clone(), cache_bytes) } else { Ok(Index::none()) };
        let mut index = index.map_err(|unopened| match unopened {
            Unopened::InUse => OpenError::Locked { directory: directory.to_owned(), pid: None },
            Unopened::Failed(ReadFailure::Damaged(reason)) => OpenError::Damaged { file: folder, reason },
            Unopened::Failed(ReadFailure::Disk(reason)) => {
                OpenError::Io { file: folder, source: io::Error::other(reason) }
            }
        })?;
        let mut maps = Vec::new();
        for (map, spec) in catalogue::list(&RealDisk, directory)? {
            let rows = match index.check(map.0) {
                Ok(RowsState::Whole { generation, .. }) => {
                    let (records, bytes) = index.size_of(map.0);
                    IndexedRows::Whole { generation, records, bytes }
                }
                Ok(RowsState::Nothing) => IndexedRows::Nothing,
                Ok(RowsState::Unfinished) => IndexedRows::Unfinished,
                Err(failure) => IndexedRows::Damaged(failure.to_string()),
            };
            maps.push((map, spec, rows));
        }
        let disk_bytes = index.disk_bytes();
        Ok(IndexContents { index, maps, disk_bytes, _lock: lock })
    }

    /// Reads the published data of a map; `None` where its rows are not whole. The models of tiles are read when they
    /// are needed.
    pub fn published(&self, map: MapId, spec: &MapSpec) -> Option<MapSnapshot> {
        self.index.read(map.0, spec).ok().flatten()
    }
}
