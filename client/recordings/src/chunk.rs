//! Decompression of a block of messages.
//!
//! Invariant: at most [`UNPACKED_BYTES_MAX`] bytes come out, whatever goes in.

use std::io::Read;

use bzip2::read::BzDecoder;
use lz4_flex::frame::FrameDecoder;

use crate::{
    recording::{MESSAGE_BYTES_MAX, RecordingError, UNPACKED_BYTES_MAX},
    zstd_stream::ZstdStream,
};

const ZSTD_MAGIC: [u8; 4] = [0x28, 0xb5, 0x2f, 0xfd];

/// The bytes of a block: `stored` itself where it is not compressed, else `buffer`. `what` is the block, and where it
/// is, for errors.
pub(crate) fn unpack<'a>(
    compression: &str,
    stored: &'a [u8],
    buffer: &'a mut Vec<u8>,
    what: &str,
) -> Result<&'a [u8], RecordingError> {
    match compression {
        "" | "none" => Ok(stored),
        "bz2" => drain(BzDecoder::new(stored), buffer, UNPACKED_BYTES_MAX, what),
        "lz4" => drain(FrameDecoder::new(stored), buffer, UNPACKED_BYTES_MAX, what),
        "zstd" => drain(ZstdStream::new(stored), buffer, UNPACKED_BYTES_MAX, what),
        other => Err(RecordingError::Unknown(format!(
            "{what} is compressed with {:?}; none, bz2, lz4 and zstd are read: record it anew or convert it",
            shortened(other)
        ))),
    }
}

/// The bytes of a message in CDR, which rosbag2 may have compressed with zstd on its own: CDR begins with a byte 0,
/// zstd never does.
pub(crate) fn cdr_bytes<'a>(
    stored: &'a [u8],
    buffer: &'a mut Vec<u8>,
    what: impl FnOnce() -> String,
) -> Result<&'a [u8], RecordingError> {
    if stored.starts_with(&ZSTD_MAGIC) {
        drain(ZstdStream::new(stored), buffer, MESSAGE_BYTES_MAX, &what())
    } else {
        Ok(stored)
    }
}

/// The first characters of a name that the file gives.
pub(crate) fn shortened(name: &str) -> String {
    name.chars().take(80).collect()
}

fn drain<'a>(
    unpacking: impl Read,
    buffer: &'a mut Vec<u8>,
    max: usize,
    what: &str,
) -> Result<&'a [u8], RecordingError> {
    buffer.clear();
    let limit = max as u64 + 1;
    match unpacking.take(limit).read_to_end(buffer) {
        Ok(_) if buffer.len() > max => {
            Err(RecordingError::TooLarge { what: format!("{what}, decompressed,"), bytes: limit, max })
        }
        Ok(_) => Ok(buffer),
        Err(error) => Err(RecordingError::Broken(format!("{what} cannot be decompressed: {error}"))),
    }
}

#[cfg(test)]
mod tests {
    use std::io::Write;

    use proptest::prelude::*;
    use ruzstd::encoding::{CompressionLevel, compress_to_vec};

    use super::*;

    fn packed(compression: &str, bytes: &[u8]) -> Vec<u8> {
        match compression {
            "bz2" => {
                let mut encoder = bzip2::write::BzEncoder::new(Vec::new(), bzip2::Compression::fast());
                encoder.write_all(bytes).unwrap();
                encoder.finish().unwrap()
            }
            "lz4" => {
                let mut encoder = lz4_flex::frame::FrameEncoder::new(Vec::new());
                encoder.write_all(bytes).unwrap();
                encoder.finish().unwrap()
            }
            "zstd" => compress_to_vec(bytes, CompressionLevel::Fastest),
            _ => bytes.to_vec(),
        }
    }

    fn names() -> impl Strategy<Value = &'static str> {
        prop_oneof![Just("none"), Just("bz2"), Just("lz4"), Just("zstd")]
    }

    #[test]
    fn an_unknown_compression_is_named() {
        let error = unpack("xz", b"", &mut Vec::new(), "the chunk at byte 13").unwrap_err();
        assert!(error.to_string().starts_with("the chunk at byte 13 is compressed with \"xz\""), "{error}");
    }

    #[test]
    fn a_block_longer_than_the_limit_is_refused() {
        let bomb = packed("lz4", &vec![0; UNPACKED_BYTES_MAX + 1]);
        let error = unpack("lz4", &bomb, &mut Vec::new(), "the chunk").unwrap_err();
        assert!(matches!(error, RecordingError::TooLarge { max: UNPACKED_BYTES_MAX, .. }), "{error}");
    }

    #[test]
    fn a_message_is_decompressed_if_it_begins_as_zstd() {
        let message = [0, 1, 0, 0, 5, 6];
        assert_eq!(cdr_bytes(&packed("zstd", &message), &mut Vec::new(), String::new).unwrap(), message);
        assert_eq!(cdr_bytes(&message, &mut Vec::new(), String::new).unwrap(), message);
    }

    proptest! {
        #[test]
        fn what_was_compressed_comes_out(name in names(), data in proptest::collection::vec(any::<u8>(), 0..2000)) {
            let (stored, mut buffer) = (packed(name, &data), Vec::new());
            prop_assert_eq!(unpack(name, &stored, &mut buffer, "").unwrap(), &data);
        }

        #[test]
        fn a_changed_byte_does_no_harm(
            name in names(), data in proptest::collection::vec(0..4_u8, 1..500), place in any::<usize>(), with in 1..=255_u8,
        ) {
            let mut stored = packed(name, &data);
            let place = place % stored.len();
            stored[place] ^= with;
            let mut buffer = Vec::new();
            if let Ok(unpacked) = unpack(name, &stored, &mut buffer, "") {
                prop_assert!(unpacked.len() <= UNPACKED_BYTES_MAX);
            }
        }
    }
}
