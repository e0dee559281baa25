//! A disk that breaks one promise: each fault is one that a daemon, a file system or a drive could have.
//!
//! Invariant: everything but the fault is done as the real disk does it. Faults concern logs.

use std::{
    io::{self, Read},
    path::Path,
    sync::atomic::{AtomicU64, Ordering},
};

use tidemap_store::disk::{Disk, DiskFile, DiskReader, RealDisk};

/// One in so many appends to a log goes wrong.
const ONE_IN: u64 = 20;
/// Bytes that are lost at the end of a log.
const LOST_BYTES: u64 = 200;

/// What is wrong with the disk.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(crate) enum Fault {
    /// An error of a sync is not told.
    IgnoredSyncError,
    /// Nothing is ever synced.
    NoSync,
    /// Opening a log cuts off its end.
    LostTail,
    /// Reading a log leaves out its end.
    ShortRead,
    /// An append to a log is written twice.
    Doubled,
    /// An append to a log is not written.
    Skipped,
    /// A bit of an append to a log is flipped.
    FlippedBit,
    /// An append to a log is written behind the next one.
    Swapped,
}

impl Fault {
    /// The fault of a name.
    pub(crate) fn named(name: &str) -> Option<Self> {
        Some(match name {
            "ignored-sync-error" => Self::IgnoredSyncError,
            "no-sync" => Self::NoSync,
            "lost-tail" => Self::LostTail,
            "short-read" => Self::ShortRead,
            "doubled" => Self::Doubled,
            "skipped" => Self::Skipped,
            "flipped-bit" => Self::FlippedBit,
            "swapped" => Self::Swapped,
            _ => return None,
        })
    }
}

/// The real disk with a fault.
pub(crate) struct FaultyDisk(pub(crate) Fault);

struct FaultyFile {
    file: Box<dyn DiskFile>,
    fault: Fault,
    is_log: bool,
    appends: AtomicU64,
    /// An append that is written behind the next one.
    late: Vec<u8>,
}

fn is_log(file: &Path) -> bool {
    file.extension().is_some_and(|extension| extension == "log")
}

impl FaultyDisk {
    fn wrapped(&self, path: &Path, file: Box<dyn DiskFile>) -> Box<dyn DiskFile> {
        let appends = AtomicU64::new(0);
        Box::new(FaultyFile { file, fault: self.0, is_log: is_log(path), appends, late: Vec::new() })
    }
}

impl DiskFile for FaultyFile {
    fn append(&mut self, bytes: &[u8]) -> io::Result<()> {
        let number = self.appends.fetch_add(1, Ordering::Relaxed) + 1;
        if !self.is_log || !number.is_multiple_of(ONE_IN) {
            self.file.append(bytes)?;
            let late = std::mem::take(&mut self.late);
            return if late.is_empty() { Ok(()) } else { self.file.append(&late) };
        }
        match self.fault {
            Fault::Doubled => {
                self.file.append(bytes)?;
                self.file.append(bytes)
            }
            Fault::Skipped => Ok(()),
            Fault::FlippedBit => {
                let mut wrong = bytes.to_vec();
                if let Some(byte) = wrong.last_mut() {
                    *byte ^= 1;
                }
                self.file.append(&wrong)
            }
            Fault::Swapped => {
                self.late = bytes.to_vec();
                Ok(())
            }
            _ => self.file.append(bytes),
        }
    }

    fn truncate(&mut self, length: u64) -> io::Result<()> {
        self.file.truncate(length)
    }

    fn sync(&mut self) -> io::Result<()> {
        match self.fault {
            Fault::NoSync => Ok(()),
            Fault::IgnoredSyncError => {
                let _ = self.file.sync();
                Ok(())
            }
            _ => self.file.sync(),
        }
    }

    fn is_at(&self, path: &Path) -> bool {
        self.file.is_at(path)
    }
}

impl Disk for FaultyDisk {
    fn create(&self, file: &Path) -> io::Result<Box<dyn DiskFile>> {
        Ok(self.wrapped(file, RealDisk.create(file)?))
    }

    fn open(&self, file: &Path) -> io::Result<Box<dyn DiskFile>> {
        let mut opened = RealDisk.open(file)?;
        if self.0 == Fault::LostTail && is_log(file) {
            opened.truncate(RealDisk.length(file)?.saturating_sub(LOST_BYTES).max(32))?;
        }
        Ok(self.wrapped(file, opened))
    }

    fn read(&self, file: &Path) -> io::Result<Box<dyn Read + Send>> {
        let reader = RealDisk.read(file)?;
        if self.0 == Fault::ShortRead && is_log(file) {
            let length = RealDisk.length(file)?.saturating_sub(LOST_BYTES).max(32);
            return Ok(Box::new(reader.take(length)));
        }
        Ok(reader)
    }

    fn read_anywhere(&self, file: &Path) -> io::Result<Box<dyn DiskReader>> {
        RealDisk.read_anywhere(file)
    }

    fn length(&self, file: &Path) -> io::Result<u64> {
        RealDisk.length(file)
    }

    fn list(&self, folder: &Path) -> io::Result<Vec<String>> {
        RealDisk.list(folder)
    }

    fn create_folder(&self, folder: &Path) -> io::Result<()> {
        RealDisk.create_folder(folder)
    }

    fn rename(&self, from: &Path, to: &Path) -> io::Result<()> {
        RealDisk.rename(from, to)
    }

    fn remove(&self, file: &Path) -> io::Result<()> {
        RealDisk.remove(file)
    }

    fn remove_folder(&self, folder: &Path) -> io::Result<()> {
        RealDisk.remove_folder(folder)
    }

    fn sync_folder(&self, folder: &Path) -> io::Result<()> {
        RealDisk.sync_folder(folder)
    }
}
