//! The files of a queue in a folder.
//!
//! A folder has segments of records, the file `relation`, and the file `lock`. Records are numbered 1, 2, 3, … for as
//! long as the folder lives. If the folder is full, new records are refused, and the old ones stay: a record whose
//! number may be on its way cannot be taken out of the sequence, or the daemon would count another one in its place.
//!
//! Invariant: a record that was appended keeps its number, survives the end of this program, and is removed only when
//! the daemon has acknowledged it. The bytes of all segments never exceed the limit. One program uses a folder at a
//! time.

use std::{
    collections::VecDeque,
    fs::{self, File, TryLockError},
    io::{self, Write as _},
    path::{Path, PathBuf},
    sync::{Arc, Mutex, MutexGuard, PoisonError},
};

use prost::Message as _;

use super::{
    error::QueueError,
    relation::QueueRelation,
    segment::{HEAD_BYTES, QueueSegment, framed, record_at},
};

const SEGMENTS: u64 = 16;
const SEGMENT_BYTES_MAX: u64 = 64 << 20;
/// An acknowledged segment that is smaller stays for the next records: removing it costs two writes to the disk.
const EMPTIED_BYTES_MIN: u64 = 4 << 20;

/// The beginning of a record in a segment.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) struct RecordPlace {
    pub(super) number: u64,
    segment_first: u64,
    offset: u64,
}

#[derive(Debug)]
pub(super) struct QueueFolder {
    pub(super) path: PathBuf,
    pub(super) bytes_max: u64,
    segment_bytes: u64,
    kept: Mutex<Kept>,
}

/// The state behind the lock.
#[derive(Debug)]
struct Kept {
    /// The lock file; `None`: the queue was closed.
    guard: Option<File>,
    segments: VecDeque<QueueSegment>,
    relation: QueueRelation,
    cut_bytes: u64,
}

/// Numbers of a folder.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub(super) struct FolderCounts {
    /// Number of the oldest record that is kept, or of the next one.
    pub(super) first: u64,
    /// Number of the last record that was appended; 0: none ever.
    pub(super) last: u64,
    pub(super) bytes: u64,
    pub(super) lost: u64,
    pub(super) cut_bytes: u64,
    pub(super) acknowledged: u64,
}

impl Kept {
    fn bytes(&self) -> u64 {
        self.segments.iter().map(|segment| segment.bytes).sum()
    }

    fn first(&self) -> u64 {
        self.segments.front().filter(|segment| segment.records > 0).map_or(self.relation.next, |segment| segment.first)
    }

    fn open(&self) -> Result<(), QueueError> {
        if self.guard.is_some() { Ok(()) } else { Err(QueueError::Closed) }
    }
}

impl QueueFolder {
    /// Opens a folder, which is created if it does not exist, for the stream of a map, producer and label.
    pub(super) fn open(path: &Path, bytes_max: u64, [map, producer, label]: [&str; 3]) -> Result<Self, QueueError> {
        let wrong = |error: io::Error| QueueError::folder(path, &error);
        fs::create_dir_all(path).map_err(wrong)?;
        let lock = File::options().read(true).write(true).create(true).truncate(false).open(path.join("lock"));
        let guard = lock.map_err(wrong)?;
        match guard.try_lock() {
            Ok(()) => {}
            Err(TryLockError::WouldBlock) => return Err(QueueError::InUse { folder: path.to_owned() }),
            Err(TryLockError::Error(error)) => return Err(wrong(error)),
        }
        let mut relation = read_relation(path)?.unwrap_or_else(|| QueueRelation {
            next: 1,
            map: map.to_owned(),
            producer: producer.to_owned(),
            label: label.to_owned(),
            ..QueueRelation::default()
        });
        let found = [&*relation.map, &*relation.producer, &*relation.label];
        if found != [map, producer, label] {
            let named =
                |[map, producer, label]: [&str; 3]| format!("map {map:?}, producer {producer:?}, label {label:?}");
            let (found, wanted) = (named(found), named([map, producer, label]));
            return Err(QueueError::OtherStream { folder: path.to_owned(), found, wanted });
        }
        let (segments, cut_bytes) = QueueSegment::all(path)?;
        // A power cut may have taken the last records, so the number in `relation` counts only if no segment is there.
        relation.opened(segments.last().map_or(relation.next.max(1), |last| last.last() + 1));
        let segment_bytes = (bytes_max / SEGMENTS).clamp(1, SEGMENT_BYTES_MAX);
        let kept = Mutex::new(Kept { guard: Some(guard), segments: segments.into(), relation, cut_bytes });
        let folder = Self { path: path.to_owned(), bytes_max, segment_bytes, kept };
        folder.sync()?;
        folder.write_relation(&folder.kept().relation)?;
        Ok(folder)
    }

