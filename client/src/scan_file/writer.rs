//! Writes files of scans.
//!
//! Invariant: the batches are the batches that a producer would send on its first connection; each can be sent as it
//! is.

use std::io::{self, Write};

use prost::Message as _;
use tidemap_proto::v1;

use super::{MAGIC, ScanFileHeader};
use crate::observe::{
    ProducerError,
    scan::Scan,
    scan_stream::{ScanMessageLimits, ScanStream},
    window::Window,
};

/// Maximum number of scans and bytes of a batch.
const LIMITS: ScanMessageLimits = ScanMessageLimits { scans: 256, bytes: 512 << 10 };

/// Writes a file of scans.
#[derive(Debug)]
pub struct ScanFileWriter<W> {
    writer: W,
    window: Window,
    stream: ScanStream,
    bytes: u64,
}

/// Why a scan cannot be written.
#[derive(Debug, thiserror::Error)]
#[allow(missing_docs, reason = "the error texts name the variants and fields")]
pub enum ScanWriteError {
    #[error(transparent)]
    Io(#[from] io::Error),
    #[error(transparent)]
    Scan(#[from] tidemap_proto::convert::scans::TileError),
    #[error(transparent)]
    Time(ProducerError),
}

impl<W: Write> ScanFileWriter<W> {
    /// Begins a file.
    ///
    /// # Errors
    /// The error of `writer`.
    pub fn new(mut writer: W, header: &ScanFileHeader) -> io::Result<Self> {
        writer.write_all(MAGIC)?;
        let header = header.encode_length_delimited_to_vec();
        writer.write_all(&header)?;
        let window = Window::new(LIMITS.scans * 2, 0, 0).with_bytes(LIMITS.bytes);
        let stream = ScanStream::new(window.base());
        Ok(Self { writer, window, stream, bytes: (MAGIC.len() + header.len()) as u64 })
    }

    /// Adds a scan.
    ///
    /// # Errors
    /// [`ScanWriteError`]
    pub fn scan(&mut self, time_nanos: i64, scan: Scan) -> Result<(), ScanWriteError> {
        checked(time_nanos)?;
        self.window.push_scan(time_nanos, scan)?;
        Ok(self.write(false)?)
    }

    /// Adds a scan in wire form: its slots number the tiles so far, including `new_tiles` (x, y, z of each).
    ///
    /// # Errors
    /// [`ScanWriteError`]
    pub fn wire_scan(&mut self, time_nanos: i64, new_tiles: &[i32], scan: v1::Scan) -> Result<(), ScanWriteError> {
        checked(time_nanos)?;
        self.window.push_wire_scan(time_nanos, new_tiles, scan)?;
        Ok(self.write(false)?)
    }

    /// Writes the remaining scans; returns the writer and the length of the file. Without this call the file lacks its
    /// last scans.
    ///
    /// # Errors
    /// The error of the writer.
    pub fn finish(mut self) -> io::Result<(W, u64)> {
        self.write(true)?;
        self.writer.flush()?;
        Ok((self.writer, self.bytes))
    }

    /// Writes complete batches, or everything.
    fn write(&mut self, all: bool) -> io::Result<()> {
        loop {
            let (window, first_sequence) = (&self.window, self.window.next_unsent());
            let waiting = window.last() + 1 - first_sequence;
            if waiting == 0 || !(all || waiting >= LIMITS.scans as u64 || !window.has_room()) {
                return Ok(());
            }
            let scans = window.scans_to_send(LIMITS.scans, LIMITS.bytes, u64::MAX);
            let (count, messages) = self.stream.pack(scans, window.tiles(), first_sequence, LIMITS);
            for message in messages {
                let bytes = message.encode_length_delimited_to_vec();
                self.writer.write_all(&bytes)?;
                self.bytes += bytes.len() as u64;
            }
            self.window.sent(count);
            // The scans that were just sent can be acknowledged.
            let _ = self.window.acknowledged(first_sequence + count as u64 - 1);
        }
    }
}

fn checked(time_nanos: i64) -> Result<(), ScanWriteError> {
    if time_nanos < 0 { Err(ScanWriteError::Time(ProducerError::TimeBefore1970(time_nanos))) } else { Ok(()) }
}
