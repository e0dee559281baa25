//! The losses that an operator has accepted: the file `LOSSES` of a data directory.
//!
//! Invariant: a loss is recorded before anything is changed that hides it, and never forgotten.

use std::path::Path;

use tidemap_layout::lists::{LOSSES_FILE, Loss, LossList};

use crate::{
    disk::Disk,
    error::{OpenError, open_io},
    list_file::{self, Unlisted},
};

/// The accepted losses of a data directory.
pub(crate) fn read(disk: &dyn Disk, directory: &Path) -> Result<Vec<Loss>, OpenError> {
    let file = directory.join(LOSSES_FILE);
    match list_file::read::<LossList>(disk, &file) {
        Ok(list) => Ok(list.losses),
        Err(Unlisted::Absent) => Ok(Vec::new()),
        Err(unlisted) => Err(unlisted.opening(&file)),
    }
}

/// Records a loss; durable when this returns.
pub(crate) fn record(disk: &dyn Disk, directory: &Path, loss: Loss) -> Result<(), OpenError> {
    let mut losses = read(disk, directory)?;
    losses.push(loss);
    let file = directory.join(LOSSES_FILE);
    list_file::replace(disk, &file, &LossList { losses }).map_err(open_io(file))
}
