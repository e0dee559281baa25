//! The readers of files, for fuzz targets: each takes any bytes, and may refuse them but not panic, hang or take memory
//! beyond what the bytes justify. Checksums are made right, so that what is behind them is reached.
//!
//! Invariant: only in builds with the feature `fuzz`; nothing of the store uses it.

use std::{
    collections::BTreeMap,
    io::{self, Cursor, Read},
    path::{Path, PathBuf},
    sync::{Arc, Mutex, MutexGuard, PoisonError},
};

use prost::Message as _;
use tidemap_grid::spec::GridSpec;
use tidemap_layout::{
    file::{CHECKPOINT_MAGIC, FileHeader, HISTORY_MAGIC, RecordKind},
    grid as layout_grid,
    index::StateRow,
    lists::{CheckpointList, ErasureCount, ErasureOrder, FileList, LossList, MapList, NewestSegment, TextList},
    log::{FIRST_CHAIN, FrameHeader, FrameKind, SegmentHeader, guard},
    map as layout, site as layout_site,
};
use tidemap_map::{ids::StateId, name::MapName, spec::MapSpec, training::ReadingsRequest};
use tidemap_model::Periodicities;

use crate::{
    MapId,
    checkpoint::{Checkpoints, Memory},
    disk::{Disk, DiskFile, DiskReader},
    history::History,
    list_file,
    log::{recovery, replay::Replay, segment_path},
    record::{published, snapshot, spec, tables, tile, tile_model},
    record_file::RecordWriter,
};

const HOUR_NANOS: i64 = 3_600_000_000_000;
const MAP: u32 = 1;
/// The log position of the checkpoint, and the generation of the history file.
const POSITION: u64 = 15;

/// The bytes of a disk in memory.
type Files = Arc<Mutex<BTreeMap<PathBuf, Vec<u8>>>>;

/// A disk in memory, without folders.
#[derive(Clone, Default)]
struct MemoryDisk(Files);

fn lock(files: &Files) -> MutexGuard<'_, BTreeMap<PathBuf, Vec<u8>>> {
    files.lock().unwrap_or_else(PoisonError::into_inner)
}

struct MemoryFile(Files, PathBuf);

struct MemoryReader(Vec<u8>);

impl MemoryDisk {
    fn bytes(&self, file: &Path) -> io::Result<Vec<u8>> {
        lock(&self.0).get(file).cloned().ok_or_else(|| io::ErrorKind::NotFound.into())
    }
}

impl Disk for MemoryDisk {
    fn create(&self, file: &Path) -> io::Result<Box<dyn DiskFile>> {
        lock(&self.0).insert(file.to_owned(), Vec::new());
        self.open(file)
    }

    fn open(&self, file: &Path) -> io::Result<Box<dyn DiskFile>> {
        Ok(Box::new(MemoryFile(Arc::clone(&self.0), file.to_owned())))
    }

    fn read(&self, file: &Path) -> io::Result<Box<dyn Read + Send>> {
        Ok(Box::new(Cursor::new(self.bytes(file)?)))
    }

    fn read_anywhere(&self, file: &Path) -> io::Result<Box<dyn DiskReader>> {
        Ok(Box::new(MemoryReader(self.bytes(file)?)))
    }

    fn length(&self, file: &Path) -> io::Result<u64> {
        Ok(self.bytes(file)?.len() as u64)
    }

    fn list(&self, folder: &Path) -> io::Result<Vec<String>> {
        let files = lock(&self.0);
        let names =
            files.keys().filter(|file| file.parent() == Some(folder)).filter_map(|file| file.file_name()?.to_str());
        Ok(names.map(str::to_owned).collect())
    }

    fn create_folder(&self, _: &Path) -> io::Result<()> {
        Ok(())
    }

    fn rename(&self, from: &Path, to: &Path) -> io::Result<()> {
        let mut files = lock(&self.0);
        let bytes = files.remove(from).ok_or(io::ErrorKind::NotFound)?;
        files.insert(to.to_owned(), bytes);
        Ok(())
    }

    fn remove(&self, file: &Path) -> io::Result<()> {
        lock(&self.0).remove(file);
        Ok(())
    }

    fn remove_folder(&self, folder: &Path) -> io::Result<()> {
        lock(&self.0).retain(|file, _| !file.starts_with(folder));
        Ok(())
    }

    fn sync_folder(&self, _: &Path) -> io::Result<()> {
        Ok(())
    }
}

