//! Checkpoints: immutable files, each a whole map at one log position.
//!
//! Invariant: a checkpoint has its final name only when it is durable and has been read back. The newest good one and
//! the log after it restore the map. A damaged checkpoint is renamed and never used.

use std::{
    io,
    path::{Path, PathBuf},
    sync::{Arc, Weak},
};

use prost::Message as _;
use tidemap_layout::{
    file::{CHECKPOINT_MAGIC, FileHeader, RecordKind, Trailer},
    map as layout, site as layout_site,
};
use tidemap_map::{site::Site, snapshot::MapSnapshot, spec::MapSpec};
use tidemap_model::PhasorSum;

use crate::{
    MapId,
    disk::Disk,
    error::{OpenError, Repair, StoreError, open_io, store_io},
    failure::ReadFailure,
    record::{snapshot as record, tables},
    record_file::{RecordReader, RecordWriter},
};

mod grid_reader;
mod grid_writer;
mod list;
mod model_cache;
pub(crate) mod spectra;
mod tiles;

use grid_reader::{Keep, ReadGrid};
pub(crate) use grid_writer::WriteError;
pub(crate) use model_cache::ModelCache;
use spectra::StatePlaces;
pub(crate) use tiles::CheckpointTiles;

const SUFFIX: &str = ".tmc";
const NEW_SUFFIX: &str = ".tmc.new";
const DAMAGED_EXTENSION: &str = "damaged";

/// The file of a checkpoint; its position and the first record that it needs, or what is wrong with it.
pub(crate) type CheckedCheckpoint = (PathBuf, Result<(u64, u64), String>);

/// A checkpoint that cannot be read, with the reason.
pub(crate) struct UnreadCheckpoint {
    path: PathBuf,
    failure: ReadFailure,
}

impl UnreadCheckpoint {
    /// The reason why the checkpoint cannot be read.
    pub(crate) fn failure(&self) -> &ReadFailure {
        &self.failure
    }
}

/// The counts of the written data.
struct Written {
    trailer: Trailer,
    shared: Vec<Weak<PhasorSum>>,
    /// Offsets of the records of states.
    offsets: Vec<u64>,
}

/// Approximate memory for what is loaded; what has no room is read from the checkpoint.
#[derive(Clone, Copy)]
pub(crate) struct Memory {
    /// For the models and sums of tiles.
    pub(crate) tile_bytes: u64,
    /// For the sums of states.
    pub(crate) spectrum_bytes: u64,
}

/// The checkpoints of one map.
pub(crate) struct Checkpoints<'store> {
    pub(crate) disk: &'store dyn Disk,
    pub(crate) folder: PathBuf,
    pub(crate) map: MapId,
}

