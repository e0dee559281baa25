//! Payloads of the log's frames of observations and of scans.
//!
//! A column of numbers holds one varint per scan, or a single one where all are equal. A set of tiles is written as the
//! tiles in which it differs from the set before: the number of ranges of tile ids, and per range how many ids lie
//! between it and the range before, and its length less 1. The set before the first of a message is empty.
//!
//! Invariant: the lengths of the columns follow from `count` and from the columns of counts, so a column that was
//! cut or lengthened is noticed.

/// Observations of one producer that became durable together: as in format 1, and the sensor of a new producer and
/// traversals that failed.
#[derive(Clone, PartialEq, prost::Message)]
pub struct Observations {
    /// Number of the producer.
    #[prost(uint32, tag = "1")]
    pub producer: u32,
    /// The producer, where this is its first record.
    #[prost(message, optional, tag = "2")]
    pub new_producer: Option<super::map::NewProducer>,
    /// The producer's incarnation.
    #[prost(uint64, tag = "3")]
    pub incarnation: u64,
    /// Sequence number of the first observation, refused ones included.
    #[prost(uint64, tag = "4")]
    pub first_sequence: u64,
    /// Sequence number of the last observation, refused ones included.
    #[prost(uint64, tag = "5")]
    pub last_sequence: u64,
    /// Running CRC-32C of the producer's observations.
    #[prost(fixed32, tag = "6")]
    pub content_crc: u32,
    /// When they were received.
    #[prost(sint64, tag = "7")]
    pub received_nanos: i64,
    /// States that appear for the first time.
    #[prost(message, repeated, tag = "8")]
    pub new_states: Vec<crate::v1::event::NewState>,
    /// Number of accepted observations.
    #[prost(uint32, tag = "9")]
    pub count: u32,
    /// Column of states.
    #[prost(bytes = "vec", tag = "10")]
    pub states: Vec<u8>,
    /// Time of the first accepted observation.
    #[prost(int64, tag = "11")]
    pub first_time_nanos: i64,
    /// Unit of the differences of times.
    #[prost(uint64, tag = "12")]
    pub time_unit_nanos: u64,
    /// Column of differences of times: `count` - 1 of them.
    #[prost(bytes = "vec", tag = "13")]
    pub times: Vec<u8>,
    /// How values are encoded.
    #[prost(uint32, tag = "14")]
    pub value_encoding: u32,
    /// Column of values.
    #[prost(bytes = "vec", tag = "15")]
    pub values: Vec<u8>,
    /// Lengths of the runs of equal UTC offsets.
    #[prost(uint32, repeated, tag = "16")]
    pub offset_counts: Vec<u32>,
    /// Offset of each run.
    #[prost(sint32, repeated, tag = "17")]
    pub offset_secs: Vec<i32>,
    /// Sequence numbers of refused observations, each as the difference from the one before.
    #[prost(uint64, repeated, tag = "18")]
    pub refused_sequences: Vec<u64>,
    /// Why each was refused: 1 value, 2 time, 3 state name, 4 state index, 5 state limit, 6 state kind, 12 edge; in a
    /// map without a grid those of scans, too.
    #[prost(uint32, repeated, tag = "19")]
    pub refused_reasons: Vec<u32>,
    /// Traversals that failed; that they did is also an observation of each.
    #[prost(message, repeated, tag = "20")]
    pub failures: Vec<super::site::EdgeFailure>,
}

