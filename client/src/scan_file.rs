//! Files of scans, `.tms`: the scans of a robot, to send later, once or to several maps.
//!
//! A file is one line and length-delimited protobuf messages, so that any language with protobuf can write it:
//!
//! ```text
//! tidemap scans 1\n
//! <length as varint> <ScanFileHeader>
//! <length as varint> <tidemap.v1.ScanBatch>   any number of times
//! ```
//!
//! ```protobuf
//! message ScanFileHeader {
//!   double resolution_m = 1;         // edge of a cell; 0 or absent: the file has no scans of tiles
//!   string frame_id = 2;             // frame of the map that the scans are for; empty: not stated
//!   repeated double origin_m = 3;    // lower corner of cell (0, 0, 0), three numbers; none: not stated
//! }
//! ```
//!
//! The batches are the batches of one Observe stream from its beginning: the first has `first_sequence` 1, and each
//! continues after the previous one; the table of tiles starts empty. A batch of up to 256 scans and 512 KiB, with
//! `first_sequence` 1 for the first, can be sent as it is.
//!
//! Invariant: at most one batch, or one scan that spans batches, is in memory. A truncated file gives every complete
//! batch and then an error with its position.

mod error;
mod writer;

use std::{
    io::{self, BufRead, Read as _},
    sync::Arc,
};

use prost::Message as _;
use tidemap_proto::{
    convert::scans::join_part,
    v1::{Scan, ScanBatch},
};

pub use error::{ScanFileError, ScanFileFault};
pub use writer::{ScanFileWriter, ScanWriteError};

/// The first line.
pub const MAGIC: &[u8] = b"tidemap scans 1\n";
/// Maximum length of a message. A batch that a daemon accepts is far shorter.
pub const MESSAGE_BYTES_MAX: u64 = 64 << 20;
/// Maximum number of messages of one scan.
const PARTS_MAX: usize = 256;
const VARINT_BYTES_MAX: u32 = 10;

/// The grid that the scans of a file are for.
#[derive(Clone, PartialEq, prost::Message)]
pub struct ScanFileHeader {
    /// Length of a cell's edge in metres; 0 if the file has no scans of tiles.
    #[prost(double, tag = "1")]
    pub resolution_m: f64,
    /// Frame of the map; empty if unknown.
    #[prost(string, tag = "2")]
    pub frame_id: String,
    /// Lower corner of cell (0, 0, 0) in metres; empty if unknown.
    #[prost(double, repeated, tag = "3")]
    pub origin_m: Vec<f64>,
}

/// A scan of a file.
#[derive(Clone, Debug, PartialEq)]
pub struct FileScan {
    /// Number, from 1.
    pub number: u64,
    /// Time, nanoseconds UTC.
    pub time_nanos: i64,
    /// Tiles to append to the table of the file: x, y, z of each.
    pub new_tiles: Vec<i32>,
    /// The content; its slots index the table of the file.
    pub scan: Scan,
}

/// An undecoded batch.
#[derive(Clone, Debug, PartialEq)]
pub struct RawBatch {
    /// Position of its length, in bytes from the start of the file.
    pub offset: u64,
    /// An encoded `ScanBatch`.
    pub bytes: Vec<u8>,
}

/// Reads a file batch by batch.
#[derive(Debug)]
pub struct ScanFile<R> {
    reader: R,
    header: ScanFileHeader,
    offset: u64,
    /// Number of complete scans so far.
    scans: u64,
    /// A scan that continues in the next batch, and its number of parts so far.
    unfinished: Option<(FileScan, usize)>,
}

impl<R: BufRead> ScanFile<R> {
    /// Reads the header.
    ///
    /// # Errors
    /// [`ScanFileError`]
    pub fn new(reader: R) -> Result<Self, ScanFileError> {
        let mut file = Self { reader, header: ScanFileHeader::default(), offset: 0, scans: 0, unfinished: None };
        let mut magic = Vec::new();
        (&mut file.reader).take(MAGIC.len() as u64).read_to_end(&mut magic).map_err(|error| file.io(error))?;
        if magic != MAGIC {
            return Err(file.wrong(0, ScanFileFault::Magic(magic)));
        }
        file.offset = MAGIC.len() as u64;
        let at = file.offset;
        let bytes = file.message("the header")?.ok_or_else(|| file.wrong(at, ScanFileFault::NoHeader))?.bytes;
        file.header = ScanFileHeader::decode(bytes.as_slice())
            .map_err(|error| file.wrong(at, ScanFileFault::Malformed(error)))?;
        let ScanFileHeader { resolution_m, origin_m, .. } = &file.header;
        if !(resolution_m.is_finite() && *resolution_m >= 0.0) {
            return Err(file.wrong(at, ScanFileFault::Resolution(*resolution_m)));
        }
        if !matches!(origin_m.len(), 0 | 3) || origin_m.iter().any(|number| !number.is_finite()) {
            return Err(file.wrong(at, ScanFileFault::Origin(origin_m.clone())));
        }
        Ok(file)
    }

    /// The header.
    pub fn header(&self) -> &ScanFileHeader {
        &self.header
    }

