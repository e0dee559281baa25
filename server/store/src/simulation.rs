//! The store on a simulated disk that loses, tears and refuses writes. The index is left out: it holds no unique data.
//!
//! Each run follows from its seed alone.

use std::path::Path;

use crate::{disk::Disk, store::lists};

mod crash;
mod disk;
mod erasures;
mod faults;
mod machine;

/// The data directory on simulated disks.
const DIRECTORY: &str = "/data";

/// Makes the data directory of a new store.
fn make_directory(disk: &disk::SimulatedDisk) {
    for folder in [DIRECTORY, "/data/maps"] {
        disk.create_folder(Path::new(folder)).expect("created");
        disk.sync_folder(Path::new(folder).parent().expect("has one")).expect("synced");
    }
    lists::make_first(disk, Path::new(DIRECTORY)).expect("a new store gets its list of maps");
}
