//! History: the exact observations that updates have learned, one file per generation for named states and one for the
//! grid.
//!
//! Invariant: a file has its final name only when it is durable and has been read back. Files are written before the
//! checkpoint that lets the log forget what is in them, and deleted only when they are older than the map's retention.

use std::{
    fmt, io,
    path::{Path, PathBuf},
    sync::Arc,
};

use tidemap_grid::{index::TileId, spec::Retention};
use tidemap_layout::lists::ListedFile;
use tidemap_map::{history::HistoryPiece, ids::StateId, spec::MapSpec};
use tidemap_model::{Sample, StopSignal};

use crate::{
    MapId,
    disk::Disk,
    error::{EraseError, HistoryError, OpenError, Repair, StoreError, open_io, store_io},
};

mod days;
mod file;
mod list;
mod states;
mod table;
mod write;

pub use days::GridDays;
use file::HistoryFile;
pub use states::StateFiles;
use table::Table;

/// Copies a file from one path to another.
pub(crate) type CopyFile = dyn Fn(&dyn Disk, &Path, &Path) -> Result<(), StoreError>;

const SUFFIX: &str = ".tmh";
const NEW_SUFFIX: &str = ".tmh.new";

/// The two kinds of history files.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Hash)]
pub(crate) enum Part {
    /// Named states.
    States,
    /// The grid.
    Grid,
}

impl Part {
    fn name(self, generation: u64) -> String {
        match self {
            Part::States => format!("{generation:020}.states{SUFFIX}"),
            Part::Grid => format!("{generation:020}.grid{SUFFIX}"),
        }
    }

    /// The generation and the part of a file of that name.
    fn of(name: &str) -> Option<(u64, Part)> {
        let name = name.strip_suffix(SUFFIX)?;
        let (digits, part) = match (name.strip_suffix(".states"), name.strip_suffix(".grid")) {
            (Some(digits), _) => (digits, Part::States),
            (_, Some(digits)) => (digits, Part::Grid),
            _ => return None,
        };
        let is_number = digits.len() == 20 && digits.bytes().all(|byte| byte.is_ascii_digit());
        Some((digits.parse().ok().filter(|_| is_number)?, part))
    }
}

/// Whether history files have such a name.
pub(crate) fn is_file(name: &str) -> bool {
    Part::of(name).is_some_and(|(generation, part)| part.name(generation) == name)
}

/// Bytes of history on the disk.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct HistorySizes {
    /// Files.
    pub files: u64,
    /// Bytes of named states.
    pub state_bytes: u64,
    /// Bytes of the grid.
    pub grid_bytes: u64,
    /// The newest generation with a file of named states; 0 without one.
    pub newest_generation: u64,
}

/// The exact observations of one map, as far back as they are kept. Those of a generation are readable once it
/// has been saved.
#[derive(Clone)]
pub struct History {
    pub(crate) disk: Arc<dyn Disk>,
    pub(crate) folder: PathBuf,
    pub(crate) map: MapId,
    /// Generations from this one on are left out.
    pub(crate) before: u64,
    /// Reading stops at the first file after this many observations of a state.
    pub(crate) enough: usize,
}

impl fmt::Debug for History {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.debug_struct("History").field("folder", &self.folder).finish_non_exhaustive()
    }
}

impl History {
    /// The history in a folder.
    pub(crate) fn at(disk: Arc<dyn Disk>, folder: PathBuf, map: MapId) -> History {
        History { disk, folder, map, before: u64::MAX, enough: usize::MAX }
    }

    fn path(&self, generation: u64, part: Part) -> PathBuf {
        self.folder.join(part.name(generation))
    }

    /// Names in the folder; empty if there is no folder.
    fn names(&self) -> io::Result<Vec<String>> {
        match self.disk.list(&self.folder) {
            Err(error) if error.kind() == io::ErrorKind::NotFound => Ok(Vec::new()),
            names => names,
        }
    }

