//! Reading the files of a store in use again, at a bounded rate, so that damage is found before a file is needed.
//!
//! Invariant: nothing is changed. A file that is deleted on purpose meanwhile is no damage, and neither is a read that
//! fails because the machine lacks descriptors or memory. Damage that is reported was read twice.

use std::{
    collections::BTreeSet,
    io::{self, BufReader, Read as _},
    path::{Path, PathBuf},
};

use tidemap_layout::{
    lists::{MAPS_FILE, MapList, NEWEST_FILE, NewestSegment},
    log::{FRAME_HEADER_LENGTH, FrameHeader, SEGMENT_HEADER_LENGTH, SegmentHeader},
};

use crate::{
    MapId, Store,
    error::{HistoryError, is_shortage},
    folders,
    list_file::{self, Unlisted},
    log::{segment_path, segment_position},
    record_file::check_total_paced,
    store::{MapEntry, OpenStore},
};

/// Bytes that are read between two calls of the pace.
const STEP_BYTES: usize = 256 << 10;

/// Gets the bytes that are read next, and waits; `false`: the round ends.
pub type Pace<'a> = &'a mut dyn FnMut(u64) -> bool;

/// A round that was ended before it was done.
struct Ended;

/// One round through the store.
struct Round<'a> {
    store: &'a OpenStore,
    pace: Pace<'a>,
    damaged: BTreeSet<PathBuf>,
    has_ended: bool,
}

impl Store {
    /// Reads the logs, checkpoints and history files of all maps and the index. [`Store::trouble`] reports damaged and
    /// missing files as soon as they are found, until a later round finds them sound. Returns the number of files that
    /// are damaged; `None` if the round was ended.
    pub fn scrub(&self, pace: Pace<'_>) -> Option<usize> {
        let mut round = Round { store: self.inner(), pace, damaged: BTreeSet::new(), has_ended: false };
        round.run().ok()?;
        let watch = &self.inner().committer.watch;
        watch.keep_damaged(&round.damaged);
        Some(round.damaged.len())
    }
}

