//! A map: its fixed properties and its content after an update.
//!
//! Invariant: a double is kept as its bits (`fixed64`), so that every bit is preserved.

/// Identifies a sequence of observations.
#[derive(Clone, PartialEq, prost::Message)]
pub struct ProducerKey {
    #[prost(string, tag = "1")]
    pub producer: String,
    /// Label of the sequence.
    #[prost(string, tag = "2")]
    pub label: String,
}

/// The newest observation of a state.
#[derive(Clone, PartialEq, prost::Message)]
pub struct LastObservation {
    #[prost(sint64, tag = "1")]
    pub nanos: i64,
    /// Value of the observation, as bits of f64.
    #[prost(fixed64, tag = "2")]
    pub value_bits: u64,
}

/// Sums over a state's observations.
#[derive(Clone, PartialEq, prost::Message)]
pub struct Accumulator {
    /// Number of observations.
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
    /// Number of observations that the model was trained on.
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

/// The fixed properties of a map.
#[derive(Clone, PartialEq, prost::Message)]
pub struct MapSpec {
    #[prost(string, tag = "1")]
    pub name: String,
    /// IANA name of the time zone of the map.
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
    /// Time at which the map was created.
    #[prost(sint64, tag = "7")]
    pub created_nanos: i64,
    /// The time for which exact observations of named states are kept.
    #[prost(message, optional, tag = "8")]
    pub retention: Option<Retention>,
    /// The grid; absent: there is none.
    #[prost(message, optional, tag = "9")]
    pub grid: Option<GridSpec>,
    /// The age difference after which an observation has half the weight; 0: all have the same weight.
    #[prost(sint64, tag = "10")]
    pub half_life_nanos: i64,
    /// The prediction of an untrained state.
    #[prost(fixed64, tag = "11")]
    pub prior_bits: u64,
    /// The models that the nightly update chooses among besides the spectral one, one bit each: 1 histograms, 2 the
    /// calibrated model, 4 the periodic mixture of Gaussians, 8 warped hypertime by expectation-maximisation, 16 by
    /// k-means, 32 the rate of counts.
    #[prost(uint32, tag = "12")]
    pub models: u32,
    /// Whether observations before 1990 are refused.
    #[prost(bool, tag = "13")]
    pub has_real_clock: bool,
}

/// The header of a snapshot.
#[derive(Clone, Copy, PartialEq, prost::Message)]
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
    /// Number of rows of the site that follow.
    #[prost(uint32, tag = "8")]
    pub table_rows: u32,
}

/// The sensor of a producer that differs from the sensor of the map, or the sensor of a state, where occupied means 1.
#[derive(Clone, Copy, PartialEq, prost::Message)]
pub struct Sensor {
    /// P(reads occupied | is occupied).
    #[prost(fixed64, tag = "1")]
    pub hit_bits: u64,
    /// P(reads occupied | is free).
    #[prost(fixed64, tag = "2")]
    pub false_alarm_bits: u64,
}

/// A new producer.
#[derive(Clone, PartialEq, prost::Message)]
pub struct NewProducer {
    #[prost(string, tag = "1")]
    pub producer: String,
    /// Label of the new sequence.
    #[prost(string, tag = "2")]
    pub label: String,
    /// The sensor of all scans of the producer; absent: the sensor of the map.
    #[prost(message, optional, tag = "3")]
    pub sensor: Option<Sensor>,
    /// The client that introduces the producer, as shares count clients; empty: a client without a share.
    #[prost(string, tag = "4")]
    pub introduced_by: String,
}

