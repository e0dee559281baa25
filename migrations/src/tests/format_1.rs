//! The layouts of format 1 that format 2 extends, as they were: the tests compare the present ones with them.

use crate::v1::{
    event::NewState,
    file::{RECORD_HEADER_LENGTH, RECORD_MAX},
    log::{FRAME_HEADER_LENGTH, FRAME_VERSION, PAYLOAD_MAX, body_length},
    map::{Accumulator, LastObservation, ProducerKey, Spectral},
    u32_at, u64_at,
};

/// Observations of one producer that became durable together.
#[derive(Clone, PartialEq, prost::Message)]
pub(crate) struct Observations {
    /// Number of the producer.
    #[prost(uint32, tag = "1")]
    pub(crate) producer: u32,
    /// The producer's key, if this is its first record.
    #[prost(message, optional, tag = "2")]
    pub(crate) new_producer: Option<ProducerKey>,
    /// The producer's incarnation.
    #[prost(uint64, tag = "3")]
    pub(crate) incarnation: u64,
    /// Sequence number of the first observation, refused ones included.
    #[prost(uint64, tag = "4")]
    pub(crate) first_sequence: u64,
    /// Sequence number of the last observation, refused ones included.
    #[prost(uint64, tag = "5")]
    pub(crate) last_sequence: u64,
    /// Running CRC-32C of the producer's observations.
    #[prost(fixed32, tag = "6")]
    pub(crate) content_crc: u32,
    /// When they were received.
    #[prost(sint64, tag = "7")]
    pub(crate) received_nanos: i64,
    /// States that appear for the first time.
    #[prost(message, repeated, tag = "8")]
    pub(crate) new_states: Vec<NewState>,
    /// Number of accepted observations.
    #[prost(uint32, tag = "9")]
    pub(crate) count: u32,
    /// Column of states.
    #[prost(bytes = "vec", tag = "10")]
    pub(crate) states: Vec<u8>,
    /// Time of the first accepted observation.
    #[prost(int64, tag = "11")]
    pub(crate) first_time_nanos: i64,
    /// Unit of the differences of times.
    #[prost(uint64, tag = "12")]
    pub(crate) time_unit_nanos: u64,
    /// Column of differences of times: `count` - 1 of them.
    #[prost(bytes = "vec", tag = "13")]
    pub(crate) times: Vec<u8>,
    /// How values are encoded.
    #[prost(uint32, tag = "14")]
    pub(crate) value_encoding: u32,
    /// Column of values.
    #[prost(bytes = "vec", tag = "15")]
    pub(crate) values: Vec<u8>,
    /// Lengths of the runs of equal UTC offsets.
    #[prost(uint32, repeated, tag = "16")]
    pub(crate) offset_counts: Vec<u32>,
    /// Offset of each run.
    #[prost(sint32, repeated, tag = "17")]
    pub(crate) offset_secs: Vec<i32>,
    /// Sequence numbers of refused observations, each as the difference from the one before.
    #[prost(uint64, repeated, tag = "18")]
    pub(crate) refused_sequences: Vec<u64>,
    /// Why each was refused: 1 value, 2 time, 3 state name, 4 state index, 5 state limit, 6 state kind.
    #[prost(uint32, repeated, tag = "19")]
    pub(crate) refused_reasons: Vec<u32>,
}

/// The fixed properties of a map.
#[derive(Clone, PartialEq, prost::Message)]
pub(crate) struct MapSpec {
    #[prost(string, tag = "1")]
    pub(crate) name: String,
    /// IANA name of its time zone.
    #[prost(string, tag = "2")]
    pub(crate) zone: String,
    /// Base period of the harmonics; 0 if the periodicities are a list.
    #[prost(sint64, tag = "3")]
    pub(crate) harmonics_base_nanos: i64,
    /// Number of harmonics; 0 if the periodicities are a list.
    #[prost(uint32, tag = "4")]
    pub(crate) harmonics_count: u32,
    /// Periods, if the periodicities are a list.
    #[prost(sint64, repeated, tag = "5")]
    pub(crate) period_nanos: Vec<i64>,
    /// 1 squared error, 2 zero-one.
    #[prost(uint32, tag = "6")]
    pub(crate) criterion: u32,
    /// When it was created.
    #[prost(sint64, tag = "7")]
    pub(crate) created_nanos: i64,
}

