//! The few file operations that logs, checkpoints and maps need.
//!
//! Invariant: nothing here decides anything. Which bytes are durable follows from the calls alone, so a simulated
//! disk can take the place of the real one.

use std::{
    fs::{self, File, OpenOptions},
    io::{self, Read, Write as _},
    os::unix::fs::{FileExt as _, MetadataExt as _},
    path::Path,
};

/// A disk.
pub trait Disk: Send + Sync {
    /// Creates a file for appending; empties an existing one.
    fn create(&self, file: &Path) -> io::Result<Box<dyn DiskFile>>;
    /// Opens a file for appending.
    fn open(&self, file: &Path) -> io::Result<Box<dyn DiskFile>>;
    /// Opens a file for reading from its start.
    fn read(&self, file: &Path) -> io::Result<Box<dyn Read + Send>>;
    /// Opens a file for random access. It stays readable while it is open, even after it is deleted.
    fn read_anywhere(&self, file: &Path) -> io::Result<Box<dyn DiskReader>>;
    /// Length of a file.
    fn length(&self, file: &Path) -> io::Result<u64>;
    /// Names in a folder, sorted.
    fn list(&self, folder: &Path) -> io::Result<Vec<String>>;
    /// Creates a folder.
    fn create_folder(&self, folder: &Path) -> io::Result<()>;
    /// Renames a file or a folder within its folder.
    fn rename(&self, from: &Path, to: &Path) -> io::Result<()>;
    /// Removes a file.
    fn remove(&self, file: &Path) -> io::Result<()>;
    /// Removes everything in a folder, and the folder.
    fn remove_folder(&self, folder: &Path) -> io::Result<()>;
    /// Makes the names in a folder durable: those created, renamed or removed since the last call.
    fn sync_folder(&self, folder: &Path) -> io::Result<()>;
}

/// A file open for appending.
pub trait DiskFile: Send {
    /// Writes at the end. After an error, any part of it may have been written.
    fn append(&mut self, bytes: &[u8]) -> io::Result<()>;
    /// Cuts the file.
    fn truncate(&mut self, length: u64) -> io::Result<()>;
    /// Makes the file's bytes and length durable. After an error it is not known what is.
    fn sync(&mut self) -> io::Result<()>;
    /// The change that somebody else has made to the file, if a path no longer leads to it or it has another length.
    fn problem(&self, _path: &Path, _length: u64) -> Option<&'static str> {
        None
    }
}

/// A file open for random access.
pub trait DiskReader: Send + Sync {
    /// Reads all of `bytes` at an offset.
    fn read_exact_at(&self, bytes: &mut [u8], offset: u64) -> io::Result<()>;
}

/// The whole of a file.
pub(crate) fn read_all(disk: &dyn Disk, file: &Path) -> io::Result<Vec<u8>> {
    let length = usize::try_from(disk.length(file)?).unwrap_or(0);
    let mut bytes = Vec::with_capacity(length);
    disk.read(file)?.read_to_end(&mut bytes)?;
    Ok(bytes)
}

/// The disk of this machine.
pub struct RealDisk;

impl Disk for RealDisk {
    fn create(&self, file: &Path) -> io::Result<Box<dyn DiskFile>> {
        File::create(file)?;
        self.open(file)
    }

    fn open(&self, file: &Path) -> io::Result<Box<dyn DiskFile>> {
        Ok(Box::new(RealFile(OpenOptions::new().append(true).open(file)?)))
    }

    fn read(&self, file: &Path) -> io::Result<Box<dyn Read + Send>> {
        Ok(Box::new(File::open(file)?))
    }

    fn read_anywhere(&self, file: &Path) -> io::Result<Box<dyn DiskReader>> {
        Ok(Box::new(RealReader(File::open(file)?)))
    }

    fn length(&self, file: &Path) -> io::Result<u64> {
        Ok(fs::metadata(file)?.len())
    }

    fn list(&self, folder: &Path) -> io::Result<Vec<String>> {
        let mut names = Vec::new();
        for entry in fs::read_dir(folder)? {
            // The store gives no file a name that is not UTF-8.
            names.extend(entry?.file_name().into_string());
        }
        names.sort();
        Ok(names)
    }

    fn create_folder(&self, folder: &Path) -> io::Result<()> {
        fs::create_dir(folder)
    }

    fn rename(&self, from: &Path, to: &Path) -> io::Result<()> {
        fs::rename(from, to)
    }

    fn remove(&self, file: &Path) -> io::Result<()> {
        fs::remove_file(file)
    }

    fn remove_folder(&self, folder: &Path) -> io::Result<()> {
        fs::remove_dir_all(folder)
    }

    fn sync_folder(&self, folder: &Path) -> io::Result<()> {
        File::open(folder)?.sync_all()
    }
}

struct RealReader(File);

impl DiskReader for RealReader {
    fn read_exact_at(&self, bytes: &mut [u8], offset: u64) -> io::Result<()> {
        self.0.read_exact_at(bytes, offset)
    }
}

/// Open in append mode, so that every write goes to the end, also after a truncation.
struct RealFile(File);

impl DiskFile for RealFile {
    fn append(&mut self, bytes: &[u8]) -> io::Result<()> {
        self.0.write_all(bytes)
    }

    fn truncate(&mut self, length: u64) -> io::Result<()> {
        self.0.set_len(length)
    }

    fn sync(&mut self) -> io::Result<()> {
        // fdatasync writes the length of a file, but not its modification time.
        Ok(rustix::fs::fdatasync(&self.0)?)
    }

    fn problem(&self, path: &Path, length: u64) -> Option<&'static str> {
        let identity = |metadata: &fs::Metadata| (metadata.dev(), metadata.ino());
        // Where the path cannot be followed, the file is out of reach for the next start.
        match (self.0.metadata(), fs::metadata(path)) {
            (Ok(open), Ok(named)) if identity(&open) == identity(&named) => {
                (open.len() != length).then_some("it was cut or written to by somebody else while the daemon ran")
            }
            _ => Some("it was removed or replaced while the daemon ran"),
        }
    }
}
