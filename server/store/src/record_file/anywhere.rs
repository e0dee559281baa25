//! Random access to single records of a file.
//!
//! Invariant: a record is used only if its header, its kind and its checksum are valid.

use prost::Message;
use tidemap_layout::file::{RECORD_HEADER_LENGTH, RecordHeader, RecordKind};

use super::{LAST, split_piece};
use crate::{disk::DiskReader, failure::ReadFailure};

/// The payload of the record at an offset, and the offset of the next one.
pub(crate) fn raw(file: &dyn DiskReader, kind: RecordKind, offset: u64) -> Result<(Vec<u8>, u64), ReadFailure> {
    let mut bytes = [0; RECORD_HEADER_LENGTH];
    file.read_exact_at(&mut bytes, offset)?;
    let header = RecordHeader::decode(&bytes)
        .filter(|header| header.kind == kind)
        .ok_or_else(|| format!("the header of the record at byte {offset} is not valid"))?;
    // The length is at most 1 MiB.
    let mut payload = vec![0; header.payload_length as usize];
    let start = offset.saturating_add(RECORD_HEADER_LENGTH as u64);
    file.read_exact_at(&mut payload, start)?;
    if crc32c::crc32c(&payload) != header.payload_crc {
        return Err(format!("the checksum of the record at byte {offset} does not match").into());
    }
    let next = start.saturating_add(payload.len() as u64);
    Ok((payload, next))
}

/// The long record whose first piece is at an offset, and the offset behind its last.
pub(crate) fn long(file: &dyn DiskReader, kind: RecordKind, offset: u64) -> Result<(Vec<u8>, u64), ReadFailure> {
    let mut whole = Vec::new();
    let mut offset = offset;
    loop {
        let (payload, next) = raw(file, kind, offset)?;
        let (mark, piece) = split_piece(&payload)?;
        whole.extend_from_slice(piece);
        offset = next;
        if mark == LAST {
            return Ok((whole, offset));
        }
    }
}

/// The message in the long record at an offset, and the offset behind it.
pub(crate) fn message<M: Message + Default>(
    file: &dyn DiskReader,
    kind: RecordKind,
    offset: u64,
) -> Result<(M, u64), ReadFailure> {
    let (bytes, next) = long(file, kind, offset)?;
    let message = M::decode(&bytes[..]).map_err(|_| format!("the record at byte {offset} is not a message"))?;
    Ok((message, next))
}