impl Round<'_> {
    fn run(&mut self) -> Result<(), Ended> {
        let list = self.store.directory.join(MAPS_FILE);
        self.check_file(&list, |round| {
            let read = list_file::read::<MapList>(&*round.store.disk, &list);
            read.map(drop).map_err(Unlisted::problem)
        })?;
        for (map, entry) in self.store.entries() {
            self.history(map)?;
            self.checkpoints(map)?;
            self.log(map, &entry)?;
            self.index(map)?;
        }
        Ok(())
    }

    /// Checks a file with `check`, again if that fails, and records the result. A file that cannot be opened for want
    /// of descriptors or memory is left for the next round.
    fn check_file(&mut self, file: &Path, check: impl Fn(&mut Self) -> Result<(), String>) -> Result<(), Ended> {
        let opened = self.store.disk.read(file).map(drop);
        if opened.as_ref().is_err_and(is_shortage) {
            return Ok(());
        }
        let is_missing = opened.is_err_and(|error| error.kind() == io::ErrorKind::NotFound);
        let checked = if is_missing { Err("it is missing".to_owned()) } else { check(self).or_else(|_| check(self)) };
        if self.has_ended {
            return Err(Ended);
        }
        self.report(file, checked.err());
        Ok(())
    }

    fn report(&mut self, file: &Path, problem: Option<String>) {
        let file = file.strip_prefix(&self.store.directory).unwrap_or(file).to_owned();
        if problem.is_some() {
            self.damaged.insert(file.clone());
        }
        self.store.committer.watch.damaged(file, problem);
    }

    /// Waits for its turn to read.
    fn pace(&mut self, bytes: u64) -> bool {
        self.has_ended |= !(self.pace)(bytes);
        !self.has_ended
    }

    /// Checks a file of records; gives its length and checksum.
    fn total(&mut self, file: &Path) -> Result<(u64, u32), String> {
        let disk = &*self.store.disk;
        Ok(check_total_paced(disk, file, &mut |bytes| self.pace(bytes))?)
    }

    fn history(&mut self, map: MapId) -> Result<(), Ended> {
        let history = self.store.history(map);
        let listed = match history.listed() {
            Ok(list) => list.files,
            Err(HistoryError::Io { source, .. }) if is_shortage(&source) => return Ok(()),
            // The map was deleted.
            Err(_) if !self.is_there(map) => return Ok(()),
            Err(error) => {
                self.report(&history.list_path(), Some(error.to_string()));
                return Ok(());
            }
        };
        self.report(&history.list_path(), None);
        for listed in listed {
            let file = history.folder.join(&listed.name);
            // Listed no longer: it was deleted on purpose.
            let is_listed = || history.listed().is_ok_and(|list| list.files.contains(&listed)) && self.is_there(map);
            if !is_listed() {
                continue;
            }
            let known = (listed.length, listed.total_crc);
            self.check_file(&file, |round| match round.total(&file) {
                Ok(total) if total == known => Ok(()),
                Ok(_) => Err("it is not the file that the list names".to_owned()),
                Err(problem) => Err(problem),
            })?;
            self.forget_unless(&file, history.listed().is_ok_and(|list| list.files.contains(&listed)));
        }
        Ok(())
    }

    fn checkpoints(&mut self, map: MapId) -> Result<(), Ended> {
        let folder = folders::checkpoints_folder(&self.store.directory, map);
        let list = self.store.checkpoints(map).list_path();
        self.check_file(&list, |round| {
            let listed = round.store.checkpoints(map).listed();
            listed.map(drop).map_err(Unlisted::problem)
        })?;
        let is_there = self.is_there(map);
        self.forget_unless(&list, is_there);
        let mut positions = self.store.checkpoints(map).positions().unwrap_or_default();
        let listed = self.store.checkpoints(map).listed().map(|list| list.checkpoints).unwrap_or_default();
        positions.extend(listed);
        positions.sort_unstable();
        positions.dedup();
        for position in positions {
            let file = self.store.checkpoints(map).path(position);
            self.check_file(&file, |round| round.total(&file).map(drop))?;
            // An older checkpoint is deleted when a newer one is written; before, it is listed no longer.
            let names = self.store.disk.list(&folder).unwrap_or_default();
            let is_there = names.iter().any(|name| file.file_name().is_some_and(|file| file == name.as_str()));
            let listed = self.store.checkpoints(map).listed();
            let is_listed = listed.is_ok_and(|list| list.checkpoints.contains(&position)) && self.is_there(map);
            self.forget_unless(&file, is_there || is_listed);
        }
        Ok(())
    }

    /// Withdraws the report of a file that was deleted on purpose while it was read.
    fn forget_unless(&mut self, file: &Path, must_exist: bool) {
        if !must_exist {
            let file = file.strip_prefix(&self.store.directory).unwrap_or(file);
            self.damaged.remove(file);
            self.store.committer.watch.damaged(file.to_owned(), None);
        }
    }

    /// Reads the records of a log that were durable when it began.
    fn log(&mut self, map: MapId, entry: &MapEntry) -> Result<(), Ended> {
        // A map that is being opened is read anyway.
        let Some(log) = &entry.log else { return Ok(()) };
        let end = log.end.load(std::sync::atomic::Ordering::Acquire);
        let folder = folders::log_folder(&self.store.directory, map);
        let segments = || -> Vec<u64> {
            let names = self.store.disk.list(&folder).unwrap_or_default();
            names.iter().filter_map(|name| segment_position(name)).collect()
        };
        self.newest_listed(map, &folder)?;
        let known = segments();
        // Read after the names: a segment is listed no longer before it is deleted.
        let begin = self.store.checkpoints(map).listed().map_or(u64::MAX, |list| list.first_record);
        if known.first().is_some_and(|&first| begin < first) {
            self.report(&segment_path(&folder, begin), Some("it is missing".to_owned()));
        }
        for (place, &first) in known.iter().enumerate() {
            let last = known.get(place + 1).map_or(end, |next| next - 1).min(end);
            let file = segment_path(&folder, first);
            self.check_file(&file, |round| round.segment(map, &file, first, last))?;
            // Segments that checkpoints cover are deleted, the oldest first.
            let now = self.store.disk.list(&folder).unwrap_or_default();
            let oldest = now.iter().find_map(|name| segment_position(name)).unwrap_or(u64::MAX);
            self.forget_unless(&file, first >= oldest && self.is_there(map));
        }
        Ok(())
    }

    /// Checks the list of the newest segment.
    fn newest_listed(&mut self, map: MapId, folder: &Path) -> Result<(), Ended> {
        let list = folder.join(NEWEST_FILE);
        self.check_file(&list, |round| {
            let listed = list_file::read::<NewestSegment>(&*round.store.disk, &list).map_err(Unlisted::problem)?;
            let segment = segment_path(folder, listed.first_position);
            match round.store.disk.length(&segment) {
                Err(error) if error.kind() == io::ErrorKind::NotFound => {
                    Err(format!("the segment that it names, {}, is missing", listed.first_position))
                }
                _ => Ok(()),
            }
        })?;
        let is_there = self.is_there(map);
        self.forget_unless(&list, is_there);
        Ok(())
    }

    /// Reads a segment up to the record `last`.
    fn segment(&mut self, map: MapId, file: &Path, first: u64, last: u64) -> Result<(), String> {
        let unreadable = |error: io::Error| match error.kind() {
            io::ErrorKind::UnexpectedEof => format!("it ends before record {last}"),
            _ => error.to_string(),
        };
        let reader = self.store.disk.read(file).map_err(unreadable)?;
        let mut reader = BufReader::with_capacity(STEP_BYTES, reader);
        let mut bytes = [0; SEGMENT_HEADER_LENGTH];
        reader.read_exact(&mut bytes).map_err(unreadable)?;
        let header =
            SegmentHeader::decode(&bytes).filter(|header| (header.map, header.first_position) == (map.0, first));
        let mut chain = header.ok_or("its header is not valid")?.chain;
        let (mut body, mut waiting) = (Vec::new(), 0);
        for position in first..=last {
            let mut bytes = [0; FRAME_HEADER_LENGTH];
            reader.read_exact(&mut bytes).map_err(unreadable)?;
            let header =
                FrameHeader::decode(&bytes).filter(|header| (header.position, header.chain) == (position, chain));
            let header = header.ok_or_else(|| format!("the header of record {position} is not valid"))?;
            body.resize(header.frame_length().saturating_sub(FRAME_HEADER_LENGTH), 0);
            reader.read_exact(&mut body).map_err(unreadable)?;
            if crc32c::crc32c(&body) != header.body_crc {
                return Err(format!("the checksum of record {position} does not match"));
            }
            chain = header.next_chain();
            waiting += header.frame_length();
            if waiting >= STEP_BYTES {
                if !self.pace(waiting as u64) {
                    return Ok(());
                }
                waiting = 0;
            }
        }
        self.pace(waiting as u64);
        Ok(())
    }

    /// Reads the rows of a map in the index. Pages that sled keeps in memory are not read from the disk.
    fn index(&mut self, map: MapId) -> Result<(), Ended> {
        let (_, bytes) = self.store.index().size_of(map.0);
        if !self.pace(bytes) {
            return Err(Ended);
        }
        let checked = self.store.index().check(map.0);
        let problem = checked.err().map(|failure| format!("the rows of map number {}: {failure}", map.0));
        self.report(&PathBuf::from(format!("index/{}", map.0)), problem);
        Ok(())
    }

    fn is_there(&self, map: MapId) -> bool {
        self.store.known().contains(&map)
    }
}
