//! What an update of a grid has done so far, in a file that grows while the update runs.
//!
//! Nothing depends on such a file but how long a repeated update takes. It is never synced: what a power cut takes away
//! is done again. Where it cannot be written it is given up, and the space is free for the log.
//!
//! Invariant: what is taken from a file was written by an earlier run of the same update, whole; every record is
//! checked by its own checksum, and every tile's last record by that of all that is before it. A file is removed when a
//! checkpoint holds what the update has learned.

use std::{
    io,
    path::{Path, PathBuf},
    sync::{Arc, Mutex, MutexGuard, PoisonError},
};

use prost::Message as _;
use tidemap_map::grid::progress::{DoneTile, TileNote, UpdateIdentity, UpdateJournal};
use tidemap_migrations::{
    v1::file::FileHeader,
    v2::{
        file::{RecordKind, UPDATE_MAGIC},
        update as v2,
    },
};
use tidemap_model::{Periodicities, PeriodicityDefinition};

use crate::{
    MapId,
    checkpoint::{Shared, TileWriter, WriteError},
    disk::Disk,
    record::doubles,
    record_file::RecordWriter,
};

mod read;

use read::{Found, read};

const PREFIX: &str = "update-";
const SUFFIX: &str = ".tmu";
/// How records are laid out.
const LAYOUT: u32 = 1;

/// What one update has done of its grid, kept in a file from one start of the process to the next.
pub struct UpdateFile {
    disk: Arc<dyn Disk>,
    path: PathBuf,
    map: MapId,
    periodicities: Periodicities,
    update: v2::Update,
    /// Number of tiles that an earlier run has left.
    resumed: usize,
    /// Held while notes are written.
    state: Mutex<State>,
}

struct State {
    /// What an earlier run has left, until somebody asks for it.
    found: Vec<DoneTile>,
    writing: Writing,
}

/// How the file is written.
enum Writing {
    /// It is made with the first note.
    NotBegun,
    /// It is open, with these shared sums in it.
    Open(RecordWriter, Shared),
    /// It could not be written.
    GivenUp,
}

impl std::fmt::Debug for UpdateFile {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        f.debug_struct("UpdateFile").field("path", &self.path).finish_non_exhaustive()
    }
}

impl UpdateFile {
    /// Takes up what an earlier run of this update has left in the folder of the map's checkpoints. A file of another
    /// update by the same name is removed.
    pub(crate) fn open(
        disk: Arc<dyn Disk>,
        folder: &Path,
        map: MapId,
        periodicities: &Periodicities,
        identity: &UpdateIdentity,
    ) -> UpdateFile {
        let path = folder.join(format!("{PREFIX}{:020}{SUFFIX}", identity.generation));
        let update = describe(identity, periodicities);
        let is_there = disk.length(&path).is_ok();
        let mut state = State { found: Vec::new(), writing: Writing::NotBegun };
        if is_there {
            match read(&*disk, &path, map, periodicities, &update) {
                Ok(Found { tiles, shared, length, crc }) => {
                    state.writing = match RecordWriter::go_on(&*disk, &path, length, crc) {
                        Ok(writer) => Writing::Open(writer, Shared::of_file(shared)),
                        Err(error) => {
                            tracing::warn!(file = %path.display(), %error, "what the update does is not noted");
                            Writing::GivenUp
                        }
                    };
                    state.found = tiles;
                }
                Err(reason) => {
                    tracing::info!(file = %path.display(), reason, "not of use for the update, and removed");
                    remove(&*disk, &path);
                }
            }
        }
        let (periodicities, resumed) = (periodicities.clone(), state.found.len());
        UpdateFile { disk, path, map, periodicities, update, resumed, state: Mutex::new(state) }
    }

    /// Number of tiles that an earlier run has left.
    #[must_use]
    pub fn resumed(&self) -> usize {
        self.resumed
    }

