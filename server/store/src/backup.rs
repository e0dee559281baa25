//! Backups: a copy of a data directory that is in use, and the way back from it.
//!
//! A backup is itself a data directory without an index. A later backup into the same folder copies only what is new:
//! checkpoints, history files and closed segments never change.
//!
//! Invariant: a backup that was complete once can be restored at every moment after, also while it is brought up to
//! date: the log is copied before the checkpoints that need it, and what is no longer needed goes last. A restored
//! folder has been checked, and its manifest is written last.

use std::{
    fs::{self, File},
    io::{self, Read as _, Write as _},
    path::{Path, PathBuf},
    sync::PoisonError,
};

use tidemap_layout::lists::{
    CHECKPOINTS_FILE, ERASURES_FILE, HISTORY_FILE, LOSSES_FILE, MAPS_FILE, NEWEST_FILE, NewestSegment, TextList as _,
};
use tidemap_migrations::{
    FORMAT, manifest,
    manifest::{Manifest, ManifestError},
};

use crate::{
    MapId, Store,
    check::{Mode, check},
    disk::{Disk, RealDisk, read_all},
    erasure,
    error::{OpenError, is_disk_full, shown},
    folders,
    log::{segment_path, segment_position},
    store::{MapEntry, OpenStore},
};

/// Bytes at the end of a file that are compared: its trailer and the records before it.
const COMPARED_BYTES: usize = 64;

/// Why a backup is not made or not restored.
#[derive(Debug, thiserror::Error)]
#[allow(missing_docs, reason = "the fields are named in the message")]
pub enum BackupError {
    /// The folder is not empty, and is no backup.
    #[error("{} is neither empty nor a backup: name an empty folder", .0.display())]
    NotEmpty(PathBuf),
    /// The folder is in the data directory, or the other way round.
    #[error("{} is in the data folder: name a folder elsewhere, best on another disk", .0.display())]
    Inside(PathBuf),
    /// The folder holds a backup of another data directory.
    #[error("{} holds a backup of another data folder: name an empty folder", .0.display())]
    OtherStore(PathBuf),
    /// A backup that is damaged is not restored.
    #[error("the backup is damaged: {file}: {problem}. Restore an older backup", file = .file.display())]
    Damaged { file: PathBuf, problem: String },
    /// The backup cannot be opened.
    #[error(transparent)]
    Open(#[from] OpenError),
    /// The caller stopped the backup.
    #[error("the backup was stopped; make it again")]
    Stopped,
    /// The manifest cannot be read or written.
    #[error(transparent)]
    Manifest(#[from] ManifestError),
    /// The disk returned an error.
    #[error("cannot read or write {}: {source}", shown(.file))]
    Io { file: PathBuf, source: io::Error },
}

/// The files that were copied.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct BackupReport {
    /// Maps.
    pub maps: u64,
    /// Files that were copied.
    pub copied_files: u64,
    /// Bytes of these files.
    pub copied_bytes: u64,
    /// Files that the folder already had.
    pub kept_files: u64,
}

impl BackupError {
    /// Whether the disk of the backup is full.
    #[must_use]
    pub fn is_disk_full(&self) -> bool {
        matches!(self, BackupError::Io { source, .. } if is_disk_full(source))
    }
}

fn io_error(file: &Path) -> impl FnOnce(io::Error) -> BackupError {
    let file = file.to_owned();
    move |source| BackupError::Io { file, source }
}

/// Names in a folder; empty where there is none.
fn names(folder: &Path) -> Result<Vec<String>, BackupError> {
    let entries = match fs::read_dir(folder) {
        Err(error) if error.kind() == io::ErrorKind::NotFound => return Ok(Vec::new()),
        entries => entries.map_err(io_error(folder))?,
    };
    let names = entries.map(|entry| Ok(entry?.file_name().into_string().ok()));
    let names: io::Result<Vec<Option<String>>> = names.collect();
    Ok(names.map_err(io_error(folder))?.into_iter().flatten().collect())
}

fn sync_folder(folder: &Path) -> Result<(), BackupError> {
    File::open(folder).and_then(|folder| folder.sync_all()).map_err(io_error(folder))
}

/// Writes a file under another name first, so that it is whole or absent.
fn put(path: &Path, write: impl FnOnce(&mut File) -> io::Result<()>) -> Result<(), BackupError> {
    let part = path.with_added_extension("part");
    let written = File::create(&part).and_then(|mut file| {
        write(&mut file)?;
        file.sync_all()
    });
    written.and_then(|()| fs::rename(&part, path)).map_err(io_error(path))
}

/// The copies that are being made.
struct Copies<'a> {
    disk: &'a dyn Disk,
    goes_on: &'a dyn Fn() -> bool,
    report: BackupReport,
}

