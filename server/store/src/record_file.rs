//! Files of records: written once, whole or not at all, and never changed.
//!
//! Invariant: a file has its final name only when all of it is durable; what is read is every record up to a trailer
//! that fits, or an error.

use std::{
    io::{self, BufReader, Read},
    path::Path,
};

use prost::Message;
use tidemap_migrations::v1::file::{
    FILE_HEADER_LENGTH, FileHeader, RECORD_HEADER_LENGTH, RECORD_MAX, RecordHeader, RecordKind, TRAILER_LENGTH, Trailer,
};

use crate::disk::{Disk, DiskFile};

/// Bytes that are written at a time.
const BUFFER: usize = 1 << 20;

/// A file that is being written.
pub(crate) struct RecordWriter {
    file: Box<dyn DiskFile>,
    buffer: Vec<u8>,
    total_crc: u32,
    records: u32,
}

impl RecordWriter {
    pub(crate) fn create(disk: &dyn Disk, path: &Path, header: &FileHeader) -> io::Result<RecordWriter> {
        let mut writer = RecordWriter { file: disk.create(path)?, buffer: Vec::new(), total_crc: 0, records: 0 };
        writer.push(&header.encode());
        Ok(writer)
    }

    fn push(&mut self, bytes: &[u8]) {
        self.total_crc = crc32c::crc32c_append(self.total_crc, bytes);
        self.buffer.extend_from_slice(bytes);
    }

    pub(crate) fn record(&mut self, kind: RecordKind, message: &impl Message) -> io::Result<()> {
        let payload = message.encode_to_vec();
        let Some(payload_length) = u32::try_from(payload.len()).ok().filter(|_| payload.len() <= RECORD_MAX) else {
            return Err(io::Error::new(io::ErrorKind::InvalidInput, "a record is longer than 1 MiB"));
        };
        let header = RecordHeader { kind, payload_length, payload_crc: crc32c::crc32c(&payload) };
        self.push(&header.encode());
        self.push(&payload);
        self.records += 1;
        if self.buffer.len() >= BUFFER {
            self.file.append(&self.buffer)?;
            self.buffer.clear();
        }
        Ok(())
    }

    /// Writes the trailer and makes the file durable, though not its name.
    pub(crate) fn finish(mut self) -> io::Result<()> {
        let trailer = Trailer { total_crc: self.total_crc, records: self.records };
        self.buffer.extend_from_slice(&trailer.encode());
        self.file.append(&self.buffer)?;
        self.file.sync()
    }
}

/// A file that is being read.
pub(crate) struct RecordReader {
    reader: BufReader<Box<dyn Read + Send>>,
    /// What the file says about itself.
    pub(crate) header: FileHeader,
    total_crc: u32,
    records: u32,
}

/// Why a file cannot be read.
fn unreadable(error: &io::Error) -> String {
    if error.kind() == io::ErrorKind::UnexpectedEof { "it is cut off".to_owned() } else { error.to_string() }
}

impl RecordReader {
    pub(crate) fn open(disk: &dyn Disk, path: &Path, magic: [u8; 8], map: u32) -> Result<RecordReader, String> {
        let reader = disk.read(path).map_err(|error| unreadable(&error))?;
        let mut reader = BufReader::with_capacity(BUFFER / 4, reader);
        let mut bytes = [0; FILE_HEADER_LENGTH];
        reader.read_exact(&mut bytes).map_err(|error| unreadable(&error))?;
        let header = FileHeader::decode(&bytes).ok_or("its header is not valid")?;
        if header.magic != magic || header.map != map {
            return Err("its header is that of another file".to_owned());
        }
        Ok(RecordReader { reader, header, total_crc: crc32c::crc32c(&bytes), records: 0 })
    }

    /// The next record, which must be of that kind.
    pub(crate) fn record<M: Message + Default>(&mut self, kind: RecordKind) -> Result<M, String> {
        let mut bytes = [0; RECORD_HEADER_LENGTH];
        self.reader.read_exact(&mut bytes).map_err(|error| unreadable(&error))?;
        let record = self.records + 1;
        let header =
            RecordHeader::decode(&bytes).ok_or_else(|| format!("the header of record {record} is not valid"))?;
        let mut payload = vec![0; header.payload_length as usize];
        self.reader.read_exact(&mut payload).map_err(|error| unreadable(&error))?;
        if crc32c::crc32c(&payload) != header.payload_crc {
            return Err(format!("the checksum of record {record} does not match"));
        }
        if header.kind != kind {
            return Err(format!("record {record} is of another kind than it should"));
        }
        self.total_crc = crc32c::crc32c_append(crc32c::crc32c_append(self.total_crc, &bytes), &payload);
        self.records = record;
        M::decode(&payload[..]).map_err(|_| format!("record {record} is not a message"))
    }

    /// Checks that all records have been read and that nothing follows.
    pub(crate) fn finish(mut self) -> Result<(), String> {
        let mut bytes = [0; TRAILER_LENGTH];
        self.reader.read_exact(&mut bytes).map_err(|error| unreadable(&error))?;
        let trailer = Trailer::decode(&bytes).ok_or("its end is not valid")?;
        if trailer.total_crc != self.total_crc || trailer.records != self.records {
            return Err("its end does not fit what is before it".to_owned());
        }
        match self.reader.read(&mut [0; 1]) {
            Ok(0) => Ok(()),
            Ok(_) => Err("something follows its end".to_owned()),
            Err(error) => Err(unreadable(&error)),
        }
    }
}
