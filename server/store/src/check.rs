//! Checking a data directory that no daemon uses: every record of every log, checkpoint and history file, the lists of
//! what must exist, and the index.
//!
//! Invariant: a map without a finding is one that a start opens: both read it with the same code. A check in the mode
//! `Look` changes nothing. A repair loses nothing: it only makes lists again where other files prove that all is there,
//! and sets a damaged index aside, which is rebuilt from the checkpoints. Going on without the lost data is recorded in
//! `LOSSES` first.

use std::{
    collections::{BTreeMap, BTreeSet},
    io,
    path::{Path, PathBuf},
    sync::Arc,
};

use tidemap_layout::{
    cluster::FORKS_FOLDER,
    lists::{
        CheckpointList, ERASURES_FILE, FileList, HISTORY_FILE, Loss, MAPS_FILE, MapList, NEWEST_FILE, NewestSegment,
        TextList,
    },
};
use tidemap_map::{snapshot::MapSnapshot, spec::MapSpec};
use tidemap_migrations::{FORMAT, manifest};

use crate::{
    History, MapId,
    checkpoint::{Checkpoints, Memory},
    disk::{Disk, RealDisk},
    erasure,
    error::{OpenError, zeroed_tail},
    failure::ReadFailure,
    folders,
    fork::{fork_in, fork_names},
    index::{Index, RowsState, Unopened, is_present},
    list_file,
    lock::Lock,
    log::{recovery, replay::Replay, segment_path, segment_position},
    losses,
    record_file::check_total,
    store::{catalogue, lists, open_map::read_map},
};

const INDEX_CACHE_BYTES: u64 = 64 << 20;
/// The memory for the part of a checkpoint that is loaded to check it.
const MEMORY: Memory = Memory { tile_bytes: 64 << 20, spectrum_bytes: 64 << 20 };

const FROM_BACKUP: &str = "restore this file from a backup";
const FOLDER_FROM_BACKUP: &str = "restore the folder of this map from a backup, or delete the map";
const ONE_OF_TWO: &str = "move the folder of one of the two maps out of the data folder";
const BY_CUT: &str =
    "restore the folder of this map from a backup that has more; or start the daemon, which cuts them off";
const BY_REPAIR: &str = "run the check with --repair, which loses nothing";
const BY_ACCEPTING: &str = "restore it from a backup of this folder; or, to continue without what is lost, run the \
                            check with --accept-loss, which records the loss";
const BY_DISK: &str = "it may be sound: free some space, or check the disk and the permissions; nothing is lost";
const BY_START: &str = "start the daemon, which makes it again from the checkpoints; nothing is lost";

/// The actions that a check may take.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Mode {
    /// Only read.
    Look,
    /// Repair what can be repaired without loss.
    Repair,
    /// Also go on without the lost data, as an operator has accepted.
    AcceptLoss {
        /// The present time, nanoseconds UTC.
        now_nanos: i64,
    },
}

/// The outcome of a finding.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Outcome {
    /// Nothing was done.
    Open,
    /// The damage has been repaired, without loss.
    Repaired,
    /// The data is lost. The loss is recorded, and the daemon goes on without.
    Accepted,
}

/// Something that is wrong with a data directory.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct Finding {
    /// The file or folder, within the data directory.
    pub file: PathBuf,
    /// Description of the damage.
    pub problem: String,
    /// Advice what to do.
    pub advice: &'static str,
    /// Whether the damage loses nothing, because other files hold the same data.
    pub is_spare: bool,
    /// The outcome of the finding.
    pub outcome: Outcome,
}

/// The files that a check has read, and its findings.
#[derive(Clone, Debug, Default, PartialEq, Eq)]
pub struct Checked {
    /// The disk format of the directory.
    pub format: u32,
    /// The disk format of this version, to which the next start migrates an older one.
    pub newest_format: u32,
    /// The identity of the store.
    pub store_id: String,
    /// Number of maps.
    pub maps: u64,
    /// Number of files read.
    pub files: u64,
    /// Number of records of logs.
    pub log_records: u64,
    /// The findings.
    pub findings: Vec<Finding>,
    /// The losses that were accepted, earlier or now.
    pub losses: Vec<Loss>,
}

/// Makes a map of its newest snapshot and the events behind it, as a start does, or returns why that fails.
pub type TryRestore<'a> = dyn Fn(&MapSpec, Option<MapSnapshot>, Replay) -> Result<(), String> + 'a;