impl Copies<'_> {
    /// Copies the first `length` bytes of a file that does not change in them, unless the copy is there.
    fn copy(&mut self, from: &Path, to: &Path, length: u64) -> Result<(), BackupError> {
        if !(self.goes_on)() {
            return Err(BackupError::Stopped);
        }
        if self.is_there(from, to, length).map_err(io_error(from))? {
            self.report.kept_files += 1;
            return Ok(());
        }
        let reader = self.disk.read(from).map_err(io_error(from))?;
        put(to, |file| {
            let copied = io::copy(&mut reader.take(length), file)?;
            if copied == length { Ok(()) } else { Err(io::ErrorKind::UnexpectedEof.into()) }
        })?;
        self.report.copied_files += 1;
        self.report.copied_bytes += length;
        Ok(())
    }

    /// Whether the copy has the same length and the same end.
    fn is_there(&self, from: &Path, to: &Path, length: u64) -> io::Result<bool> {
        if fs::metadata(to).map_or(true, |metadata| metadata.len() != length) {
            return Ok(false);
        }
        let compared = usize::try_from(length).unwrap_or(usize::MAX).min(COMPARED_BYTES);
        let (mut here, mut there) = (vec![0; compared], vec![0; compared]);
        let start = length - compared as u64;
        self.disk.read_anywhere(from)?.read_exact_at(&mut here, start)?;
        self.disk.read_anywhere(to)?.read_exact_at(&mut there, start)?;
        Ok(here == there)
    }

    /// Copies the immutable files of a folder.
    fn copy_folder(&mut self, from: &Path, to: &Path, wanted: impl Fn(&str) -> bool) -> Result<(), BackupError> {
        let present = match self.disk.list(from) {
            Err(error) if error.kind() == io::ErrorKind::NotFound => return Ok(()),
            present => present.map_err(io_error(from))?,
        };
        fs::create_dir_all(to).map_err(io_error(to))?;
        for name in present.iter().filter(|name| wanted(name)) {
            let length = self.disk.length(&from.join(name)).map_err(io_error(from))?;
            self.copy(&from.join(name), &to.join(name), length)?;
        }
        sync_folder(to)
    }
}

/// Removes the files that the source no longer has.
fn remove_old(disk: &dyn Disk, from: &Path, to: &Path) -> Result<(), BackupError> {
    let present = disk.list(from).unwrap_or_default();
    for name in names(to)?.iter().filter(|name| !present.contains(name)) {
        fs::remove_file(to.join(name)).map_err(io_error(to))?;
    }
    Ok(())
}

impl Store {
    /// Copies all maps to a folder, which is empty or holds an earlier backup of the same data directory. Appends go on
    /// meanwhile; saves of the map that is being copied wait. Observations that were acknowledged before the call are
    /// in the backup. Maps that are set aside are not copied; the data that an earlier backup has of them stays.
    ///
    /// # Errors
    /// [`BackupError`]; an earlier backup in the folder can still be restored.
    pub fn backup(&self, target: &Path) -> Result<BackupReport, BackupError> {
        self.backup_while(target, &|| true)
    }

