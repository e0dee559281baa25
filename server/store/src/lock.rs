//! One process at a time: a lock on the data directory itself and on the file `LOCK` in it, which names its owner.
//!
//! Invariant: the kernel frees the locks when the process ends, however it ends; the process number in the file is only
//! for information. Removing `LOCK` does not free the directory.

use std::{
    fs::{self, File, OpenOptions},
    io::{self, Write as _},
    os::unix::fs::MetadataExt as _,
    path::{Path, PathBuf},
};

use rustix::{
    fs::{FlockOperation, flock},
    io::Errno,
};

use crate::error::{OpenError, open_io};

const FILE_NAME: &str = "LOCK";

/// The lock, held until it is dropped.
pub(crate) struct Lock {
    path: PathBuf,
    /// Open as long as the lock is held; none where `take_to_read` found none.
    file: Option<File>,
    _directory: File,
}

impl Lock {
    /// Takes the lock of a data directory for a daemon.
    pub(crate) fn take(directory: &Path) -> Result<Lock, OpenError> {
        Lock::new(directory, true)
    }

    /// Takes the lock of a data directory to read it; makes no file where there is none.
    pub(crate) fn take_to_read(directory: &Path) -> Result<Lock, OpenError> {
        Lock::new(directory, false)
    }

    fn new(directory: &Path, is_daemon: bool) -> Result<Lock, OpenError> {
        let path = directory.join(FILE_NAME);
        let locked = || OpenError::Locked {
            directory: directory.to_owned(),
            pid: fs::read_to_string(&path).ok().and_then(|text| text.trim().parse().ok()),
        };
        let folder = File::open(directory).map_err(open_io(directory))?;
        // Some network file systems cannot lock a directory; the file is locked as well.
        if flock(&folder, FlockOperation::NonBlockingLockExclusive) == Err(Errno::WOULDBLOCK) {
            return Err(locked());
        }
        // The file is not truncated: until the lock is held, another process owns it.
        let file = OpenOptions::new().create(is_daemon).truncate(false).read(true).write(true).open(&path);
        let mut file = match file {
            Err(error) if error.kind() == io::ErrorKind::NotFound && !is_daemon => None,
            file => Some(file.map_err(open_io(&path))?),
        };
        if let Some(file) = &mut file {
            match flock(&*file, FlockOperation::NonBlockingLockExclusive) {
                Ok(()) => {}
                Err(Errno::WOULDBLOCK) => return Err(locked()),
                Err(error) => return Err(OpenError::Io { file: path, source: error.into() }),
            }
            // Only for information: a full disk must not prevent the daemon from starting, and the lock is held anyway.
            let _ = file.set_len(0).and_then(|()| writeln!(file, "{}", std::process::id()));
        }
        Ok(Lock { path, file, _directory: folder })
    }

    /// Whether a daemon has used the directory.
    pub(crate) fn is_of_daemon(&self) -> bool {
        self.file.is_some()
    }

    /// The file and what is wrong with it, if its path no longer leads to the one that is held: a program that knows
    /// only that file could use the directory as well.
    pub(crate) fn problem(&self) -> Option<(PathBuf, &'static str)> {
        let identity = |metadata: fs::Metadata| (metadata.dev(), metadata.ino());
        let held = self.file.as_ref()?.metadata().map(identity).ok();
        let named = fs::metadata(&self.path).map(identity).ok();
        let is_held = held.is_some() && held == named;
        (!is_held).then(|| {
            (self.path.clone(), "it was removed or replaced while the daemon ran, so the folder may be used by two")
        })
    }
}
