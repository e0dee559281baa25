//! One process at a time: a lock on the file `LOCK`, which names its owner.
//!
//! Invariant: the kernel frees the lock when the process ends, however it ends; the process number in the file is only
//! for information.

use std::{
    fs::{self, File, OpenOptions},
    io::Write as _,
    path::Path,
};

use rustix::{
    fs::{FlockOperation, flock},
    io::Errno,
};

use crate::error::{OpenError, open_io};

/// The lock, held until it is dropped.
pub(crate) struct Lock {
    _file: File,
}

impl Lock {
    /// Takes the lock of a data directory.
    pub(crate) fn take(directory: &Path) -> Result<Lock, OpenError> {
        let path = directory.join("LOCK");
        // Not truncated: until the lock is held, another process owns the file.
        let file = OpenOptions::new().create(true).truncate(false).read(true).write(true).open(&path);
        let mut file = file.map_err(open_io(&path))?;
        match flock(&file, FlockOperation::NonBlockingLockExclusive) {
            Ok(()) => {}
            Err(Errno::WOULDBLOCK) => {
                let pid = fs::read_to_string(&path).ok().and_then(|text| text.trim().parse().ok());
                return Err(OpenError::Locked { directory: directory.to_owned(), pid });
            }
            Err(error) => return Err(OpenError::Io { file: path, source: error.into() }),
        }
        // Only for information: a full disk must not prevent the daemon from starting, and the lock is held anyway.
        let _ = file.set_len(0).and_then(|()| writeln!(file, "{}", std::process::id()));
        Ok(Lock { _file: file })
    }
}