/// Scans of one producer that became durable together.
#[derive(Clone, PartialEq, prost::Message)]
pub struct Scans {
    /// Number of the producer.
    #[prost(uint32, tag = "1")]
    pub producer: u32,
    /// The producer, where this is its first record.
    #[prost(message, optional, tag = "2")]
    pub new_producer: Option<super::map::NewProducer>,
    /// The producer's incarnation.
    #[prost(uint64, tag = "3")]
    pub incarnation: u64,
    /// Sequence number of the first scan, refused ones included.
    #[prost(uint64, tag = "4")]
    pub first_sequence: u64,
    /// Sequence number of the last scan, refused ones included.
    #[prost(uint64, tag = "5")]
    pub last_sequence: u64,
    /// Running CRC-32C of what the producer sent.
    #[prost(fixed32, tag = "6")]
    pub content_crc: u32,
    /// When they were received.
    #[prost(sint64, tag = "7")]
    pub received_nanos: i64,
    /// Tiles that appear for the first time: x, y, z of each as zigzag varints, as differences from the one before.
    #[prost(bytes = "vec", tag = "8")]
    pub new_tiles: Vec<u8>,
    /// Number of accepted scans.
    #[prost(uint32, tag = "9")]
    pub count: u32,
    /// Time of the first accepted scan.
    #[prost(int64, tag = "10")]
    pub first_time_nanos: i64,
    /// Unit of the differences of times.
    #[prost(uint64, tag = "11")]
    pub time_unit_nanos: u64,
    /// Column of differences of times: `count` - 1 of them.
    #[prost(bytes = "vec", tag = "12")]
    pub times: Vec<u8>,
    /// Lengths of the runs of equal UTC offsets.
    #[prost(uint32, repeated, tag = "13")]
    pub offset_counts: Vec<u32>,
    /// Offset of each run.
    #[prost(sint32, repeated, tag = "14")]
    pub offset_secs: Vec<i32>,
    /// If a scan has other tiles than the scan before: how many scans lie between this one and the last one that
    /// is named here, and the set of tiles.
    #[prost(bytes = "vec", tag = "15")]
    pub seen: Vec<u8>,
    /// Column: how many observed bits each scan flips.
    #[prost(bytes = "vec", tag = "16")]
    pub observed_counts: Vec<u8>,
    /// Column: how many occupied bits each scan flips.
    #[prost(bytes = "vec", tag = "17")]
    pub occupied_counts: Vec<u8>,
    /// Cells whose observed bit is flipped, scan by scan: how many cells lie between each and the one before, as
    /// varints.
    #[prost(bytes = "vec", tag = "18")]
    pub observed_flips: Vec<u8>,
    /// Cells whose occupied bit is flipped, likewise.
    #[prost(bytes = "vec", tag = "19")]
    pub occupied_flips: Vec<u8>,
    /// Tiles all of whose observed bits are flipped; their cells are neither among `observed_flips` nor in
    /// `observed_counts`. Where there are any: how many scans lie between this one and the last one that is named here,
    /// and the set of tiles as the difference from the empty one.
    #[prost(bytes = "vec", tag = "22")]
    pub observed_tiles: Vec<u8>,
    /// Sequence numbers of refused scans, each as the difference from the one before.
    #[prost(uint64, repeated, tag = "20")]
    pub refused_sequences: Vec<u64>,
    /// Why each was refused: as in format 1, and 7 no grid, 8 malformed scan, 9 empty scan, 10 tile limit, 11 frame.
    #[prost(uint32, repeated, tag = "21")]
    pub refused_reasons: Vec<u32>,
}

#[cfg(test)]
mod tests {
    use prost::Message as _;

    use super::*;
    use crate::{tests::format_1, v1};

    #[test]
    fn observations_of_format_1_have_no_failures() {
        let old = format_1::Observations {
            producer: 2,
            new_producer: Some(v1::map::ProducerKey { producer: "robot".to_owned(), label: "lidar".to_owned() }),
            incarnation: 1,
            first_sequence: 5,
            last_sequence: 7,
            content_crc: 6,
            received_nanos: -9,
            new_states: vec![v1::event::NewState { id: 1, name: "door".to_owned(), kind: 0 }],
            count: 3,
            states: vec![1],
            first_time_nanos: 1 << 60,
            time_unit_nanos: 1000,
            times: vec![2, 2],
            value_encoding: v1::event::VALUES_BITS,
            values: vec![5],
            offset_counts: vec![3],
            offset_secs: vec![3600],
            refused_sequences: vec![],
            refused_reasons: vec![],
        };
        let new = Observations::decode(&old.encode_to_vec()[..]).expect("a message");
        assert_eq!((new.failures.len(), new.encode_to_vec()), (0, old.encode_to_vec()));
    }
}