/// A check that is under way.
struct Check<'a> {
    directory: &'a Path,
    disk: Arc<dyn Disk>,
    mode: Mode,
    restore: &'a TryRestore<'a>,
    checked: Checked,
}

/// The rows of the maps in the index; empty where there is no index, or it cannot be opened.
type IndexedMaps = BTreeMap<MapId, Result<RowsState, ReadFailure>>;

/// Checks the files of a data directory that no daemon uses.
///
/// # Errors
/// [`OpenError`] where nothing can be checked: there is no data directory, a daemon uses it, a newer version wrote it,
/// or the record of its losses is damaged.
pub fn check(directory: &Path, mode: Mode) -> Result<Checked, OpenError> {
    check_with(directory, mode, &|_, _, _| Ok(()))
}

/// Does what [`check`] does, and tries to restore each map that is whole.
///
/// # Errors
/// The errors of [`check`].
pub fn check_with(directory: &Path, mode: Mode, restore: &TryRestore<'_>) -> Result<Checked, OpenError> {
    let Some(manifest) = manifest::read(directory, FORMAT)? else {
        let reason = "there is none: this is no data directory of tidemapd".to_owned();
        return Err(OpenError::Damaged { file: directory.join(manifest::FILE_NAME), reason });
    };
    let lock = Lock::take_to_read(directory)?;
    let checked =
        Checked { format: manifest.format, newest_format: FORMAT, store_id: manifest.store_id, ..Checked::default() };
    let mut check = Check { directory, disk: Arc::new(RealDisk), mode, restore, checked };
    // First: without it, no loss can be recorded.
    losses::read(&RealDisk, directory)?;
    let maps = check.maps()?;
    let (rows, index_failure) = check.read_index(&maps)?;
    let mut indexed = BTreeSet::new();
    for (map, known) in &maps {
        let before = check.checked.findings.len();
        if check.map(*map, known) {
            indexed.insert(*map);
        }
        check.try_open(*map, known, rows.get(map).cloned(), before);
    }
    // A backup has no index; nor has a folder that was restored from one, until a daemon has used it.
    check.index(&rows, index_failure, &indexed, lock.is_of_daemon());
    check.checked.losses = losses::read(&RealDisk, directory)?;
    Ok(check.checked)
}

