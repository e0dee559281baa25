//! One file of the queue: records of length, CRC-32C and bytes.
//!
//! Invariant: a file holds whole records, with consecutive numbers from the number in its name on; bytes behind the
//! last whole record are cut off when the file is opened. A file whose name ends with `.new` was never synced, so that
//! a power cut may have taken records before it.

use std::{
    fs::{self, File},
    io,
    os::unix::fs::FileExt as _,
    path::{Path, PathBuf},
    sync::Arc,
};

use super::error::QueueError;

/// Length and CRC-32C, little-endian.
pub(super) const HEAD_BYTES: usize = 8;
const SUFFIX: &str = ".queue";
const NEW_SUFFIX: &str = ".queue.new";

/// A record with its head.
pub(super) fn framed(raw: &[u8]) -> Option<Vec<u8>> {
    let length = u32::try_from(raw.len()).ok().filter(|&length| length > 0)?;
    let mut whole = Vec::with_capacity(HEAD_BYTES + raw.len());
    whole.extend(length.to_le_bytes());
    whole.extend(crc32c::crc32c(raw).to_le_bytes());
    whole.extend(raw);
    Some(whole)
}

/// The record at an offset of a file of `end` bytes; `None`: there is no whole one.
pub(super) fn record_at(file: &File, offset: u64, end: u64) -> io::Result<Option<Vec<u8>>> {
    let room = end.saturating_sub(offset);
    let mut head = [0; HEAD_BYTES];
    if room < HEAD_BYTES as u64 {
        return Ok(None);
    }
    file.read_exact_at(&mut head, offset)?;
    let [a, b, c, d, rest @ ..] = head;
    let (length, crc) = (u32::from_le_bytes([a, b, c, d]), u32::from_le_bytes(rest));
    if length == 0 || u64::from(length) > room - HEAD_BYTES as u64 {
        return Ok(None);
    }
    let mut raw = vec![0; length as usize];
    file.read_exact_at(&mut raw, offset + HEAD_BYTES as u64)?;
    Ok((crc32c::crc32c(&raw) == crc).then_some(raw))
}

#[derive(Debug)]
pub(super) struct QueueSegment {
    pub(super) path: PathBuf,
    pub(super) file: Arc<File>,
    /// Number of its first record.
    pub(super) first: u64,
    pub(super) records: u64,
    pub(super) bytes: u64,
    pub(super) is_unsynced: bool,
    /// Whether the file was never synced.
    pub(super) is_new: bool,
}

impl QueueSegment {
    /// Number of its last record; the number before the first if it has none.
    pub(super) fn last(&self) -> u64 {
        self.first + self.records - 1
    }

    /// Begins a file; the caller that appends does not wait for the disk.
    pub(super) fn begin(folder: &Path, first: u64) -> io::Result<Self> {
        let path = folder.join(format!("{first:020}{NEW_SUFFIX}"));
        let file = File::options().read(true).write(true).create(true).truncate(true).open(&path)?;
        Ok(Self { path, file: Arc::new(file), first, records: 0, bytes: 0, is_unsynced: true, is_new: true })
    }

    /// The segments of a folder, by number, with the bytes that were cut off.
    pub(super) fn all(folder: &Path) -> Result<(Vec<Self>, u64), QueueError> {
        let mut found = Vec::new();
        let wrong = |error: io::Error| QueueError::folder(folder, &error);
        for entry in fs::read_dir(folder).map_err(wrong)? {
            let name = entry.map_err(wrong)?.file_name();
            let Some(name) = name.to_str() else { continue };
            let is_new = name.ends_with(NEW_SUFFIX);
            let Some(number) = name.strip_suffix(if is_new { NEW_SUFFIX } else { SUFFIX }) else { continue };
            let path = folder.join(name);
            let first = number.parse().ok().filter(|&first: &u64| first > 0);
            let first = first.ok_or_else(|| QueueError::damaged(&path, "its name has no number of a record"))?;
            found.push((first, is_new, path));
        }
        found.sort_unstable();
        let (mut segments, mut cut_bytes): (Vec<Self>, u64) = (Vec::new(), 0);
        for (first, is_new, path) in found {
            let before = segments.last().map(Self::last);
            let (segment, cut) =
                Self::adopted(path, first, is_new).map_err(|(path, error)| QueueError::folder(&path, &error))?;
            if before.is_none_or(|before| before + 1 == first) {
                segments.push(segment);
                cut_bytes += cut;
            } else if is_new {
                // A power cut took records before it; nothing after them was synced.
                fs::remove_file(&segment.path).map_err(wrong)?;
                cut_bytes += segment.bytes + cut;
            } else {
                let before = before.unwrap_or(0);
                let detail = format!("it does not follow record {before}, so that a file is damaged or missing");
                return Err(QueueError::damaged(&segment.path, detail));
            }
        }
        Ok((segments, cut_bytes))
    }

    /// Opens a file; cuts off a record that was not written whole, and returns the number of these bytes.
    fn adopted(path: PathBuf, first: u64, is_new: bool) -> Result<(Self, u64), (PathBuf, io::Error)> {
        let opened = || {
            let file = File::options().read(true).write(true).open(&path)?;
            let size = file.metadata()?.len();
            let (mut bytes, mut records) = (0, 0);
            while let Some(raw) = record_at(&file, bytes, size)? {
                bytes += (HEAD_BYTES + raw.len()) as u64;
                records += 1;
            }
            if bytes < size {
                file.set_len(bytes)?;
            }
            Ok((file, size, bytes, records))
        };
        match opened() {
            Ok((file, size, bytes, records)) => {
                let file = Arc::new(file);
                Ok((Self { path, file, first, records, bytes, is_unsynced: true, is_new }, size - bytes))
            }
            Err(error) => Err((path, error)),
        }
    }

    /// Appends a record with its head.
    pub(super) fn append(&mut self, whole: &[u8]) -> io::Result<()> {
        if let Err(error) = self.file.write_all_at(whole, self.bytes) {
            // If this fails too, the next record overwrites these bytes, or they are cut off at the next start.
            let _ = self.file.set_len(self.bytes);
            return Err(error);
        }
        self.bytes += whole.len() as u64;
        self.records += 1;
        self.is_unsynced = true;
        Ok(())
    }

    /// The file was synced, with everything before it: gives it its lasting name.
    pub(super) fn named(&mut self, folder: &Path) -> io::Result<()> {
        let path = folder.join(format!("{:020}{SUFFIX}", self.first));
        fs::rename(&self.path, &path)?;
        self.path = path;
        self.is_new = false;
        Ok(())
    }
}