    /// Generations that have a file of a part, or should have one, ascending.
    fn generations(&self, part: Part) -> Result<Vec<u64>, HistoryError> {
        let mut names = self.names().map_err(|error| self.list_error(error))?;
        // Read after the names: a file that is no longer listed was deleted on purpose.
        names.extend(self.listed()?.files.into_iter().map(|file| file.name));
        let mut found: Vec<u64> = names
            .iter()
            .filter_map(|name| Part::of(name))
            .filter(|found| found.1 == part && found.0 < self.before)
            .map(|found| found.0)
            .collect();
        found.sort_unstable();
        found.dedup();
        Ok(found)
    }

    fn open(&self, generation: u64, part: Part) -> Result<HistoryFile, HistoryError> {
        HistoryFile::open(&*self.disk, &self.path(generation, part), self.map.0, generation)
    }

    fn list_error(&self, source: io::Error) -> HistoryError {
        HistoryError::Io { file: self.folder.clone(), source }
    }

    /// This history without this generation and later ones, which the caller reads elsewhere.
    pub fn before(self, generation: u64) -> History {
        History { before: generation, ..self }
    }

    /// This history for a caller that uses at most so many observations of a state. If there are more, reading stops
    /// early: the caller gets more than it uses, but not all.
    pub fn at_most(self, observations: usize) -> History {
        History { enough: observations, ..self }
    }

    /// The observations of a state at times from `from_nanos` up to but not including `to_nanos`, ascending by time; of
    /// equal times in order of arrival.
    ///
    /// # Errors
    /// [`HistoryError`] names the file that cannot be read.
    pub fn state(&self, id: StateId, from_nanos: i64, to_nanos: i64) -> Result<Vec<Sample>, HistoryError> {
        self.state_until(id, from_nanos, to_nanos, StopSignal::NEVER)
    }

    /// The observations of a state as [`History::state`] gives them; not all of them if the signal is set.
    ///
    /// # Errors
    /// [`HistoryError`] names the file that cannot be read.
    pub fn state_until(
        &self,
        id: StateId,
        from_nanos: i64,
        to_nanos: i64,
        stop: StopSignal<'_>,
    ) -> Result<Vec<Sample>, HistoryError> {
        let mut found = Vec::new();
        for generation in self.generations(Part::States)? {
            if found.len() > self.enough || stop.is_set() {
                break;
            }
            let Some(file) = self.open_if_there(generation, Part::States, from_nanos, to_nanos)? else { continue };
            if file.overlaps(from_nanos, to_nanos) {
                Table::new(&file).samples(id, |sample| {
                    if (from_nanos..to_nanos).contains(&sample.utc_nanos) {
                        found.push(sample);
                    }
                })?;
            }
        }
        found.sort_by_key(|sample: &Sample| sample.utc_nanos);
        Ok(found)
    }

    /// The days that have scans at times from `from_nanos` up to but not including `to_nanos`, one by one, by
    /// generation and day. Each is a whole day, with the observations of `tiles` only, or of all tiles if `tiles` is
    /// `None`.
    pub fn grid_days(&self, from_nanos: i64, to_nanos: i64, tiles: Option<Vec<TileId>>) -> GridDays {
        GridDays::new(self.clone(), from_nanos, to_nanos, tiles)
    }

    /// Bytes on the disk.
    ///
    /// # Errors
    /// [`HistoryError`] where the folder cannot be read.
    pub fn sizes(&self) -> Result<HistorySizes, HistoryError> {
        let mut sizes = HistorySizes::default();
        for name in self.names().map_err(|error| self.list_error(error))? {
            let Some((generation, part)) = Part::of(&name) else { continue };
            // A file may be deleted meanwhile.
            let Ok(bytes) = self.disk.length(&self.folder.join(&name)) else { continue };
            sizes.files += 1;
            sizes.newest_generation = sizes.newest_generation.max(generation);
            match part {
                Part::States => {
                    sizes.state_bytes += bytes;
                }
                Part::Grid => sizes.grid_bytes += bytes,
            }
        }
        Ok(sizes)
    }