    /// Does the same as [`Store::backup`]; before each file it calls `goes_on`, which decides whether the backup goes
    /// on.
    ///
    /// # Errors
    /// The errors of [`Store::backup`], and [`BackupError::Stopped`].
    pub fn backup_while(&self, target: &Path, goes_on: &dyn Fn() -> bool) -> Result<BackupReport, BackupError> {
        let inner = self.inner();
        // Two at once would write the same files.
        let _alone = inner.backup.lock().unwrap_or_else(PoisonError::into_inner);
        let is_new = prepare(&inner.directory, target, self.store_id())?;
        let manifest = || Manifest { format: FORMAT, store_id: self.store_id().to_owned() };
        if !is_new {
            // First, so that an older program does not open an earlier backup with what it does not understand.
            manifest::write(target, &manifest())?;
        }
        let mut copies = Copies { disk: &*inner.disk, goes_on, report: BackupReport::default() };
        for (map, entry) in inner.entries() {
            inner.backup_map(&mut copies, target, map, &entry)?;
            copies.report.maps += 1;
        }
        for name in [MAPS_FILE, LOSSES_FILE] {
            let file = inner.directory.join(name);
            match read_all(&*inner.disk, &file) {
                // A store without losses has no such file.
                Err(error) if error.kind() == io::ErrorKind::NotFound && name == LOSSES_FILE => {}
                list => {
                    let list = list.map_err(io_error(&file))?;
                    put(&target.join(name), |to| to.write_all(&list))?;
                }
            }
        }
        let maps = folders::maps_folder(target);
        fs::create_dir_all(&maps).map_err(io_error(&maps))?;
        sync_folder(&maps)?;
        sync_folder(target)?;
        // Written last into a new folder, so that an unfinished backup is none.
        if is_new {
            manifest::write(target, &manifest())?;
        }
        // Maps that were deleted since the earlier backup.
        let kept: Vec<MapId> = inner.known();
        for name in names(&maps)? {
            let number = name.parse().ok().map(MapId);
            if number.is_none_or(|number| !kept.contains(&number)) {
                fs::remove_dir_all(maps.join(&name)).map_err(io_error(&maps))?;
            }
        }
        Ok(copies.report)
    }
}

/// Gives a new folder the files of a complete backup, without copying them: both folders name the same files (hard
/// links). A backup replaces files and never writes into one, so that bringing the new folder up to date leaves the
/// other as it is. Where the disk has no hard links the new folder stays empty, and the next backup copies everything.
///
/// # Errors
/// The backup cannot be read, or the folder cannot be made.
pub fn link_backup(backup: &Path, target: &Path) -> Result<(), BackupError> {
    fs::create_dir_all(target).map_err(io_error(target))?;
    for name in names(backup)? {
        let (from, to) = (backup.join(&name), target.join(&name));
        if from.is_dir() {
            link_backup(&from, &to)?;
        } else if name != "LOCK" && !name.ends_with(".part") {
            // A file that cannot be linked is copied by the backup itself.
            let _ = fs::hard_link(&from, &to);
        }
    }
    Ok(())
}

/// Whether a folder holds a complete backup of a store, in the present disk format.
#[must_use]
pub fn is_backup_of(folder: &Path, store_id: &str) -> bool {
    let found = manifest::read(folder, FORMAT).ok().flatten();
    found.is_some_and(|found| found.store_id == store_id && found.format == FORMAT)
}

/// Checks the folder of a backup; whether it is empty.
fn prepare(directory: &Path, target: &Path, store_id: &str) -> Result<bool, BackupError> {
    fs::create_dir_all(target).map_err(io_error(target))?;
    let (source, inside) = (directory.canonicalize(), target.canonicalize());
    let (source, inside) = (source.map_err(io_error(directory))?, inside.map_err(io_error(target))?);
    if inside.starts_with(&source) || source.starts_with(&inside) {
        return Err(BackupError::Inside(target.to_owned()));
    }
    let found = manifest::read(target, FORMAT)?;
    match found {
        Some(found) if found.store_id == store_id => Ok(false),
        Some(_) => Err(BackupError::OtherStore(target.to_owned())),
        // A first backup that was cut off has maps and no manifest.
        None if names(target)?
            .iter()
            .all(|name| name == "maps" || name.starts_with(MAPS_FILE) || name.starts_with(LOSSES_FILE)) =>
        {
            Ok(true)
        }
        None => Err(BackupError::NotEmpty(target.to_owned())),
    }
}

