//! Payloads of the log's frames.
//!
//! A column holds one value per accepted observation, or a single value if all are equal:
//! - states: the numbers of the states as varints;
//! - times: the differences from one time to the next in units of `time_unit_nanos`, as zigzag varints;
//! - values: by their encoding, [`VALUES_BITS`], [`VALUES_DOUBLES`] or [`VALUES_FLOATS`].
//!
//! For scans, a column of numbers holds one varint per scan, or a single varint if all are equal. A set of tiles is
//! written as the tiles in which it differs from the set before: the number of ranges of tile ids, and for each range
//! the number of ids between it and the range before, and its length less 1. The set before the first set of a message
//! is empty.
//!
//! Invariant: the lengths of the columns follow from `count` and from the columns of counts, so a column that was cut
//! or lengthened is detected.

/// The values are bits, the first in the lowest bit of the first byte, padded with zero bits: 0.0 or 1.0.
pub const VALUES_BITS: u32 = 0;
/// The values are doubles of eight bytes.
pub const VALUES_DOUBLES: u32 = 1;
/// The values are floats of four bytes.
pub const VALUES_FLOATS: u32 = 2;

/// A state that appears for the first time.
#[derive(Clone, PartialEq, prost::Message)]
pub struct NewState {
    #[prost(uint32, tag = "1")]
    pub id: u32,
    #[prost(string, tag = "2")]
    pub name: String,
    /// Kind of the state: 0 probability, 1 continuous, 2 count, 3 a vector of 2 coordinates, 4 a vector of 3
    /// coordinates, 5 an angle, 6 a categorical state. Values of all kinds but probabilities are from -1e12 to 1e12. A
    /// vector is as many states of kind 1 as it has coordinates, with the names NAME/x, NAME/y and NAME/z, with the
    /// number `id` and the numbers after it. An angle is two such states, NAME/cos and NAME/sin. A categorical state is
    /// a probability NAME/LABEL for each of `labels`, in their order.
    #[prost(uint32, tag = "3")]
    pub kind: u32,
    /// The sensor that was stated for the state; only of kind 0.
    #[prost(message, optional, tag = "4")]
    pub sensor: Option<super::map::Sensor>,
    /// The reporting of the state; absent: each of its rows is a reading.
    #[prost(message, optional, tag = "5")]
    pub reporting: Option<super::rows::Reporting>,
    /// The labels, 2 to 64; only of kind 6.
    #[prost(string, repeated, tag = "6")]
    pub labels: Vec<String>,
}

/// The start of an update.
#[derive(Clone, PartialEq, prost::Message)]
pub struct UpdateStart {
    /// Number of the generation.
    #[prost(uint64, tag = "1")]
    pub generation: u64,
    /// The cut: earlier observations are learned, later ones are pending.
    #[prost(sint64, tag = "2")]
    pub cut_nanos: i64,
    /// 1 request, 2 midnight, 3 data time, 4 pending limit.
    #[prost(uint32, tag = "3")]
    pub cause: u32,
}

/// Observations of one producer that became durable together.
#[derive(Clone, PartialEq, prost::Message)]
pub struct Observations {
    /// Number of the producer.
    #[prost(uint32, tag = "1")]
    pub producer: u32,
    /// The producer, if this is its first record.
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
    /// Time at which the observations were received.
    #[prost(sint64, tag = "7")]
    pub received_nanos: i64,
    /// States that appear for the first time.
    #[prost(message, repeated, tag = "8")]
    pub new_states: Vec<NewState>,
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
    /// Encoding of the values.
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
    /// Reason of each refusal: 1 value, 2 time, 3 state name, 4 state index, 5 state limit, 6 state kind, 12 edge; in a
    /// map without a grid the reasons of scans, too.
    #[prost(uint32, repeated, tag = "19")]
    pub refused_reasons: Vec<u32>,
    /// Traversals that failed. Each failure is also an observation.
    #[prost(message, repeated, tag = "20")]
    pub failures: Vec<super::site::EdgeFailure>,
    /// Reports of tasks, each with an observation of its state.
    #[prost(message, repeated, tag = "21")]
    pub runs: Vec<super::task::TaskRun>,
}

/// Scans of one producer that became durable together.
#[derive(Clone, PartialEq, prost::Message)]
pub struct Scans {
    /// Number of the producer.
    #[prost(uint32, tag = "1")]
    pub producer: u32,
    /// The producer, if this is its first record.
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
    /// Running CRC-32C of the data that the producer sent.
    #[prost(fixed32, tag = "6")]
    pub content_crc: u32,
    /// Time at which the scans were received.
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
    /// For each scan that has other tiles than the scan before: the number of scans between it and the last scan listed
    /// here, and the set of tiles.
    #[prost(bytes = "vec", tag = "15")]
    pub seen: Vec<u8>,
    /// Column: number of observed bits that each scan flips.
    #[prost(bytes = "vec", tag = "16")]
    pub observed_counts: Vec<u8>,
    /// Column: number of occupied bits that each scan flips.
    #[prost(bytes = "vec", tag = "17")]
    pub occupied_counts: Vec<u8>,
    /// Cells whose observed bit is flipped, scan by scan: the number of cells between each cell and the one before, as
    /// varints.
    #[prost(bytes = "vec", tag = "18")]
    pub observed_flips: Vec<u8>,
    /// Cells whose occupied bit is flipped, in the encoding of `observed_flips`.
    #[prost(bytes = "vec", tag = "19")]
    pub occupied_flips: Vec<u8>,
    /// Tiles all of whose observed bits are flipped; their cells are neither among `observed_flips` nor in
    /// `observed_counts`. For each scan with such tiles: the number of scans between it and the last scan listed here,
    /// and the set of tiles as the difference from the empty set.
    #[prost(bytes = "vec", tag = "20")]
    pub observed_tiles: Vec<u8>,
    /// Sequence numbers of refused scans, each as the difference from the one before.
    #[prost(uint64, repeated, tag = "21")]
    pub refused_sequences: Vec<u64>,
    /// Reason of each refusal: 1 to 6 as for observations, 7 no grid, 8 malformed scan, 9 empty scan, 10 tile limit, 11
    /// frame.
    #[prost(uint32, repeated, tag = "22")]
    pub refused_reasons: Vec<u32>,
    /// The cells that the scans are pictures of; absent if no scan states them.
    #[prost(message, optional, tag = "23")]
    pub shown: Option<super::map::CellBox>,
    /// Lengths of the runs of scans of one source; empty if all scans state cells.
    #[prost(uint32, repeated, tag = "24")]
    pub source_counts: Vec<u32>,
    /// Source of each run: 0 for scans that state cells, 129 plus the height for rays.
    #[prost(sint32, repeated, tag = "25")]
    pub sources: Vec<i32>,
}

/// Producers that will not return give up their places.
#[derive(Clone, PartialEq, prost::Message)]
pub struct ForgetProducers {
    /// Numbers of the producers.
    #[prost(uint32, repeated, tag = "1")]
    pub producers: Vec<u32>,
}