impl Check<'_> {
    fn within(&self, file: &Path) -> PathBuf {
        file.strip_prefix(self.directory).unwrap_or(file).to_owned()
    }

    fn find(&mut self, file: &Path, problem: impl Into<String>, advice: &'static str) {
        let (file, problem, outcome) = (self.within(file), problem.into(), Outcome::Open);
        self.checked.findings.push(Finding { file, problem, advice, is_spare: false, outcome });
    }

    /// Something that other files hold as well, with what makes it good.
    fn find_spare(
        &mut self,
        file: &Path,
        problem: impl Into<String>,
        advice: &'static str,
        repair: impl FnOnce() -> bool,
    ) {
        self.find(file, problem, advice);
        let is_repaired = self.mode != Mode::Look && repair();
        if let Some(finding) = self.checked.findings.last_mut() {
            finding.is_spare = true;
            finding.outcome = if is_repaired { Outcome::Repaired } else { Outcome::Open };
        }
    }

    /// Something that is lost, with how to go on without.
    fn find_lost(&mut self, file: &Path, problem: &str, go_on: impl FnOnce() -> bool) {
        self.find(file, problem, BY_ACCEPTING);
        let Mode::AcceptLoss { now_nanos } = self.mode else { return };
        let file = self.within(file).display().to_string();
        let loss = Loss { accepted_nanos: now_nanos, file, problem: problem.replace('\n', " ") };
        if losses::record(&*self.disk, self.directory, loss).is_ok()
            && go_on()
            && let Some(finding) = self.checked.findings.last_mut()
        {
            finding.outcome = Outcome::Accepted;
        }
    }

    /// A list of what must exist, or what is wrong with it where it is lost.
    fn list<L: TextList>(&self, file: &Path) -> Result<L, String> {
        list_file::read(&*self.disk, file).map_err(|unlisted| unlisted.problem())
    }

    /// The maps that can be read; finds what is wrong with the others.
    fn maps(&mut self) -> Result<Vec<(MapId, MapSpec)>, OpenError> {
        let found = catalogue::read_only(&*self.disk, self.directory)?;
        let (disk, directory) = (Arc::clone(&self.disk), self.directory);
        let file = directory.join(MAPS_FILE);
        if let Err(problem) = self.list::<MapList>(&file) {
            self.find_lost(&file, &problem, || list_file::replace(&*disk, &file, &found.list()).is_ok());
        }
        for map in found.set_aside.values() {
            let name = map.name.as_deref().unwrap_or("its name is not known");
            let folder = folders::map_folder(directory, map.id);
            let problem = format!("map {name}: {}", map.reason);
            if self.disk.list(&folder).is_err_and(|error| error.kind() == io::ErrorKind::NotFound) {
                let forget = || {
                    let forget = |list: &mut MapList| list.maps.retain(|(number, _)| *number != map.id.0);
                    catalogue::change_list(&*disk, directory, forget).is_ok()
                };
                // The name of the map may be that of a person, and is not recorded.
                self.find_lost(&folder, "the folder of this map is missing", forget);
                if let Some(finding) = self.checked.findings.last_mut() {
                    finding.problem = problem;
                }
            } else {
                self.find(&folder, problem, FOLDER_FROM_BACKUP);
            }
        }
        self.checked.maps = (found.maps.len() + found.set_aside.len()) as u64;
        let mut names = BTreeMap::new();
        for (map, spec) in &found.maps {
            if let Some(first) = names.insert(spec.name.clone(), map.0) {
                let problem = format!("it has the same name as map number {first}");
                self.find(&folders::map_folder(directory, *map), problem, ONE_OF_TWO);
            }
        }
        Ok(found.maps.into_iter().collect())
    }

    /// Checks a map; returns whether the index should have rows of it.
    fn map(&mut self, map: MapId, spec: &MapSpec) -> bool {
        self.history(map, spec);
        let newest = self.checkpoints(map, spec);
        self.log(map, newest);
        self.forks(map);
        self.erasures(map);
        newest.is_some()
    }

    /// Checks the forks, which were set aside where the logs of two daemons parted.
    fn forks(&mut self, map: MapId) {
        let folder = folders::map_folder(self.directory, map).join(FORKS_FOLDER);
        let names = match fork_names(&*self.disk, &folder) {
            Ok(names) => names,
            Err(error) => return self.find(&folder, error.to_string(), BY_DISK),
        };
        for name in names {
            self.checked.files += 1;
            let file = folder.join(&name);
            if let Err(error) = fork_in(&*self.disk, &folder, name) {
                let problem = match error {
                    OpenError::Damaged { reason, .. } => reason,
                    other => other.to_string(),
                };
                self.find(&file, problem, FROM_BACKUP);
            }
        }
    }

    /// Checks the number of erasures, which backups and the next erasure read.
    fn erasures(&mut self, map: MapId) {
        let folder = folders::map_folder(self.directory, map);
        if let Err(error) = erasure::count(&*self.disk, &folder) {
            self.find(&folder.join(ERASURES_FILE), error.to_string(), FROM_BACKUP);
        }
    }

    fn history(&mut self, map: MapId, spec: &MapSpec) {
        let folder = folders::history_folder(self.directory, map);
        let history = History::at(Arc::clone(&self.disk), folder.clone(), map);
        let list_path = folder.with_file_name(HISTORY_FILE);
        let listed = self.list::<FileList>(&list_path);
        if let Err(problem) = &listed {
            let make = || history.make_list().is_ok();
            if lists::is_history_whole(&self.disk, self.directory, map, spec) {
                self.find_spare(&list_path, problem, BY_REPAIR, make);
            } else {
                self.find_lost(&list_path, problem, make);
            }
        }
        let listed = listed.unwrap_or_default().files;
        let present = self.disk.list(&folder).unwrap_or_default();
        for file in &listed {
            let path = folder.join(&file.name);
            if !present.contains(&file.name) {
                let (from, to) = (file.from_nanos.div_euclid(1_000_000_000), file.to_nanos.div_euclid(1_000_000_000));
                let problem = format!("it is missing, with observations from {from} to {to} s after 1970-01-01");
                self.find_lost(&path, &problem, || history.remove_from_list(std::slice::from_ref(&path)).is_ok());
            } else {
                self.checked.files += 1;
                let problem = match check_total(&*self.disk, &path) {
                    Ok(total) if total == (file.length, file.total_crc) => continue,
                    Ok(_) => "it is not the file that the list names".to_owned(),
                    Err(problem) => problem.into(),
                };
                let disk = Arc::clone(&self.disk);
                self.find_lost(&path, &problem, || {
                    history.remove_from_list(std::slice::from_ref(&path)).is_ok() && disk.remove(&path).is_ok()
                });
            }
        }
        // A save that was cut off may have left a file that is not listed yet.
        for name in present.iter().filter(|name| name.ends_with(".tmh")) {
            if listed.iter().all(|file| file.name != *name) {
                self.checked.files += 1;
                if let Err(problem) = check_total(&*self.disk, &folder.join(name)) {
                    self.find(&folder.join(name), problem, FROM_BACKUP);
                }
            }
        }
    }

    /// Reads all checkpoints; gives the position, the first needed record and the generation of the newest good one.
    fn checkpoints(&mut self, map: MapId, spec: &MapSpec) -> Option<(u64, u64)> {
        let (disk, directory) = (Arc::clone(&self.disk), self.directory);
        let folder = folders::checkpoints_folder(directory, map);
        let checkpoints = Checkpoints { disk: &*disk, folder: folder.clone(), map };
        let mut newest = None;
        match checkpoints.check_all(spec, MEMORY) {
            Err(error) => self.find(&folder, error.to_string(), FOLDER_FROM_BACKUP),
            Ok(all) => {
                self.checked.files += all.len() as u64;
                for (path, read) in all {
                    match read {
                        Ok(found) => newest = Some(found).max(newest),
                        Err(problem) => {
                            let advice = "start the daemon: it sets the file aside, and uses an older one or the log";
                            self.find(&path, problem, advice);
                        }
                    }
                }
            }
        }
        let log = folders::log_folder(directory, map);
        let Ok(present) = checkpoints.present(&log) else { return newest };
        // If the map can be restored, no other listed file holds more.
        let is_whole = newest.map_or(1, |(_, replay_from)| replay_from) >= present.first_record;
        let make = || lists::make_checkpoints(&*disk, directory, map).is_ok();
        let list_path = checkpoints.list_path();
        let listed = match self.list::<CheckpointList>(&list_path) {
            Ok(listed) => listed,
            Err(problem) => {
                self.find_spare(&list_path, problem, BY_REPAIR, make);
                return newest;
            }
        };
        for position in listed.checkpoints {
            let path = checkpoints.path(position);
            match present.checkpoints.contains(&position) {
                true => {}
                false if is_whole => self.find_spare(&path, "it is missing", BY_REPAIR, make),
                false => self.find(&path, "it is missing", FROM_BACKUP),
            }
        }
        if listed.first_record < present.first_record {
            let path = segment_path(&log, listed.first_record);
            match is_whole {
                true => self.find_spare(&path, "it is missing", BY_REPAIR, make),
                false => self.find(&path, "it is missing", FROM_BACKUP),
            }
        }
        newest
    }

    fn log(&mut self, map: MapId, known: Option<(u64, u64)>) {
        let (disk, directory) = (Arc::clone(&self.disk), self.directory);
        let folder = folders::log_folder(directory, map);
        let (position, replay_from) = known.unwrap_or((0, 1));
        let names = self.disk.list(&folder).unwrap_or_default();
        let first = names.iter().find_map(|name| segment_position(name)).unwrap_or(1);
        // Segments that only older checkpoints need must exist, too. Without a checkpoint, the log must begin with
        // record 1.
        let replay_from = replay_from.min(first.max(1));
        let list = folder.join(NEWEST_FILE);
        let go_on = || lists::make_newest(&*disk, directory, map).is_ok();
        match self.list::<NewestSegment>(&list) {
            Err(problem) => self.find_lost(&list, &problem, go_on),
            Ok(NewestSegment { first_position }) => {
                let newest = segment_path(&folder, first_position);
                if disk.length(&newest).is_err_and(|error| error.kind() == io::ErrorKind::NotFound) {
                    self.find_lost(&newest, "it is missing, the newest segment of the log", go_on);
                    if !matches!(self.mode, Mode::AcceptLoss { .. }) {
                        return;
                    }
                }
            }
        }
        // A fault of the list has been found already.
        let is_listed = self.list::<NewestSegment>(&list).is_ok();
        let expected = recovery::Expectation { map: map.0, replay_from, known: position, is_listed };
        let read = match recovery::read(&*self.disk, &folder, &expected) {
            Ok(read) => read,
            // A damaged list, which has been found.
            Err(OpenError::ListLost { .. }) => return,
            Err(error) => return self.find(&folder, error.to_string(), FOLDER_FROM_BACKUP),
        };
        if let Some(torn) = read.torn.as_ref().filter(|torn| torn.zero_bytes > 0) {
            self.find(&torn.file, zeroed_tail(torn.zero_bytes), BY_CUT);
        }
        self.checked.files += read.segments.len() as u64;
        let end = read.cursor.position - 1;
        let first = read.segments.first().copied().unwrap_or(1);
        for event in Replay::new(Arc::clone(&self.disk), folder.clone(), read.segments, first, end) {
            match event {
                Ok(_) => self.checked.log_records += 1,
                Err(error) => return self.find(&folder, error.to_string(), FOLDER_FROM_BACKUP),
            }
        }
    }

    /// Opens a map as a start does, but for repairs, where nothing was found wrong with its files from the finding
    /// `before` on that would keep a start from it.
    fn try_open(&mut self, map: MapId, spec: &MapSpec, rows: Option<Result<RowsState, ReadFailure>>, before: usize) {
        if self.checked.findings.iter().skip(before).any(|finding| !finding.is_spare) {
            return;
        }
        let directory = self.directory;
        let folder = folders::map_folder(directory, map);
        let disk = Arc::clone(&self.disk);
        let checkpoints = Checkpoints { disk: &*disk, folder: folders::checkpoints_folder(directory, map), map };
        let rows = rows.unwrap_or(Ok(RowsState::Nothing));
        let opened = read_map(&checkpoints, spec, MEMORY, rows).and_then(|stored| {
            catalogue::read_shared(&*disk, directory, map)?;
            erasure::read_order(&*disk, directory, map)?;
            Ok(stored)
        });
        let opened = opened.map_err(|error| error.to_string()).and_then(|stored| {
            let (snapshot, segments, from, end) = stored.into_parts();
            let log = folders::log_folder(directory, map);
            (self.restore)(spec, snapshot, Replay::new(Arc::clone(&disk), log, segments, from, end))
        });
        if let Err(problem) = opened {
            let problem = format!("the daemon does not open this map: {problem}");
            self.find(&folder, problem, FOLDER_FROM_BACKUP);
        }
    }

    /// Reads the rows of the maps from the index, and the reason why it cannot be used.
    fn read_index(&mut self, maps: &[(MapId, MapSpec)]) -> Result<(IndexedMaps, Option<ReadFailure>), OpenError> {
        let folder = self.directory.join("index");
        if !is_present(&folder) {
            return Ok((IndexedMaps::new(), None));
        }
        match Index::inspect(folder, INDEX_CACHE_BYTES) {
            Ok(mut index) => Ok((maps.iter().map(|&(map, _)| (map, index.check(map.0))).collect(), None)),
            Err(Unopened::Failed(failure)) => Ok((IndexedMaps::new(), Some(failure))),
            Err(Unopened::InUse) => Err(OpenError::Locked { directory: self.directory.to_owned(), pid: None }),
        }
    }

    /// Finds what is wrong with the index, also where rows are missing that should be there.
    fn index(&mut self, rows: &IndexedMaps, failure: Option<ReadFailure>, indexed: &BTreeSet<MapId>, must_exist: bool) {
        let folder = self.directory.join("index");
        if !is_present(&folder) {
            if must_exist && !indexed.is_empty() {
                self.find_spare(&folder, "it is missing", BY_START, || false);
            }
            return;
        }
        let of_map = |(map, found): (&MapId, &Result<RowsState, ReadFailure>)| match found {
            Err(failure) => Some(failure.clone()),
            Ok(RowsState::Nothing) if indexed.contains(map) => {
                Some(ReadFailure::Damaged(format!("it has nothing of map number {}", map.0)))
            }
            // A save that was cut off is completed by the next start.
            Ok(_) => None,
        };
        match failure.or_else(|| rows.iter().find_map(of_map)) {
            None => {}
            Some(ReadFailure::Disk(reason)) => self.find_spare(&folder, reason, BY_DISK, || false),
            Some(ReadFailure::Damaged(damage)) => {
                let (disk, aside) = (Arc::clone(&self.disk), self.directory.join("index.damaged"));
                let repair = || !is_present(&aside) && disk.rename(&folder, &aside).is_ok();
                self.find_spare(&folder, damage, BY_REPAIR, repair);
            }
        }
    }
}
