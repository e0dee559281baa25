//! Checking a data directory that no daemon uses: every record of every log, checkpoint and history file, the lists of
//! what must exist, and the index.
//!
//! Invariant: without `repair` nothing is changed. A repair loses nothing: it only makes lists again and sets a damaged
//! index aside, which is rebuilt from the checkpoints.

use std::{
    path::{Path, PathBuf},
    sync::Arc,
};

use tidemap_map::spec::MapSpec;
use tidemap_migrations::{
    FORMAT, manifest,
    v3::lists::{FileList, HISTORY_FILE, MAPS_FILE, MapList},
};

use crate::{
    MapId,
    checkpoint::{Checkpoints, Memory},
    disk::{Disk, RealDisk},
    error::{OpenError, Report},
    index::{Index, is_present},
    list_file::{self, Unlisted},
    log::{recovery, replay::Replay, segment_position},
    record_file::check_total,
    store::{catalogue, lock::Lock},
};

const INDEX_CACHE_BYTES: u64 = 64 << 20;
/// What is loaded of a checkpoint to check it.
const MEMORY: Memory = Memory { tile_bytes: 64 << 20, spectrum_bytes: 64 << 20 };

const FROM_BACKUP: &str = "restore this file from a backup";
const FOLDER_FROM_BACKUP: &str = "restore the folder of this map from a backup, or delete the map";
const BY_REPAIR: &str = "run the check with --repair, which loses nothing";

/// Something that is wrong with a data directory.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct Finding {
    /// The file or folder, within the data directory.
    pub file: PathBuf,
    /// What is wrong with it.
    pub problem: String,
    /// What to do.
    pub advice: &'static str,
    /// Whether it has been repaired.
    pub is_repaired: bool,
}

/// What a check has read and found.
#[derive(Clone, Debug, Default, PartialEq, Eq)]
pub struct Checked {
    /// Number of maps.
    pub maps: u64,
    /// Number of files read.
    pub files: u64,
    /// Number of records of logs.
    pub log_records: u64,
    /// What is wrong.
    pub findings: Vec<Finding>,
}

/// A check that is under way.
struct Check<'a> {
    directory: &'a Path,
    disk: Arc<dyn Disk>,
    repair: bool,
    checked: Checked,
}

/// Checks a data directory that no daemon uses.
///
/// # Errors
/// [`OpenError`] where nothing can be checked: there is no data directory, a daemon uses it, or a newer version wrote
/// it.
pub fn check(directory: &Path, repair: bool) -> Result<Checked, OpenError> {
    if manifest::read(directory, FORMAT)?.is_none() {
        let reason = "there is none: this is no data directory of tidemapd".to_owned();
        return Err(OpenError::Damaged { file: directory.join(manifest::FILE_NAME), reason });
    }
    let _lock = Lock::take(directory)?;
    let mut check = Check { directory, disk: Arc::new(RealDisk), repair, checked: Checked::default() };
    let maps = check.maps()?;
    for (map, spec) in &maps {
        check.map(*map, spec);
    }
    check.index(&maps);
    Ok(check.checked)
}

