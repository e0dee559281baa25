//! Opening a log after a crash or a power cut.
//!
//! Invariant: only bytes that were never acknowledged are cut off. If they may have been, the log is refused unchanged.
//! Every remaining record is made durable before it is used.

use std::path::{Path, PathBuf};

use tidemap_layout::{
    lists::{NEWEST_FILE, NewestSegment},
    log::{FRAME_HEADER_LENGTH, SEGMENT_HEADER_LENGTH, SegmentHeader},
};

use crate::{
    disk::{Disk, read_all},
    error::{OpenError, Repair, open_io},
    list_file::{self, Unlisted},
    log::{
        Progress,
        frame::{Cursor, has_unwritten_sector, is_followed, next_frame},
        segment_path, segment_position,
    },
};

/// A log that has been read to its end.
pub(crate) struct Recovered {
    /// First positions of the segments that were read, ascending; never empty.
    pub(crate) segments: Vec<u64>,
    /// Behind the last record.
    pub(crate) cursor: Cursor,
    pub(crate) progress: Progress,
    pub(crate) repairs: Vec<Repair>,
}

/// The requirements of the checkpoints and the index on a log.
pub(crate) struct Expectation {
    pub(crate) map: u32,
    /// Records before this one are not needed.
    pub(crate) replay_from: u64,
    /// The last record that a checkpoint or the index knows; the log cannot end before it.
    pub(crate) known: u64,
    /// Whether the newest segment must be listed. A check goes on without a list that it has found to be lost.
    pub(crate) is_listed: bool,
}

fn corrupt(file: &Path, offset: usize, position: u64, reason: impl Into<String>) -> OpenError {
    OpenError::CorruptLog { file: file.to_owned(), offset: offset as u64, position, reason: reason.into() }
}

/// Bytes at the end of the newest segment that are no record.
pub(crate) struct Torn {
    pub(crate) file: PathBuf,
    pub(crate) bytes: u64,
    /// Number of the last bytes that are zero, if there are too many for a record that was cut off. Their earlier
    /// contents are not known: a record that had been acknowledged is not different from one that was never written.
    pub(crate) zero_bytes: u64,
}

/// A log that has been read to its end, before anything is repaired.
pub(crate) struct Read {
    /// First positions of the segments that were read, ascending; never empty.
    pub(crate) segments: Vec<u64>,
    /// Behind the last record.
    pub(crate) cursor: Cursor,
    progress: Progress,
    listed: Option<NewestSegment>,
    /// A segment that was just being created.
    unfinished: Option<PathBuf>,
    /// Bytes at the end of the newest segment that were not written whole.
    pub(crate) torn: Option<Torn>,
}

/// Cuts a torn tail off a log that was read, and makes the rest durable.
pub(crate) fn repair(disk: &dyn Disk, folder: &Path, read: Read) -> Result<Recovered, OpenError> {
    let mut repairs = Vec::new();
    let Read { segments, cursor, progress, listed, unfinished, torn } = read;
    let newest = segment_path(folder, segments.last().copied().unwrap_or(1));
    if let Some(file) = unfinished {
        disk.remove(&file).map_err(open_io(&file))?;
        repairs.push(Repair::LeftoverRemoved { file });
    }
    let mut file = disk.open(&newest).map_err(open_io(&newest))?;
    if let Some(Torn { file: torn_file, bytes, zero_bytes }) = torn {
        file.truncate(cursor.offset as u64).map_err(open_io(&newest))?;
        repairs.push(Repair::TornTail { file: torn_file, bytes, zero_bytes });
    }
    // Records may be in the page cache only; they are about to be used, so they must be durable.
    file.sync().map_err(open_io(&newest))?;
    disk.sync_folder(folder).map_err(open_io(folder))?;
    let first_position = segments.last().copied().unwrap_or(1);
    if listed.is_none_or(|listed| listed.first_position < first_position) {
        let list = folder.join(NEWEST_FILE);
        list_file::replace(disk, &list, &NewestSegment { first_position }).map_err(open_io(&list))?;
    }
    Ok(Recovered { segments, cursor, progress, repairs })
}

