//! Files of records: `MAP` and checkpoints.
//!
//! A file is a header, records, and a trailer after which nothing follows. A record is its header and a payload.
//!
//! Invariant: the trailer holds the number of records and the CRC of every byte before it; a file without a trailer
//! is incomplete.

use super::{FORMAT, u32_at, u64_at};

/// First bytes of a map's `MAP`.
pub const MAP_MAGIC: [u8; 8] = *b"tidemmap";
/// First bytes of a checkpoint.
pub const CHECKPOINT_MAGIC: [u8; 8] = *b"tidemchk";
/// Length of a file's header.
pub const FILE_HEADER_LENGTH: usize = 28;
/// Length of a record's header.
pub const RECORD_HEADER_LENGTH: usize = 16;
/// Length of the trailer.
pub const TRAILER_LENGTH: usize = 16;
/// Most bytes of a record's payload.
pub const RECORD_MAX: usize = 1 << 20;

/// Header of a file: magic 8, format u32, map u32, position u64, CRC-32C of the 24 bytes before.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct FileHeader {
    /// [`MAP_MAGIC`] or [`CHECKPOINT_MAGIC`].
    pub magic: [u8; 8],
    /// Number of the map.
    pub map: u32,
    /// Log position; 0 in `MAP`.
    pub position: u64,
}

impl FileHeader {
    pub fn encode(&self) -> [u8; FILE_HEADER_LENGTH] {
        let mut bytes = [0; FILE_HEADER_LENGTH];
        bytes[..8].copy_from_slice(&self.magic);
        bytes[8..12].copy_from_slice(&FORMAT.to_le_bytes());
        bytes[12..16].copy_from_slice(&self.map.to_le_bytes());
        bytes[16..24].copy_from_slice(&self.position.to_le_bytes());
        let crc = crc32c::crc32c(&bytes[..24]);
        bytes[24..].copy_from_slice(&crc.to_le_bytes());
        bytes
    }

    /// The header at the start of `bytes`, if it is complete and valid.
    pub fn decode(bytes: &[u8]) -> Option<FileHeader> {
        let bytes = bytes.get(..FILE_HEADER_LENGTH)?;
        let sound = u32_at(bytes, 8) == FORMAT && u32_at(bytes, 24) == crc32c::crc32c(&bytes[..24]);
        let magic = bytes[..8].try_into().ok()?;
        sound.then(|| FileHeader { magic, map: u32_at(bytes, 12), position: u64_at(bytes, 16) })
    }
}

/// End of a file: 0xFF, zero u8 × 3, CRC-32C u32 of all bytes before the trailer, number of records u32, CRC-32C of the
/// 12 bytes before.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Trailer {
    /// CRC-32C of all bytes before the trailer.
    pub total_crc: u32,
    /// Number of records.
    pub records: u32,
}

impl Trailer {
    pub fn encode(&self) -> [u8; TRAILER_LENGTH] {
        let mut bytes = [0; TRAILER_LENGTH];
        bytes[0] = 0xFF;
        bytes[4..8].copy_from_slice(&self.total_crc.to_le_bytes());
        bytes[8..12].copy_from_slice(&self.records.to_le_bytes());
        let crc = crc32c::crc32c(&bytes[..12]);
        bytes[12..].copy_from_slice(&crc.to_le_bytes());
        bytes
    }

    /// The trailer at the start of `bytes`, if it is complete and valid.
    pub fn decode(bytes: &[u8]) -> Option<Trailer> {
        let bytes = bytes.get(..TRAILER_LENGTH)?;
        let sound = bytes[..4] == [0xFF, 0, 0, 0] && u32_at(bytes, 12) == crc32c::crc32c(&bytes[..12]);
        sound.then(|| Trailer { total_crc: u32_at(bytes, 4), records: u32_at(bytes, 8) })
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::tests::format_1::{RecordHeader, RecordKind};

    #[test]
    fn headers_come_back_and_every_flipped_bit_is_noticed() {
        let header = FileHeader { magic: CHECKPOINT_MAGIC, map: 3, position: 9 };
        let record = RecordHeader { kind: RecordKind::State, payload_length: 70, payload_crc: 5 };
        let trailer = Trailer { total_crc: 77, records: 12 };
        assert_eq!(FileHeader::decode(&header.encode()), Some(header));
        assert_eq!(RecordHeader::decode(&record.encode()), Some(record));
        assert_eq!(Trailer::decode(&trailer.encode()), Some(trailer));
        for bit in 0..FILE_HEADER_LENGTH * 8 {
            let mut bytes = header.encode();
            bytes[bit / 8] ^= 1 << (bit % 8);
            assert_eq!(FileHeader::decode(&bytes), None, "bit {bit}");
        }
        for bit in 0..RECORD_HEADER_LENGTH * 8 {
            let mut bytes = record.encode();
            bytes[bit / 8] ^= 1 << (bit % 8);
            assert_eq!(RecordHeader::decode(&bytes), None, "bit {bit}");
            let mut bytes = trailer.encode();
            bytes[bit / 8] ^= 1 << (bit % 8);
            assert_eq!(Trailer::decode(&bytes), None, "bit {bit}");
        }
    }
}