/// The durable part of a producer's sequence.
#[derive(Clone, PartialEq, prost::Message)]
pub struct Producer {
    #[prost(uint32, tag = "1")]
    pub id: u32,
    /// Name of the producer and label of its sequence.
    #[prost(message, optional, tag = "2")]
    pub key: Option<ProducerKey>,
    /// Highest incarnation received.
    #[prost(uint64, tag = "3")]
    pub incarnation: u64,
    /// All observations up to this sequence number are durable or refused.
    #[prost(uint64, tag = "4")]
    pub durable_sequence: u64,
    /// Running CRC-32C of the producer's observations.
    #[prost(fixed32, tag = "5")]
    pub content_crc: u32,
    /// The sensor of all scans of the producer; absent: the sensor of the map.
    #[prost(message, optional, tag = "6")]
    pub sensor: Option<Sensor>,
    /// Sequence numbers before `durable_sequence` at which the running CRC is known, ascending.
    #[prost(uint64, repeated, tag = "7")]
    pub recent_sequences: Vec<u64>,
    /// The running CRC at each of `recent_sequences`.
    #[prost(fixed32, repeated, tag = "8")]
    pub recent_crcs: Vec<u32>,
    /// Time at which the producer's newest observation was received, nanoseconds UTC.
    #[prost(sfixed64, tag = "9")]
    pub received_nanos: i64,
    /// Whether the producer has sent scans.
    #[prost(bool, tag = "10")]
    pub has_scans: bool,
    /// Latest time of the producer's observations that did not have to wait, nanoseconds UTC, in a map whose states do
    /// not all report samples.
    #[prost(sfixed64, tag = "11")]
    pub newest_nanos: i64,
    /// Whether the producer has given its place up.
    #[prost(bool, tag = "12")]
    pub is_forgotten: bool,
    /// The client that introduced the producer, as shares count clients; empty: a client without a share.
    #[prost(string, tag = "13")]
    pub introduced_by: String,
}

/// The time for which exact observations are kept.
#[derive(Clone, Copy, PartialEq, prost::Message)]
pub struct Retention {
    /// 0 not at all, 1 for a duration, 2 for ever.
    #[prost(uint32, tag = "1")]
    pub kind: u32,
    /// The duration; 0 for the other kinds.
    #[prost(sint64, tag = "2")]
    pub nanos: i64,
}

/// The fixed properties of a grid.
#[derive(Clone, PartialEq, prost::Message)]
pub struct GridSpec {
    /// Frame id.
    #[prost(string, tag = "1")]
    pub frame_id: String,
    /// Whether the grid has the layer z = 0 only.
    #[prost(bool, tag = "2")]
    pub is_flat: bool,
    /// Edge of a cell in metres.
    #[prost(fixed64, tag = "3")]
    pub resolution_bits: u64,
    /// Lower corner of cell (0, 0, 0) in metres: three.
    #[prost(fixed64, repeated, tag = "4")]
    pub origin_bits: Vec<u64>,
    /// The cells that the grid may have; absent: the grid grows.
    #[prost(message, optional, tag = "5")]
    pub extent: Option<CellBox>,
    /// P(reads occupied | is occupied).
    #[prost(fixed64, tag = "6")]
    pub hit_bits: u64,
    /// P(reads occupied | is free).
    #[prost(fixed64, tag = "7")]
    pub false_alarm_bits: u64,
    /// P(is occupied).
    #[prost(fixed64, tag = "8")]
    pub prior_bits: u64,
    /// The time for which exact readings are kept.
    #[prost(message, optional, tag = "9")]
    pub retention: Option<Retention>,
    /// Half-life of readings; 0: all readings have the same weight.
    #[prost(int64, tag = "10")]
    pub half_life_nanos: i64,
}

/// A box of cells.
#[derive(Clone, PartialEq, prost::Message)]
pub struct CellBox {
    /// Lowest cell: x, y, z.
    #[prost(sint32, repeated, tag = "1")]
    pub min: Vec<i32>,
    /// The indices after those of the highest cell: x, y, z.
    #[prost(sint32, repeated, tag = "2")]
    pub max: Vec<i32>,
}