/// Reads the log from the segment that holds `replay_from`, and changes nothing.
pub(crate) fn read(disk: &dyn Disk, folder: &Path, expected: &Expectation) -> Result<Read, OpenError> {
    let names = disk.list(folder).map_err(open_io(folder))?;
    let mut segments: Vec<u64> = names.iter().filter_map(|name| segment_position(name)).collect();
    let list = folder.join(NEWEST_FILE);
    let listed: Option<NewestSegment> = match list_file::read(disk, &list) {
        Ok(listed) => Some(listed),
        Err(Unlisted::Absent) if !expected.is_listed => None,
        Err(unlisted) => return Err(unlisted.opening(&list)),
    };
    let unfinished = unfinished_segment(disk, folder, &segments)?;
    if unfinished.is_some() {
        segments.pop();
    }
    if let Some(NewestSegment { first_position }) = listed.filter(|listed| !segments.contains(&listed.first_position)) {
        let file = segment_path(folder, first_position);
        return Err(corrupt(&file, 0, first_position, "the segment that begins with this record is missing"));
    }
    let replay_from = expected.replay_from.max(1);
    let Some(start) = segments.iter().rposition(|&first| first <= replay_from) else {
        return Err(corrupt(folder, 0, replay_from, "there is no segment that holds this record"));
    };
    segments.drain(..start);

    let mut progress = Progress::default();
    let mut cursor = None;
    let mut torn = None;
    for (index, &first) in segments.iter().enumerate() {
        let file = segment_path(folder, first);
        let bytes = read_all(disk, &file).map_err(open_io(&file))?;
        let header = segment_header(&file, &bytes, expected.map, first)?;
        let mut here = cursor.unwrap_or(Cursor { offset: 0, position: first, chain: header.chain });
        if here.position != first || here.chain != header.chain {
            return Err(corrupt(&file, 0, here.position, "the segment does not follow the one before it"));
        }
        here.offset = SEGMENT_HEADER_LENGTH;
        // A segment is created only when everything before it is durable.
        let may_be_torn = index + 1 == segments.len() && unfinished.is_none();
        if let Some(torn_bytes) = read_segment(&file, &bytes, &mut here, may_be_torn, expected.known, &mut progress)? {
            let zero_bytes = zero_bytes(bytes.get(here.offset..).unwrap_or_default());
            torn = Some(Torn { file, bytes: torn_bytes, zero_bytes });
        }
        cursor = Some(here);
    }
    let newest = segment_path(folder, segments.last().copied().unwrap_or(1));
    let cursor = cursor.ok_or_else(|| corrupt(&newest, 0, replay_from, "there is no segment"))?;
    if cursor.position <= expected.known {
        let reason = format!("the log ends here, but a checkpoint or the index has record {}", expected.known);
        return Err(corrupt(&newest, cursor.offset, cursor.position, reason));
    }

    Ok(Read { segments, cursor, progress, listed, unfinished, torn })
}

/// Number of the last bytes that are zero; none where a record may end like that.
fn zero_bytes(torn: &[u8]) -> u64 {
    let zeros = torn.iter().rev().take_while(|&&byte| byte == 0).count();
    if zeros == torn.len() || zeros >= FRAME_HEADER_LENGTH { zeros as u64 } else { 0 }
}

/// The newest segment, if its header is incomplete because it was just being created.
fn unfinished_segment(disk: &dyn Disk, folder: &Path, segments: &[u64]) -> Result<Option<PathBuf>, OpenError> {
    // The first segment of a map is durable before the map exists.
    let &[.., _, newest] = segments else { return Ok(None) };
    let file = segment_path(folder, newest);
    if disk.length(&file).map_err(open_io(&file))? > SEGMENT_HEADER_LENGTH as u64 {
        return Ok(None);
    }
    let bytes = read_all(disk, &file).map_err(open_io(&file))?;
    let is_unwritten = bytes.len() < SEGMENT_HEADER_LENGTH
        || has_unwritten_sector(&bytes, 0, SEGMENT_HEADER_LENGTH, SEGMENT_HEADER_LENGTH);
    Ok(is_unwritten.then_some(file))
}

fn segment_header(file: &Path, bytes: &[u8], map: u32, first: u64) -> Result<SegmentHeader, OpenError> {
    let header = SegmentHeader::decode(bytes)
        .ok_or_else(|| corrupt(file, 0, first, "the header of the segment is not valid"))?;
    if header.map != map || header.first_position != first {
        return Err(corrupt(file, 0, first, "the header of the segment is that of another segment"));
    }
    Ok(header)
}

/// Reads a segment up to its end or to a torn tail, whose length is returned.
fn read_segment(
    file: &Path,
    bytes: &[u8],
    cursor: &mut Cursor,
    may_be_torn: bool,
    known: u64,
    progress: &mut Progress,
) -> Result<Option<u64>, OpenError> {
    loop {
        let offset = cursor.offset;
        match next_frame(bytes, cursor) {
            Ok(Some(frame)) => {
                progress.bytes += (cursor.offset - offset) as u64;
                if frame.header.position <= known {
                    progress.covered = progress.bytes;
                } else if frame.is_update_start() {
                    progress.updates.push((frame.header.position, progress.bytes));
                }
            }
            Ok(None) => return Ok(None),
            Err(bad) if may_be_torn && bad.is_unwritten && !is_followed(bytes, offset, cursor.position) => {
                return Ok(Some((bytes.len() - offset) as u64));
            }
            Err(bad) => return Err(corrupt(file, offset, cursor.position, bad.reason)),
        }
    }
}