impl DiskFile for MemoryFile {
    fn append(&mut self, bytes: &[u8]) -> io::Result<()> {
        lock(&self.0).entry(self.1.clone()).or_default().extend_from_slice(bytes);
        Ok(())
    }

    fn truncate(&mut self, length: u64) -> io::Result<()> {
        let length = usize::try_from(length).unwrap_or(usize::MAX);
        lock(&self.0).entry(self.1.clone()).or_default().truncate(length);
        Ok(())
    }

    fn sync(&mut self) -> io::Result<()> {
        Ok(())
    }
}

impl DiskReader for MemoryReader {
    fn read_exact_at(&self, bytes: &mut [u8], offset: u64) -> io::Result<()> {
        let from = usize::try_from(offset).unwrap_or(usize::MAX);
        let found = self.0.get(from..).and_then(|rest| rest.get(..bytes.len())).ok_or(io::ErrorKind::UnexpectedEof)?;
        bytes.copy_from_slice(found);
        Ok(())
    }
}

/// The map of all files, with a grid or without.
fn map_spec(has_grid: bool) -> Option<MapSpec> {
    let periodicities = if has_grid {
        Periodicities::list(vec![168 * HOUR_NANOS, 24 * HOUR_NANOS, 12 * HOUR_NANOS])
    } else {
        Periodicities::harmonics(24 * HOUR_NANOS, 130)
    };
    let spec = MapSpec::new(MapName::new("office").ok()?);
    Some(MapSpec { periodicities: periodicities.ok()?, grid: has_grid.then(|| GridSpec::new(0.1)), ..spec })
}

/// The parts of any bytes: each has a kind (one byte), a length (two bytes, little-endian) and its content; the last
/// may be shorter.
fn parts(mut bytes: &[u8]) -> impl Iterator<Item = (u8, &[u8])> {
    std::iter::from_fn(move || {
        let (&[kind, low, high], rest) = bytes.split_first_chunk::<3>()?;
        let (part, rest) = rest.split_at(usize::from(u16::from_le_bytes([low, high])).min(rest.len()));
        bytes = rest;
        Some((kind, part))
    })
}

/// Writes parts as the records of a file, with their checksums.
fn write_records(disk: &MemoryDisk, path: &Path, magic: [u8; 8], bytes: &[u8]) -> Option<()> {
    let header = FileHeader { magic, map: MAP, position: POSITION };
    let mut writer = RecordWriter::create(disk, path, &header).ok()?;
    for (kind, part) in parts(bytes) {
        if let Ok(kind) = RecordKind::try_from(i32::from(kind)) {
            writer.raw(kind, &[], part).ok()?;
        }
    }
    writer.finish().ok().map(drop)
}

fn open(disk: &MemoryDisk, path: &Path, bytes: &[u8]) {
    lock(&disk.0).insert(path.to_owned(), bytes.to_vec());
}

/// A checkpoint. The lowest bit of the first byte: whether its map has a grid; the next: whether the rest is a file as
/// it is, and not parts.
pub fn checkpoint(bytes: &[u8]) {
    let Some((&first, rest)) = bytes.split_first() else { return };
    let Some(spec) = map_spec(first & 1 == 1) else { return };
    let disk = MemoryDisk::default();
    let checkpoints = Checkpoints { disk: &disk, folder: PathBuf::from("/c"), map: MapId(MAP) };
    let path = checkpoints.path(POSITION);
    if first & 2 == 2 {
        open(&disk, &path, rest);
    } else if write_records(&disk, &path, CHECKPOINT_MAGIC, rest).is_none() {
        return;
    }
    let _ = checkpoints.replay_from(1);
    for bytes in [u64::MAX, 0] {
        let Ok((Some(snapshot), _)) = checkpoints.load(&spec, Memory { tile_bytes: bytes, spectrum_bytes: bytes })
        else {
            continue;
        };
        for slot in snapshot.grid.iter().flat_map(|grid| &grid.models) {
            let _ = slot.get();
        }
    }
}