impl Check<'_> {
    fn find(&mut self, file: &Path, problem: impl Into<String>, advice: &'static str) {
        let file = file.strip_prefix(self.directory).unwrap_or(file).to_owned();
        self.checked.findings.push(Finding { file, problem: problem.into(), advice, is_repaired: false });
    }

    /// The last finding has been repaired.
    fn repaired(&mut self) {
        if let Some(finding) = self.checked.findings.last_mut() {
            finding.is_repaired = true;
        }
    }

    /// The maps that can be read; finds what is wrong with the others.
    fn maps(&mut self) -> Result<Vec<(MapId, MapSpec)>, OpenError> {
        let found = catalogue::look(&*self.disk, self.directory)?;
        let file = self.directory.join(MAPS_FILE);
        let problem = match list_file::read::<MapList>(&*self.disk, &file) {
            Ok(_) => None,
            Err(Unlisted::Absent) => Some("it is missing".to_owned()),
            Err(Unlisted::Damaged(reason)) => Some(reason.to_owned()),
            Err(Unlisted::Io(error)) => Some(error.to_string()),
        };
        if let Some(problem) = problem {
            self.find(&file, problem, BY_REPAIR);
            if self.repair && list_file::replace(&*self.disk, &file, &found.list()).is_ok() {
                self.repaired();
            }
        }
        for map in found.set_aside.values() {
            let name = map.name.as_deref().unwrap_or("its name is not known");
            let folder = catalogue::map_folder(self.directory, map.id);
            self.find(&folder, format!("map {name}: {}", map.reason), FOLDER_FROM_BACKUP);
        }
        self.checked.maps = (found.maps.len() + found.set_aside.len()) as u64;
        Ok(found.maps.into_iter().map(|(map, known)| (map, known.spec)).collect())
    }

    fn map(&mut self, map: MapId, spec: &MapSpec) {
        self.history(map);
        let known = self.checkpoints(map, spec);
        self.log(map, known);
    }

    fn history(&mut self, map: MapId) {
        let folder = catalogue::history_folder(self.directory, map);
        let list_path = folder.with_file_name(HISTORY_FILE);
        let listed = match list_file::read::<FileList>(&*self.disk, &list_path) {
            Ok(list) => list.files,
            Err(unlisted) => {
                let problem = match unlisted {
                    Unlisted::Absent => "it is missing".to_owned(),
                    Unlisted::Damaged(reason) => reason.to_owned(),
                    Unlisted::Io(error) => error.to_string(),
                };
                self.find(&list_path, problem, BY_REPAIR);
                let history = crate::History::at(Arc::clone(&self.disk), folder.clone(), map);
                if self.repair && history.make_list(&mut Vec::new()).is_ok() {
                    self.repaired();
                }
                Vec::new()
            }
        };
        let present = self.disk.list(&folder).unwrap_or_default();
        for file in &listed {
            let path = folder.join(&file.name);
            if !present.contains(&file.name) {
                let (from, to) = (file.from_nanos.div_euclid(1_000_000_000), file.to_nanos.div_euclid(1_000_000_000));
                let problem = format!("it is missing, with observations from {from} to {to} s after 1970-01-01");
                self.find(&path, problem, FROM_BACKUP);
            } else {
                self.checked.files += 1;
                match check_total(&*self.disk, &path) {
                    Ok(total) if total == (file.length, file.total_crc) => {}
                    Ok(_) => self.find(&path, "it is another file than the list says", FROM_BACKUP),
                    Err(problem) => self.find(&path, problem, FROM_BACKUP),
                }
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

    /// Reads all checkpoints; gives the position and the first needed record of the newest good one.
    fn checkpoints(&mut self, map: MapId, spec: &MapSpec) -> Option<(u64, u64)> {
        let disk = Arc::clone(&self.disk);
        let folder = catalogue::checkpoints_folder(self.directory, map);
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
        newest
    }

    fn log(&mut self, map: MapId, known: Option<(u64, u64)>) {
        let folder = catalogue::log_folder(self.directory, map);
        let (position, replay_from) = known.unwrap_or((0, 1));
        // Also the segments that only older checkpoints need.
        let names = self.disk.list(&folder).unwrap_or_default();
        let first = names.iter().find_map(|name| segment_position(name)).unwrap_or(1);
        let replay_from = replay_from.min(first.max(1));
        let expected = recovery::Expectation { map: map.0, replay_from, known: position };
        let mut reports = Vec::new();
        let read = match recovery::read(&*self.disk, &folder, &expected, &mut reports) {
            Ok(read) => read,
            Err(error) => return self.find(&folder, error.to_string(), FOLDER_FROM_BACKUP),
        };
        for report in reports {
            if let Report::ListMade { file, reason } = report {
                self.find(&file, reason, "start the daemon, which makes it again");
            }
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

    fn index(&mut self, maps: &[(MapId, MapSpec)]) {
        let folder = self.directory.join("index");
        if !is_present(&folder) {
            // It may be lost at any time.
            return;
        }
        let damage = match Index::inspect(folder.clone(), INDEX_CACHE_BYTES) {
            Ok(mut index) => maps.iter().find_map(|(map, _)| index.check(map.0).err()),
            Err(reason) => Some(reason),
        };
        if let Some(damage) = damage {
            self.find(&folder, damage, BY_REPAIR);
            let aside = self.directory.join("index.damaged");
            if self.repair && !is_present(&aside) && self.disk.rename(&folder, &aside).is_ok() {
                self.repaired();
            }
        }
    }
}