/// One state.
#[derive(Clone, PartialEq, prost::Message)]
pub struct State {
    #[prost(uint32, tag = "1")]
    pub id: u32,
    #[prost(string, tag = "2")]
    pub name: String,
    /// Kind of the state: 0 probability, 1 continuous, 2 count, 3 the probability of a label, which has the name
    /// NAME/LABEL.
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
    /// The newest observation; absent if there is none.
    #[prost(message, optional, tag = "7")]
    pub last: Option<LastObservation>,
    /// The accumulator without its spectrum.
    #[prost(message, optional, tag = "8")]
    pub accumulator: Option<Accumulator>,
    /// Four doubles of eight bytes for each periodicity.
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
    /// The training data and models apart from the spectrum, a message with the fields of `AlternativesParts` of
    /// `tidemap-model`; absent while the state is untrained.
    #[prost(bytes = "vec", optional, tag = "14")]
    pub alternatives: Option<Vec<u8>>,
    /// All readings, if they are few; then there is no spectrum.
    #[prost(message, optional, tag = "15")]
    pub short: Option<ShortRecord>,
    /// The unusual observations among those that were learned; absent if there are none.
    #[prost(message, optional, tag = "16")]
    pub surprises: Option<Surprises>,
    /// The learned data for short-term forecasts, a message with the fields of `Belief` of `tidemap-model`; absent
    /// while the state is untrained.
    #[prost(bytes = "vec", optional, tag = "20")]
    pub belief: Option<Vec<u8>>,
    /// The recent readings in spans of 16 bytes: nanoseconds of the first reading (8), milliseconds from it to the last
    /// reading (4), number of readings of 1 (2) and of 0 (2).
    #[prost(bytes = "vec", tag = "21")]
    pub recent: Vec<u8>,
    /// The sensor that was stated for the state; only of kind 0.
    #[prost(message, optional, tag = "22")]
    pub sensor: Option<Sensor>,
    /// The reporting of the state and the learned data of its rows; absent unless the rows are changes or events.
    #[prost(message, optional, tag = "23")]
    pub rows: Option<super::rows::Rows>,
}

/// Runs of observations of a state that its model did not expect before it learned them.
#[derive(Clone, PartialEq, prost::Message)]
pub struct Surprises {
    /// The runs, ascending by the first time; at most 64.
    #[prost(message, repeated, tag = "1")]
    pub runs: Vec<SurpriseRun>,
    /// Whether the run with the newest observation continues with the next unusual one.
    #[prost(bool, tag = "2")]
    pub is_open: bool,
    /// Number of runs that were removed to make room.
    #[prost(uint64, tag = "3")]
    pub dropped: u64,
}

/// A run of observations that begins with an unusual one.
#[derive(Clone, Copy, PartialEq, prost::Message)]
pub struct SurpriseRun {
    /// Time of the first observation, nanoseconds UTC.
    #[prost(sfixed64, tag = "1")]
    pub first_nanos: i64,
    /// Time from the first to the last observation, nanoseconds.
    #[prost(uint64, tag = "2")]
    pub length_nanos: u64,
    /// Number of observations that were not expected.
    #[prost(uint64, tag = "3")]
    pub observations: u64,
    /// Whether the observations lie above the prediction.
    #[prost(bool, tag = "4")]
    pub is_above: bool,
    /// The value of the most surprising observation.
    #[prost(fixed64, tag = "5")]
    pub value_bits: u64,
    /// The model's prediction for this observation: the probability of 1, or of a value at least as far from the
    /// prediction.
    #[prost(fixed64, tag = "6")]
    pub probability_bits: u64,
    /// The probability of the observed value; absent if it equals `probability_bits`.
    #[prost(fixed64, optional, tag = "7")]
    pub observed_bits: Option<u64>,
    /// The surprise of all half-hour bins, in bits.
    #[prost(fixed64, tag = "8")]
    pub surprise_bits: u64,
}

/// All readings of a state with few readings. Its spectrum follows from them.
#[derive(Clone, PartialEq, prost::Message)]
pub struct ShortRecord {
    /// For each reading the local civil time in nanoseconds since 1970-01-01T00:00 local, 8 bytes, and the value, a
    /// double of 8 bytes; little-endian.
    #[prost(bytes = "vec", tag = "1")]
    pub readings: Vec<u8>,
    /// The number of readings of each batch that was folded in.
    #[prost(uint32, repeated, tag = "2")]
    pub batches: Vec<u32>,
}
