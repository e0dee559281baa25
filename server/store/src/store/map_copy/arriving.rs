//! A file of a copy that arrives: the number of the map in its header is replaced, and its checksums with it.
//!
//! Invariant: the file has the bytes that were given, but for the number of the map and the checksums over it, or it
//! is refused. A file of records is complete and its trailer holds.

use std::path::Path;

use tidemap_layout::{
    file::{CHECKPOINT_MAGIC, FILE_HEADER_LENGTH, FileHeader, HISTORY_MAGIC, TRAILER_LENGTH, Trailer},
    log::{SEGMENT_HEADER_LENGTH, SegmentHeader},
};

use super::{CopiedFile, CopyError, CopyPart, invalid};
use crate::{
    disk::{Disk, DiskFile},
    error::{StoreError, store_io},
};

/// A file that is being written.
pub(super) struct ArrivingFile {
    pub(super) name: String,
    kind: CopiedFile,
    map: u32,
    file: Box<dyn DiskFile>,
    offset: u64,
    /// Bytes that may be the trailer: the last ones that have come.
    held: Vec<u8>,
    /// Checksum of the bytes as they came, without those that are held.
    given_crc: u32,
    /// Checksum of the bytes as they are written.
    written_crc: u32,
}

impl ArrivingFile {
    /// Creates the file of a first part, in the folder of the map.
    pub(super) fn create(disk: &dyn Disk, folder: &Path, map: u32, name: &str) -> Result<ArrivingFile, CopyError> {
        let kind = CopiedFile::named(name).ok_or_else(|| invalid(name, "a map has no such file"))?;
        let path = folder.join(name);
        let file = disk.create(&path).map_err(store_io(&path))?;
        let name = name.to_owned();
        Ok(ArrivingFile { name, kind, map, file, offset: 0, held: Vec::new(), given_crc: 0, written_crc: 0 })
    }

    /// Takes the next part of the file. The last one makes it durable.
    pub(super) fn take(&mut self, part: &CopyPart, path: &Path) -> Result<(), CopyError> {
        if part.name != self.name || part.offset != self.offset || (part.bytes.is_empty() && !part.is_last) {
            return Err(invalid(&part.name, "the part does not follow the one before"));
        }
        let mut bytes = std::mem::take(&mut self.held);
        bytes.extend_from_slice(&part.bytes);
        let header = if part.offset > 0 { None } else { Some(self.header(&bytes)?) };
        self.offset += part.bytes.len() as u64;
        if self.kind != CopiedFile::Segment {
            self.held = bytes.split_off(bytes.len().saturating_sub(TRAILER_LENGTH));
        }
        self.given_crc = crc32c::crc32c_append(self.given_crc, &bytes);
        if let Some(header) = header {
            let place = bytes.get_mut(..header.len()).ok_or_else(|| invalid(&part.name, "its header is cut off"))?;
            place.copy_from_slice(&header);
        }
        self.written_crc = crc32c::crc32c_append(self.written_crc, &bytes);
        if part.is_last {
            bytes.extend_from_slice(&self.trailer()?);
        }
        let written = self.file.append(&bytes).and_then(|()| if part.is_last { self.file.sync() } else { Ok(()) });
        Ok(written.map_err(|error| StoreError::from_io(path.to_owned(), error))?)
    }

    /// The header for this map in place of the one that came.
    fn header(&self, bytes: &[u8]) -> Result<Vec<u8>, CopyError> {
        let not_valid = || invalid(&self.name, "its header is not valid");
        let file = self.name.rsplit('/').next().unwrap_or_default();
        let magic = match self.kind {
            CopiedFile::Segment => {
                let header = SegmentHeader::decode(bytes).ok_or_else(not_valid)?;
                if crate::log::segment_position(file) != Some(header.first_position) {
                    return Err(invalid(&self.name, "its header is that of another segment"));
                }
                debug_assert!(bytes.len() >= SEGMENT_HEADER_LENGTH, "it was decoded");
                return Ok(SegmentHeader { map: self.map, ..header }.encode().to_vec());
            }
            CopiedFile::Checkpoint => CHECKPOINT_MAGIC,
            CopiedFile::History => HISTORY_MAGIC,
        };
        let header = FileHeader::decode(bytes).filter(|header| header.magic == magic).ok_or_else(not_valid)?;
        if bytes.len() < FILE_HEADER_LENGTH + TRAILER_LENGTH {
            return Err(invalid(&self.name, "it is cut off"));
        }
        Ok(FileHeader { map: self.map, ..header }.encode().to_vec())
    }

    /// The bytes that are written behind the last part.
    fn trailer(&self) -> Result<Vec<u8>, CopyError> {
        if self.kind == CopiedFile::Segment {
            return Ok(Vec::new());
        }
        let trailer = Trailer::decode(&self.held).filter(|trailer| trailer.total_crc == self.given_crc);
        let trailer = trailer.ok_or_else(|| invalid(&self.name, "its checksum does not match"))?;
        Ok(Trailer { total_crc: self.written_crc, ..trailer }.encode().to_vec())
    }
}
