//! Files of records: written once, completely or not at all, and never changed.
//!
//! Invariant: a file has its final name only when all of it is durable. Reading from the start gives every record up
//! to a valid trailer, or an error.

use std::{
    io::{self, BufReader, Read},
    path::Path,
};

use prost::Message;
use tidemap_layout::file::{
    FILE_HEADER_LENGTH, FileHeader, PIECE_MAX, RECORD_HEADER_LENGTH, RECORD_MAX, RecordHeader, RecordKind,
    TRAILER_LENGTH, Trailer,
};

use crate::{
    disk::{Disk, DiskFile},
    failure::ReadFailure,
};

pub(crate) mod anywhere;

/// Bytes that are written at a time.
const BUFFER: usize = 1 << 20;
/// First byte of a piece of a long record.
const LAST: u8 = 0;
const MORE_FOLLOW: u8 = 1;

/// A file that is being written.
pub(crate) struct RecordWriter {
    file: Box<dyn DiskFile>,
    buffer: Vec<u8>,
    length: u64,
    total_crc: u32,
    records: u32,
}

impl RecordWriter {
    pub(crate) fn create(disk: &dyn Disk, path: &Path, header: &FileHeader) -> io::Result<RecordWriter> {
        let file = disk.create(path)?;
        let mut writer = RecordWriter { file, buffer: Vec::new(), length: 0, total_crc: 0, records: 0 };
        writer.push(&header.encode());
        Ok(writer)
    }

    /// Offset of the next record in the file.
    pub(crate) fn offset(&self) -> u64 {
        self.length
    }

    fn push(&mut self, bytes: &[u8]) {
        self.total_crc = crc32c::crc32c_append(self.total_crc, bytes);
        self.buffer.extend_from_slice(bytes);
        self.length += bytes.len() as u64;
    }

    /// Writes a record whose payload is a message.
    pub(crate) fn record(&mut self, kind: RecordKind, message: &impl Message) -> io::Result<()> {
        self.raw(kind, &[], &message.encode_to_vec())
    }

    /// Writes a record whose payload consists of two parts.
    pub(crate) fn raw(&mut self, kind: RecordKind, first: &[u8], rest: &[u8]) -> io::Result<()> {
        let length = first.len() + rest.len();
        let Some(payload_length) = u32::try_from(length).ok().filter(|_| length <= RECORD_MAX) else {
            return Err(io::Error::new(io::ErrorKind::InvalidInput, "a record is longer than 1 MiB"));
        };
        let payload_crc = crc32c::crc32c_append(crc32c::crc32c(first), rest);
        self.push(&RecordHeader { kind, payload_length, payload_crc }.encode());
        self.push(first);
        self.push(rest);
        self.records = self.records.checked_add(1).ok_or(io::ErrorKind::FileTooLarge)?;
        if self.buffer.len() >= BUFFER {
            self.file.append(&self.buffer)?;
            self.buffer.clear();
        }
        Ok(())
    }

    /// Writes a long record in pieces.
    pub(crate) fn long(&mut self, kind: RecordKind, mut payload: &[u8]) -> io::Result<()> {
        while payload.len() > PIECE_MAX {
            let (piece, rest) = payload.split_at(PIECE_MAX);
            self.raw(kind, &[MORE_FOLLOW], piece)?;
            payload = rest;
        }
        self.raw(kind, &[LAST], payload)
    }

    /// Writes the trailer and makes the file durable, but not its name. Returns the trailer.
    pub(crate) fn finish(mut self) -> io::Result<Trailer> {
        let trailer = Trailer { total_crc: self.total_crc, records: self.records };
        self.buffer.extend_from_slice(&trailer.encode());
        self.file.append(&self.buffer)?;
        self.file.sync()?;
        Ok(trailer)
    }
}

/// A file that is being read.
pub(crate) struct RecordReader {
    reader: BufReader<Box<dyn Read + Send>>,
    /// The header of the file.
    pub(crate) header: FileHeader,
    /// The header of the next record, if it has been read.
    ahead: Option<RecordHeader>,
    offset: u64,
    total_crc: u32,
    /// Checksum of all bytes before `offset`.
    records: u32,
    payload: Vec<u8>,
}

impl RecordReader {
    pub(crate) fn open(disk: &dyn Disk, path: &Path, magic: [u8; 8], map: u32) -> Result<RecordReader, ReadFailure> {
        let reader = disk.read(path)?;
        let mut reader = BufReader::with_capacity(BUFFER / 4, reader);
        let mut bytes = [0; FILE_HEADER_LENGTH];
        reader.read_exact(&mut bytes)?;
        let header = FileHeader::decode(&bytes).ok_or("its header is not valid")?;
        if header.magic != magic || header.map != map {
            return Err("its header is that of another file".into());
        }
        let offset = FILE_HEADER_LENGTH as u64;
        let crc = crc32c::crc32c(&bytes);
        let (ahead, payload) = (None, Vec::new());
        Ok(RecordReader { reader, header, ahead, offset, total_crc: crc, records: 0, payload })
    }

    /// Offset of the next record in the file.
    pub(crate) fn offset(&self) -> u64 {
        self.offset
    }

    /// The kind of the next record.
    pub(crate) fn next_kind(&mut self) -> Result<RecordKind, ReadFailure> {
        self.next_header().map(|header| header.kind)
    }

