//! Exact observations of one generation.
//!
//! A history file is a file of records: the observations, a table of their offsets, and [`End`]. A file of states has
//! [`StateSamples`], whose key in the table is the number of the state. A file of a grid has days in the form of a
//! checkpoint ([`super::grid::Day`], each followed by its [`super::grid::DayTile`]). The key of a day is its place in
//! the file times 2^32; the key of a tile is the key of its day + 1 + the number of the tile.
//!
//! Invariant: keys ascend, and the last 16 + [`END_LENGTH`] bytes before the trailer are the record [`End`], so a
//! part can be found without reading the rest.

use super::{u32_at, u64_at};

/// Entries of one record of the table; the last one may have fewer.
pub const ENTRIES_MAX: usize = 4096;
/// Length of an entry of the table.
pub const ENTRY_LENGTH: usize = 20;
/// Length of the payload of [`End`].
pub const END_LENGTH: usize = 40;

/// Exact observations of one state, in order of arrival.
#[derive(Clone, PartialEq, prost::Message)]
pub struct StateSamples {
    /// Number of the state.
    #[prost(uint32, tag = "1")]
    pub state: u32,
    /// Number of observations.
    #[prost(uint32, tag = "2")]
    pub count: u32,
    /// Time of the first observation.
    #[prost(int64, tag = "3")]
    pub first_time_nanos: i64,
    /// Unit of the differences of times.
    #[prost(uint64, tag = "4")]
    pub time_unit_nanos: u64,
    /// Column of differences of times, as in the log.
    #[prost(bytes = "vec", tag = "5")]
    pub times: Vec<u8>,
    /// Encoding of the values, as in the log.
    #[prost(uint32, tag = "6")]
    pub value_encoding: u32,
    /// Column of values.
    #[prost(bytes = "vec", tag = "7")]
    pub values: Vec<u8>,
    /// Lengths of the runs of equal UTC offsets.
    #[prost(uint32, repeated, tag = "8")]
    pub offset_counts: Vec<u32>,
    /// Offset of each run.
    #[prost(sint32, repeated, tag = "9")]
    pub offset_secs: Vec<i32>,
    /// Lengths of the runs of observations of one producer that arrived one after the other.
    #[prost(uint32, repeated, tag = "10")]
    pub run_counts: Vec<u32>,
    /// Producer of each run.
    #[prost(uint32, repeated, tag = "11")]
    pub run_producers: Vec<u32>,
    /// Number of the first observation of each run among the observations of the state, less the number that follows
    /// the run before; for the first run, less 0.
    #[prost(sint64, repeated, tag = "12")]
    pub run_steps: Vec<i64>,
    /// Number of the last observations that had waited because their time was later than the clock.
    #[prost(uint32, tag = "13")]
    pub ahead: u32,
    /// Number of the last observation of the state that had arrived when the update began; 0 if none had waited.
    #[prost(uint64, tag = "14")]
    pub arrived: u64,
    /// Whether the update ran early, to free memory.
    #[prost(bool, tag = "15")]
    pub is_early: bool,
    /// This field has no meaning any more.
    #[prost(bool, tag = "16")]
    pub is_crowded: bool,
    /// Lengths of the runs of equal values, varints; then the column of values has one value for each run. Empty if
    /// values are not stored in runs.
    #[prost(bytes = "vec", tag = "17")]
    pub value_runs: Vec<u8>,
    /// Lengths of the runs of equal differences of times, varints; then the column of times has one difference for each
    /// run. Empty if times are not stored in runs.
    #[prost(bytes = "vec", tag = "18")]
    pub time_runs: Vec<u8>,
}

/// An entry of the table: key u64, offset u64 of the first record in the file, number of records u32.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Entry {
    pub key: u64,
    /// Offset of the first record in the file.
    pub offset: u64,
    /// Number of records.
    pub records: u32,
}

impl Entry {
    pub fn encode(&self) -> [u8; ENTRY_LENGTH] {
        let mut bytes = [0; ENTRY_LENGTH];
        bytes[..8].copy_from_slice(&self.key.to_le_bytes());
        bytes[8..16].copy_from_slice(&self.offset.to_le_bytes());
        bytes[16..].copy_from_slice(&self.records.to_le_bytes());
        bytes
    }

    /// The entry of these bytes.
    pub fn decode(bytes: &[u8; ENTRY_LENGTH]) -> Entry {
        Entry { key: u64_at(bytes, 0), offset: u64_at(bytes, 8), records: u32_at(bytes, 16) }
    }
}

/// The end of a history file: offset of the table u64, entries u64, smallest time i64, greatest time i64, days
/// u64.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct End {
    /// Offset of the table's first record.
    pub table: u64,
    /// Number of entries of the table.
    pub entries: u64,
    /// Smallest time of the observations.
    pub from_nanos: i64,
    /// Greatest time of the observations.
    pub to_nanos: i64,
    /// Number of days; 0 in a file of states.
    pub days: u64,
}

impl End {
    pub fn encode(&self) -> [u8; END_LENGTH] {
        let mut bytes = [0; END_LENGTH];
        bytes[..8].copy_from_slice(&self.table.to_le_bytes());
        bytes[8..16].copy_from_slice(&self.entries.to_le_bytes());
        bytes[16..24].copy_from_slice(&self.from_nanos.to_le_bytes());
        bytes[24..32].copy_from_slice(&self.to_nanos.to_le_bytes());
        bytes[32..].copy_from_slice(&self.days.to_le_bytes());
        bytes
    }

    /// The end of these bytes; `None` if their number is wrong.
    pub fn decode(bytes: &[u8]) -> Option<End> {
        let sound = bytes.len() == END_LENGTH;
        sound.then(|| End {
            table: u64_at(bytes, 0),
            entries: u64_at(bytes, 8),
            from_nanos: u64_at(bytes, 16).cast_signed(),
            to_nanos: u64_at(bytes, 24).cast_signed(),
            days: u64_at(bytes, 32),
        })
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn what_is_written_is_read() {
        let entry = Entry { key: 1 << 40, offset: 77, records: 3 };
        assert_eq!(Entry::decode(&entry.encode()), entry);
        let end = End { table: 1, entries: 2, from_nanos: -3, to_nanos: i64::MAX, days: 5 };
        assert_eq!(End::decode(&end.encode()), Some(end));
        assert_eq!(End::decode(&[0; 39]), None);
    }
}