/// A history file. The lowest bit of the first byte: whether it is that of a grid; the next: whether the rest is a file
/// as it is, and not parts.
pub fn history(bytes: &[u8]) {
    let Some((&first, rest)) = bytes.split_first() else { return };
    let disk = MemoryDisk::default();
    let part = if first & 1 == 1 { "grid" } else { "states" };
    let path = PathBuf::from(format!("/h/{POSITION:020}.{part}.tmh"));
    if first & 2 == 2 {
        open(&disk, &path, rest);
    } else if write_records(&disk, &path, HISTORY_MAGIC, rest).is_none() {
        return;
    }
    let history = History::at(Arc::new(disk), PathBuf::from("/h"), MapId(MAP));
    // Nothing is listed, so that nothing is missing.
    let _ = list_file::replace(&*history.disk, &history.list_path(), &FileList::default());
    let _ = history.state(StateId(0), i64::MIN, i64::MAX);
    if let Ok(files) = history.state_files() {
        let _ = files.readings(&[ReadingsRequest { state: StateId(1), from_nanos: 0 }]);
    }
    for day in history.grid_days(i64::MIN, i64::MAX, None) {
        if day.is_err() {
            break;
        }
    }
}

/// A segment of the log. The lowest bit of the first byte: whether the rest is the file as it is; else it is parts,
/// whose kinds are those of frames.
pub fn log_segment(bytes: &[u8]) {
    let Some((&first, rest)) = bytes.split_first() else { return };
    let disk = MemoryDisk::default();
    let folder = Path::new("/l");
    let mut segment = SegmentHeader { map: MAP, first_position: 1, chain: FIRST_CHAIN }.encode().to_vec();
    if first & 1 == 1 {
        segment = rest.to_vec();
    } else {
        let mut chain = FIRST_CHAIN;
        for (position, (kind, part)) in (1..).zip(parts(rest)) {
            let kind = match kind % 5 {
                0 => FrameKind::Observations,
                1 => FrameKind::UpdateStart,
                2 => FrameKind::Scans,
                3 => FrameKind::AddState,
                _ => FrameKind::EditSite,
            };
            let body = guard(part);
            let payload_length = u32::try_from(part.len()).unwrap_or(0);
            let body_crc = crc32c::crc32c(&body);
            let header = FrameHeader { kind, payload_length, position, group_index: 0, chain, body_crc };
            segment.extend_from_slice(&header.encode());
            segment.extend_from_slice(&body);
            chain = header.next_chain();
        }
    }
    open(&disk, &segment_path(folder, 1), &segment);
    let expected = recovery::Expectation { map: MAP, replay_from: 1, known: 0, is_listed: false };
    let read = recovery::read(&disk, folder, &expected);
    if let Ok(found) = read.and_then(|read| recovery::repair(&disk, folder, read)) {
        let end = found.cursor.position - 1;
        for event in Replay::new(Arc::new(disk), folder.to_owned(), found.segments, 1, end) {
            if event.is_err() {
                break;
            }
        }
    }
}

/// A row of the index, by its first byte, or the file of a map.
pub fn row(bytes: &[u8]) {
    let Some((&first, rest)) = bytes.split_first() else { return };
    let Some(map) = map_spec(first & 8 == 8) else { return };
    let periodicities = &map.periodicities;
    match first & 7 {
        0 => drop(StateRow::decode(rest).map(|row| published::decode(0, row, periodicities))),
        1 => drop(layout::Producer::decode(rest).map(|message| snapshot::decode_producer(0, &message))),
        2 => drop(layout_site::TableRow::decode(rest).map(|row| tables::site(&[row], 3))),
        3 => drop(layout_grid::Tile::decode(rest).map(|message| tile::decode(&message))),
        4 => drop(layout_grid::TileModel::decode(rest).map(|message| tile_model::decode(&message, periodicities))),
        _ => drop(layout::MapSpec::decode(rest).map(spec::decode)),
    }
}

/// A list, by its first byte; with the right checksum.
pub fn list(bytes: &[u8]) {
    fn read<L: TextList>(lines: &[u8]) {
        let text = [format!("{}\n", L::FIRST_LINE).as_bytes(), lines].concat();
        let checksum = format!("crc32c {:08x}\n", crc32c::crc32c(&text));
        drop(L::from_text(&[&text, checksum.as_bytes()].concat()));
        drop(L::from_text(lines));
    }
    let Some((&first, rest)) = bytes.split_first() else { return };
    match first % 7 {
        0 => read::<MapList>(rest),
        1 => read::<FileList>(rest),
        2 => read::<NewestSegment>(rest),
        3 => read::<ErasureOrder>(rest),
        4 => read::<ErasureCount>(rest),
        5 => read::<CheckpointList>(rest),
        _ => read::<LossList>(rest),
    }
}

#[cfg(test)]
mod tests;