    fn kept(&self) -> MutexGuard<'_, Kept> {
        self.kept.lock().unwrap_or_else(PoisonError::into_inner)
    }

    /// The numbers now.
    pub(super) fn counts(&self) -> FolderCounts {
        let kept = self.kept();
        FolderCounts {
            first: kept.first(),
            last: kept.relation.next - 1,
            bytes: kept.bytes(),
            lost: kept.relation.lost,
            cut_bytes: kept.cut_bytes,
            acknowledged: kept.relation.acknowledged,
        }
    }

    /// The number of the record that has a sequence number of the daemon; 0: a record before the first one.
    pub(super) fn number(&self, sequence: u64) -> u64 {
        self.kept().relation.number(sequence)
    }

    /// The sequence number of a record.
    pub(super) fn sequence(&self, number: u64) -> i128 {
        self.kept().relation.sequence(number)
    }

    /// Takes a record of at least one byte, and returns its number. It survives the end of this program at once, and a
    /// power cut from the next sync on.
    pub(super) fn append(&self, raw: &[u8]) -> Result<u64, QueueError> {
        let too_large = || QueueError::NotWritten(format!("a record of {} bytes", raw.len()));
        let whole = framed(raw).ok_or_else(too_large)?;
        let mut kept = self.kept();
        kept.open()?;
        let bytes = kept.bytes();
        if bytes + whole.len() as u64 > self.bytes_max {
            return Err(QueueError::Full { bytes, bytes_max: self.bytes_max });
        }
        let wrong = |error: io::Error| QueueError::NotWritten(error.to_string());
        if kept.segments.back().is_none_or(|segment| segment.bytes >= self.segment_bytes) {
            let segment = QueueSegment::begin(&self.path, kept.relation.next).map_err(wrong)?;
            kept.segments.push_back(segment);
        }
        kept.segments.back_mut().map_or(Ok(()), |segment| segment.append(&whole)).map_err(wrong)?;
        kept.relation.next += 1;
        Ok(kept.relation.next - 1)
    }

    /// Everything that was appended so far survives a power cut from here on. Appending goes on meanwhile.
    pub(super) fn sync(&self) -> Result<(), QueueError> {
        let files: Vec<(u64, Arc<File>)> = {
            let mut kept = self.kept();
            let unsynced = kept.segments.iter_mut().filter(|segment| segment.is_unsynced);
            let taken = |segment: &mut QueueSegment| {
                segment.is_unsynced = false;
                (segment.first, Arc::clone(&segment.file))
            };
            unsynced.map(taken).collect()
        };
        if files.is_empty() {
            return Ok(());
        }
        let synced = files.iter().try_for_each(|(_, file)| file.sync_data()).and_then(|()| {
            let mut kept = self.kept();
            let of_them = |segment: &&mut QueueSegment| files.iter().any(|(first, _)| *first == segment.first);
            let mut new = kept.segments.iter_mut().filter(|segment| segment.is_new).filter(of_them).peekable();
            if new.peek().is_none() {
                return Ok(());
            }
            new.try_for_each(|segment| segment.named(&self.path))?;
            drop(kept);
            sync_folder(&self.path)
        });
        synced.map_err(|error| {
            let mut kept = self.kept();
            let again =
                kept.segments.iter_mut().filter(|segment| files.iter().any(|(first, _)| *first == segment.first));
            again.for_each(|segment| segment.is_unsynced = true);
            QueueError::NotSynced(error.to_string())
        })
    }

    /// The daemon has everything of this producer up to a sequence number: removes those records. Before it returns,
    /// the numbers of the other records for the daemon are on the disk, so that a record never gets two of them.
    pub(super) fn linked(&self, durable_sequence: u64) -> Result<(), QueueError> {
        // So that the numbers in `relation` are those of records on the disk.
        self.sync()?;
        let mut kept = self.kept();
        kept.open()?;
        let first = kept.first();
        let mut relation = kept.relation.clone();
        let durable = relation.linked(durable_sequence, first);
        self.write_relation(&relation)?;
        kept.relation = relation;
        self.forget(&mut kept, durable)
    }

    /// The daemon has everything up to this sequence number.
    pub(super) fn acknowledged(&self, sequence: u64) -> Result<(), QueueError> {
        let mut kept = self.kept();
        if kept.relation.offset.is_none() || kept.guard.is_none() {
            return Ok(());
        }
        let durable = kept.relation.number(sequence);
        kept.relation.acknowledged = kept.relation.acknowledged.max(durable);
        self.forget(&mut kept, durable)
    }

    /// Removes segments whose records all are up to `number`.
    fn forget(&self, kept: &mut Kept, number: u64) -> Result<(), QueueError> {
        while let Some(oldest) = kept.segments.front().filter(|segment| segment.last() <= number) {
            if kept.segments.len() == 1 {
                if oldest.bytes < self.segment_bytes.min(EMPTIED_BYTES_MIN) {
                    break;
                }
                // The numbers go on: a folder without segments would begin at 1.
                self.write_relation(&kept.relation)?;
            }
            if let Some(gone) = kept.segments.pop_front() {
                fs::remove_file(&gone.path).map_err(|error| QueueError::folder(&gone.path, &error))?;
            }
        }
        Ok(())
    }

    /// The record of this number, and the place of the next one; `None` if there is no such record. `at` is the place
    /// that the last call returned; it saves a search.
    pub(super) fn read(
        &self,
        at: Option<RecordPlace>,
        number: u64,
    ) -> Result<Option<(Vec<u8>, RecordPlace)>, QueueError> {
        let kept = self.kept();
        let Some(segment) =
            kept.segments.iter().find(|one| one.records > 0 && (one.first..=one.last()).contains(&number))
        else {
            return Ok(None);
        };
        let known = at.filter(|at| (at.number, at.segment_first) == (number, segment.first));
        let (mut current, mut offset) = known.map_or((segment.first, 0), |at| (number, at.offset));
        loop {
            let found = record_at(&segment.file, offset, segment.bytes);
            let found = found.map_err(|error| QueueError::folder(&segment.path, &error))?;
            let raw =
                found.ok_or_else(|| QueueError::damaged(&segment.path, format!("record {current} has changed")))?;
            offset += (HEAD_BYTES + raw.len()) as u64;
            if current == number {
                return Ok(Some((raw, RecordPlace { number: number + 1, segment_first: segment.first, offset })));
            }
            current += 1;
        }
    }

    /// Ends; the records that were appended are on the disk, and another program may use the folder.
    pub(super) fn close(&self) -> Result<(), QueueError> {
        let synced = self.sync();
        let mut kept = self.kept();
        if kept.guard.is_none() {
            return Ok(());
        }
        let written = self.write_relation(&kept.relation);
        kept.segments.clear();
        kept.guard = None;
        synced.and(written)
    }

    fn write_relation(&self, relation: &QueueRelation) -> Result<(), QueueError> {
        let fresh = self.path.join("relation.new");
        let written = || {
            let mut file = File::create(&fresh)?;
            file.write_all(&framed(&relation.encode_to_vec()).unwrap_or_default())?;
            file.sync_all()?;
            fs::rename(&fresh, self.path.join("relation"))?;
            sync_folder(&self.path)
        };
        written().map_err(|error| QueueError::folder(&self.path, &error))
    }
}

fn sync_folder(path: &Path) -> io::Result<()> {
    File::open(path)?.sync_all()
}

fn read_relation(folder: &Path) -> Result<Option<QueueRelation>, QueueError> {
    let path = folder.join("relation");
    let file = match File::open(&path) {
        Ok(file) => file,
        Err(error) if error.kind() == io::ErrorKind::NotFound => return Ok(None),
        Err(error) => return Err(QueueError::folder(&path, &error)),
    };
    let read = file.metadata().and_then(|metadata| record_at(&file, 0, metadata.len()));
    let raw = read.map_err(|error| QueueError::folder(&path, &error))?;
    let raw = raw.ok_or_else(|| QueueError::damaged(&path, "its checksum is wrong"))?;
    let relation = QueueRelation::decode(&*raw).map_err(|error| QueueError::damaged(&path, error.to_string()))?;
    Ok(Some(relation))
}

#[cfg(test)]
mod tests;
