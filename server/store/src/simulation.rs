//! The store on a simulated disk that loses, tears and refuses writes. The index is left out: it holds no unique data.
//!
//! Each run follows from its seed alone.

use std::{path::Path, sync::Arc};

use crate::{
    OpenError, Store, StoreOptions,
    disk::Disk,
    index::Index,
    store::{lists, open::Parts},
};

#[cfg(test)]
mod crash;
mod disk;
#[cfg(test)]
mod erasures;
#[cfg(test)]
mod faults;
#[cfg(test)]
mod machine;

pub use disk::{Fault, SimulatedDisk};

/// The data directory on simulated disks.
const DIRECTORY: &str = "/data";

/// Opens a store on a disk that has one, without a thread that commits: only groups of a [`crate::GroupLog`] are
/// written.
///
/// # Errors
/// [`OpenError`].
pub fn open(disk: &SimulatedDisk, options: StoreOptions) -> Result<Store, OpenError> {
    Store::assemble(Parts {
        disk: Arc::new(disk.clone()),
        directory: DIRECTORY.into(),
        options,
        store_id: String::new(),
        is_new: false,
        index: Index::none(),
        committer: Arc::default(),
        repairs: Vec::new(),
        lock: None,
    })
}

/// Makes the data directory of a new store.
///
/// # Panics
/// If the disk has a data directory already, or a fault.
pub fn make_directory(disk: &disk::SimulatedDisk) {
    for folder in [DIRECTORY, "/data/maps"] {
        disk.create_folder(Path::new(folder)).expect("created");
        disk.sync_folder(Path::new(folder).parent().expect("has one")).expect("synced");
    }
    lists::make_first(disk, Path::new(DIRECTORY)).expect("a new store gets its list of maps");
}
