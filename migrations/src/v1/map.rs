//! A map: its fixed properties and its content after an update.
//!
//! Invariant: a double is kept as its bits (`fixed64`), so that every bit is preserved.

/// The fixed properties of a map.
#[derive(Clone, PartialEq, prost::Message)]
pub struct MapSpec {
    #[prost(string, tag = "1")]
    pub name: String,
    /// IANA name of its time zone.
    #[prost(string, tag = "2")]
    pub zone: String,
    /// Base period of the harmonics; 0 if the periodicities are a list.
    #[prost(sint64, tag = "3")]
    pub harmonics_base_nanos: i64,
    /// Number of harmonics; 0 if the periodicities are a list.
    #[prost(uint32, tag = "4")]
    pub harmonics_count: u32,
    /// Periods, if the periodicities are a list.
    #[prost(sint64, repeated, tag = "5")]
    pub period_nanos: Vec<i64>,
    /// 1 squared error, 2 zero-one.
    #[prost(uint32, tag = "6")]
    pub criterion: u32,
    /// When it was created.
    #[prost(sint64, tag = "7")]
    pub created_nanos: i64,
}

/// What a snapshot says about itself.
#[derive(Clone, PartialEq, prost::Message)]
pub struct Snapshot {
    /// Log position of the update's start.
    #[prost(uint64, tag = "1")]
    pub position: u64,
    /// Log position from which pending observations are read again.
    #[prost(uint64, tag = "2")]
    pub replay_from: u64,
    /// Number of the generation.
    #[prost(uint64, tag = "3")]
    pub generation: u64,
    /// Cut of the last update.
    #[prost(sint64, tag = "4")]
    pub cut_nanos: i64,
    /// Greatest time of any observation.
    #[prost(sint64, tag = "5")]
    pub newest_nanos: i64,
    /// Number of producers.
    #[prost(uint32, tag = "6")]
    pub producers: u32,
    /// Number of states.
    #[prost(uint32, tag = "7")]
    pub states: u32,
}

/// Whose sequence of observations.
#[derive(Clone, PartialEq, prost::Message)]
pub struct ProducerKey {
    #[prost(string, tag = "1")]
    pub producer: String,
    /// One of its labels.
    #[prost(string, tag = "2")]
    pub label: String,
}

/// How far a producer's sequence is durable.
#[derive(Clone, PartialEq, prost::Message)]
pub struct Producer {
    #[prost(uint32, tag = "1")]
    pub id: u32,
    /// Its key.
    #[prost(message, optional, tag = "2")]
    pub key: Option<ProducerKey>,
    /// Highest incarnation seen.
    #[prost(uint64, tag = "3")]
    pub incarnation: u64,
    /// Everything up to here is durable or refused.
    #[prost(uint64, tag = "4")]
    pub durable_sequence: u64,
    /// Running CRC-32C of its observations.
    #[prost(fixed32, tag = "5")]
    pub content_crc: u32,
}

/// One state. In the index it has no `spectrum`; the chunks of that have keys of their own.
#[derive(Clone, PartialEq, prost::Message)]
pub struct State {
    #[prost(uint32, tag = "1")]
    pub id: u32,
    #[prost(string, tag = "2")]
    pub name: String,
    /// Its kind: 0 probability; from format 2 on as in [`super::event::NewState`].
    #[prost(uint32, tag = "3")]
    pub kind: u32,
    /// Observations acknowledged.
    #[prost(uint64, tag = "4")]
    pub observations: u64,
    /// Persistence: pairs of successive observations.
    #[prost(uint64, tag = "5")]
    pub pairs: u64,
    /// Persistence: summed rate of change.
    #[prost(fixed64, tag = "6")]
    pub change_rate_sum_bits: u64,
    /// The newest observation, where there is one.
    #[prost(message, optional, tag = "7")]
    pub last: Option<LastObservation>,
    /// The accumulator without its spectrum.
    #[prost(message, optional, tag = "8")]
    pub accumulator: Option<Accumulator>,
    /// Per periodicity four doubles of eight bytes.
    #[prost(bytes = "vec", tag = "9")]
    pub spectrum: Vec<u8>,
    /// The spectral model.
    #[prost(message, optional, tag = "10")]
    pub spectral: Option<Spectral>,
    /// Number of components in force.
    #[prost(uint32, tag = "11")]
    pub order: u32,
    /// Faded sums of errors, orders 0 to 15.
    #[prost(fixed64, repeated, tag = "12")]
    pub error_sums_bits: Vec<u64>,
    /// Last local day recorded in the errors, in days since 1970-01-01.
    #[prost(sint32, optional, tag = "13")]
    pub errors_last_day: Option<i32>,
}

/// The newest observation of a state.
#[derive(Clone, PartialEq, prost::Message)]
pub struct LastObservation {
    #[prost(sint64, tag = "1")]
    pub nanos: i64,
    /// Its value.
    #[prost(fixed64, tag = "2")]
    pub value_bits: u64,
}

/// Sums over a state's observations.
#[derive(Clone, PartialEq, prost::Message)]
pub struct Accumulator {
    /// Their number.
    #[prost(uint64, tag = "1")]
    pub observations: u64,
    /// Sum of values.
    #[prost(fixed64, tag = "2")]
    pub sum_bits: u64,
    /// Sum of squares of values.
    #[prost(fixed64, tag = "3")]
    pub sum_squares_bits: u64,
    /// Earliest time.
    #[prost(sint64, tag = "4")]
    pub first_nanos: i64,
    /// Latest time.
    #[prost(sint64, tag = "5")]
    pub last_nanos: i64,
    /// Number of periodicities in the spectrum.
    #[prost(uint32, tag = "6")]
    pub periodicities: u32,
}

/// A spectral model.
#[derive(Clone, PartialEq, prost::Message)]
pub struct Spectral {
    #[prost(fixed64, tag = "1")]
    pub mean_bits: u64,
    /// Number of observations it was fitted to.
    #[prost(uint64, tag = "2")]
    pub observations: u64,
    /// Components, strongest first.
    #[prost(message, repeated, tag = "3")]
    pub components: Vec<Component>,
}

/// One component of a spectral model.
#[derive(Clone, PartialEq, prost::Message)]
pub struct Component {
    /// Index of the periodicity.
    #[prost(uint32, tag = "1")]
    pub periodicity: u32,
    /// Real part of the coefficient.
    #[prost(fixed64, tag = "2")]
    pub re_bits: u64,
    /// Imaginary part of the coefficient.
    #[prost(fixed64, tag = "3")]
    pub im_bits: u64,
}
