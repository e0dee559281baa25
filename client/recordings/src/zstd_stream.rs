//! Decompression of zstd as a stream.
//!
//! Invariant: memory is bounded by the largest window that is accepted, and a block. A wrong checksum is an error.

use std::io::{self, Read};

use ruzstd::decoding::{
    BlockDecodingStrategy, FrameDecoder,
    errors::{FrameDecoderError, ReadFrameHeaderError},
};

use crate::source::ByteSource;

/// Maximum number of bytes that a frame may refer back to.
pub const WINDOW_BYTES_MAX: u64 = 32 << 20;

/// Reads data that was compressed with zstd; several frames one after the other are one stream.
///
/// A source that ends within a frame gives [`io::ErrorKind::UnexpectedEof`], bytes that are not zstd
/// [`io::ErrorKind::InvalidData`].
pub struct ZstdStream<R> {
    source: ByteSource<R>,
    decoder: FrameDecoder,
    is_in_frame: bool,
}

impl<R: Read> ZstdStream<R> {
    /// Decompresses `source`.
    pub fn new(source: R) -> Self {
        let mut decoder = FrameDecoder::new();
        decoder.set_max_window_size(WINDOW_BYTES_MAX);
        Self { source: ByteSource::new(source), decoder, is_in_frame: false }
    }

    fn begin_frame(&mut self) -> io::Result<()> {
        match self.decoder.reset(&mut self.source) {
            Ok(()) => {
                self.is_in_frame = true;
                Ok(())
            }
            Err(FrameDecoderError::ReadFrameHeaderError(ReadFrameHeaderError::SkipFrame { length, .. })) => {
                self.source.skip(u64::from(length))
            }
            Err(error) => Err(self.failure(&error)),
        }
    }

    fn end_frame(&mut self) -> io::Result<()> {
        self.is_in_frame = false;
        match (self.decoder.get_checksum_from_data(), self.decoder.get_calculated_checksum()) {
            (Some(stated), Some(found)) if stated != found => {
                let text = format!("zstd: the checksum of the data is {found:08x}; the frame states {stated:08x}");
                Err(io::Error::new(io::ErrorKind::InvalidData, text))
            }
            _ => Ok(()),
        }
    }

    /// The decoder cannot report whether bytes were missing.
    fn failure(&mut self, error: &FrameDecoderError) -> io::Error {
        match self.source.is_at_end() {
            Ok(true) => io::ErrorKind::UnexpectedEof.into(),
            Ok(false) => io::Error::new(io::ErrorKind::InvalidData, format!("zstd: {error}")),
            Err(error) => error,
        }
    }
}

impl<R: Read> Read for ZstdStream<R> {
    fn read(&mut self, into: &mut [u8]) -> io::Result<usize> {
        if into.is_empty() {
            return Ok(0);
        }
        loop {
            if self.is_in_frame {
                if self.decoder.can_collect() > 0 {
                    return self.decoder.read(into);
                }
                if self.decoder.is_finished() {
                    self.end_frame()?;
                } else {
                    let one = BlockDecodingStrategy::UptoBlocks(1);
                    let decoded = self.decoder.decode_blocks(&mut self.source, one);
                    decoded.map_err(|error| self.failure(&error))?;
                }
            } else if self.source.is_at_end()? {
                return Ok(0);
            } else {
                self.begin_frame()?;
            }
        }
    }
}

#[cfg(test)]
mod tests {
    use proptest::prelude::*;
    use ruzstd::encoding::{CompressionLevel, compress_to_vec};

    use super::*;

    fn packed(bytes: &[u8]) -> Vec<u8> {
        compress_to_vec(bytes, CompressionLevel::Fastest)
    }

    fn unpacked(bytes: &[u8]) -> io::Result<Vec<u8>> {
        let mut all = Vec::new();
        ZstdStream::new(bytes).read_to_end(&mut all)?;
        Ok(all)
    }

    #[test]
    fn frames_one_after_the_other_are_one_stream() {
        let mut bytes = packed(b"first ");
        bytes.extend([0x50, 0x2a, 0x4d, 0x18, 3, 0, 0, 0, 9, 9, 9]);
        bytes.extend(packed(b"second"));
        assert_eq!(unpacked(&bytes).unwrap(), b"first second");
    }

    #[test]
    fn a_window_above_the_limit_is_refused() {
        // Exponent 20: a window of 1 GiB.
        let error = unpacked(&[0x28, 0xb5, 0x2f, 0xfd, 0x00, 20 << 3, 0x01, 0x00, 0x00, 0x00]).unwrap_err();
        assert!(error.to_string().contains("window"), "{error}");
    }

    #[test]
    fn a_wrong_checksum_is_an_error() {
        let mut bytes = packed(&[7; 1000]);
        *bytes.last_mut().unwrap() ^= 1;
        assert!(unpacked(&bytes).unwrap_err().to_string().contains("checksum"));
    }

    proptest! {
        #[test]
        fn a_stream_cut_short_is_an_error(data in proptest::collection::vec(0..4_u8, 1..500), cut in 1..10_000_usize) {
            let bytes = packed(&data);
            let cut = 1 + cut % (bytes.len() - 1);
            prop_assert_eq!(unpacked(&bytes[..cut]).unwrap_err().kind(), io::ErrorKind::UnexpectedEof);
            prop_assert_eq!(unpacked(&bytes).unwrap(), data);
        }
    }
}
