//! Files of records: `MAP`, checkpoints and history files.
//!
//! A file is a header, records, and a trailer after which nothing follows. A record is its header and a payload. The
//! payload of a [`RecordKind`] above [`RecordKind::State`], except the table of a history file and its end, is one
//! piece of a long record: a byte, 1 if another piece follows and 0 in the last piece, and then up to [`PIECE_MAX`]
//! bytes.
//!
//! Invariant: the trailer holds the number of records and the CRC of all bytes before it; a file without a trailer is
//! incomplete.

use super::{FORMAT, u32_at, u64_at};

/// First bytes of a map's `MAP`.
pub const MAP_MAGIC: [u8; 8] = *b"tidemmap";
/// First bytes of a checkpoint.
pub const CHECKPOINT_MAGIC: [u8; 8] = *b"tidemchk";
/// First bytes of a history file; the position in its header is the generation.
pub const HISTORY_MAGIC: [u8; 8] = *b"tidemhst";
/// Length of a file's header.
pub const FILE_HEADER_LENGTH: usize = 28;
/// Length of a record's header.
pub const RECORD_HEADER_LENGTH: usize = 16;
/// Length of the trailer.
pub const TRAILER_LENGTH: usize = 16;
/// Most bytes of a record's payload.
pub const RECORD_MAX: usize = 1 << 20;
/// Most bytes of a long record in one piece.
pub const PIECE_MAX: usize = RECORD_MAX - 1;

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

/// The kind of a record.
#[derive(Clone, Copy, Debug, PartialEq, Eq, prost::Enumeration)]
#[repr(i32)]
pub enum RecordKind {
    /// [`super::map::MapSpec`].
    Spec = 1,
    /// [`super::map::Snapshot`], the first record of a checkpoint.
    Snapshot = 2,
    /// [`super::map::Producer`], in the order of the producers' numbers.
    Producer = 3,
    /// [`super::map::State`], in the order of the states' numbers.
    State = 4,
    /// [`super::grid::Grid`], the first record of a grid.
    Grid = 5,
    /// A sum of phasors that tiles share: doubles, little-endian. The sums are numbered from 0 in their order; each
    /// comes before the first tile that refers to it.
    SharedSum = 6,
    /// [`super::grid::Tile`], in the order of the tiles' numbers.
    Tile = 7,
    /// [`super::grid::TileModel`] of the tile before.
    TileModel = 8,
    /// Sums of the tile before: number of groups u32, number of changed cells u32, for each group the number of its
    /// shared sum u32, for each cell its sums as doubles; little-endian. The length u32 of a [`super::grid::Sightings`]
    /// and the message follow. If the groups have readings of other sensors than the sensor of the map, the highest bit
    /// of the number of changed cells is set, and after the numbers of the shared sums there are two more numbers u32
    /// for each group: of the sums of phasors weighted by α and by β, both 2^32 - 1 if the group has none.
    TileSums = 9,
    /// [`super::grid::Day`].
    Day = 10,
    /// [`super::grid::DayTile`] of the day before, ascending by tile.
    DayTile = 11,
    /// [`super::grid::AheadScan`].
    AheadScan = 12,
    /// [`super::history::StateSamples`], ascending by state.
    StateSamples = 13,
    /// [`super::history::ENTRIES_MAX`] entries of the table of a history file; the last record may have fewer.
    Table = 14,
    /// [`super::history::End`], the last record of a history file.
    End = 15,
    /// [`super::site::TableRow`], after the last state, ascending by table.
    TableRow = 16,
}

/// Header of a record: kind u8, zero u8 × 3, payload length u32, payload CRC-32C u32, CRC-32C of the 12 bytes before.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct RecordHeader {
    /// The kind of the record.
    pub kind: RecordKind,
    /// Length of the payload.
    pub payload_length: u32,
    /// CRC-32C of the payload.
    pub payload_crc: u32,
}

impl RecordHeader {
    pub fn encode(&self) -> [u8; RECORD_HEADER_LENGTH] {
        let mut bytes = [0; RECORD_HEADER_LENGTH];
        bytes[0] = self.kind as u8;
        bytes[4..8].copy_from_slice(&self.payload_length.to_le_bytes());
        bytes[8..12].copy_from_slice(&self.payload_crc.to_le_bytes());
        let crc = crc32c::crc32c(&bytes[..12]);
        bytes[12..].copy_from_slice(&crc.to_le_bytes());
        bytes
    }

    /// The header at the start of `bytes`, if it is complete and valid.
    pub fn decode(bytes: &[u8]) -> Option<RecordHeader> {
        let bytes = bytes.get(..RECORD_HEADER_LENGTH)?;
        let kind = RecordKind::try_from(i32::from(bytes[0])).ok()?;
        let payload_length = u32_at(bytes, 4);
        let sound = bytes[1..4] == [0, 0, 0]
            && payload_length as usize <= RECORD_MAX
            && u32_at(bytes, 12) == crc32c::crc32c(&bytes[..12]);
        sound.then(|| RecordHeader { kind, payload_length, payload_crc: u32_at(bytes, 8) })
    }
}

#[cfg(test)]
mod tests {
    use super::*;

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

    #[test]
    fn records_of_every_kind_come_back_and_every_flipped_bit_is_noticed() {
        assert!(RecordKind::try_from(0).is_err() && RecordKind::try_from(17).is_err());
        for kind in (1..=16).map(|number| RecordKind::try_from(number).expect("a kind")) {
            let record = RecordHeader { kind, payload_length: 70, payload_crc: 5 };
            assert_eq!(RecordHeader::decode(&record.encode()), Some(record));
            for bit in 0..RECORD_HEADER_LENGTH * 8 {
                let mut bytes = record.encode();
                bytes[bit / 8] ^= 1 << (bit % 8);
                assert_eq!(RecordHeader::decode(&bytes), None, "bit {bit}");
            }
        }
    }
}
