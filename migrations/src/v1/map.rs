//! A map: its fixed properties and its content after an update.
//!
//! Invariant: a double is kept as its bits (`fixed64`), so that every bit is preserved.

/// Whose sequence of observations.
#[derive(Clone, PartialEq, prost::Message)]
pub struct ProducerKey {
    #[prost(string, tag = "1")]
    pub producer: String,
    /// One of its labels.
    #[prost(string, tag = "2")]
    pub label: String,
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