    /// Opens a file that may have been deleted since its name was read; not an error unless it must exist and may have
    /// observations of the range.
    fn open_if_there(
        &self,
        generation: u64,
        part: Part,
        from_nanos: i64,
        to_nanos: i64,
    ) -> Result<Option<HistoryFile>, HistoryError> {
        match self.open(generation, part) {
            Ok(file) => Ok(Some(file)),
            Err(HistoryError::Io { source, .. }) if source.kind() == io::ErrorKind::NotFound => {
                self.check_missing(generation, part, from_nanos, to_nanos).map(|()| None)
            }
            Err(error) => Err(error),
        }
    }

    /// Writes the parts that the map's retention keeps; durable when this returns.
    pub(crate) fn save(&self, spec: &MapSpec, pieces: &[Arc<HistoryPiece>]) -> Result<(), StoreError> {
        let keeps_states = spec.retention != Retention::None;
        let keeps_grid = spec.grid.as_ref().is_some_and(|grid| grid.retention != Retention::None);
        let mut written = Vec::new();
        for piece in pieces {
            if keeps_states && !piece.states.is_empty() {
                self.write(piece, Part::States, &mut written)?;
            }
            if keeps_grid && !piece.days.is_empty() {
                self.write(piece, Part::Grid, &mut written)?;
            }
        }
        if written.is_empty() {
            return Ok(());
        }
        self.disk.sync_folder(&self.folder).map_err(store_io(&self.folder))?;
        self.add_to_list(written)
    }

    fn write(&self, piece: &HistoryPiece, part: Part, written: &mut Vec<ListedFile>) -> Result<(), StoreError> {
        if written.is_empty() {
            self.create_folder().map_err(store_io(&self.folder))?;
        }
        let path = self.path(piece.generation, part);
        let new_path = self.folder.join(part.name(piece.generation).replace(SUFFIX, NEW_SUFFIX));
        let trailer = write::write(&*self.disk, &new_path, self.map, piece, part);
        let verified = trailer.and_then(|trailer| {
            file::verify(&*self.disk, &new_path, self.map.0, piece.generation, trailer)
                .map_err(|reason| StoreError::NotReadBack { file: new_path.clone(), reason })?;
            self.entry(&new_path, part.name(piece.generation), piece.generation)
                .map_err(|error| StoreError::NotReadBack { file: new_path.clone(), reason: error.to_string() })
        });
        let listed = verified.inspect_err(|_| {
            // Frees the space now; if this fails, the next start removes the file.
            let _ = self.disk.remove(&new_path);
        })?;
        self.disk.rename(&new_path, &path).map_err(store_io(&path))?;
        written.push(listed);
        Ok(())
    }

    /// All observations of named states of a file, by state.
    fn whole(&self, generation: u64) -> Result<HistoryPiece, HistoryError> {
        let file = self.open(generation, Part::States)?;
        let mut table = Table::new(&file);
        let mut ids = Vec::new();
        table.each(0, u64::MAX, |entry| {
            ids.push(StateId(u32::try_from(entry.key).map_err(|_| file.damaged("its table is not valid"))?));
            Ok(())
        })?;
        let mut piece = HistoryPiece::new(generation);
        for id in ids {
            let (samples, origins) = table.state(id)?;
            piece.states.push((id, samples));
            piece.origins.push(origins);
        }
        Ok(piece)
    }

    /// Passes the observations of named states of each generation up to one to `take`, ascending, with the latest time
    /// of each: of these states, ascending, or of all. An error if a file is missing that must exist.
    pub(crate) fn each_generation(
        &self,
        until: u64,
        states: Option<&[StateId]>,
        mut take: impl FnMut(&HistoryPiece, i64),
    ) -> Result<(), HistoryError> {
        for generation in self.generations(Part::States)?.into_iter().filter(|generation| *generation <= until) {
            let Some(file) = self.open_if_there(generation, Part::States, i64::MIN, i64::MAX)? else { continue };
            let to_nanos = file.to_nanos();
            let Some(states) = states else {
                take(&self.whole(generation)?, to_nanos);
                continue;
            };
            let (mut table, mut piece) = (Table::new(&file), HistoryPiece::new(generation));
            for &id in states {
                let (samples, origins) = table.state(id)?;
                if !samples.is_empty() {
                    piece.states.push((id, samples));
                    piece.origins.push(origins);
                }
            }
            take(&piece, to_nanos);
        }
        Ok(())
    }