impl Checkpoints<'_> {
    pub(crate) fn path(&self, position: u64) -> PathBuf {
        self.folder.join(format!("{position:020}{SUFFIX}"))
    }

    /// Positions of all checkpoints, ascending.
    pub(crate) fn positions(&self) -> io::Result<Vec<u64>> {
        let names = self.disk.list(&self.folder)?;
        Ok(names.iter().filter_map(|name| position(name)).collect())
    }

    /// Writes a checkpoint and reads it back; durable when this returns. Keeps the newest `kept`. Returns the states
    /// and the tiles of a grid, to be read from there.
    pub(crate) fn save(
        &self,
        spec: &MapSpec,
        snapshot: &MapSnapshot,
        kept: usize,
    ) -> Result<(StatePlaces, Option<Arc<CheckpointTiles>>), StoreError> {
        let invalid = |reason: String| StoreError::InvalidSnapshot { map: self.map, reason };
        record::check(snapshot).map_err(|reason| invalid(reason.to_owned()))?;
        if spec.grid.is_some() != snapshot.grid.is_some() {
            return Err(invalid("it has a grid where its map has none, or none where its map has one".to_owned()));
        }
        let new_path = self.folder.join(format!("{:020}{NEW_SUFFIX}", snapshot.position));
        let written = self.write(spec, &new_path, snapshot).map_err(|error| match error {
            WriteError::Io(error) => StoreError::from_io(new_path.clone(), error),
            WriteError::Invalid(reason) => invalid(reason),
        });
        let verified = written.and_then(|Written { trailer, shared, offsets }| {
            let tiles = self.verify(spec, &new_path, snapshot, trailer, shared);
            let source = self.spectra(&new_path).map_err(|error| error.to_string());
            let verified = tiles.and_then(|tiles| Ok((StatePlaces { source: source?, offsets }, tiles)));
            verified.map_err(|reason| StoreError::NotReadBack { file: new_path.clone(), reason })
        });
        let read_from = verified.inspect_err(|_| {
            // Frees the space now; if this fails, the next start removes the file.
            let _ = self.disk.remove(&new_path);
        })?;
        let path = self.path(snapshot.position);
        self.disk.rename(&new_path, &path).map_err(store_io(&path))?;
        self.disk.sync_folder(&self.folder).map_err(store_io(&self.folder))?;
        let positions = self.positions().map_err(store_io(&self.folder))?;
        let (old, kept) = positions.split_at(positions.len().saturating_sub(kept.max(1)));
        self.keep(kept.to_vec())?;
        for &position in old {
            self.disk.remove(&self.path(position)).map_err(store_io(&self.folder))?;
        }
        Ok(read_from)
    }

    fn write(&self, spec: &MapSpec, path: &Path, snapshot: &MapSnapshot) -> Result<Written, WriteError> {
        let header = FileHeader { magic: CHECKPOINT_MAGIC, map: self.map.0, position: snapshot.position };
        let mut writer = RecordWriter::create(self.disk, path, &header)?;
        writer.record(RecordKind::Snapshot, &record::encode(snapshot))?;
        for (id, producer) in (0..).zip(&snapshot.producers) {
            writer.record(RecordKind::Producer, &record::encode_producer(id, producer))?;
        }
        let mut offsets = Vec::with_capacity(snapshot.states.len());
        for (id, state) in (0..).zip(&snapshot.states) {
            offsets.push(writer.offset());
            let sums = state.model.accumulator().stored_parts()?;
            writer.record(RecordKind::State, &record::encode_state(id, state, sums))?;
        }
        for row in tables::rows(&snapshot.site) {
            writer.long(RecordKind::TableRow, &row.encode_to_vec())?;
        }
        let shared = match &snapshot.grid {
            Some(grid) => grid_writer::write(&mut writer, grid, &spec.periodicities)?,
            None => Vec::new(),
        };
        Ok(Written { trailer: writer.finish()?, shared, offsets })
    }

    /// Reads a file back record by record, so that a large map is not in memory twice. The grid is compared by its
    /// checksum, which covers every byte and is known from the writing, and found readable.
    fn verify(
        &self,
        spec: &MapSpec,
        path: &Path,
        snapshot: &MapSnapshot,
        trailer: Trailer,
        shared: Vec<Weak<PhasorSum>>,
    ) -> Result<Option<Arc<CheckpointTiles>>, String> {
        let same = |is_same: bool| if is_same { Ok(()) } else { Err("the content differs".to_owned()) };
        let mut reader = RecordReader::open(self.disk, path, CHECKPOINT_MAGIC, self.map.0)?;
        same(reader.header.position == snapshot.position)?;
        same(reader.record::<layout::Snapshot>(RecordKind::Snapshot)? == record::encode(snapshot))?;
        for (id, producer) in snapshot.producers.iter().enumerate() {
            same(record::decode_producer(id, &reader.record(RecordKind::Producer)?)? == *producer)?;
        }
        for (id, state) in snapshot.states.iter().enumerate() {
            let message = reader.record(RecordKind::State)?;
            same(record::decode_state(id, &message, &spec.periodicities, record::SpectrumIn::Checkpoint)? == *state)?;
        }
        same(read_site(&mut reader, &record::encode(snapshot))? == *snapshot.site)?;
        let read = match &snapshot.grid {
            Some(_) => Some(grid_reader::read(&mut reader, &spec.periodicities, Keep::Offsets)?),
            None => None,
        };
        same(reader.finish()? == trailer)?;
        read.map(|mut read| self.tiles(spec, path, &mut read, Some(shared))).transpose()
    }

    /// The tiles of a checkpoint, in a file that stays open.
    fn tiles(
        &self,
        spec: &MapSpec,
        path: &Path,
        read: &mut ReadGrid,
        shared: Option<Vec<Weak<PhasorSum>>>,
    ) -> Result<Arc<CheckpointTiles>, String> {
        let file = self.disk.read_anywhere(path).map_err(|error| error.to_string())?;
        let (offsets, read_shared) = read.take_offsets();
        let shared = shared.unwrap_or(read_shared);
        let name = if path.extension().is_some_and(|extension| extension == "new") {
            path.with_extension("")
        } else {
            path.to_owned()
        };
        Ok(Arc::new(CheckpointTiles::new(file, name, spec.periodicities.clone(), offsets, shared)))
    }

    fn read(&self, spec: &MapSpec, path: &Path, position: u64, memory: Memory) -> Result<MapSnapshot, ReadFailure> {
        let mut reader = RecordReader::open(self.disk, path, CHECKPOINT_MAGIC, self.map.0)?;
        let message: layout::Snapshot = reader.record(RecordKind::Snapshot)?;
        if message.position != position || reader.header.position != position {
            return Err("its position differs from its name".into());
        }
        let producers = (0..message.producers as usize).map(|id| {
            let producer = reader.record(RecordKind::Producer)?;
            Ok(record::decode_producer(id, &producer)?)
        });
        let producers = producers.collect::<Result<_, ReadFailure>>()?;
        let source = self.spectra(path)?;
        let mut bytes = 0;
        let states = (0..message.states as usize).map(|id| {
            let offset = reader.offset();
            let state = reader.record(RecordKind::State)?;
            let state = record::decode_state(id, &state, &spec.periodicities, record::SpectrumIn::Checkpoint)?;
            if let Some(cell) = state.model.accumulator().cell() {
                bytes += cell.bytes() as u64;
                if bytes > memory.spectrum_bytes {
                    bytes -= cell.bytes() as u64;
                    cell.move_to(&source, offset);
                }
            }
            Ok::<_, ReadFailure>(state)
        });
        let states = states.collect::<Result<_, ReadFailure>>()?;
        let site = read_site(&mut reader, &message)?;
        let grid = match &spec.grid {
            Some(_) => Some(grid_reader::read(&mut reader, &spec.periodicities, Keep::UpTo(memory.tile_bytes))?),
            None => None,
        };
        reader.finish()?;
        let mut snapshot = record::decode(&message, producers, states, site)?;
        if let Some(mut read) = grid {
            let tiles = self.tiles(spec, path, &mut read, None)?;
            snapshot.grid = Some(read.into_grid(&tiles));
        }
        Ok(snapshot)
    }

    /// The smallest log position from which any of the checkpoints replays; `None` if there are fewer than `count`, or
    /// where one cannot be read.
    pub(crate) fn replay_from(&self, count: usize) -> io::Result<Option<u64>> {
        let positions = self.positions()?;
        if positions.is_empty() || positions.len() < count {
            return Ok(None);
        }
        let replay_from = |&position: &u64| {
            let mut reader = RecordReader::open(self.disk, &self.path(position), CHECKPOINT_MAGIC, self.map.0).ok()?;
            Some(reader.record::<layout::Snapshot>(RecordKind::Snapshot).ok()?.replay_from)
        };
        Ok(positions.iter().map(replay_from).collect::<Option<Vec<u64>>>().and_then(|all| all.into_iter().min()))
    }

    /// The generation of the newest checkpoint that can be read; `None` where there is none.
    pub(crate) fn newest_generation(&self) -> Option<u64> {
        self.positions().ok()?.into_iter().rev().find_map(|position| {
            let mut reader = RecordReader::open(self.disk, &self.path(position), CHECKPOINT_MAGIC, self.map.0).ok()?;
            Some(reader.record::<layout::Snapshot>(RecordKind::Snapshot).ok()?.generation)
        })
    }

    /// The newest checkpoint that can be read, and the newer ones that cannot. Changes nothing.
    ///
    /// # Errors
    /// Also a lack of descriptors or memory: a good checkpoint must not be passed over for that.
    pub(crate) fn load(
        &self,
        spec: &MapSpec,
        memory: Memory,
    ) -> io::Result<(Option<MapSnapshot>, Vec<UnreadCheckpoint>)> {
        let mut unread = Vec::new();
        for &position in self.positions()?.iter().rev() {
            let path = self.path(position);
            match self.read(spec, &path, position, memory) {
                Ok(snapshot) => return Ok((Some(snapshot), unread)),
                Err(failure) => match failure.shortage() {
                    Some(error) => return Err(error),
                    None => unread.push(UnreadCheckpoint { path, failure }),
                },
            }
        }
        Ok((None, unread))
    }

    /// Reads every checkpoint: its position and the first record that it needs of the log, or what is wrong with it.
    pub(crate) fn check_all(&self, spec: &MapSpec, memory: Memory) -> io::Result<Vec<CheckedCheckpoint>> {
        let read = |position| {
            let path = self.path(position);
            let read = self.read(spec, &path, position, memory);
            let read = read.map(|snapshot| (snapshot.position, snapshot.replay_from.max(1)));
            (path, read.map_err(String::from))
        };
        Ok(self.positions()?.into_iter().map(read).collect())
    }

    /// Renames a damaged checkpoint and keeps it for inspection. One that the disk or the machine refuses to read stays
    /// where it is: it may be sound.
    pub(crate) fn set_aside(&self, unread: UnreadCheckpoint) -> Result<Repair, OpenError> {
        let UnreadCheckpoint { path, failure } = unread;
        let reason = match failure {
            ReadFailure::Damaged(reason) => reason,
            ReadFailure::Disk(reason) => return Ok(Repair::CheckpointNotRead { file: path, reason }),
        };
        let file = path.with_added_extension(DAMAGED_EXTENSION);
        self.disk.rename(&path, &file).map_err(open_io(&path))?;
        self.disk.sync_folder(&self.folder).map_err(open_io(&self.folder))?;
        if let Some(position) = path.file_name().and_then(|name| name.to_str()).and_then(position) {
            self.unlist(position).map_err(|error| open_io(self.list_path())(io::Error::other(error.to_string())))?;
        }
        Ok(Repair::CheckpointSetAside { file, reason })
    }

    /// Removes files of an interrupted save.
    pub(crate) fn remove_leftovers(&self, repairs: &mut Vec<Repair>) -> Result<(), OpenError> {
        for name in self.disk.list(&self.folder).map_err(open_io(&self.folder))? {
            if name.ends_with(NEW_SUFFIX) {
                let file = self.folder.join(name);
                self.disk.remove(&file).map_err(open_io(&file))?;
                repairs.push(Repair::LeftoverRemoved { file });
            }
        }
        Ok(())
    }
}

/// The site of a checkpoint whose states have been read.
fn read_site(reader: &mut RecordReader, snapshot: &layout::Snapshot) -> Result<Site, ReadFailure> {
    let mut bytes = Vec::new();
    let rows = (0..snapshot.table_rows).map(|_| reader.long_message(RecordKind::TableRow, &mut bytes));
    let rows = rows.collect::<Result<Vec<layout_site::TableRow>, ReadFailure>>()?;
    Ok(tables::site(&rows, snapshot.states as usize)?)
}

/// Position of a checkpoint of that name; `None` for other files.
pub(crate) fn position(name: &str) -> Option<u64> {
    let digits = name.strip_suffix(SUFFIX)?;
    let is_position = digits.len() == 20 && digits.bytes().all(|byte| byte.is_ascii_digit());
    if is_position { digits.parse().ok() } else { None }
}