    fn next_header(&mut self) -> Result<RecordHeader, ReadFailure> {
        if let Some(header) = self.ahead {
            return Ok(header);
        }
        let mut bytes = [0; RECORD_HEADER_LENGTH];
        self.reader.read_exact(&mut bytes)?;
        let header = RecordHeader::decode(&bytes)
            .ok_or_else(|| format!("the header of record {} is not valid", self.records + 1))?;
        self.total_crc = crc32c::crc32c_append(self.total_crc, &bytes);
        self.ahead = Some(header);
        Ok(header)
    }

    /// The payload of the next record, which must be of that kind.
    fn next(&mut self, kind: RecordKind) -> Result<&[u8], ReadFailure> {
        let header = self.next_header()?;
        let record = self.records + 1;
        self.payload.resize(header.payload_length as usize, 0);
        self.reader.read_exact(&mut self.payload)?;
        if crc32c::crc32c(&self.payload) != header.payload_crc {
            return Err(format!("the checksum of record {record} does not match").into());
        }
        if header.kind != kind {
            return Err(format!("record {record} is of another kind than it should").into());
        }
        self.total_crc = crc32c::crc32c_append(self.total_crc, &self.payload);
        self.records = record;
        self.offset += (RECORD_HEADER_LENGTH + self.payload.len()) as u64;
        self.ahead = None;
        Ok(&self.payload)
    }

    /// The next record, which must be of that kind.
    pub(crate) fn record<M: Message + Default>(&mut self, kind: RecordKind) -> Result<M, ReadFailure> {
        let record = self.records + 1;
        M::decode(self.next(kind)?).map_err(|_| format!("record {record} is not a message").into())
    }

    /// The payload of the next record, which must be of that kind.
    pub(crate) fn raw(&mut self, kind: RecordKind, out: &mut Vec<u8>) -> Result<(), ReadFailure> {
        out.clear();
        out.extend_from_slice(self.next(kind)?);
        Ok(())
    }

    /// The pieces of the next long record, which must be of that kind, in `out`.
    pub(crate) fn long(&mut self, kind: RecordKind, out: &mut Vec<u8>) -> Result<(), ReadFailure> {
        out.clear();
        loop {
            let (mark, piece) = split_piece(self.next(kind)?)?;
            out.extend_from_slice(piece);
            if mark == LAST {
                return Ok(());
            }
        }
    }

    /// The next long record, which must be a message of that kind.
    pub(crate) fn long_message<M: Message + Default>(
        &mut self,
        kind: RecordKind,
        buffer: &mut Vec<u8>,
    ) -> Result<M, ReadFailure> {
        let record = self.records + 1;
        self.long(kind, buffer)?;
        M::decode(&buffer[..]).map_err(|_| format!("record {record} is not a message").into())
    }

    /// Checks that all records have been read and that nothing follows. Returns the trailer.
    pub(crate) fn finish(mut self) -> Result<Trailer, ReadFailure> {
        let mut bytes = [0; TRAILER_LENGTH];
        if self.ahead.is_some() {
            return Err("there are more records than there should be".into());
        }
        self.reader.read_exact(&mut bytes)?;
        let trailer = Trailer::decode(&bytes).ok_or("its end is not valid")?;
        if trailer.total_crc != self.total_crc || trailer.records != self.records {
            return Err("its end does not fit what is before it".into());
        }
        match self.reader.read(&mut [0; 1]) {
            Ok(0) => Ok(trailer),
            Ok(_) => Err("something follows its end".into()),
            Err(error) => Err(error.into()),
        }
    }
}

/// Reads a whole file and compares it with the checksum in its trailer; gives its length and that checksum.
pub(crate) fn check_total(disk: &dyn Disk, path: &Path) -> Result<(u64, u32), ReadFailure> {
    check_total_paced(disk, path, &mut |_| true)
}

/// Does what [`check_total`] does. Before each part `pace` gets its length in bytes, and may wait; `false` ends the
/// reading with an error.
pub(crate) fn check_total_paced(
    disk: &dyn Disk,
    path: &Path,
    pace: &mut dyn FnMut(u64) -> bool,
) -> Result<(u64, u32), ReadFailure> {
    let length = disk.length(path)?;
    let body = length.checked_sub(TRAILER_LENGTH as u64).ok_or("it is cut off")?;
    let mut reader = disk.read(path)?;
    let (mut crc, mut buffer) = (0, Vec::new());
    let mut rest = body;
    while rest > 0 {
        buffer.resize(rest.min(CHECK_BYTES) as usize, 0);
        if !pace(buffer.len() as u64) {
            return Err("it was not read to its end".into());
        }
        reader.read_exact(&mut buffer)?;
        crc = crc32c::crc32c_append(crc, &buffer);
        rest -= buffer.len() as u64;
    }
    let mut bytes = [0; TRAILER_LENGTH];
    reader.read_exact(&mut bytes)?;
    let trailer = Trailer::decode(&bytes).ok_or("its end is not valid")?;
    if trailer.total_crc == crc { Ok((length, crc)) } else { Err("its checksum does not match".into()) }
}

/// Bytes that are checked at a time.
const CHECK_BYTES: u64 = 256 << 10;

/// The mark and the bytes of a piece of a long record.
fn split_piece(payload: &[u8]) -> Result<(u8, &[u8]), ReadFailure> {
    match payload.split_first() {
        Some((&mark @ (LAST | MORE_FOLLOW), piece)) => Ok((mark, piece)),
        _ => Err("a piece of a long record is not valid".into()),
    }
}