/// What a snapshot says about itself.
#[derive(Clone, PartialEq, prost::Message)]
pub(crate) struct Snapshot {
    /// Log position of the update's start.
    #[prost(uint64, tag = "1")]
    pub(crate) position: u64,
    /// Log position from which pending observations are read again.
    #[prost(uint64, tag = "2")]
    pub(crate) replay_from: u64,
    /// Number of the generation.
    #[prost(uint64, tag = "3")]
    pub(crate) generation: u64,
    /// Cut of the last update.
    #[prost(sint64, tag = "4")]
    pub(crate) cut_nanos: i64,
    /// Greatest time of any observation.
    #[prost(sint64, tag = "5")]
    pub(crate) newest_nanos: i64,
    /// Number of producers.
    #[prost(uint32, tag = "6")]
    pub(crate) producers: u32,
    /// Number of states.
    #[prost(uint32, tag = "7")]
    pub(crate) states: u32,
}

/// How far a producer's sequence is durable.
#[derive(Clone, PartialEq, prost::Message)]
pub(crate) struct Producer {
    #[prost(uint32, tag = "1")]
    pub(crate) id: u32,
    /// Its key.
    #[prost(message, optional, tag = "2")]
    pub(crate) key: Option<ProducerKey>,
    /// Highest incarnation seen.
    #[prost(uint64, tag = "3")]
    pub(crate) incarnation: u64,
    /// Everything up to here is durable or refused.
    #[prost(uint64, tag = "4")]
    pub(crate) durable_sequence: u64,
    /// Running CRC-32C of its observations.
    #[prost(fixed32, tag = "5")]
    pub(crate) content_crc: u32,
}

/// One state. In the index it has no `spectrum`; the chunks of that have keys of their own.
#[derive(Clone, PartialEq, prost::Message)]
pub(crate) struct State {
    #[prost(uint32, tag = "1")]
    pub(crate) id: u32,
    #[prost(string, tag = "2")]
    pub(crate) name: String,
    /// Its kind: 0 probability; from format 2 on as in [`NewState`].
    #[prost(uint32, tag = "3")]
    pub(crate) kind: u32,
    /// Observations acknowledged.
    #[prost(uint64, tag = "4")]
    pub(crate) observations: u64,
    /// Persistence: pairs of successive observations.
    #[prost(uint64, tag = "5")]
    pub(crate) pairs: u64,
    /// Persistence: summed rate of change.
    #[prost(fixed64, tag = "6")]
    pub(crate) change_rate_sum_bits: u64,
    /// The newest observation, where there is one.
    #[prost(message, optional, tag = "7")]
    pub(crate) last: Option<LastObservation>,
    /// The accumulator without its spectrum.
    #[prost(message, optional, tag = "8")]
    pub(crate) accumulator: Option<Accumulator>,
    /// Per periodicity four doubles of eight bytes.
    #[prost(bytes = "vec", tag = "9")]
    pub(crate) spectrum: Vec<u8>,
    /// The spectral model.
    #[prost(message, optional, tag = "10")]
    pub(crate) spectral: Option<Spectral>,
    /// Number of components in force.
    #[prost(uint32, tag = "11")]
    pub(crate) order: u32,
    /// Faded sums of errors, orders 0 to 15.
    #[prost(fixed64, repeated, tag = "12")]
    pub(crate) error_sums_bits: Vec<u64>,
    /// Last local day recorded in the errors, in days since 1970-01-01.
    #[prost(sint32, optional, tag = "13")]
    pub(crate) errors_last_day: Option<i32>,
}

/// What a record is.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(crate) enum RecordKind {
    /// [`MapSpec`].
    Spec = 1,
    /// [`Snapshot`], the first of a checkpoint.
    Snapshot = 2,
    /// [`Producer`], in the order of their numbers.
    Producer = 3,
    /// [`State`], in the order of their numbers.
    State = 4,
}

/// Header of a record: kind u8, zero u8 × 3, payload length u32, payload CRC-32C u32, CRC-32C of the 12 bytes before.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(crate) struct RecordHeader {
    /// What the record is.
    pub(crate) kind: RecordKind,
    /// Length of the payload.
    pub(crate) payload_length: u32,
    /// CRC-32C of the payload.
    pub(crate) payload_crc: u32,
}

