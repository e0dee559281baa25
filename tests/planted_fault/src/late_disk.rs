//! A disk that reports "durable" before it has written anything: a process that stops within [`LATE_BY`] loses
//! acknowledged data.
//!
//! Invariant: late writes are done in their order, and before anything else is done with the same disk.

use std::{
    io::{self, Read},
    path::Path,
    sync::{Arc, Mutex, MutexGuard, PoisonError},
    thread,
    time::Duration,
};

use tidemap_store::disk::{Disk, DiskFile, DiskReader, RealDisk};

/// How long after its acknowledgement a record reaches the file.
const LATE_BY: Duration = Duration::from_millis(50);

/// The real disk, whose logs are late.
#[derive(Default)]
pub(crate) struct LateDisk {
    logs: Mutex<Vec<Arc<Mutex<LateLog>>>>,
}

/// A log whose end is acknowledged and not written.
struct LateLog {
    file: Box<dyn DiskFile>,
    /// Bytes appended through this handle.
    appended: usize,
    /// The last of them, which are not in the file.
    late: Vec<u8>,
}

impl LateLog {
    /// Writes what was appended until `appended` was as given.
    fn write_until(&mut self, appended: usize) -> io::Result<()> {
        let newer = self.appended - appended;
        let length = self.late.len().saturating_sub(newer);
        let bytes: Vec<u8> = self.late.drain(..length).collect();
        if bytes.is_empty() {
            return Ok(());
        }
        self.file.append(&bytes)?;
        self.file.sync()
    }

    fn write_all(&mut self) -> io::Result<()> {
        self.write_until(self.appended)
    }
}

fn lock<T>(mutex: &Mutex<T>) -> MutexGuard<'_, T> {
    mutex.lock().unwrap_or_else(PoisonError::into_inner)
}

impl LateDisk {
    /// The real disk, once everything late is written.
    fn caught_up(&self) -> io::Result<RealDisk> {
        for log in &*lock(&self.logs) {
            lock(log).write_all()?;
        }
        Ok(RealDisk)
    }

    fn late(&self, path: &Path, file: Box<dyn DiskFile>) -> Box<dyn DiskFile> {
        if path.extension().is_none_or(|extension| extension != "log") {
            return file;
        }
        let log = Arc::new(Mutex::new(LateLog { file, appended: 0, late: Vec::new() }));
        lock(&self.logs).push(Arc::clone(&log));
        Box::new(LateFile(log))
    }
}

impl Disk for LateDisk {
    fn create(&self, file: &Path) -> io::Result<Box<dyn DiskFile>> {
        Ok(self.late(file, self.caught_up()?.create(file)?))
    }

    fn open(&self, file: &Path) -> io::Result<Box<dyn DiskFile>> {
        Ok(self.late(file, self.caught_up()?.open(file)?))
    }

    fn read(&self, file: &Path) -> io::Result<Box<dyn Read + Send>> {
        self.caught_up()?.read(file)
    }

    fn read_anywhere(&self, file: &Path) -> io::Result<Box<dyn DiskReader>> {
        self.caught_up()?.read_anywhere(file)
    }

    fn length(&self, file: &Path) -> io::Result<u64> {
        self.caught_up()?.length(file)
    }

    fn list(&self, folder: &Path) -> io::Result<Vec<String>> {
        self.caught_up()?.list(folder)
    }

    fn create_folder(&self, folder: &Path) -> io::Result<()> {
        self.caught_up()?.create_folder(folder)
    }

    fn rename(&self, from: &Path, to: &Path) -> io::Result<()> {
        self.caught_up()?.rename(from, to)
    }

    fn remove(&self, file: &Path) -> io::Result<()> {
        self.caught_up()?.remove(file)
    }

    fn remove_folder(&self, folder: &Path) -> io::Result<()> {
        self.caught_up()?.remove_folder(folder)
    }

    fn sync_folder(&self, folder: &Path) -> io::Result<()> {
        self.caught_up()?.sync_folder(folder)
    }
}

struct LateFile(Arc<Mutex<LateLog>>);

impl DiskFile for LateFile {
    fn append(&mut self, bytes: &[u8]) -> io::Result<()> {
        let mut log = lock(&self.0);
        log.appended += bytes.len();
        log.late.extend_from_slice(bytes);
        Ok(())
    }

    fn truncate(&mut self, length: u64) -> io::Result<()> {
        let mut log = lock(&self.0);
        log.write_all()?;
        log.file.truncate(length)
    }

    /// Returns before anything is synced: this is the fault.
    fn sync(&mut self) -> io::Result<()> {
        let log = Arc::clone(&self.0);
        let appended = lock(&log).appended;
        thread::spawn(move || {
            thread::sleep(LATE_BY);
            // Nobody receives an error: the record has been acknowledged.
            let _ = lock(&log).write_until(appended);
        });
        Ok(())
    }
}

impl Drop for LateFile {
    fn drop(&mut self) {
        // A daemon that stops in order loses nothing.
        let _ = lock(&self.0).write_all();
    }
}
