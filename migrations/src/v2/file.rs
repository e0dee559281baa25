//! Files of records: those of format 1, with more kinds of records, and long records cut into several.
//!
//! The payload of a [`RecordKind`] above [`RecordKind::State`], the table of a history file and its end excepted, is
//! one piece of a long record: a byte, 1 where another piece follows and 0 in the last, and then up to [`PIECE_MAX`]
//! bytes.
//!
//! Invariant: a record of format 1 is the same to the byte.

use crate::v1::{
    file::{RECORD_HEADER_LENGTH, RECORD_MAX},
    u32_at,
};

/// First bytes of a history file; the position in its header is the generation.
pub const HISTORY_MAGIC: [u8; 8] = *b"tidemhst";
/// Most bytes of a long record in one piece.
pub const PIECE_MAX: usize = RECORD_MAX - 1;

/// What a record is.
#[derive(Clone, Copy, Debug, PartialEq, Eq, prost::Enumeration)]
#[repr(i32)]
pub enum RecordKind {
    /// [`super::map::MapSpec`].
    Spec = 1,
    /// [`super::map::Snapshot`], the first of a checkpoint.
    Snapshot = 2,
    /// [`super::map::Producer`], in the order of their numbers.
    Producer = 3,
    /// [`super::map::State`], in the order of their numbers.
    State = 4,
    /// [`super::grid::Grid`], the first of a grid.
    Grid = 5,
    /// Sums of phasors that tiles share: doubles, little-endian. Numbered from 0 in their order, each before the first
    /// tile that refers to it.
    SharedSum = 6,
    /// [`super::grid::Tile`], in the order of their numbers.
    Tile = 7,
    /// [`super::grid::TileModel`] of the tile before.
    TileModel = 8,
    /// Sums of the tile before: number of groups u32, number of changed cells u32, per group the number of its shared
    /// sum u32, per cell its sums as doubles; little-endian. The length u32 of a [`super::grid::Sightings`] and the
    /// message may follow. Where the groups have readings of other sensors than the map's own the highest bit of the
    /// number of changed cells is set, and behind the numbers of the shared sums come those of two more per group u32:
    /// of phasors weighted by α and by β, both 2^32 - 1 where a group has none.
    TileSums = 9,
    /// [`super::grid::Day`].
    Day = 10,
    /// [`super::grid::DayTile`] of the day before, ascending by tile.
    DayTile = 11,
    /// [`super::grid::AheadScan`].
    AheadScan = 12,
    /// [`super::history::StateSamples`], ascending by state.
    StateSamples = 13,
    /// [`super::history::ENTRIES_MAX`] entries of the table of a history file, the last record fewer.
    Table = 14,
    /// [`super::history::End`], the last record of a history file.
    End = 15,
    /// Of the file of an update; no longer written.
    Update = 16,
    /// Of the file of an update; no longer written.
    DoneTile = 17,
    /// [`super::site::Site`], after the last state, if the snapshot has one.
    Site = 18,
}

/// Header of a record: kind u8, zero u8 × 3, payload length u32, payload CRC-32C u32, CRC-32C of the 12 bytes before.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct RecordHeader {
    /// What the record is.
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
    use crate::tests::format_1;

    #[test]
    fn records_of_format_1_are_the_same() {
        let kinds = [
            (format_1::RecordKind::Spec, RecordKind::Spec),
            (format_1::RecordKind::Snapshot, RecordKind::Snapshot),
            (format_1::RecordKind::Producer, RecordKind::Producer),
            (format_1::RecordKind::State, RecordKind::State),
        ];
        for (old, new) in kinds {
            let old = format_1::RecordHeader { kind: old, payload_length: 70, payload_crc: 5 };
            let new = RecordHeader { kind: new, payload_length: 70, payload_crc: 5 };
            assert_eq!(new.encode(), old.encode());
        }
    }

    #[test]
    fn headers_come_back_and_every_flipped_bit_is_noticed() {
        assert!(RecordKind::try_from(0).is_err() && RecordKind::try_from(19).is_err());
        for kind in (1..=18).map(|number| RecordKind::try_from(number).expect("a kind")) {
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