impl RecordHeader {
    pub(crate) fn encode(&self) -> [u8; RECORD_HEADER_LENGTH] {
        let mut bytes = [0; RECORD_HEADER_LENGTH];
        bytes[0] = self.kind as u8;
        bytes[4..8].copy_from_slice(&self.payload_length.to_le_bytes());
        bytes[8..12].copy_from_slice(&self.payload_crc.to_le_bytes());
        let crc = crc32c::crc32c(&bytes[..12]);
        bytes[12..].copy_from_slice(&crc.to_le_bytes());
        bytes
    }

    /// The header at the start of `bytes`, if it is complete and valid.
    pub(crate) fn decode(bytes: &[u8]) -> Option<RecordHeader> {
        let bytes = bytes.get(..RECORD_HEADER_LENGTH)?;
        let kind = match bytes[0] {
            1 => RecordKind::Spec,
            2 => RecordKind::Snapshot,
            3 => RecordKind::Producer,
            4 => RecordKind::State,
            _ => return None,
        };
        let payload_length = u32_at(bytes, 4);
        let sound = bytes[1..4] == [0, 0, 0]
            && payload_length as usize <= RECORD_MAX
            && u32_at(bytes, 12) == crc32c::crc32c(&bytes[..12]);
        sound.then(|| RecordHeader { kind, payload_length, payload_crc: u32_at(bytes, 8) })
    }
}

/// What a frame's payload is. The numbers have several bits set, so that no single flipped bit makes a first byte zero.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(crate) enum FrameKind {
    /// [`Observations`].
    Observations = b'O' as isize,
    /// [`UpdateStart`].
    UpdateStart = b'U' as isize,
}

/// Header of a frame: kind u8, version u8, zero u16, payload length u32, position u64, group index u32, chain u32,
/// body CRC-32C u32, CRC-32C of the 28 bytes before.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(crate) struct FrameHeader {
    /// What the payload is.
    pub(crate) kind: FrameKind,
    /// Length of the payload, without guards.
    pub(crate) payload_length: u32,
    /// Number of the record, from 1.
    pub(crate) position: u64,
    /// How many records before this one were written together with it. All records before those were durable, which
    /// distinguishes a torn tail from a damaged durable record.
    pub(crate) group_index: u32,
    /// Header CRC of the record before, [`FIRST_CHAIN`] for the first.
    pub(crate) chain: u32,
    /// CRC-32C of the body.
    pub(crate) body_crc: u32,
}

impl FrameHeader {
    pub(crate) fn encode(&self) -> [u8; FRAME_HEADER_LENGTH] {
        let mut bytes = [0; FRAME_HEADER_LENGTH];
        bytes[0] = self.kind as u8;
        bytes[1] = FRAME_VERSION;
        bytes[4..8].copy_from_slice(&self.payload_length.to_le_bytes());
        bytes[8..16].copy_from_slice(&self.position.to_le_bytes());
        bytes[16..20].copy_from_slice(&self.group_index.to_le_bytes());
        bytes[20..24].copy_from_slice(&self.chain.to_le_bytes());
        bytes[24..28].copy_from_slice(&self.body_crc.to_le_bytes());
        let crc = crc32c::crc32c(&bytes[..28]);
        bytes[28..].copy_from_slice(&crc.to_le_bytes());
        bytes
    }

    /// The header at the start of `bytes`, if it is complete and valid.
    pub(crate) fn decode(bytes: &[u8]) -> Option<FrameHeader> {
        let bytes = bytes.get(..FRAME_HEADER_LENGTH)?;
        let kind = match bytes[0] {
            b'O' => FrameKind::Observations,
            b'U' => FrameKind::UpdateStart,
            _ => return None,
        };
        let payload_length = u32_at(bytes, 4);
        let sound = bytes[1] == FRAME_VERSION
            && bytes[2..4] == [0, 0]
            && payload_length as usize <= PAYLOAD_MAX
            && u32_at(bytes, 28) == crc32c::crc32c(&bytes[..28]);
        sound.then(|| FrameHeader {
            kind,
            payload_length,
            position: u64_at(bytes, 8),
            group_index: u32_at(bytes, 16),
            chain: u32_at(bytes, 20),
            body_crc: u32_at(bytes, 24),
        })
    }

    /// The chain of the next record.
    pub(crate) fn next_chain(&self) -> u32 {
        u32_at(&self.encode(), 28)
    }

    /// Length of the frame, header and guards included.
    pub(crate) fn frame_length(&self) -> usize {
        FRAME_HEADER_LENGTH + body_length(self.payload_length as usize)
    }
}