    /// Bytes read so far.
    pub fn bytes(&self) -> u64 {
        self.offset
    }

    /// The next batch, undecoded; `None` at the end.
    ///
    /// # Errors
    /// [`ScanFileError`]
    pub fn next_raw(&mut self) -> Result<Option<RawBatch>, ScanFileError> {
        self.message("a batch")
    }

    /// The scans that the next batch completes, possibly none; `None` at the end.
    ///
    /// # Errors
    /// [`ScanFileError`]
    pub fn next_scans(&mut self) -> Result<Option<Vec<FileScan>>, ScanFileError> {
        let at = self.offset;
        let Some(raw) = self.next_raw()? else {
            return match self.unfinished {
                Some(_) => Err(self.wrong(at, ScanFileFault::Unfinished)),
                None => Ok(None),
            };
        };
        let batch =
            ScanBatch::decode(raw.bytes.as_slice()).map_err(|error| self.wrong(at, ScanFileFault::Malformed(error)))?;
        self.taken(batch).map(Some).map_err(|wrong| self.wrong(at, wrong))
    }

    fn taken(&mut self, batch: ScanBatch) -> Result<Vec<FileScan>, ScanFileFault> {
        let expected = self.scans + 1;
        if batch.first_sequence != expected {
            return Err(ScanFileFault::Sequence { expected, found: batch.first_sequence });
        }
        let (count, times) = (batch.scans.len(), batch.time_deltas.len());
        if count == 0 || count != times {
            return Err(ScanFileFault::Lengths { scans: count, times });
        }
        let unit = i64::try_from(batch.time_unit_nanos.max(1)).ok();
        let mut time = Some(batch.first_time_nanos);
        let mut new_tiles = batch.new_tiles;
        let mut scans = Vec::with_capacity(count);
        for (i, (scan, delta)) in batch.scans.into_iter().zip(batch.time_deltas).enumerate() {
            time = time.and_then(|time| time.checked_add(delta.checked_mul(unit?)?));
            let time_nanos = time.filter(|time| *time >= 0).ok_or(ScanFileFault::Time { scan: self.scans + 1 })?;
            let new_tiles = std::mem::take(&mut new_tiles);
            let (whole, parts) = match self.unfinished.take() {
                None => (FileScan { number: self.scans + 1, time_nanos, new_tiles, scan }, 1),
                Some((mut whole, parts)) => {
                    if parts == PARTS_MAX {
                        return Err(ScanFileFault::Parts(PARTS_MAX));
                    }
                    whole.new_tiles.extend(new_tiles);
                    join_part(&mut whole.scan.content, scan.content).map_err(ScanFileFault::Tiles)?;
                    (whole, parts + 1)
                }
            };
            if batch.continues && i + 1 == count {
                self.unfinished = Some((whole, parts));
            } else {
                self.scans += 1;
                scans.push(whole);
            }
        }
        Ok(scans)
    }

    /// A message with its length; `None` at the end of the file.
    fn message(&mut self, what: &'static str) -> Result<Option<RawBatch>, ScanFileError> {
        let offset = self.offset;
        let Some(length) = self.length(what)? else { return Ok(None) };
        if length > MESSAGE_BYTES_MAX {
            return Err(self.wrong(offset, ScanFileFault::Length(length)));
        }
        let mut bytes = Vec::new();
        // The buffer grows as bytes arrive: a length alone allocates nothing.
        (&mut self.reader).take(length).read_to_end(&mut bytes).map_err(|error| self.io(error))?;
        if (bytes.len() as u64) < length {
            return Err(self.wrong(offset, ScanFileFault::CutOff { what, needs: length, has: bytes.len() as u64 }));
        }
        self.offset += length;
        Ok(Some(RawBatch { offset, bytes }))
    }

    fn length(&mut self, what: &'static str) -> Result<Option<u64>, ScanFileError> {
        let offset = self.offset;
        let mut length = 0_u64;
        for place in 0..VARINT_BYTES_MAX {
            let byte = loop {
                match self.reader.fill_buf() {
                    Ok(buffer) => break buffer.first().copied(),
                    Err(error) if error.kind() == io::ErrorKind::Interrupted => {}
                    Err(error) => return Err(self.io(error)),
                }
            };
            let Some(byte) = byte else {
                if place == 0 {
                    return Ok(None);
                }
                return Err(
                    self.wrong(offset, ScanFileFault::CutOff { what, needs: u64::from(place) + 1, has: place.into() })
                );
            };
            self.reader.consume(1);
            self.offset += 1;
            length |= u64::from(byte & 0x7f).checked_shl(7 * place).unwrap_or(u64::MAX);
            if byte & 0x80 == 0 {
                return Ok(Some(length));
            }
        }
        Err(self.wrong(offset, ScanFileFault::Length(u64::MAX)))
    }

    fn wrong(&self, offset: u64, wrong: ScanFileFault) -> ScanFileError {
        ScanFileError::Wrong { offset, scans: self.scans, wrong }
    }

    fn io(&self, error: io::Error) -> ScanFileError {
        ScanFileError::Io { offset: self.offset, error: Arc::new(error) }
    }
}

#[cfg(test)]
mod tests;