    fn state(&self) -> MutexGuard<'_, State> {
        self.state.lock().unwrap_or_else(PoisonError::into_inner)
    }

    fn create(&self) -> Result<(RecordWriter, Shared), WriteError> {
        let header = FileHeader { magic: UPDATE_MAGIC, map: self.map.0, position: self.update.generation };
        let mut writer = RecordWriter::create(&*self.disk, &self.path, &header)?;
        writer.long(RecordKind::Update, &self.update.encode_to_vec())?;
        Ok((writer, Shared::default()))
    }

    /// Writes notes. Gives the file back only where it is whole.
    fn write(&self, writing: Writing, notes: &[TileNote<'_>]) -> Result<Writing, WriteError> {
        let (mut writer, mut shared) = match writing {
            Writing::NotBegun => self.create()?,
            Writing::Open(writer, shared) => (writer, shared),
            Writing::GivenUp => return Ok(Writing::GivenUp),
        };
        for note in notes {
            let mut tiles = TileWriter::new(&mut writer, &self.periodicities, shared);
            tiles.put(note.model, note.sums)?;
            shared = tiles.into_shared();
            let mut squared_errors = Vec::new();
            doubles::push(&mut squared_errors, &note.outcome.squared_errors);
            doubles::push(
                &mut squared_errors,
                &[note.outcome.squared_error_in_force, note.outcome.squared_error_chosen],
            );
            let done = v2::DoneTile {
                tile: note.tile.0,
                through: note.through.0,
                observations: note.outcome.observations,
                scored: note.outcome.scored,
                squared_errors,
                crc_before: writer.total_crc(),
            };
            writer.long(RecordKind::DoneTile, &done.encode_to_vec())?;
        }
        writer.flush()?;
        Ok(Writing::Open(writer, shared))
    }
}

impl UpdateJournal for UpdateFile {
    fn resume(&self) -> Vec<DoneTile> {
        std::mem::take(&mut self.state().found)
    }

    fn note(&self, tiles: &[TileNote<'_>]) {
        let mut state = self.state();
        let writing = std::mem::replace(&mut state.writing, Writing::GivenUp);
        match self.write(writing, tiles) {
            Ok(writing) => state.writing = writing,
            Err(error) => {
                let reason = match error {
                    WriteError::Io(error) => error.to_string(),
                    WriteError::Invalid(reason) => reason,
                };
                let file = self.path.display();
                tracing::warn!(
                    %file, reason,
                    "what the update does is not noted any more: if it is cut off, it is run again from its start"
                );
                remove(&*self.disk, &self.path);
            }
        }
    }
}

fn describe(identity: &UpdateIdentity, periodicities: &Periodicities) -> v2::Update {
    let (harmonics_base_nanos, harmonics_count, period_nanos) = match periodicities.definition() {
        PeriodicityDefinition::Harmonics { base_nanos, count } => (*base_nanos, *count, Vec::new()),
        PeriodicityDefinition::List { period_nanos } => (0, 0, period_nanos.clone()),
    };
    let UpdateIdentity { generation, position, cut_nanos, content } = *identity;
    v2::Update {
        layout: LAYOUT,
        generation,
        position,
        cut_nanos,
        content,
        harmonics_base_nanos,
        harmonics_count,
        period_nanos,
    }
}

/// Whether a file is one of these, and no checkpoint.
pub(crate) fn is_update_file(name: &str) -> bool {
    generation(name).is_some()
}

/// The generation that a file's update publishes.
fn generation(name: &str) -> Option<u64> {
    let digits = name.strip_prefix(PREFIX)?.strip_suffix(SUFFIX)?;
    let is_number = digits.len() == 20 && digits.bytes().all(|byte| byte.is_ascii_digit());
    if is_number { digits.parse().ok() } else { None }
}

/// Removes the files of updates whose results a snapshot of this generation holds. Gives their paths.
pub(crate) fn remove_through(disk: &dyn Disk, folder: &Path, snapshot: u64) -> io::Result<Vec<PathBuf>> {
    let mut removed = Vec::new();
    for name in disk.list(folder)? {
        if generation(&name).is_some_and(|generation| generation <= snapshot) {
            let path = folder.join(name);
            disk.remove(&path)?;
            removed.push(path);
        }
    }
    Ok(removed)
}

/// Removes a file that may not be there.
fn remove(disk: &dyn Disk, path: &Path) {
    match disk.remove(path) {
        Err(error) if error.kind() != io::ErrorKind::NotFound => {
            tracing::warn!(file = %path.display(), %error, "not removed; tried again at the next save");
        }
        _ => {}
    }
}