    /// Writes the files of another history: those of named states as `rewrite` returns them, or none, and those of the
    /// grid as they are. A file that is missing there is missing here.
    pub(crate) fn write_again(
        &self,
        from: &History,
        rewrite: &dyn Fn(&HistoryPiece) -> Option<HistoryPiece>,
        copy: &CopyFile,
    ) -> Result<(), EraseError> {
        self.create_folder().map_err(store_io(&self.folder))?;
        let names = from.names().map_err(|error| from.list_error(error))?;
        let missing = from.listed()?.files.into_iter().filter(|file| !names.contains(&file.name));
        let mut written: Vec<ListedFile> = missing.collect();
        for name in &names {
            match Part::of(name) {
                Some((generation, Part::States)) => {
                    if let Some(piece) = rewrite(&from.whole(generation)?) {
                        self.write(&piece, Part::States, &mut written)?;
                    }
                }
                Some((generation, Part::Grid)) => {
                    let path = self.path(generation, Part::Grid);
                    copy(&*self.disk, &from.path(generation, Part::Grid), &path)?;
                    written.push(self.entry(&path, name.clone(), generation)?);
                }
                None => {}
            }
        }
        self.disk.sync_folder(&self.folder).map_err(store_io(&self.folder))?;
        Ok(self.add_to_list(written)?)
    }

    /// A map has no such folder before its first file.
    fn create_folder(&self) -> io::Result<()> {
        match self.disk.create_folder(&self.folder) {
            Err(error) if error.kind() != io::ErrorKind::AlreadyExists => Err(error),
            // The folder above is synced even if the folder existed: its name may not be durable yet.
            _ => self.disk.sync_folder(self.folder.parent().unwrap_or(Path::new("."))),
        }
    }

    /// Deletes the files whose newest observation is older than the map's retention allows.
    pub(crate) fn forget(&self, spec: &MapSpec, newest_nanos: i64) -> Result<(), HistoryError> {
        let grid = spec.grid.as_ref().map_or(Retention::Forever, |grid| grid.retention);
        let mut forgotten = Vec::new();
        for (part, retention) in [(Part::States, spec.retention), (Part::Grid, grid)] {
            let Retention::Duration(nanos) = retention else { continue };
            let keep_from = newest_nanos.saturating_sub(nanos);
            for generation in self.generations(part)? {
                // A damaged file stays for inspection, and a missing one that is too old is missed no longer.
                let is_old = match self.open_if_there(generation, part, keep_from, i64::MAX) {
                    Ok(file) => file.is_none_or(|file| file.to_nanos() < keep_from),
                    Err(_) => false,
                };
                if is_old {
                    forgotten.push(self.path(generation, part));
                }
            }
        }
        if forgotten.is_empty() {
            return Ok(());
        }
        // First, so that no file is missed that was deleted on purpose.
        self.remove_from_list(&forgotten)?;
        for path in forgotten {
            match self.disk.remove(&path) {
                Err(source) if source.kind() != io::ErrorKind::NotFound => {
                    return Err(HistoryError::Io { file: path, source });
                }
                _ => {}
            }
        }
        Ok(())
    }

    /// Removes files of an interrupted save.
    pub(crate) fn remove_leftovers(&self, repairs: &mut Vec<Repair>) -> Result<(), OpenError> {
        for name in self.names().map_err(open_io(&self.folder))? {
            if name.ends_with(NEW_SUFFIX) {
                let file = self.folder.join(name);
                self.disk.remove(&file).map_err(open_io(&file))?;
                repairs.push(Repair::LeftoverRemoved { file });
            }
        }
        Ok(())
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn names_lead_to_files_and_back() {
        for part in [Part::States, Part::Grid] {
            assert_eq!(Part::of(&part.name(7)), Some((7, part)));
        }
        for name in ["7.grid.tmh", "00000000000000000007.tmh", "00000000000000000007.grid.tmh.new", "x.states.tmh"] {
            assert_eq!(Part::of(name), None, "{name}");
        }
    }
}