impl OpenStore {
    fn backup_map(
        &self,
        copies: &mut Copies<'_>,
        target: &Path,
        map: MapId,
        entry: &MapEntry,
    ) -> Result<(), BackupError> {
        // Nothing is saved or deleted meanwhile, so that checkpoints, history and segments fit together.
        let _busy = entry.busy.lock().unwrap_or_else(PoisonError::into_inner);
        let (from, to) = (folders::map_folder(&self.directory, map), folders::map_folder(target, map));
        let erasures = erasure::count(&*self.disk, &from).map_err(io_error(&from))?;
        if names(&to)?.iter().any(|name| name == "MAP") && erasure::count(&RealDisk, &to).ok() != Some(erasures) {
            // The files of the earlier backup have the names of other files now, and hold erased data.
            fs::remove_dir_all(&to).map_err(io_error(&to))?;
        }
        let folders = [folders::log_folder, folders::history_folder, folders::checkpoints_folder];
        let [log, history, checkpoints] = folders.map(|folder| (folder(&self.directory, map), folder(target, map)));
        fs::create_dir_all(&checkpoints.1).map_err(io_error(&checkpoints.1))?;
        self.backup_log(copies, entry, &log.0, &log.1)?;
        copies.copy_folder(&history.0, &history.1, |name| name.ends_with(".tmh"))?;
        let erasures = Some(ERASURES_FILE).filter(|_| erasures > 0);
        for name in [HISTORY_FILE, "MAP"].into_iter().chain(erasures) {
            let length = self.disk.length(&from.join(name)).map_err(io_error(&from))?;
            copies.copy(&from.join(name), &to.join(name), length)?;
        }
        copies.copy_folder(&checkpoints.0, &checkpoints.1, |name| name.ends_with(".tmc"))?;
        // Behind what it lists, and before what it no longer lists goes.
        let list = [&from, &to].map(|folder| folder.join(CHECKPOINTS_FILE));
        let length = self.disk.length(&list[0]).map_err(io_error(&from))?;
        copies.copy(&list[0], &list[1], length)?;
        sync_folder(&to)?;
        for (from, to) in [&log, &history, &checkpoints] {
            remove_old(&*self.disk, from, to)?;
        }
        Ok(())
    }

    /// Copies the log up to what is durable now.
    fn backup_log(&self, copies: &mut Copies<'_>, entry: &MapEntry, from: &Path, to: &Path) -> Result<(), BackupError> {
        let durable = entry.log.as_ref().and_then(|log| {
            let writer = log.writer.lock().unwrap_or_else(PoisonError::into_inner);
            writer.as_ref().map(|writer| (writer.segment(), writer.durable_bytes()))
        });
        fs::create_dir_all(to).map_err(io_error(to))?;
        let names = self.disk.list(from).map_err(io_error(from))?;
        let mut newest = 1;
        for first in names.iter().filter_map(|name| segment_position(name)) {
            let path = segment_path(from, first);
            let length = match durable {
                // The segment was created after `durable` was read from the writer.
                Some((last, _)) if first > last => continue,
                Some((last, bytes)) if first == last => bytes,
                _ => self.disk.length(&path).map_err(io_error(&path))?,
            };
            copies.copy(&path, &segment_path(to, first), length)?;
            newest = newest.max(first);
        }
        let list = NewestSegment { first_position: newest }.to_text();
        put(&to.join(NEWEST_FILE), |file| file.write_all(list.as_bytes()))?;
        sync_folder(to)
    }
}

/// Copies a backup to an empty folder, which is a data directory of its own afterwards: it gets another identity, so
/// that producers send again what the backup does not have.
///
/// # Errors
/// [`BackupError`]; a damaged backup is not restored.
pub fn restore(backup: &Path, directory: &Path, new_store_id: &str) -> Result<BackupReport, BackupError> {
    if !names(directory)?.is_empty() {
        return Err(BackupError::NotEmpty(directory.to_owned()));
    }
    let format = refuse_damage(backup)?;
    let disk = RealDisk;
    let mut copies = Copies { disk: &disk, goes_on: &|| true, report: BackupReport::default() };
    let maps = folders::maps_folder(directory);
    fs::create_dir_all(&maps).map_err(io_error(&maps))?;
    for name in names(&folders::maps_folder(backup))? {
        let (from, to) = (folders::maps_folder(backup).join(&name), maps.join(&name));
        for folder in ["log", "history", "checkpoints"] {
            copies.copy_folder(&from.join(folder), &to.join(folder), |_| true)?;
        }
        let lists = [HISTORY_FILE, CHECKPOINTS_FILE, ERASURES_FILE, "MAP"];
        copies.copy_folder(&from, &to, |name| lists.contains(&name))?;
        copies.report.maps += 1;
    }
    copies.copy_folder(backup, directory, |name| name == MAPS_FILE || name == LOSSES_FILE)?;
    sync_folder(&maps)?;
    // A backup of an older format stays one: the next start migrates it.
    manifest::write(directory, &Manifest { format, store_id: new_store_id.to_owned() })?;
    refuse_damage(directory)?;
    Ok(copies.report)
}

/// The format of a folder that is sound, apart from what can be made again.
fn refuse_damage(directory: &Path) -> Result<u32, BackupError> {
    let checked = check(directory, Mode::Look)?;
    match checked.findings.into_iter().find(|finding| !finding.is_spare) {
        Some(finding) => Err(BackupError::Damaged { file: finding.file, problem: finding.problem }),
        None => Ok(checked.format),
    }
}
